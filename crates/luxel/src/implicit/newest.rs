//! The newest readable state of a run: checkpoints to resume from, fields and anchors to render.

use std::path::PathBuf;

use super::files;
use super::scene::ImplicitScene;
use super::trainer::Checkpoint;
use crate::error::Context;
use crate::run::state::{continue_run, start_anew};
use crate::run::{ImplicitKind, RunFolder};
use crate::{Error, Observer, Result};

/// Returns the newest checkpoint that can be read, to continue from; `None` if the run ended before
/// its first. Damaged newer ones are reported and renamed: they must not count as the newest when
/// old ones are deleted.
pub(super) fn take_checkpoint(folder: &RunFolder, observer: &dyn Observer) -> Result<Option<(PathBuf, Checkpoint)>> {
    let mut damaged = Vec::new();
    let mut found = None;
    for file in luxel_io::list_checkpoints(folder.root())? {
        match Checkpoint::read(&file.path) {
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

/// Returns a run's newest field or anchors that can be read, with their step: from `field/` or
/// `anchors/`, or from a newer checkpoint.
///
/// # Errors
/// A run without a readable state.
pub fn newest_scene(folder: &RunFolder, observer: &dyn Observer) -> Result<(u32, ImplicitScene)> {
    let scenes = ImplicitKind::ALL
        .into_iter()
        .flat_map(|kind| folder.implicit_iterations(kind).into_iter().map(move |n| (u64::from(n), folder.implicit(kind, n))));
    let states = luxel_io::list_checkpoints(folder.root())?.into_iter().map(|file| (file.iteration, file.path));
    let mut candidates: Vec<(u64, PathBuf)> = scenes.chain(states).collect();
    // Newest first; of the same step the scene, which is smaller, stays first.
    candidates.sort_by_key(|(iteration, _)| std::cmp::Reverse(*iteration));
    for (iteration, path) in candidates {
        match files::read(&path) {
            Ok(scene) => return Ok((u32::try_from(iteration)?, scene)),
            Err(error) => observer.warn(&format!("skipping a damaged file: {error:#}")),
        }
    }
    Err(Error::new(format!("{}: the run has no readable state yet", folder.root().display())).with_remedy(continue_run()))
}
