//! The files of fields: `field.safetensors`, and checkpoints, which hold the state of the training
//! too. Both are files of arrays ([`luxel_io::write_arrays`]) with a description in JSON.

use std::path::Path;

use luxel_core::Scene;
use luxel_field::{Field, FieldArrays, FieldShape, FieldSnapshot, FieldState};
use luxel_io::{Arrays, NamedArray};
use luxel_train::TrainConfig;
use serde::{Deserialize, Serialize};

use super::place::PlaceRecord;
use super::scene::{Content, ImplicitScene};
use crate::error::Context;
use crate::{Error, Result};

/// Name of the kind of file.
pub(super) const FORMAT: &str = "luxel-field";

/// A run that can be continued.
pub(super) struct FieldCheckpoint {
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

/// Writes a field alone.
pub(super) fn write(path: &Path, place: &Scene, field: &Field) -> Result<(), luxel_io::IoError> {
    write_parts(path, place, field.shape(), Parts { arrays: &field.arrays(), training: None })
}

/// Writes a checkpoint.
pub(super) fn write_checkpoint(
    path: &Path,
    place: &Scene,
    snapshot: &FieldSnapshot,
    training: TrainingRecord,
) -> Result<(), luxel_io::IoError> {
    let FieldSnapshot { shape, arrays, first, second, .. } = snapshot;
    write_parts(path, place, *shape, Parts { arrays, training: Some((training, [first, second])) })
}

/// The content of a file.
struct Parts<'a> {
    arrays: &'a FieldArrays,
    /// State and moments.
    training: Option<(TrainingRecord, [&'a Vec<f32>; 2])>,
}

fn write_parts(path: &Path, place: &Scene, shape: FieldShape, parts: Parts<'_>) -> Result<(), luxel_io::IoError> {
    let Parts { arrays: FieldArrays { table, weights, occupancy }, training } = parts;
    let mut named = vec![("table", table), ("weights", weights), ("occupancy", occupancy)];
    let training = training.map(|(training, [first, second])| {
        named.extend([("moments.first", first), ("moments.second", second)]);
        training
    });
    let description = Description { shape, place: PlaceRecord::of(place), training };
    let description = serde_json::to_string(&description).map_err(|e| luxel_io::IoError::invalid(path, e))?;
    let shapes: Vec<[usize; 1]> = named.iter().map(|(_, values)| [values.len()]).collect();
    let arrays: Vec<NamedArray<'_>> = named.iter().zip(&shapes).map(|((name, values), shape)| NamedArray { name, shape, values }).collect();
    luxel_io::write_arrays(path, FORMAT, &description, &arrays)
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
