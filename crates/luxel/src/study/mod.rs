//! A study: methods, data sets and seeds, each combination trained and measured, set side by side
//! as a paper does.
//!
//! In: [`StudyOptions`]. Out: a folder.
//!
//! ```text
//! matrix.toml                             all that was asked for; marks the folder
//! runs/DATASET/METHOD/seed_N/             a run folder each, with measured.json beside
//! report.html                             tables, plots, pictures, machine and protocol
//! {runs,means,profiles,editing}.csv       the metrics, unrounded
//! tables.tex                              the tables for a paper
//! ```
//!
//! Finished runs are kept, interrupted ones are continued, and the report covers what is asked for
//! and the finished runs of earlier calls. First everything is trained, then measured with nothing
//! else running, then reported. Degenerate: a run that fails is left out of the report and named in
//! it; the others continue.

mod beside;
mod columns;
mod crops;
mod csv;
mod editing;
mod html_table;
mod latex;
mod matrix;
mod measure;
mod method;
mod options;
mod page;
mod paper;
mod plan;
mod results;
mod stored;
mod table;
mod tables;
mod training;
mod worker;

use std::path::{Path, PathBuf};

use luxel_metrics::LuminanceProfile;

use self::editing::Edited;
use self::matrix::{CellState, Matrix};
use self::measure::MeasureOptions;
pub use self::method::{METHOD_OPTIONS, StudyMethod, parse_method};
pub use self::options::{StudyDataset, StudyOptions, parse_dataset};
use self::page::Content;
pub use self::paper::parse_methods;
pub use self::plan::{StudyPlan, plan};
use self::results::CellResult;
use self::tables::Tables;
use crate::run::{Outcome, RunFolder};
use crate::{Error, Observer, Result, StopFlag, files};

/// A run that did not finish.
#[derive(Debug)]
pub struct Failure {
    /// Its name: `desk-lamp lcd seed 42`.
    pub run: String,
    /// Why.
    pub error: Error,
}

/// The files of a report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StudyFiles {
    /// The page, HTML.
    pub report: PathBuf,
    /// The tables, LaTeX.
    pub tables: PathBuf,
    /// A line per run, CSV.
    pub runs: PathBuf,
    /// Means and deviations over seeds, CSV.
    pub means: PathBuf,
    /// Error by luminance, CSV.
    pub profiles: PathBuf,
    /// Errors of luminance editing, CSV.
    pub editing: PathBuf,
}

/// The end of a study.
#[derive(Debug)]
pub enum Study {
    /// A stop was requested. Every run's state is saved, and the same call continues.
    Interrupted,
    /// The report is written.
    Reported {
        /// Its files.
        files: StudyFiles,
        /// Runs that are missing in it. The same call tries them again.
        failures: Vec<Failure>,
    },
}

/// Trains what is not finished, measures it and writes the report.
///
/// # Errors
/// Options that are wrong or contradict stored runs, an output folder that is in use or holds
/// something else, the file system's refusal. A run that fails is no error.
pub fn run(options: &StudyOptions, observer: &dyn Observer, stop: &StopFlag) -> Result<Study> {
    let matrix = Matrix::plan(options)?;
    // All options are checked before hours of training.
    let measure_options = MeasureOptions::read(options)?;
    matrix.check_root()?;
    let _lock = RunFolder::at(&matrix.root).lock()?;
    let states = matrix.states(options.word_difference)?;
    matrix.claim()?;
    let (outcome, mut failures) = training::train(&matrix, &states, &options.program, observer, stop)?;
    if outcome == Outcome::Interrupted {
        return Ok(Study::Interrupted);
    }
    let is_finished = |state: &CellState| *state == CellState::Finished;
    let states = matrix.states(options.word_difference)?;
    let finished: Vec<usize> = states.iter().enumerate().filter(|(_, state)| is_finished(state)).map(|(i, _)| i).collect();
    failures.extend(measure::measure(&matrix, &finished, &measure_options, &options.device, observer)?);
    let results = results::read(&matrix, &finished)?;
    // Results of training are reported without those of editing if need be.
    let edited = editing::edit(&matrix, &finished, &options.device, observer).unwrap_or_else(|error| {
        observer.warn(&format!("{:#}", error.context("luminance editing is left out of the report")));
        Vec::new()
    });
    let files = write(&matrix, &results, &failures, &edited)?;
    Ok(Study::Reported { files, failures })
}

/// Writes the report and its data.
fn write(matrix: &Matrix, results: &[CellResult], failures: &[Failure], edited: &[Edited]) -> Result<StudyFiles> {
    let tables = Tables::new(matrix, results);
    let profiles = profiles(matrix, results);
    let paths = StudyFiles::new(&matrix.root);
    files::write_text(&paths.runs, &csv::runs(matrix, results))?;
    files::write_text(&paths.means, &csv::means(matrix, results))?;
    files::write_text(&paths.profiles, &csv::profiles(matrix, &profiles))?;
    files::write_text(&paths.editing, &csv::editing(matrix, edited))?;
    files::write_text(
        &paths.tables,
        &(latex::document(matrix, &tables) + &beside::latex(matrix, &tables) + &latex::editing(matrix, edited)),
    )?;
    let editing = editing::section(matrix, edited)?;
    let content = Content { matrix, results, failures, tables: &tables, profiles: &profiles, editing };
    files::write_text(&paths.report, &page::page(&content)?)?;
    Ok(paths)
}

impl StudyFiles {
    fn new(root: &Path) -> Self {
        let [report, tables, runs, means, profiles, editing] =
            ["report.html", "tables.tex", "runs.csv", "means.csv", "profiles.csv", "editing.csv"].map(|name| root.join(name));
        Self { report, tables, runs, means, profiles, editing }
    }
}

/// The error by luminance of a method on a data set, pooled over the pixels of all seeds.
struct MethodProfile {
    /// Index into [`Matrix::sources`].
    source: usize,
    /// Index into [`Matrix::methods`].
    method: usize,
    profile: LuminanceProfile,
}

/// Pools the error by luminance over seeds.
fn profiles(matrix: &Matrix, results: &[CellResult]) -> Vec<MethodProfile> {
    let mut profiles = Vec::new();
    for (source, method) in (0..matrix.sources.len()).flat_map(|source| (0..matrix.methods.len()).map(move |method| (source, method))) {
        let mut profile = LuminanceProfile::default();
        for of_seed in results.iter().filter(|cell| cell.source == source && cell.method == method).filter_map(CellResult::profile) {
            profile.merge(of_seed);
        }
        if profile.count() > 0 {
            profiles.push(MethodProfile { source, method, profile });
        }
    }
    profiles
}
