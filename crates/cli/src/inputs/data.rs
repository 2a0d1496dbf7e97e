//! Reading a data set, with a line about what it is.

use std::path::Path;

use anyhow::{Result, bail};
use luxel::{LoadOptions, Observer};
use luxel_app::run::ExplicitArgs;
use luxel_core::{ColorSpace, Dataset};

use crate::args::flag;

/// Refuses an explicit colour space of images that all state another.
pub(crate) fn check_color_space(dataset: &Dataset, options: &LoadOptions, explicit: &ExplicitArgs) -> Result<()> {
    match options.color_space {
        Some(given) if explicit.contains("color_space") => check_stated(given, Some(dataset.color_space), "every image of the data set"),
        _ => Ok(()),
    }
}

/// Refuses primaries that were `given` for images that state others; `what` states them.
pub(crate) fn check_stated(given: ColorSpace, stated: Option<ColorSpace>, what: &str) -> Result<()> {
    match stated {
        Some(stated) if stated != given => bail!(
            "{what} states the colour space {}, so that {} {} has nothing to act on; leave it out",
            stated.name(),
            flag("color_space"),
            given.name()
        ),
        _ => Ok(()),
    }
}

/// Reads the data set and reports its size and warnings.
pub(crate) fn load(path: &Path, options: &LoadOptions, observer: &dyn Observer) -> Result<Dataset> {
    Ok(luxel::Dataset::open_reporting(path, options, observer)?.into_core())
}
