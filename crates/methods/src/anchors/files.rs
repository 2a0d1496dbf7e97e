//! The files of anchors: `anchors.safetensors`, and checkpoints, which hold the state of the
//! training too. Both are named arrays with a description in JSON.

use luxel_core::{ColorModel, Knots, RESPONSE_KNOTS, RasterConfig, Scene};
use luxel_train::{ANCHOR_FORMAT, ArrayFile, FileArray, TrainConfig, TrainError};
use serde::{Deserialize, Serialize};

use super::{AnchorArray, AnchorScene, AnchorSnapshot};
use crate::place::PlaceRecord;
use crate::{FileError, Tensors};

/// Name of the array of the camera's response.
const RESPONSE: &str = "response";

/// A run that can be continued.
pub struct AnchorCheckpoint {
    pub(super) config: TrainConfig,
    pub(super) fingerprint: String,
    /// Number of steps done.
    pub(super) step: u32,
    pub(super) snapshot: AnchorSnapshot,
}

/// The state of a run, without its arrays.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TrainingRecord {
    pub(super) config: TrainConfig,
    /// Digest of the data set.
    pub(super) fingerprint: String,
    pub(super) step: u32,
    /// The trainer's state as JSON.
    pub(super) state: String,
}

#[derive(Serialize, Deserialize)]
struct Description {
    color_model: ColorModel,
    raster: RasterConfig,
    #[serde(flatten)]
    place: PlaceRecord,
    /// Only in checkpoints.
    training: Option<TrainingRecord>,
}

/// Returns the file of anchors alone.
pub(super) fn of_scene(place: &Scene, scene: &AnchorScene, response: Option<&Knots>) -> Result<ArrayFile, TrainError> {
    of_arrays(place, scene.color_model(), scene.arrays(), response, None)
}

/// Returns the file of a checkpoint.
pub(super) fn of_run(place: &Scene, response: Option<&Knots>, checkpoint: AnchorCheckpoint) -> Result<ArrayFile, TrainError> {
    let AnchorCheckpoint { config, fingerprint, step, snapshot: AnchorSnapshot { color_model, arrays, state_json } } = checkpoint;
    of_arrays(place, color_model, arrays, response, Some(TrainingRecord { config, fingerprint, step, state: state_json }))
}

fn of_arrays(
    place: &Scene,
    color_model: ColorModel,
    arrays: Vec<AnchorArray>,
    response: Option<&Knots>,
    training: Option<TrainingRecord>,
) -> Result<ArrayFile, TrainError> {
    let description = Description { color_model, raster: place.raster, place: PlaceRecord::of(place), training };
    let description = serde_json::to_string(&description).map_err(|error| TrainError::State(error.to_string()))?;
    let rows = |AnchorArray { name, width, values }| FileArray { name, shape: vec![values.len() / width.max(1), width], values };
    let of_response = response.map(|knots| FileArray {
        name: RESPONSE.to_owned(),
        shape: vec![3, RESPONSE_KNOTS],
        values: knots.as_flattened().to_vec(),
    });
    Ok(ArrayFile { format: ANCHOR_FORMAT, description, arrays: arrays.into_iter().map(rows).chain(of_response).collect() })
}

/// The content of a file of anchors.
#[derive(Clone, Debug, PartialEq)]
pub struct AnchorFile {
    /// The anchors with their networks.
    pub scene: AnchorScene,
    /// The camera's response, if it was learned.
    pub response: Option<Knots>,
    /// Units, place and settings of the rasteriser: a scene without splats.
    pub place: Scene,
}

/// Reads anchors, or those of a checkpoint.
///
/// # Errors
/// A description or arrays of something else.
pub fn read_anchors(description: &str, tensors: Tensors) -> Result<AnchorFile, FileError> {
    let description = described(description)?;
    let (mut arrays, response) = arrays_of(tensors)?;
    let scene = AnchorScene::from_arrays(description.color_model, &mut arrays).map_err(FileError::new)?;
    Ok(AnchorFile { scene, response, place: Scene { raster: description.raster, ..description.place.scene()? } })
}

/// Reads a checkpoint.
///
/// # Errors
/// Those of [`read_anchors`]; a file without the state of a training.
pub fn read_anchor_run(description: &str, tensors: Tensors) -> Result<AnchorCheckpoint, FileError> {
    let description = described(description)?;
    let (arrays, _) = arrays_of(tensors)?;
    let training = description.training.ok_or_else(|| FileError::new("holds anchors without their training"))?;
    let TrainingRecord { config, fingerprint, step, state } = training;
    // Whatever is damaged shows before the run is changed.
    AnchorScene::from_arrays(description.color_model, &mut arrays.clone()).map_err(FileError::new)?;
    let snapshot = AnchorSnapshot { color_model: description.color_model, arrays, state_json: state };
    Ok(AnchorCheckpoint { config, fingerprint, step, snapshot })
}

fn described(description: &str) -> Result<Description, FileError> {
    serde_json::from_str(description).map_err(|error| FileError::new(format!("not the description of anchors: {error}")))
}

/// Returns the arrays of a file, apart from the camera's response.
fn arrays_of(tensors: Tensors) -> Result<(Vec<AnchorArray>, Option<Knots>), FileError> {
    let mut response = None;
    let mut arrays = Vec::with_capacity(tensors.len());
    for (name, (shape, values)) in tensors {
        if name == RESPONSE {
            let knots: Option<[[f32; RESPONSE_KNOTS]; 3]> = values.as_chunks().0.try_into().ok();
            response = Some(knots.ok_or_else(|| FileError::new(format!("a response of {} numbers", values.len())))?);
        } else {
            arrays.push(AnchorArray { name, width: shape.get(1).copied().unwrap_or(1), values });
        }
    }
    Ok((arrays, response))
}
