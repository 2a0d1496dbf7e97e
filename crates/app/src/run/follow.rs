//! A run as the ranks other than 0 see it.
//!
//! In: what rank 0 tells. Out: the same trainer as there, step by step. These ranks read the data
//! set, of which they keep the images of their own views, and train; they write nothing but the
//! cache of images that memory has no room for. Degenerate: if rank 0 fails, it ends them.

use std::path::{Path, PathBuf};

use luxel::error::Context;
use luxel::step_methods::means_of;
use luxel::{Error, Result, SelectedEngine, Silent, StopFlag};
use luxel_core::Exchange;
use luxel_train::Trainer;

use super::launch::{RunStart, limit_images, open_dataset};
use super::ranks::{STATE, broadcast, views_of};
use super::{Launch, Outcome, RunConfig, RunFolder};

/// Trains as a rank other than 0, with what rank 0 tells. `open` opens the engine for the settings.
///
/// # Errors
/// What rank 0 sends cannot be read; a data set, an engine or a step that fails.
pub fn follow(
    mut exchange: Box<dyn Exchange>,
    open: impl FnOnce(&RunConfig) -> Result<SelectedEngine>,
    stop: &StopFlag,
) -> Result<Outcome> {
    let settings = String::from_utf8(broadcast(&mut *exchange, &[])?).map_err(|_| Error::new("rank 0 sent settings that are no text"))?;
    let config = RunConfig::parse(&settings).context("cannot read the settings from rank 0")?;
    let root = broadcast(&mut *exchange, &[])?;
    let folder = RunFolder::at(&PathBuf::from(String::from_utf8_lossy(&root).into_owned()));
    let SelectedEngine { mut engine, gpu, .. } = open(&config)?;
    let launch = Launch { folder: &folder, observer: &Silent, stop };
    let start = RunStart { is_on_gpu: gpu.is_some(), scene_splats: None };
    let dataset = open_dataset(&config.dataset, &config, launch, start, views_of(&*exchange, &config))?;
    limit_images(engine.as_mut(), &config);
    let state = broadcast(&mut *exchange, &[])?;
    let snapshot = luxel_io::decode_checkpoint(Path::new(STATE), &state)?;
    let mut trainer = Trainer::resume(&dataset, snapshot, means_of(engine)).context("cannot start training")?.with_exchange(exchange);
    trainer.finish_average()?;
    // A signal asks for a stop from here on, and does not end the process.
    let _listening = stop.listen();
    while !trainer.is_finished() {
        trainer.announce_stop(stop.is_requested());
        if trainer.is_asked_to_stop() {
            return Ok(Outcome::Interrupted);
        }
        trainer.step().with_context(|| format!("training step {}", trainer.iteration() + 1))?;
    }
    Ok(Outcome::Finished)
}
