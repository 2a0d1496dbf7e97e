//! The newest field or anchors of a run that can be read.

use std::path::PathBuf;

use luxel::{Error, Observer, Result};

use super::scene::NonSplatScene;
use crate::run::state::continue_run;
use crate::run::{NonSplatKind, RunFolder};

/// Returns a run's newest field or anchors that can be read, with their step: from `field/` or
/// `anchors/`, or from a newer checkpoint.
///
/// # Errors
/// A run without a readable state.
pub fn newest_scene(folder: &RunFolder, observer: &dyn Observer) -> Result<(u32, NonSplatScene)> {
    let scenes = NonSplatKind::ALL
        .into_iter()
        .flat_map(|kind| folder.non_splat_iterations(kind).into_iter().map(move |n| (u64::from(n), folder.non_splat(kind, n))));
    let states = luxel_io::list_checkpoints(folder.root())?.into_iter().map(|file| (file.iteration, file.path));
    let mut candidates: Vec<(u64, PathBuf)> = scenes.chain(states).collect();
    // Newest first; of the same step the scene, which is smaller, stays first.
    candidates.sort_by_key(|(iteration, _)| std::cmp::Reverse(*iteration));
    for (iteration, path) in candidates {
        match NonSplatScene::read(&path) {
            Ok(scene) => return Ok((u32::try_from(iteration)?, scene)),
            Err(error) => observer.warn(&format!("skipping a damaged file: {error:#}")),
        }
    }
    Err(Error::new(format!("{}: the run has no readable state yet", folder.root().display())).with_remedy(continue_run()))
}
