//! `luxel compare`: every figure of two images, or of two folders of them.

mod measure;
mod pairs;
mod report;

use anyhow::{Context, Result, bail};
use luxel::files;
use measure::{Compared, Settings};
use pairs::{Pairs, Sources};
use rayon::prelude::*;

use crate::args::CompareArgs;
use crate::output::console::{self, Console, LogFormat};

/// Compares and prints.
pub(crate) fn run(args: &CompareArgs) -> Result<()> {
    let console = Console::new(LogFormat::Text, false);
    let sources = Sources::of(args)?;
    let pairs = Pairs::find(&sources, args)?;
    for missing in pairs.missing_lines() {
        console.warn(&missing);
    }
    if pairs.pairs.is_empty() {
        bail!("{}", pairs.nothing_matches(&sources));
    }
    for path in pairs.pairs.iter().filter_map(|pair| pair.heatmap.as_ref()) {
        files::check_free(path, args.overwrite)?;
        files::check_no_input(path, pairs.pairs.iter().flat_map(|pair| pair.inputs()))?;
    }
    if let (Some(folder), true) = (&args.heatmap, pairs.are_folders) {
        std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot make the folder", folder.display()))?;
    }
    let settings = Settings::new(args, &pairs)?;
    let mut compared = Vec::with_capacity(pairs.pairs.len());
    for batch in pairs.pairs.chunks(settings.batch()) {
        // In the order of the names: the first error is reported, and warnings come out in order.
        let figures: Vec<Result<Compared>> = batch.par_iter().map(|pair| measure::compare(pair, &settings)).collect();
        for figures in figures {
            let figures = figures?;
            if let Some(warning) = &figures.warning {
                console.warn(warning);
            }
            compared.push(figures);
        }
    }
    let result = report::Comparison::new(&sources, &settings, pairs, compared);
    if args.json { console::print(&result.json()?) } else { console::print(result.text().trim_end()) }
}
