//! Reading a data set and telling what is odd about it.

use std::path::Path;

use anyhow::{Context, Result};
use luxel_core::Dataset;
use luxel_io::LoadOptions;

use crate::cli::LoadArgs;
use crate::console::Console;
use crate::text;

/// Files with bad pixels that are listed one by one.
const LISTED_FILES: usize = 5;

/// Reads the data set and tells what it is.
pub(crate) fn load(path: &Path, args: &LoadArgs, console: &Console) -> Result<Dataset> {
    let dataset = luxel_io::load_dataset(path, &options(args)).context("cannot read the data set")?;
    for warning in dataset.warnings.iter().cloned().chain(bad_pixel_lines(&dataset)) {
        console.warn(&warning);
    }
    let size = dataset.train.iter().chain(&dataset.test).next().map(|view| view.camera.size_px);
    console.note(&format!(
        "{}: {}, {} to train on, {} to test, {}{}",
        path.display(),
        dataset.format,
        text::plural(dataset.train.len(), "view"),
        text::count(dataset.test.len()),
        text::plural(dataset.points.len(), "point"),
        size.map_or(String::new(), |[w, h]| format!(", {w}x{h}")),
    ));
    Ok(dataset)
}

/// The reader's options.
pub(crate) fn options(args: &LoadArgs) -> LoadOptions {
    LoadOptions {
        format: args.format.map(Into::into),
        transfer: args.transfer.map(Into::into),
        color_space: args.color_space.map(Into::into),
        downscale: args.downscale,
        supervision: args.supervision.into(),
        exposures: args.exposures.0.clone(),
        masks: args.masks.0.clone(),
    }
}

/// What was masked out, file by file; a long list is cut.
pub(crate) fn bad_pixel_lines(dataset: &Dataset) -> Vec<String> {
    let line = |bad: &luxel_core::BadPixels| {
        let kinds = [(bad.nan, "NaN"), (bad.infinite, "infinite"), (bad.negative, "negative")];
        let kinds: Vec<String> = kinds.into_iter().filter(|(n, _)| *n > 0).map(|(n, kind)| format!("{} {kind}", text::count(n))).collect();
        format!("{}: masked pixels: {}", bad.name, kinds.join(", "))
    };
    let mut lines: Vec<String> = dataset.bad_pixels.iter().take(LISTED_FILES).map(line).collect();
    if dataset.bad_pixels.len() > LISTED_FILES {
        let rest = &dataset.bad_pixels[LISTED_FILES..];
        let pixels = rest.iter().map(|bad| bad.nan + bad.infinite + bad.negative).sum();
        lines.push(format!("{} more with {} masked", text::plural(rest.len(), "image"), text::plural(pixels, "pixel")));
    }
    lines
}
