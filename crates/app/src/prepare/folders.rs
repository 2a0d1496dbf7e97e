//! The layout of the output folder, and a check that nothing foreign is written over.
//!
//! In: paths. Out: paths of a view's files. Degenerate: an output folder that does not exist is
//! free.

use std::fs::DirEntry;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use luxel::Result;
use luxel::error::{Context, bail};

use super::state::State;
use crate::run::is_left_over;

/// Folders in the output that files are written into.
const WRITTEN: [&str; 5] = ["images", "proxies", "saturation", "sparse", "work"];

/// The output folder and the folder in it for intermediate files.
#[derive(Clone, Debug)]
pub(super) struct Folders {
    pub(super) output: PathBuf,
    pub(super) work: PathBuf,
}

impl Folders {
    pub(super) fn new(output: &Path) -> Self {
        Self { output: output.to_owned(), work: output.join("work") }
    }

    /// Refuses an output folder in which foreign files would be written over: the photographs
    /// themselves, or another program's data set.
    pub(super) fn check(&self, photos: &Path) -> Result<()> {
        let output = self.output.display();
        let holds = |folder: &Path, path: &Path| std::fs::canonicalize(folder).is_ok_and(|folder| path.starts_with(folder));
        if let Ok(photos) = std::fs::canonicalize(photos)
            && let Some(name) = WRITTEN.into_iter().find(|name| holds(&self.output.join(name), &photos))
        {
            bail!("{output}: the photographs lie in its folder {name}, which files are written to; choose another output folder");
        }
        let entries = match std::fs::read_dir(&self.output) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
            entries => entries.with_context(|| format!("{output}: cannot list the output folder"))?,
        };
        let is_empty =
            |folder: &Path| std::fs::read_dir(folder).is_ok_and(|entries| entries.flatten().all(|entry| is_left_over(&entry.file_name())));
        // What a call leaves that ended before it wrote anything.
        let is_ours = |entry: &DirEntry| is_left_over(&entry.file_name()) || entry.path() == self.work && is_empty(&self.work);
        if !State::is_in(&self.work) && !entries.flatten().all(|entry| is_ours(&entry)) {
            bail!("{output}: is not empty and not a data set that luxel prepared; choose another output folder");
        }
        Ok(())
    }

    /// Returns the place of a view's radiance as the lens saw it.
    pub(super) fn radiance(&self, view: &str) -> PathBuf {
        self.work.join("radiance").join(format!("{view}.exr"))
    }

    /// Returns the place of the mask of saturated pixels as the lens saw them.
    pub(super) fn saturation(&self, view: &str) -> PathBuf {
        self.work.join("saturation").join(format!("{view}.png"))
    }

    /// Returns the place of the mask of saturated pixels of the undistorted image.
    pub(super) fn mask(&self, view: &str) -> PathBuf {
        self.output.join("saturation").join(format!("{view}.png"))
    }

    /// Returns the place of the undistorted image.
    pub(super) fn image(&self, view: &str) -> PathBuf {
        self.output.join("images").join(format!("{view}.exr"))
    }
}

/// Returns the name by which COLMAP knows a view.
pub(super) fn proxy_name(view: &str) -> String {
    format!("{view}.jpg")
}
