//! The checkpoints of a run folder: `checkpoints/step_000007000.safetensors`.

use std::path::{Path, PathBuf};

use crate::IoError;
use crate::atomic::is_unfinished_name;

const FOLDER: &str = "checkpoints";
const PREFIX: &str = "step_";
const SUFFIX: &str = ".safetensors";

/// A checkpoint of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CheckpointFile {
    /// Steps done when it was written.
    pub iteration: u64,
    /// The file.
    pub path: PathBuf,
}

/// Returns the path of the checkpoint after `iteration` steps of the run in `run_dir`.
pub fn checkpoint_path(run_dir: &Path, iteration: u64) -> PathBuf {
    run_dir.join(FOLDER).join(format!("{PREFIX}{iteration:09}{SUFFIX}"))
}

/// Returns the run's checkpoints by name, newest first; none if the run has no such folder yet.
///
/// # Errors
/// A folder that cannot be read.
pub fn list_checkpoints(run_dir: &Path) -> Result<Vec<CheckpointFile>, IoError> {
    let mut files: Vec<CheckpointFile> = entries(run_dir)?
        .into_iter()
        .filter_map(|path| {
            let digits = path.file_name()?.to_str()?.strip_prefix(PREFIX)?.strip_suffix(SUFFIX)?;
            let iteration = digits.bytes().all(|b| b.is_ascii_digit()).then(|| digits.parse().ok())??;
            Some(CheckpointFile { iteration, path })
        })
        .collect();
    files.sort_by(|a, b| (b.iteration, &b.path).cmp(&(a.iteration, &a.path)));
    Ok(files)
}

/// Removes all but the newest `keep` checkpoints (at least one is kept), and files that a killed
/// process left half-written. For the process that writes them, after it has written one.
///
/// # Errors
/// A folder that cannot be read or a file that cannot be removed.
pub fn prune_checkpoints(run_dir: &Path, keep: usize) -> Result<(), IoError> {
    let old = list_checkpoints(run_dir)?.into_iter().skip(keep.max(1)).map(|file| file.path);
    let is_leftover = |path: &PathBuf| path.file_name().is_some_and(is_unfinished_name);
    for path in old.chain(entries(run_dir)?.into_iter().filter(is_leftover)) {
        std::fs::remove_file(&path).map_err(|e| IoError::system(&path, "remove", &e))?;
    }
    Ok(())
}

/// Returns the files of the checkpoint folder, in no order.
fn entries(run_dir: &Path) -> Result<Vec<PathBuf>, IoError> {
    let folder = run_dir.join(FOLDER);
    let system = |e: std::io::Error| IoError::system(&folder, "read folder", &e);
    match std::fs::read_dir(&folder) {
        Ok(entries) => entries.map(|entry| entry.map(|e| e.path()).map_err(system)).collect(),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(e) => Err(system(e)),
    }
}
