//! The state of a run besides its arrays, as JSON in [`luxel_core::Snapshot::state_json`]; with it,
//! a run resumes bit for bit.

use std::collections::BTreeMap;

use luxel_core::{Dataset, Knots, RadianceScale, Snapshot};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

use crate::camera_response::CameraResponse;
use crate::companion::{self, RunOf};
use crate::config::ExposureCompensation;
use crate::crop::{Crop, Shape};
use crate::gains::Gains;
use crate::poses::{Corrections, Poses};
use crate::step_method::{MethodState, StepMethods, resumed};
use crate::validation_views::Fit;
use crate::view_order::{Cursors, first_order};
use crate::vignetting::{LensVignetting, Lenses, Vignettings};
use crate::{Schedule, TrainConfig, TrainError};

/// Version of the format of [`State`]; a state of another version is refused with a clear message.
const VERSION: u32 = 3;

/// Constant that separates the random stream of crops from others of the same seed.
const CROP_STREAM: u64 = 0x6c75_7865_6c02;
/// Constant that separates the random stream of dropout from others of the same seed.
const DROPOUT_STREAM: u64 = 0x6c75_7865_6c03;
/// Factor that separates the streams of slots: the golden ratio in 64 bits.
const SLOT_STREAM: u64 = 0x9e37_79b9_7f4a_7c15;

/// The state of a run, without its arrays.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct State {
    version: u32,
    pub(crate) config: TrainConfig,
    /// Number of steps that the schedule is planned for: that of the first start, even if
    /// `config.iterations` changed since.
    pub(crate) planned_iterations: u32,
    /// Number of steps done.
    pub(crate) iteration: u32,
    pub(crate) extent: f32,
    pub(crate) radiance_scale: RadianceScale,
    pub(crate) fingerprint: String,
    pub(crate) rng: Pcg64Mcg,
    /// Number of states in the snapshot's average; 0 if there is no average yet.
    pub(crate) averaged: u32,
    /// Gains of the training images; `None` if they are not optimised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) gains: Option<Gains>,
    /// Response of the camera that captured the images; `None` if they are radiance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) response: Option<CameraResponse>,
    /// Vignetting of the training images' lenses; `None` if it is not optimised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) vignetting: Option<Vignettings>,
    /// Numbers that a method trains beside splats, in a checkpoint alone; `None` for most methods.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) networks: Option<MethodState>,
    /// Corrections of the training images' poses; `None` if they are fixed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) poses: Option<Corrections>,
    /// Radius of free space of each training view's camera, world units; empty if splats may be
    /// anywhere.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) clearances: Vec<f32>,
    /// The lead of trained views over validation views so far; `None` if none are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) fit: Option<Fit>,
    /// Order of the training views in their current epochs, part after part
    /// ([`crate::view_order`]).
    order: Vec<u32>,
    /// Number of views of each part's epoch that have been used.
    cursor: Cursors,
}

/// The starting point of a run.
pub(crate) struct Start {
    pub(crate) config: TrainConfig,
    pub(crate) extent: f32,
    pub(crate) radiance_scale: RadianceScale,
    pub(crate) response: Option<CameraResponse>,
    /// Radius of free space of each training view's camera, world units; empty if splats may be
    /// anywhere.
    pub(crate) clearances: Vec<f32>,
}

impl State {
    pub(crate) fn new(dataset: &Dataset, start: Start) -> Self {
        let Start { config, extent, radiance_scale, response, clearances } = start;
        let (order, cursor) = first_order(dataset.train.len(), config.batch as usize);
        let gains = (config.exposure_compensation != ExposureCompensation::Off).then(|| Gains::ones(dataset.train.len()));
        Self {
            version: VERSION,
            planned_iterations: config.iterations,
            iteration: 0,
            averaged: 0,
            extent,
            radiance_scale,
            fingerprint: dataset.fingerprint.clone(),
            rng: Pcg64Mcg::seed_from_u64(config.seed),
            gains,
            response,
            vignetting: config.vignetting.then(|| Vignettings::none(&Lenses::new(dataset))),
            networks: None,
            poses: config.refine_poses.then(|| Corrections::none(&Poses::of_views(dataset, extent), config.refine_focal)),
            clearances,
            fit: None,
            order,
            cursor,
            config,
        }
    }

    /// Returns the indices of the next step's training views, one a slot of the batch. The order is
    /// shuffled, and each view comes once per epoch of its part.
    pub(crate) fn next_views(&mut self, validation: &[usize]) -> Vec<usize> {
        self.cursor.next_views(&mut self.order, &mut self.rng, validation)
    }

    /// Returns the view of `slot` that [`Self::next_views`] would return now. At the end of an
    /// epoch, random numbers drawn until then may still change it.
    pub(crate) fn upcoming_view(&self, slot: usize, validation: &[usize]) -> usize {
        self.cursor.upcoming_view(&self.order, &self.rng, slot, validation)
    }

    /// Returns the gain of training view `index`.
    pub(crate) fn gain(&self, index: usize) -> [f32; 3] {
        self.gains.as_ref().map_or([1.0; 3], |gains| gains.gain(index))
    }

    /// Returns the seed of a step's noise, which depends on the run's seed and the step alone.
    pub(crate) fn noise_seed(&self, step: u32) -> u64 {
        Pcg64Mcg::seed_from_u64(self.config.seed ^ (u64::from(step) << 32)).random()
    }

    /// Returns the part of its view that a slot of `step` sees, if not all of it; it depends on the
    /// run's seed, the step and the slot alone.
    pub(crate) fn crop(&self, step: u32, slot: usize) -> Option<Crop> {
        let stream = CROP_STREAM ^ (slot as u64).wrapping_mul(SLOT_STREAM);
        let seed = || Pcg64Mcg::seed_from_u64(self.config.seed ^ (u64::from(step) << 32) ^ stream).random();
        let tile = self.config.crop.map(|side_px| Shape::Tile { side_px });
        let is_strip = || Schedule::new(&self.config, self.planned_iterations, self.extent).takes_strips(step);
        let shape = tile.or_else(|| is_strip().then_some(Shape::Strip))?;
        Some(Crop { shape, seed: seed() })
    }

    /// Returns the seed of the splats that `step` leaves out, which depends on the run's seed and
    /// the step alone.
    pub(crate) fn dropout_seed(&self, step: u32) -> u32 {
        Pcg64Mcg::seed_from_u64(self.config.seed ^ (u64::from(step) << 32) ^ DROPOUT_STREAM).random()
    }

    /// Returns the state as text, with what a method trains beside splats.
    pub(crate) fn to_json(&self, networks: Option<MethodState>) -> Result<String, TrainError> {
        serde_json::to_string(&Self { networks, ..self.clone() }).map_err(|error| TrainError::State(error.to_string()))
    }

    /// Reads the state of a snapshot and checks it against the data set that the run resumes with.
    pub(crate) fn from_snapshot(snapshot: &Snapshot, dataset: &Dataset) -> Result<Self, TrainError> {
        let state = Self::parse(&snapshot.state_json)?;
        let (scene, config) = (snapshot.scene.splats.color_model, state.config.color_model());
        if scene != config {
            return Err(TrainError::ColorModel { scene: scene.name(), config: config.name() });
        }
        state.check_data(dataset)?;
        if (state.averaged > 0) != snapshot.average.is_some() {
            return Err(TrainError::State("the average of the parameters is missing, or is there without being counted".to_owned()));
        }
        if !state.clearances.is_empty() && state.clearances.len() != dataset.train.len() {
            let (found, expected) = (state.clearances.len(), dataset.train.len());
            return Err(TrainError::State(format!("free space around {found} cameras, expected {expected}")));
        }
        let run = state.run_of(dataset);
        companion::check(state.gains.as_ref(), &run)?;
        companion::check(state.vignetting.as_ref(), &run)?;
        companion::check(state.poses.as_ref(), &run)?;
        Ok(state)
    }

    /// Checks that the state is of a run on this data set.
    pub(crate) fn check_data(&self, dataset: &Dataset) -> Result<(), TrainError> {
        if self.fingerprint != dataset.fingerprint {
            return Err(TrainError::Fingerprint { checkpoint: self.fingerprint.clone(), dataset: dataset.fingerprint.clone() });
        }
        if !self.cursor.fit(&self.order, dataset.train.len(), self.config.batch as usize) {
            return Err(TrainError::State(format!("the order of views is not one of the data set's {} views", dataset.train.len())));
        }
        companion::check(self.response.as_ref(), &self.run_of(dataset))
    }

    /// Returns the run that the companions are of, on a data set.
    fn run_of<'a>(&'a self, dataset: &'a Dataset) -> RunOf<'a> {
        RunOf { dataset, config: &self.config, extent: self.extent }
    }

    pub(crate) fn parse(json: &str) -> Result<Self, TrainError> {
        /// The version alone, to tell another version from a damaged file.
        #[derive(Deserialize)]
        struct Header {
            version: u32,
        }
        let header: Header = serde_json::from_str(json).map_err(|error| TrainError::State(error.to_string()))?;
        if header.version != VERSION {
            let found = header.version;
            return Err(TrainError::State(format!("version {found}, expected {VERSION}; resume with the program that wrote it")));
        }
        /// The options that it has: a run from before `early_end` makes all its steps.
        #[derive(Deserialize)]
        struct Options {
            config: BTreeMap<String, IgnoredAny>,
        }
        let options: Options = serde_json::from_str(json).map_err(|error| TrainError::State(error.to_string()))?;
        let mut state: Self = serde_json::from_str(json).map_err(|error| TrainError::State(error.to_string()))?;
        state.config.early_end = state.config.early_end.filter(|_| options.config.contains_key("early_end"));
        state.config.validate()?;
        if !(state.extent.is_finite() && state.extent > 0.0) {
            return Err(TrainError::State(format!("extent is {}, expected a number above 0", state.extent)));
        }
        Ok(state)
    }
}

/// Returns the configuration of the run that a snapshot was taken of.
///
/// # Errors
/// Returns [`TrainError::State`] if the state cannot be read.
pub fn snapshot_config(snapshot: &Snapshot) -> Result<TrainConfig, TrainError> {
    Ok(State::parse(&snapshot.state_json)?.config)
}

/// Returns the camera's response in a snapshot, or `None` if the run trains on radiance.
///
/// # Errors
/// Returns [`TrainError::State`] if the state cannot be read.
pub fn snapshot_response(snapshot: &Snapshot, methods: &dyn StepMethods) -> Result<Option<Knots>, TrainError> {
    let State { response, networks, config, .. } = State::parse(&snapshot.state_json)?;
    if let Some(response) = &response {
        response.validate()?;
        return Ok(Some(response.knots()));
    }
    let method = resumed(methods, networks.as_ref(), &config, snapshot.scene.splats.len())?;
    Ok(method.and_then(|method| method.response()))
}

/// Returns the vignetting of each lens in a snapshot of a run on `dataset`; empty if it is not
/// optimised.
///
/// # Errors
/// Returns [`TrainError::State`] if the state cannot be read or is of other lenses.
pub fn snapshot_vignetting(snapshot: &Snapshot, dataset: &Dataset) -> Result<Vec<LensVignetting>, TrainError> {
    let Some(vignetting) = State::parse(&snapshot.state_json)?.vignetting else { return Ok(Vec::new()) };
    let lenses = Lenses::new(dataset);
    vignetting.validate(&lenses)?;
    Ok(vignetting.report(&lenses))
}
