//! Training of radiance fields with a run folder: methods without splats.
//!
//! A run of a field has the folder, events, log, metrics and report of any run ([`crate::run`]).
//! Its checkpoints hold a field and the state of its training, and `field/iteration_N/` is what
//! `point_cloud/` is for splats. Whatever needs splats refuses a field by name ([`refuse_field`]).
//!
//! In: a [`RunConfig`] whose method is a field's, and a [`RunFolder`]. Out: a trained field, in the
//! folder. Fields are trained and rendered on the processor.

mod files;
mod launch;
mod newest;
mod objective;
mod session;

use std::path::Path;

pub use files::FieldScene;
pub(crate) use launch::seconds_per_step;
pub use launch::{TrainedField, fresh, resume};
pub use luxel_field::{ColorHead, FieldNetwork};
pub use newest::newest_field;

use crate::error::Context;
use crate::run::{RunConfig, RunFolder};
use crate::{DeviceOptions, Error, Remedy, Result, SelectedEngine};

/// Why a field is not computed on a GPU.
const ON_PROCESSOR: &str = "radiance fields are computed on the processor";

/// Opens the processor for a field.
///
/// # Errors
/// A GPU that was asked for.
pub fn open_processor(options: &DeviceOptions) -> Result<SelectedEngine> {
    SelectedEngine::on_processor(options, ON_PROCESSOR)
}

/// Refuses a run of a radiance field where splats are needed.
///
/// # Errors
/// The run is one of a field; its configuration cannot be read.
pub fn refuse_field(folder: &RunFolder) -> Result<()> {
    let (_, config) = RunFolder::open(folder.root())?;
    match config.train.method.is_field() {
        true => Err(no_splats(folder.root(), &config)),
        false => Ok(()),
    }
}

fn no_splats(root: &Path, config: &RunConfig) -> Error {
    let message = format!("{}: holds a radiance field ({}), which has no splats", root.display(), config.method_name());
    Error::new(message).with_remedy(Remedy::advice("render or evaluate it, or train splats with another method, such as lcd"))
}

/// Reads the field of a file, `field.safetensors` or a checkpoint; `None` if the file holds
/// something else.
///
/// # Errors
/// A file of a field that is damaged or of another version.
pub fn open_file(path: &Path) -> Result<Option<FieldScene>> {
    if luxel_io::holds_arrays(path, files::FORMAT) { files::read(path).map(Some) } else { Ok(None) }
}

/// Refuses a file of a radiance field where a scene of splats is needed.
pub(crate) fn refuse_field_file(path: &Path) -> Result<()> {
    if path.extension().is_none_or(|extension| extension != "safetensors") || !luxel_io::holds_arrays(path, files::FORMAT) {
        return Ok(());
    }
    let message = format!("{}: holds a radiance field, which has no splats", path.display());
    Err(Error::new(message).with_remedy(Remedy::advice("name the folder of its run to render or evaluate it")))
}

impl FieldScene {
    /// Returns a digest of the field: images of equal ones are equal.
    pub fn digest(&self) -> String {
        let (arrays, mut hasher) = (self.field.arrays(), blake3::Hasher::new());
        hasher.update(format!("{:?}", self.field.shape()).as_bytes());
        for values in [&arrays.table, &arrays.weights, &arrays.occupancy] {
            values.chunks(1 << 12).for_each(|values| {
                let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
                hasher.update(&bytes);
            });
        }
        hasher.finalize().to_hex().to_string()
    }

    /// Puts the field into an engine that renders it, in place of the one that was opened for its
    /// run.
    ///
    /// # Errors
    /// An engine of a GPU; threads that the system refuses.
    pub fn into_engine(self, selected: SelectedEngine) -> Result<SelectedEngine> {
        if selected.gpu.is_some() {
            return Err(Error::new(ON_PROCESSOR).with_remedy(Remedy::set("device", "cpu")));
        }
        let engine = luxel_field::FieldEngine::new(self.field, selected.threads).context("cannot render the field")?;
        Ok(SelectedEngine { instruction_set: Some(engine.instruction_set()), engine: Box::new(engine), ..selected })
    }
}
