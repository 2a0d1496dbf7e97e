//! When a run saves and measures, and how it writes a checkpoint.
//!
//! In: a run's folder and options, what writes its state. Out: the checkpoint's path. Degenerate:
//! if the disk is full, older checkpoints are removed, but never the newest.

use std::path::{Path, PathBuf};

use luxel::{Error, Result};
use luxel_io::{IoError, IoErrorKind};

use super::{RunFolder, RunOptions, state};

impl RunOptions {
    /// Returns whether a checkpoint is due after step `iteration`.
    pub(crate) fn saves_after(&self, iteration: u32, is_finished: bool) -> bool {
        is_finished || (self.checkpoint_every > 0 && iteration.is_multiple_of(self.checkpoint_every))
    }

    /// Returns whether the test views are measured after step `iteration`.
    pub(crate) fn measures_after(&self, iteration: u32, is_finished: bool) -> bool {
        is_finished
            || match self.eval_every {
                Some(every) => iteration > 0 && iteration.is_multiple_of(every),
                None => self.eval_at.contains(&iteration),
            }
    }
}

/// Writes the checkpoint of step `iteration` with `write`, and removes the oldest ones.
///
/// # Errors
/// Those of `write`, with the name of the last good checkpoint.
pub(crate) fn save_checkpoint(
    folder: &RunFolder,
    options: &RunOptions,
    iteration: u32,
    mut write: impl FnMut(&Path) -> std::result::Result<(), IoError>,
) -> Result<PathBuf> {
    let (root, keep) = (folder.root(), options.keep_checkpoints as usize);
    let path = luxel_io::checkpoint_path(root, iteration.into());
    let mut written = write(&path);
    let lacks_room = written.as_ref().is_err_and(|error| error.kind == IoErrorKind::NoRoom);
    // Where those cannot be deleted either, the first error has the reason.
    if lacks_room && keep > 1 && luxel_io::prune_checkpoints(root, 1).is_ok() {
        written = write(&path);
    }
    if let Err(error) = written {
        let kept = match state::newest_checkpoint(folder) {
            Some(path) => format!("the last good checkpoint is {}", path.display()),
            None => "there is no earlier checkpoint".into(),
        };
        let kept = match lacks_room && keep == 1 {
            true => format!("{kept}; it is deleted only when the next is whole, so there must be room for two"),
            false => kept,
        };
        return Err(Error::from(error).context(format!("cannot save the state of step {iteration}; {kept}")));
    }
    luxel_io::prune_checkpoints(root, keep)?;
    Ok(path)
}
