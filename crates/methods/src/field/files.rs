//! The files of fields: `field.safetensors`, and checkpoints, which hold the state of the training
//! too. Both are named arrays with a description in JSON.

use luxel_core::Scene;
use luxel_train::{ArrayFile, FIELD_FORMAT, FileArray, TrainConfig, TrainError};
use serde::{Deserialize, Serialize};

use super::{Field, FieldArrays, FieldShape, FieldSnapshot, FieldState};
use crate::place::PlaceRecord;
use crate::{FileError, Tensors};

/// A run that can be continued.
pub struct FieldCheckpoint {
    pub(crate) training: TrainingRecord,
    pub(crate) snapshot: FieldSnapshot,
}

/// The state of a run, without its arrays.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TrainingRecord {
    pub(crate) config: TrainConfig,
    /// Digest of the data set.
    pub(crate) fingerprint: String,
    pub(crate) state: FieldState,
}

#[derive(Serialize, Deserialize)]
struct Description {
    shape: FieldShape,
    #[serde(flatten)]
    place: PlaceRecord,
    /// Only in checkpoints.
    training: Option<TrainingRecord>,
}

/// Returns the file of a field alone.
pub(crate) fn of_field(place: &Scene, field: &Field) -> Result<ArrayFile, TrainError> {
    let FieldArrays { table, weights, occupancy } = field.arrays();
    of_arrays(place, field.shape(), None, vec![("table", table), ("weights", weights), ("occupancy", occupancy)])
}

/// Returns the file of a checkpoint.
pub(crate) fn of_run(place: &Scene, snapshot: FieldSnapshot, training: TrainingRecord) -> Result<ArrayFile, TrainError> {
    let FieldSnapshot { shape, arrays: FieldArrays { table, weights, occupancy }, first, second, .. } = snapshot;
    let arrays =
        vec![("table", table), ("weights", weights), ("occupancy", occupancy), ("moments.first", first), ("moments.second", second)];
    of_arrays(place, shape, Some(training), arrays)
}

fn of_arrays(
    place: &Scene,
    shape: FieldShape,
    training: Option<TrainingRecord>,
    arrays: Vec<(&'static str, Vec<f32>)>,
) -> Result<ArrayFile, TrainError> {
    let description = Description { shape, place: PlaceRecord::of(place), training };
    let description = serde_json::to_string(&description).map_err(|error| TrainError::State(error.to_string()))?;
    let arrays = arrays.into_iter().map(|(name, values)| FileArray { name: name.to_owned(), shape: vec![values.len()], values });
    Ok(ArrayFile { format: FIELD_FORMAT, description, arrays: arrays.collect() })
}

/// Reads a field, or that of a checkpoint, with its units and place: a scene without splats.
///
/// # Errors
/// A description or arrays of something else.
pub fn read_field(description: &str, mut tensors: Tensors) -> Result<(Field, Scene), FileError> {
    let description = described(description)?;
    Ok((field_of(&description, &mut tensors)?, description.place.scene()?))
}

/// Reads a checkpoint.
///
/// # Errors
/// Those of [`read_field`]; a file without the state of a training.
pub fn read_field_run(description: &str, mut tensors: Tensors) -> Result<FieldCheckpoint, FileError> {
    let mut description = described(description)?;
    let field = field_of(&description, &mut tensors)?;
    let training = description.training.take().ok_or_else(|| FileError::new("holds a field without its training"))?;
    let (first, second) = (take(&mut tensors, "moments.first")?, take(&mut tensors, "moments.second")?);
    let snapshot = FieldSnapshot { shape: description.shape, arrays: field.arrays(), first, second, state: training.state };
    Ok(FieldCheckpoint { training, snapshot })
}

fn described(description: &str) -> Result<Description, FileError> {
    serde_json::from_str(description).map_err(|error| FileError::new(format!("not the description of a field: {error}")))
}

fn field_of(description: &Description, tensors: &mut Tensors) -> Result<Field, FileError> {
    let arrays = FieldArrays { table: take(tensors, "table")?, weights: take(tensors, "weights")?, occupancy: take(tensors, "occupancy")? };
    Field::from_arrays(description.shape, arrays).map_err(FileError::new)
}

fn take(tensors: &mut Tensors, name: &str) -> Result<Vec<f32>, FileError> {
    tensors.remove(name).map(|(_, values)| values).ok_or_else(|| FileError::new(format!("no array \"{name}\"")))
}
