//! What a run needs besides arrays to go on bit for bit, as JSON in [`luxel_core::Snapshot::state_json`].

use luxel_core::{Dataset, Knots, RadianceScale, Snapshot};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::camera_response::CameraResponse;
use crate::config::ExposureCompensation;
use crate::gains::Gains;
use crate::recorded::is_recorded;
use crate::{TrainConfig, TrainError};

/// Format of [`State`]: another one is refused with a clear message rather than misread.
const VERSION: u32 = 2;

/// The run, arrays apart.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct State {
    version: u32,
    pub(crate) config: TrainConfig,
    /// Steps the schedule is laid out for: those of the first start, whatever `config.iterations` became since.
    pub(crate) planned_iterations: u32,
    /// Steps done.
    pub(crate) iteration: u32,
    pub(crate) extent: f32,
    pub(crate) radiance_scale: RadianceScale,
    pub(crate) fingerprint: String,
    pub(crate) rng: Pcg64Mcg,
    /// States that the snapshot's average is the mean of; 0: there is none yet.
    pub(crate) averaged: u32,
    /// Of the training images; `None`: not compensated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) gains: Option<Gains>,
    /// Of the camera that recorded the images; `None`: they are radiance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) response: Option<CameraResponse>,
    /// Permutation of the training views that is being gone through.
    order: Vec<u32>,
    /// Views of it that have been used.
    cursor: usize,
}

/// What a run starts from.
pub(crate) struct Start {
    pub(crate) config: TrainConfig,
    pub(crate) extent: f32,
    pub(crate) radiance_scale: RadianceScale,
    pub(crate) response: Option<CameraResponse>,
}

impl State {
    pub(crate) fn new(dataset: &Dataset, start: Start) -> Self {
        let Start { config, extent, radiance_scale, response } = start;
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
            order: (0u32..).take(dataset.train.len()).collect(),
            // At the end: the first step shuffles.
            cursor: dataset.train.len(),
            config,
        }
    }

    /// Index of the training view of the next step: shuffled, each once before any twice.
    pub(crate) fn next_view(&mut self) -> usize {
        if self.cursor >= self.order.len() {
            self.order.shuffle(&mut self.rng);
            self.cursor = 0;
        }
        let view = self.order.get(self.cursor).copied().unwrap_or(0);
        self.cursor += 1;
        view as usize
    }

    /// Seed of one step's noise: of (seed, step) alone.
    pub(crate) fn noise_seed(&self, step: u32) -> u64 {
        Pcg64Mcg::seed_from_u64(self.config.seed ^ (u64::from(step) << 32)).random()
    }

    pub(crate) fn to_json(&self) -> Result<String, TrainError> {
        serde_json::to_string(self).map_err(|error| TrainError::State(error.to_string()))
    }

    /// The state of a snapshot, checked against the data set it is to go on with.
    pub(crate) fn of_snapshot(snapshot: &Snapshot, dataset: &Dataset) -> Result<Self, TrainError> {
        let state = Self::parse(&snapshot.state_json)?;
        if state.fingerprint != dataset.fingerprint {
            return Err(TrainError::Fingerprint { checkpoint: state.fingerprint, dataset: dataset.fingerprint.clone() });
        }
        let (scene, config) = (snapshot.scene.splats.color_model, state.config.color_model());
        if scene != config {
            return Err(TrainError::ColorModel { scene: scene.name(), config: config.name() });
        }
        let mut sorted = state.order.clone();
        sorted.sort_unstable();
        if !sorted.iter().copied().eq((0u32..).take(dataset.train.len())) || state.cursor > state.order.len() {
            return Err(TrainError::State(format!("the order of views is not one of the data set's {} views", dataset.train.len())));
        }
        if (state.averaged > 0) != snapshot.average.is_some() {
            return Err(TrainError::State("the average of the parameters is missing, or is there without being counted".to_owned()));
        }
        if let Some(gains) = &state.gains {
            gains.validate(dataset.train.len())?;
        }
        if let Some(response) = &state.response {
            response.validate()?;
        }
        let (is_compensated, wanted) = (state.gains.is_some(), state.config.exposure_compensation != ExposureCompensation::Off);
        if is_compensated != wanted || state.response.is_some() != is_recorded(&dataset.train)? {
            return Err(TrainError::State("gains or a camera's response are missing, or are there without being asked for".to_owned()));
        }
        Ok(state)
    }

    fn parse(json: &str) -> Result<Self, TrainError> {
        /// Enough to tell another version from a damaged file.
        #[derive(Deserialize)]
        struct Header {
            version: u32,
        }
        let header: Header = serde_json::from_str(json).map_err(|error| TrainError::State(error.to_string()))?;
        if header.version != VERSION {
            let found = header.version;
            return Err(TrainError::State(format!("version {found}, expected {VERSION}; resume with the program that wrote it")));
        }
        let state: Self = serde_json::from_str(json).map_err(|error| TrainError::State(error.to_string()))?;
        state.config.validate()?;
        if !(state.extent.is_finite() && state.extent > 0.0) {
            return Err(TrainError::State(format!("extent is {}, expected a number above 0", state.extent)));
        }
        Ok(state)
    }
}

/// The response of the camera as it was when a snapshot was taken; `None` of a run on radiance.
///
/// # Errors
/// [`TrainError::State`] if it cannot be read.
pub fn snapshot_response(snapshot: &Snapshot) -> Result<Option<Knots>, TrainError> {
    let response = State::parse(&snapshot.state_json)?.response;
    if let Some(response) = &response {
        response.validate()?;
    }
    Ok(response.as_ref().map(CameraResponse::knots))
}
