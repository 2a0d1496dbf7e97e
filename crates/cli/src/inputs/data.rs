//! Reading a data set, with a line about what it is.

use std::path::Path;

use anyhow::Result;
use luxel::{LoadOptions, Observer};
use luxel_core::Dataset;

/// Reads the data set and reports its size and warnings.
pub(crate) fn load(path: &Path, options: &LoadOptions, observer: &dyn Observer) -> Result<Dataset> {
    Ok(luxel::Dataset::open_reporting(path, options, observer)?.into_core())
}
