//! The messages of rank 0 of a distributed run to the others at the start, and the images that a
//! rank keeps.
//!
//! In: the settings and the state of rank 0, which has the run's folder. Out: the same on every
//! rank. Degenerate: a single process tells nobody anything.

use std::path::Path;

use luxel::error::Context;
use luxel::{Error, Result};
use luxel_core::{Exchange, Remedy};
use luxel_io::ViewPlace;
use luxel_train::{RankViews, Trainer};

use super::{RunConfig, RunFolder};

/// Returns the views that a rank trains on.
pub(super) fn views_of(exchange: &dyn Exchange, config: &RunConfig) -> RankViews {
    RankViews { batch: config.train.batch, ranks: exchange.ranks(), rank: exchange.rank() }
}

/// Returns whether a rank keeps the pixels of a view in memory. Rank 0 measures the test views.
pub(super) fn keeps(views: RankViews, place: ViewPlace) -> bool {
    match place {
        ViewPlace::Train(view) => views.contain(view),
        ViewPlace::Test(_) => views.rank == 0,
    }
}

/// Tells the other ranks the settings of the run, and where its data set and its folder are.
pub(super) fn tell_settings(exchange: &mut dyn Exchange, config: &RunConfig, folder: &RunFolder) -> Result<()> {
    if exchange.ranks() == 1 {
        return Ok(());
    }
    let config = RunConfig { dataset: config.find_dataset(folder.root(), Remedy::give("dataset"))?, ..config.clone() };
    broadcast(exchange, config.to_toml()?.as_bytes())?;
    broadcast(exchange, folder.root().as_os_str().as_encoded_bytes())?;
    Ok(())
}

/// Tells the other ranks the state that the run starts with.
pub(super) fn tell_state(trainer: &mut Trainer) -> Result<()> {
    if trainer.exchange().ranks() == 1 {
        return Ok(());
    }
    let snapshot = trainer.snapshot()?;
    let bytes = luxel_io::encode_checkpoint(Path::new(STATE), &snapshot).context("cannot send the state to the other ranks")?;
    broadcast(trainer.exchange(), &bytes)?;
    Ok(())
}

/// Name of the state on its way between ranks, for errors.
pub(super) const STATE: &str = "the state from rank 0";

/// Sends the bytes of rank 0 to all ranks; what the others give is ignored.
pub(super) fn broadcast(exchange: &mut dyn Exchange, bytes: &[u8]) -> Result<Vec<u8>> {
    let mut words = Vec::new();
    if exchange.rank() == 0 {
        words.push(u32::try_from(bytes.len() % 4).unwrap_or(0));
        words.extend(bytes.chunks(4).map(|chunk| u32::from_le_bytes(std::array::from_fn(|i| chunk.get(i).copied().unwrap_or(0)))));
    }
    let messages = exchange.all_gather(&words).map_err(|error| Error::new(error.to_string()))?;
    let Some((rest, words)) = messages.iter().next().and_then(|message| message.split_first()) else {
        return Err(Error::new("rank 0 sent nothing; do all ranks run the same command?"));
    };
    let mut bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    bytes.truncate(bytes.len() - (4 - *rest as usize % 4) % 4);
    Ok(bytes)
}
