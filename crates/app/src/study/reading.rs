//! How the data sets of a study are read.
//!
//! In: the options of reading that are asked for, and the runs there are. Out: options for each
//! data set, with the reduction of its images as a number, so that all runs on one have one. Where
//! the reduction is left to the images' sizes, it is that of the runs on the data set, if there are
//! any. Degenerate: a data set of an earlier call that is gone and has no run is not trained on, so
//! its options say nothing.

use std::path::{Path, PathBuf};

use luxel::error::Context;
use luxel::{Result, reduction_line};
use luxel_io::{Downscale, LoadOptions};

use crate::run::RunFolder;

/// Options of reading a data set, and a line about a reduction that was chosen.
#[derive(Debug)]
pub(super) struct SourceReading {
    pub(super) load: LoadOptions,
    pub(super) note: Option<String>,
}

/// Returns how the data set at `path` is read. `runs` are the places of the study's runs on it;
/// `is_asked` says whether this call asks for the data set.
pub(super) fn reading_of(name: &str, path: &Path, load: &LoadOptions, runs: &[PathBuf], is_asked: bool) -> Result<SourceReading> {
    let with = |factor, note| SourceReading { load: LoadOptions { downscale: Downscale::By(factor), ..load.clone() }, note };
    if load.downscale != Downscale::Auto {
        return Ok(SourceReading { load: load.clone(), note: None });
    }
    let stored = runs.iter().filter(|place| RunFolder::is_run(place)).find_map(|place| Some(RunFolder::open(place).ok()?.1.load.downscale));
    if let Some(Downscale::By(factor)) = stored {
        return Ok(with(factor, None));
    }
    match luxel_io::choose_downscale(path, load) {
        Ok(chosen) => Ok(with(chosen.factor, (chosen.factor > 1).then(|| format!("{name}: {}", reduction_line(chosen))))),
        Err(_) if !is_asked => Ok(with(1, None)),
        Err(error) => Err(error).context("cannot read the data set"),
    }
}
