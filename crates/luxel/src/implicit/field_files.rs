//! The files of fields: `field.safetensors`, and checkpoints, which hold the state of the training
//! too. Both are files of arrays ([`luxel_io::write_arrays`]) with a description in JSON.

use std::path::Path;

use luxel_core::Scene;
use luxel_field::{Field, FieldArrays, FieldShape, FieldSnapshot, FieldState};
use luxel_io::Arrays;
use luxel_train::{ArrayFile, FileArray, TrainConfig, TrainError};
use serde::{Deserialize, Serialize};

use super::place::PlaceRecord;
use super::scene::{Content, ImplicitScene};
use crate::error::Context;
use crate::{Error, Result};

/// Name of the kind of file.
pub(super) const FORMAT: &str = "luxel-field";

/// A run that can be continued.
pub(crate) struct FieldCheckpoint {
    pub(super) training: TrainingRecord,
    pub(super) snapshot: FieldSnapshot,
}

/// The state of a run, without its arrays.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TrainingRecord {
    pub(super) config: TrainConfig,
    /// Digest of the data set.
    pub(super) fingerprint: String,
    pub(super) state: FieldState,
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
pub(super) fn of_field(place: &Scene, field: &Field) -> Result<ArrayFile, TrainError> {
    let FieldArrays { table, weights, occupancy } = field.arrays();
    of_arrays(place, field.shape(), None, vec![("table", table), ("weights", weights), ("occupancy", occupancy)])
}

/// Returns the file of a checkpoint.
pub(super) fn of_run(place: &Scene, snapshot: FieldSnapshot, training: TrainingRecord) -> Result<ArrayFile, TrainError> {
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
    Ok(ArrayFile { format: FORMAT, description, arrays: arrays.collect() })
}

/// Reads a field, or that of a checkpoint.
pub(super) fn read(path: &Path) -> Result<ImplicitScene> {
    let (description, mut arrays) = read_parts(path)?;
    let field = field(path, &description, &mut arrays)?;
    Ok(ImplicitScene { content: Content::Field(Box::new(field)), place: description.place.scene(path)? })
}

/// Reads a checkpoint.
pub(super) fn read_checkpoint(path: &Path) -> Result<FieldCheckpoint> {
    let (mut description, mut arrays) = read_parts(path)?;
    let field = field(path, &description, &mut arrays)?;
    let training = description.training.take().with_context(|| format!("{}: holds a field without its training", path.display()))?;
    let (first, second) = (take(path, &mut arrays, "moments.first")?, take(path, &mut arrays, "moments.second")?);
    let snapshot = FieldSnapshot { shape: description.shape, arrays: field.arrays(), first, second, state: training.state };
    Ok(FieldCheckpoint { training, snapshot })
}

fn read_parts(path: &Path) -> Result<(Description, Arrays)> {
    let arrays = luxel_io::read_arrays(path, FORMAT)?;
    let description =
        serde_json::from_str(&arrays.description).with_context(|| format!("{}: not the description of a field", path.display()))?;
    Ok((description, arrays))
}

fn field(path: &Path, description: &Description, arrays: &mut Arrays) -> Result<Field> {
    let field = FieldArrays {
        table: take(path, arrays, "table")?,
        weights: take(path, arrays, "weights")?,
        occupancy: take(path, arrays, "occupancy")?,
    };
    Field::from_arrays(description.shape, field).with_context(|| path.display().to_string())
}

fn take(path: &Path, arrays: &mut Arrays, name: &str) -> Result<Vec<f32>> {
    let found = arrays.tensors.remove(name).map(|(_, values)| values);
    found.ok_or_else(|| Error::new(format!("{}: no array \"{name}\"", path.display())))
}
