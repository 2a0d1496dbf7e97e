//! The newest readable state of a run of a field: checkpoints to resume from, fields to render.

use std::path::PathBuf;

use super::files::{self, FieldCheckpoint, FieldScene};
use crate::error::Context;
use crate::run::RunFolder;
use crate::run::state::{continue_run, start_anew};
use crate::{Error, Observer, Result};

/// Returns the newest checkpoint that can be read, to continue from; `None` if the run ended before
/// its first. Damaged newer ones are reported and renamed: they must not count as the newest when
/// old ones are deleted.
pub(super) fn take_checkpoint(folder: &RunFolder, observer: &dyn Observer) -> Result<Option<(PathBuf, FieldCheckpoint)>> {
    let mut damaged = Vec::new();
    let mut found = None;
    for file in luxel_io::list_checkpoints(folder.root())? {
        match files::read_checkpoint(&file.path) {
            Ok(checkpoint) => {
                found = Some((file.path, checkpoint));
                break;
            }
            Err(error) => {
                observer.warn(&format!("skipping a damaged checkpoint: {error:#}"));
                damaged.push(file.path);
            }
        }
    }
    if found.is_none() && !damaged.is_empty() {
        let message = format!("{}: none of the {} checkpoints can be read", folder.root().display(), damaged.len());
        return Err(Error::new(message).with_remedy(start_anew()));
    }
    for path in damaged {
        luxel_io::check_within(folder.root(), &path)?;
        let mut aside = path.clone().into_os_string();
        aside.push(".damaged");
        std::fs::rename(&path, &aside).with_context(|| format!("{}: cannot set aside", path.display()))?;
    }
    Ok(found)
}

/// Returns a run's newest field that can be read, with its step: from `field/`, or from a newer
/// checkpoint.
///
/// # Errors
/// A run without a readable field.
pub fn newest_field(folder: &RunFolder, observer: &dyn Observer) -> Result<(u32, FieldScene)> {
    let fields = folder.field_iterations().into_iter().map(|n| (u64::from(n), folder.field(n)));
    let states = luxel_io::list_checkpoints(folder.root())?.into_iter().map(|file| (file.iteration, file.path));
    let mut candidates: Vec<(u64, PathBuf)> = fields.chain(states).collect();
    // Newest first; of the same step the field, which is smaller, stays first.
    candidates.sort_by_key(|(iteration, _)| std::cmp::Reverse(*iteration));
    for (iteration, path) in candidates {
        match files::read(&path) {
            Ok(scene) => return Ok((u32::try_from(iteration)?, scene)),
            Err(error) => observer.warn(&format!("skipping a damaged file: {error:#}")),
        }
    }
    Err(Error::new(format!("{}: the run has no readable field yet", folder.root().display())).with_remedy(continue_run()))
}
