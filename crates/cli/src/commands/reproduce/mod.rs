//! `luxel reproduce`: a matrix of methods, data sets and seeds, trained, measured and set side by side as the paper does.
//!
//! ```text
//! matrix.toml                             what was asked for; marks the folder
//! runs/DATASET/METHOD/seed_N/             a run folder each, with measured.json beside
//! report.html                             tables, figures, machine and protocol
//! {runs,means,profiles,editing}.csv       the figures, unrounded
//! tables.tex                              the tables for a paper
//! ```
//!
//! What is finished stays, what was interrupted goes on, and the report is of what was asked for last. First all training, then what is measured with
//! nothing else running, then the report.

mod columns;
mod crops;
mod csv;
mod editing;
mod html_table;
mod latex;
mod matrix;
mod measure;
pub(crate) mod method;
mod page;
mod paper;
mod results;
mod table;
mod training;
mod worker;

use anyhow::{Result, bail};
use editing::Edited;
use luxel::files;
use luxel::run::{ExplicitArgs, Outcome, RunFolder};
use luxel_metrics::LuminanceProfile;
use matrix::{CellState, Matrix};
use page::Content;
use results::CellResult;
use serde_json::json;
use table::Table;
use training::Failure;

use crate::args::ReproduceArgs;
use crate::output::console::Console;

/// Trains what is open, measures, reports; `explicit` names the options that were given.
pub(crate) fn run(args: &ReproduceArgs, explicit: &ExplicitArgs) -> Result<Outcome> {
    let mut console = Console::new(args.console.log_format, args.console.quiet);
    let matrix = Matrix::plan(args, explicit)?;
    // All that can be wrong with what was asked for is explicit before hours of training.
    let wanted = measure::Wanted::of(args)?;
    matrix.check_root()?;
    let _lock = RunFolder::at(&matrix.root).lock()?;
    let states = matrix.states()?;
    matrix.claim()?;
    let (outcome, mut failures) = training::train(&matrix, &states, &mut console)?;
    if outcome == Outcome::Interrupted {
        console.note("saved; the same command goes on from here");
        return Ok(outcome);
    }
    let is_finished = |state: &CellState| *state == CellState::Finished;
    let finished: Vec<usize> = matrix.states()?.iter().enumerate().filter(|(_, state)| is_finished(state)).map(|(i, _)| i).collect();
    failures.extend(measure::measure(&matrix, &finished, &wanted, &args.device, &console)?);
    let results = results::read(&matrix, &finished)?;
    // Figures of training stand without those of editing.
    let edited = editing::edit(&matrix, &finished, &args.device, &console).map_err(|error| error.context("no figures of editing"));
    let edited = edited.unwrap_or_else(|error| {
        console.warn(&format!("{error:#}"));
        Vec::new()
    });
    write(&matrix, &results, &failures, &edited)?;
    tell(&matrix, &console)?;
    match failures.as_slice() {
        [] => Ok(Outcome::Finished),
        [failure, others @ ..] => {
            let name = matrix.cells.get(failure.cell).map_or_else(String::new, |cell| cell.name(&matrix));
            let others = if others.is_empty() { String::new() } else { format!(" (and {} more)", others.len()) };
            bail!("{name}: {:#}{others}; the report is without that, and the same command tries it again", failure.error)
        }
    }
}

/// The report and its data.
fn write(matrix: &Matrix, results: &[CellResult], failures: &[Failure], edited: &[Edited]) -> Result<()> {
    let all: Vec<usize> = (0..matrix.methods.len()).collect();
    let activations: Vec<usize> = all.iter().copied().filter(|&i| paper::name_of_activation(matrix.methods[i]).is_some()).collect();
    let sources = 0..matrix.sources.len();
    let tables: Vec<Table> = sources.clone().map(|source| Table::of_source(results, source, &all)).collect();
    let average = (matrix.sources.len() > 1).then(|| Table::average(results, matrix.sources.len(), &all, &matrix.seeds));
    // Of one activation there is nothing to compare.
    let of_activations: Vec<Table> = match activations.len() {
        0 | 1 => Vec::new(),
        _ => sources.map(|source| Table::of_source(results, source, &activations)).collect(),
    };
    let profiles = profiles(matrix, results);
    let root = &matrix.root;
    files::write_text(&root.join("runs.csv"), &csv::runs(matrix, results))?;
    files::write_text(&root.join("means.csv"), &csv::means(matrix, results))?;
    files::write_text(&root.join("profiles.csv"), &csv::profiles(matrix, &profiles))?;
    files::write_text(&root.join("editing.csv"), &csv::editing(matrix, edited))?;
    files::write_text(
        &root.join("tables.tex"),
        &(tex(matrix, average.as_ref(), &tables, &of_activations) + &latex::editing(matrix, edited)),
    )?;
    let content = Content {
        matrix,
        results,
        failures,
        average: average.as_ref().filter(|table| table.has_values()),
        tables: &tables,
        activations: &of_activations,
        profiles: &profiles,
        editing: editing::section(matrix, edited)?,
    };
    Ok(files::write_text(&root.join("report.html"), &page::page(&content)?)?)
}

/// Data set, method and error by luminance, the pixels of all seeds together.
fn profiles(matrix: &Matrix, results: &[CellResult]) -> Vec<(usize, usize, LuminanceProfile)> {
    let mut profiles = Vec::new();
    for (source, method) in (0..matrix.sources.len()).flat_map(|source| (0..matrix.methods.len()).map(move |method| (source, method))) {
        let mut pooled = LuminanceProfile::default();
        for profile in results.iter().filter(|cell| cell.source == source && cell.method == method).filter_map(CellResult::profile) {
            pooled.merge(profile);
        }
        if pooled.count() > 0 {
            profiles.push((source, method, pooled));
        }
    }
    profiles
}

fn tex(matrix: &Matrix, average: Option<&Table>, tables: &[Table], activations: &[Table]) -> String {
    let iterations = matrix.cells.first().map_or(0, |cell| cell.config.train.iterations);
    let protocol = format!(
        "Test views, {iterations} iterations, {} seed(s). PSNR and SSIM under the mu-law by protocol: scene (one constant per scene), gtmax (maximum of the \
         ground truth), selfmax (each image's own maximum). Best bold, second best underlined.",
        matrix.seeds.len()
    );
    let mut out = format!("% Made by luxel reproduce {}. Needs \\usepackage{{booktabs}}.\n\n", luxel::VERSION);
    if let Some(table) = average {
        out += &latex::table(matrix, table, &format!("Mean of all data sets. {protocol}"), "mean-of-data-sets");
    }
    for (source, table) in matrix.sources.iter().zip(tables) {
        out += &latex::table(matrix, table, &format!("Results on {}. {protocol}", source.name), &format!("results-{}", source.name));
    }
    for (source, table) in matrix.sources.iter().zip(activations) {
        let label = format!("activation-{}", source.name);
        out += &latex::table(matrix, table, &format!("Activation of the luminance on {}. {protocol}", source.name), &label);
    }
    for table in &paper::RESULTS {
        out += &latex::papers(table, "Results", &format!("paper-{}", table.dataset));
    }
    for table in &paper::ACTIVATIONS {
        out += &latex::papers(table, "Activation of the luminance", &format!("paper-activation-{}", table.dataset));
    }
    out
}

fn tell(matrix: &Matrix, console: &Console) -> Result<()> {
    let at = |name: &str| matrix.root.join(name).display().to_string();
    let [report, tables, runs, means, profiles] = ["report.html", "tables.tex", "runs.csv", "means.csv", "profiles.csv"].map(at);
    let event = json!({ "event": "finished", "report": report, "tables": tables, "runs": runs, "means": means, "profiles": profiles });
    let text =
        format!("report  {report}   <- open this in a browser\ntables  {tables}\nfigures {runs}\n        {means}\n        {profiles}");
    console.result(&event, &text)
}
