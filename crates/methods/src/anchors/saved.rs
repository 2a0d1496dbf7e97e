//! A run of anchors as named arrays and text, from which it resumes bit for bit, and the scene
//! alone in the same form.
//!
//! In and out: [`AnchorSnapshot`]. Degenerate: arrays that are missing, of other lengths or not
//! finite are errors that name them.

use luxel_core::ColorModel;
use luxel_train::{MethodState, Representation, Scheme, TrainError, ViewState, ViewTraining};
use serde::{Deserialize, Serialize};

use super::decoders::Decoders;
use super::groups::{GROUPS, Groups, NAMES, numbers};
use super::numbers::check_numbers;
use super::scene::{AnchorScene, Anchors};
use super::statistics::Statistics;
use super::{FEATURE, OFFSETS, SCALES, SPLATS_PER_ANCHOR};
use crate::captured::{Adam, GaussTone, SharedNetworks};

/// Names of the arrays besides those of the groups.
const POSITION: &str = "anchors.position";
const STATISTICS: [&str; 4] = ["statistics.gradient", "statistics.draws", "statistics.opacity", "statistics.views"];
const AVERAGE: &str = "average";

/// An array of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct AnchorArray {
    /// Name of the array.
    pub name: String,
    /// Numbers of a row: of an anchor, or 1.
    pub width: usize,
    /// The numbers, row by row.
    pub values: Vec<f32>,
}

/// A run, or its scene.
#[derive(Clone, Debug, PartialEq)]
pub struct AnchorSnapshot {
    /// Colour model of the splats.
    pub color_model: ColorModel,
    /// The arrays.
    pub arrays: Vec<AnchorArray>,
    /// The state of the run as JSON; empty for a scene alone.
    pub state_json: String,
}

/// All that a run consists of.
pub(super) struct Saved {
    pub(super) state: ViewState,
    pub(super) scene: AnchorScene,
    pub(super) progress: Progress,
}

/// All that anchors train besides the scene and what any training on views has.
pub(super) struct Progress {
    pub(super) groups: Groups,
    pub(super) statistics: Statistics,
    /// Side of a voxel, world units.
    pub(super) voxel: f32,
    /// Mean of the trained numbers over the steps so far, while it is being taken, one after
    /// another.
    pub(super) average: Option<Vec<f32>>,
    /// The tone networks of GaussHDR.
    pub(super) tone: Option<Box<GaussTone>>,
}

/// The state of a run besides its arrays.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Description {
    voxel: f32,
    /// [`ViewState`] as JSON.
    trainer: String,
}

/// Returns the number of a group's numbers that belong together.
fn width(group: usize) -> usize {
    [OFFSETS, FEATURE, SCALES].get(group).copied().unwrap_or(1)
}

impl AnchorScene {
    /// Returns the arrays of the scene.
    pub fn arrays(&self) -> Vec<AnchorArray> {
        let position = AnchorArray { name: POSITION.to_owned(), width: 3, values: self.anchors.position.as_flattened().to_vec() };
        let groups = numbers(self).into_iter().zip(NAMES).enumerate();
        let groups = groups.map(|(n, (values, name))| AnchorArray { name: name.to_owned(), width: width(n), values: values.to_vec() });
        [position].into_iter().chain(groups).collect()
    }

    /// Makes a scene of the arrays of a file, of which others may be there.
    ///
    /// # Errors
    /// [`TrainError::State`] for arrays that are missing or do not belong together.
    pub fn from_arrays(color_model: ColorModel, arrays: &mut Vec<AnchorArray>) -> Result<Self, TrainError> {
        if !color_model.is_valid() || color_model.max_degree() > 0 || color_model.check_trainable().is_err() {
            let name = color_model.name();
            return Err(TrainError::State(format!("colour model {name}, expected one of degree 0: networks see the direction")));
        }
        let position = take(arrays, POSITION)?;
        if !position.len().is_multiple_of(3) {
            return Err(TrainError::State(format!("{POSITION} has {} numbers, expected three an anchor", position.len())));
        }
        let mut groups = Vec::with_capacity(GROUPS);
        for name in NAMES {
            groups.push(take(arrays, name)?);
        }
        let [offset, feature, log_scale, opacity, shape, color, context]: [Vec<f32>; GROUPS] =
            groups.try_into().map_err(|_| TrainError::State("groups of numbers are missing".to_owned()))?;
        let anchors = Anchors { position: position.as_chunks().0.to_vec(), offset, feature, log_scale };
        let scene = Self { anchors, decoders: Decoders::from_weights(color_model, [opacity, shape, color], context) };
        scene.validate()?;
        Ok(scene)
    }
}

fn take(arrays: &mut Vec<AnchorArray>, name: &str) -> Result<Vec<f32>, TrainError> {
    match arrays.iter().position(|array| array.name == name) {
        Some(at) => Ok(arrays.swap_remove(at).values),
        None => Err(TrainError::State(format!("no array \"{name}\""))),
    }
}

/// Returns the name of an array of moments.
fn moments_name(order: &str, group: usize) -> String {
    format!("moments.{order}.{}", NAMES[group])
}

/// Writes a run.
pub(super) fn write(scene: &AnchorScene, training: &ViewTraining, progress: &Progress) -> Result<AnchorSnapshot, TrainError> {
    let Progress { groups, statistics, voxel, average, tone } = progress;
    let mut arrays = scene.arrays();
    for (group, adam) in groups.adam.iter().enumerate() {
        for (order, values) in ["first", "second"].into_iter().zip(adam.moments()) {
            arrays.push(AnchorArray { name: moments_name(order, group), width: width(group), values: values.to_vec() });
        }
    }
    let Statistics { gradient, draws, opacity, views } = statistics;
    for (name, values) in STATISTICS.into_iter().zip([gradient, draws, opacity, views]) {
        arrays.push(AnchorArray { name: name.to_owned(), width: 1, values: values.clone() });
    }
    if let Some(average) = average {
        arrays.push(AnchorArray { name: AVERAGE.to_owned(), width: 1, values: average.clone() });
    }
    let networks = tone.clone().map(|tone| MethodState::of(&SharedNetworks::GaussHdrAnchors(tone))).transpose()?;
    let description = Description { voxel: *voxel, trainer: training.to_json(networks)? };
    let state_json = serde_json::to_string(&description).map_err(|error| TrainError::State(error.to_string()))?;
    Ok(AnchorSnapshot { color_model: scene.color_model(), arrays, state_json })
}

/// Takes the tone networks out of a state that was read.
fn tone_of(state: &mut ViewState) -> Result<Option<Box<GaussTone>>, TrainError> {
    let networks = state.take_method().map(|networks| networks.numbers()).transpose()?;
    let spec = state.config().method.spec();
    match (networks, spec.representation == Representation::Anchors && spec.scheme == Scheme::Captured) {
        (None, false) => Ok(None),
        (Some(SharedNetworks::GaussHdrAnchors(tone)), true) => {
            tone.validate()?;
            Ok(Some(tone))
        }
        _ => Err(TrainError::State("the tone networks are missing, or are those of another method".to_owned())),
    }
}

impl Saved {
    /// Reads a run.
    pub(super) fn read(snapshot: AnchorSnapshot) -> Result<Self, TrainError> {
        let AnchorSnapshot { color_model, mut arrays, state_json } = snapshot;
        let Description { voxel, trainer } = serde_json::from_str(&state_json).map_err(|error| TrainError::State(error.to_string()))?;
        if !(voxel.is_finite() && voxel > 0.0) {
            return Err(TrainError::State(format!("a voxel of {voxel}, expected a number above 0")));
        }
        let mut state = ViewState::parse(&trainer)?;
        let tone = tone_of(&mut state)?;
        let (scene, config) = (color_model, state.config().color_model());
        if scene != config {
            return Err(TrainError::ColorModel { scene: scene.name(), config: config.name() });
        }
        let mut adam = Vec::with_capacity(GROUPS);
        for group in 0..GROUPS {
            let first = take(&mut arrays, &moments_name("first", group))?;
            let second = take(&mut arrays, &moments_name("second", group))?;
            adam.push(Adam::from_moments(first, second, state.iteration()));
        }
        let adam = adam.try_into().map_err(|_| TrainError::State("moments are missing".to_owned()))?;
        let average = if state.averaged() > 0 { Some(take(&mut arrays, AVERAGE)?) } else { None };
        let [gradient, draws, opacity, views] = STATISTICS;
        let statistics = Statistics {
            gradient: take(&mut arrays, gradient)?,
            draws: take(&mut arrays, draws)?,
            opacity: take(&mut arrays, opacity)?,
            views: take(&mut arrays, views)?,
        };
        let scene = AnchorScene::from_arrays(color_model, &mut arrays)?;
        let groups = Groups { adam };
        groups.validate(&scene)?;
        let anchors = scene.anchors.len();
        let lengths = [anchors * SPLATS_PER_ANCHOR, anchors * SPLATS_PER_ANCHOR, anchors, anchors];
        let Statistics { gradient, draws, opacity, views } = &statistics;
        for ((name, values), len) in STATISTICS.into_iter().zip([gradient, draws, opacity, views]).zip(lengths) {
            check_numbers(name, values, len)?;
        }
        if let Some(average) = &average {
            check_numbers(AVERAGE, average, numbers(&scene).iter().map(|numbers| numbers.len()).sum())?;
        }
        Ok(Self { state, scene, progress: Progress { groups, statistics, voxel, average, tone } })
    }
}
