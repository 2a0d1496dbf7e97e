//! The files of anchors: `anchors.safetensors`, and checkpoints, which hold the state of the
//! training too. Both are files of arrays ([`luxel_io::write_arrays`]) with a description in JSON.

use std::path::Path;

use luxel_core::{ColorModel, Knots, RESPONSE_KNOTS, RasterConfig, Scene};
use luxel_io::Arrays;
use luxel_train::{AnchorArray, AnchorScene, AnchorSnapshot, ArrayFile, FileArray, TrainConfig, TrainError};
use serde::{Deserialize, Serialize};

use super::place::PlaceRecord;
use super::scene::{Content, ImplicitScene};
use crate::error::Context;
use crate::{Error, Result};

/// Name of the kind of file.
pub(super) const FORMAT: &str = "luxel-anchors";

/// Name of the array of the camera's response.
const RESPONSE: &str = "response";

/// A run that can be continued.
pub(crate) struct AnchorCheckpoint {
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
    Ok(ArrayFile { format: FORMAT, description, arrays: arrays.into_iter().map(rows).chain(of_response).collect() })
}

/// Reads anchors, or those of a checkpoint.
pub(super) fn read(path: &Path) -> Result<ImplicitScene> {
    let (description, arrays, response) = read_parts(path)?;
    let scene = AnchorScene::from_arrays(description.color_model, &mut { arrays }).with_context(|| path.display().to_string())?;
    let place = Scene { raster: description.raster, ..description.place.scene(path)? };
    Ok(ImplicitScene { content: Content::Anchors { scene: Box::new(scene), response: response.map(Box::new) }, place })
}

/// Reads a checkpoint.
pub(super) fn read_checkpoint(path: &Path) -> Result<AnchorCheckpoint> {
    let (description, arrays, _) = read_parts(path)?;
    let training = description.training.with_context(|| format!("{}: holds anchors without their training", path.display()))?;
    let TrainingRecord { config, fingerprint, step, state } = training;
    // Whatever is damaged shows before the run is changed.
    AnchorScene::from_arrays(description.color_model, &mut arrays.clone()).with_context(|| path.display().to_string())?;
    let snapshot = AnchorSnapshot { color_model: description.color_model, arrays, state_json: state };
    Ok(AnchorCheckpoint { config, fingerprint, step, snapshot })
}

fn read_parts(path: &Path) -> Result<(Description, Vec<AnchorArray>, Option<Knots>)> {
    let Arrays { description, tensors } = luxel_io::read_arrays(path, FORMAT)?;
    let description = serde_json::from_str(&description).with_context(|| format!("{}: not the description of anchors", path.display()))?;
    let mut response = None;
    let mut arrays = Vec::with_capacity(tensors.len());
    for (name, (shape, values)) in tensors {
        if name == RESPONSE {
            let knots: Option<[[f32; RESPONSE_KNOTS]; 3]> = values.as_chunks().0.try_into().ok();
            response = Some(knots.ok_or_else(|| Error::new(format!("{}: a response of {} numbers", path.display(), values.len())))?);
        } else {
            arrays.push(AnchorArray { name, width: shape.get(1).copied().unwrap_or(1), values });
        }
    }
    Ok((description, arrays, response))
}
