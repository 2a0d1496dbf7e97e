//! Data sets: posed images, their split into views to train on and views held out, and points.

use std::ops::Deref;
use std::path::Path;

use luxel_io::LoadOptions;

use crate::Result;
use crate::error::Context;

/// A data set in memory. Dereferences to [`luxel_core::Dataset`], which has the views, points and colour space.
#[derive(Clone, Debug)]
pub struct Dataset(luxel_core::Dataset);

impl Dataset {
    /// Reads the data set at `path`, a folder or a `transforms.json`, whose layout is recognised.
    ///
    /// # Errors
    /// An error if a file is missing, damaged or of an unknown layout.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::open_with(path, &LoadOptions::default())
    }

    /// Reads the data set at `path` as `options` ask.
    ///
    /// # Errors
    /// An error if a file is missing, damaged or not of the format asked for.
    pub fn open_with(path: impl AsRef<Path>, options: &LoadOptions) -> Result<Self> {
        luxel_io::load_dataset(path.as_ref(), options).map(Self).context("cannot read the data set")
    }

    /// Returns what a user should know about the data set, such as 8-bit images.
    pub fn warnings(&self) -> &[String] {
        &self.0.warnings
    }
}

impl From<luxel_core::Dataset> for Dataset {
    fn from(dataset: luxel_core::Dataset) -> Self {
        Self(dataset)
    }
}

impl Deref for Dataset {
    type Target = luxel_core::Dataset;

    fn deref(&self) -> &luxel_core::Dataset {
        &self.0
    }
}
