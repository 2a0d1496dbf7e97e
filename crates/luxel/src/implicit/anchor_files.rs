//! The files of anchors: `anchors.safetensors`, and checkpoints, which hold the state of the
//! training too. Both are files of arrays ([`luxel_io::write_arrays`]) with a description in JSON.

use std::path::Path;

use luxel_core::{ColorModel, Knots, RESPONSE_KNOTS, RasterConfig, Scene};
use luxel_io::{Arrays, IoError, NamedArray};
use luxel_train::{AnchorArray, AnchorScene, AnchorSnapshot, TrainConfig};
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
pub(super) struct AnchorCheckpoint {
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

fn write_parts(
    path: &Path,
    place: &Scene,
    color_model: ColorModel,
    arrays: &[AnchorArray],
    response: Option<&Knots>,
    training: Option<TrainingRecord>,
) -> Result<(), IoError> {
    let description = Description { color_model, raster: place.raster, place: PlaceRecord::of(place), training };
    let description = serde_json::to_string(&description).map_err(|e| IoError::invalid(path, e))?;
    let shapes: Vec<[usize; 2]> = arrays.iter().map(|array| [array.values.len() / array.width.max(1), array.width]).collect();
    let named = arrays.iter().zip(&shapes).map(|(array, shape)| NamedArray { name: &array.name, shape, values: &array.values });
    let of_response = response.map(|knots| NamedArray { name: RESPONSE, shape: &[3, RESPONSE_KNOTS], values: knots.as_flattened() });
    luxel_io::write_arrays(path, FORMAT, &description, &named.chain(of_response).collect::<Vec<_>>())
}

/// Writes a scene alone.
pub(super) fn write(path: &Path, place: &Scene, scene: &AnchorScene, response: Option<&Knots>) -> Result<(), IoError> {
    write_parts(path, place, scene.color_model(), &scene.arrays(), response, None)
}

/// Writes a checkpoint.
pub(super) fn write_checkpoint(path: &Path, place: &Scene, response: Option<&Knots>, checkpoint: &AnchorCheckpoint) -> Result<(), IoError> {
    let AnchorCheckpoint { config, fingerprint, step, snapshot } = checkpoint;
    let training =
        TrainingRecord { config: config.clone(), fingerprint: fingerprint.clone(), step: *step, state: snapshot.state_json.clone() };
    write_parts(path, place, snapshot.color_model, &snapshot.arrays, response, Some(training))
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
