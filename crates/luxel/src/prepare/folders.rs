//! The places of files in a data set that is being prepared.

use std::fs::DirEntry;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use luxel_core::ColorSpace;
use luxel_io::{ExrOptions, ExrSample};

use super::state::State;
use crate::Result;
use crate::error::{Context, bail};
use crate::run::LOCK;

/// Folders in the output that files are written into.
const WRITTEN: [&str; 5] = ["images", "proxies", "saturation", "sparse", "work"];

/// Where things lie.
#[derive(Clone, Debug)]
pub(super) struct Folders {
    pub(super) output: PathBuf,
    pub(super) work: PathBuf,
}

impl Folders {
    pub(super) fn new(output: &Path) -> Self {
        Self { output: output.to_owned(), work: output.join("work") }
    }

    /// Refuses an output folder in which something of others would be written over: the photographs themselves, or another program's data set.
    pub(super) fn check(&self, photos: &Path) -> Result<()> {
        let output = self.output.display();
        if let Ok(photos) = std::fs::canonicalize(photos)
            && let Some(name) =
                WRITTEN.into_iter().find(|name| std::fs::canonicalize(self.output.join(name)).is_ok_and(|own| photos.starts_with(own)))
        {
            bail!("{output}: the photographs lie in its folder {name}, where this command writes; choose another output folder");
        }
        let entries = match std::fs::read_dir(&self.output) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
            entries => entries.with_context(|| format!("{output}: cannot look into the output folder"))?,
        };
        let is_empty = |folder: &Path| std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none());
        // What is there when an earlier time ended before it began.
        let is_left_over = |entry: &DirEntry| entry.file_name() == LOCK || entry.path() == self.work && is_empty(&self.work);
        if !State::is_in(&self.work) && !entries.flatten().all(|entry| is_left_over(&entry)) {
            bail!("{output}: is not empty and not a data set of luxel prepare; choose another output folder");
        }
        Ok(())
    }

    pub(super) fn radiance(&self, view: &str) -> PathBuf {
        self.work.join("radiance").join(format!("{view}.exr"))
    }

    pub(super) fn proxy(&self, view: &str) -> PathBuf {
        self.output.join("proxies").join(proxy_name(view))
    }

    /// Mask of what was saturated, as the lens saw it.
    pub(super) fn saturation(&self, view: &str) -> PathBuf {
        self.work.join("saturation").join(format!("{view}.png"))
    }

    /// The same for the undistorted image.
    pub(super) fn mask(&self, view: &str) -> PathBuf {
        self.output.join("saturation").join(format!("{view}.png"))
    }

    pub(super) fn image(&self, view: &str) -> PathBuf {
        self.output.join("images").join(format!("{view}.exr"))
    }
}

/// The name by which COLMAP knows a view.
pub(super) fn proxy_name(view: &str) -> String {
    format!("{view}.jpg")
}

/// Float, with its space and units.
pub(super) fn exr_options(space: ColorSpace, is_absolute: bool) -> ExrOptions {
    let units = if is_absolute { "cd/m2 by EXIF and ISO 12232" } else { "of the capture" };
    let attributes = vec![("luxel:color_space".to_owned(), space.name().to_owned()), ("luxel:units".to_owned(), units.to_owned())];
    ExrOptions { sample: ExrSample::Float, color_space: space, attributes, ..ExrOptions::default() }
}
