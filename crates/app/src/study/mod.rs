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
//!
//! Processes that train a share each ([`StudyOptions::share`]) work in one folder at once, also on
//! several machines, and need no lock of it. Their runs differ; the list of what is asked for is
//! the same, written whole; and a run is finished once its metrics are there, which are written
//! last. A run that another process works in is left to that process, as far as the file system has
//! locks. Without them, a share that is begun twice at once is trained twice, to the same bits and
//! with each file whole; one of the two may end with an error where the other tidied up.

mod beside;
mod columns;
mod crops;
mod csv;
mod editing;
mod html_table;
mod jobs;
mod latex;
mod matrix;
mod measure;
mod method;
mod one_scale;
mod options;
mod page;
mod paper;
mod plan;
mod reading;
mod results;
mod share;
mod stored;
mod table;
mod tables;
mod training;
mod worker;

use std::path::{Path, PathBuf};

use luxel::error::bail;
use luxel::{Error, Observer, Result, StopFlag};
use luxel_metrics::LuminanceProfile;

use self::editing::Edited;
pub use self::jobs::{StudyJob, jobs};
use self::matrix::{CellState, Matrix};
use self::measure::MeasureOptions;
pub use self::method::{METHOD_OPTIONS, StudyMethod, parse_method};
pub use self::options::{StudyDataset, StudyOptions, parse_dataset};
use self::page::Content;
pub use self::paper::parse_methods;
pub use self::plan::{StudyPlan, plan};
use self::results::CellResult;
pub use self::share::{StudyShare, parse_share};
use self::tables::Tables;
use self::training::Todo;
use crate::files;
use crate::run::{Outcome, RunFolder};

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
    /// A share is trained, and others are not: there is no report yet.
    InPart {
        /// Names of runs that are not finished; none if another process writes the report now.
        missing: Vec<String>,
        /// Runs of the share that failed. The same call tries them again.
        failures: Vec<Failure>,
    },
    /// The report is written.
    Reported {
        /// Its files.
        files: StudyFiles,
        /// Names of runs that are missing in it.
        missing: Vec<String>,
        /// Those of them that failed in this call. The same call tries them again.
        failures: Vec<Failure>,
    },
}

/// Trains what is not finished, measures it and writes the report. With a share, trains that part
/// alone, beside other processes, and reports only if all runs are finished then.
///
/// # Errors
/// Options that are wrong or contradict stored runs, an output folder that is in use or holds
/// something else, the file system's refusal. A run that fails is no error.
pub fn run(options: &StudyOptions, observer: &dyn Observer, stop: &StopFlag) -> Result<Study> {
    let matrix = Matrix::plan(options)?;
    // All options are checked before hours of training.
    let measure_options = MeasureOptions::read(options)?;
    matrix.check_root()?;
    let lock = if options.share.is_none() { Some(RunFolder::at(&matrix.root).lock()?) } else { None };
    let states = matrix.states(options.word_difference)?;
    let is_due = |job: Option<usize>| options.share.is_none_or(|share| job.is_some_and(|job| share.has(job)));
    let is_open = |i: &usize| states.get(*i) == Some(&CellState::Open) && is_due(matrix.cells[*i].job);
    let open: Vec<usize> = (0..matrix.cells.len()).filter(is_open).collect();
    matrix.report_readings(observer);
    matrix.claim()?;
    let _confinement = luxel_io::confine(&matrix.root)?;
    let todo = Todo { open: &open, is_shared: options.share.is_some() };
    let (outcome, failures) = training::train(&matrix, todo, &options.program, observer, stop)?;
    if outcome == Outcome::Interrupted {
        return Ok(Study::Interrupted);
    }
    let states = matrix.states(options.word_difference)?;
    if options.share.is_some() {
        let missing = matrix.missing(&states);
        // Of several processes that see all runs finished, one writes the report.
        let lock = if missing.is_empty() { RunFolder::at(&matrix.root).lock().ok() } else { None };
        let Some(_lock) = lock else { return Ok(Study::InPart { missing, failures }) };
        return report_on(&matrix, &states, failures, Reporting { options, measure_options, observer });
    }
    let study = report_on(&matrix, &states, failures, Reporting { options, measure_options, observer });
    drop(lock);
    study
}

/// Trains nothing, measures the finished runs and writes the report on them, which names those that
/// are missing.
///
/// # Errors
/// As [`run`]; no run that is finished.
pub fn report(options: &StudyOptions, observer: &dyn Observer) -> Result<Study> {
    let matrix = Matrix::plan(options)?;
    let measure_options = MeasureOptions::read(options)?;
    matrix.check_root()?;
    let states = matrix.states(options.word_difference)?;
    if !states.contains(&CellState::Finished) {
        bail!("{}: no run is finished, so there is nothing to report", matrix.root.display());
    }
    let _lock = RunFolder::at(&matrix.root).lock()?;
    report_on(&matrix, &states, Vec::new(), Reporting { options, measure_options, observer })
}

/// Needs of a report besides the runs.
struct Reporting<'a> {
    options: &'a StudyOptions,
    measure_options: MeasureOptions,
    observer: &'a dyn Observer,
}

/// Measures the finished cells and writes the report.
fn report_on(matrix: &Matrix, states: &[CellState], mut failures: Vec<Failure>, reporting: Reporting<'_>) -> Result<Study> {
    let Reporting { options, measure_options, observer } = reporting;
    let is_finished = |state: &CellState| *state == CellState::Finished;
    let finished: Vec<usize> = states.iter().enumerate().filter(|(_, state)| is_finished(state)).map(|(i, _)| i).collect();
    failures.extend(measure::measure(matrix, &finished, &measure_options, &options.device, observer)?);
    let results = results::read(matrix, &finished)?;
    // Results of training are reported without those of editing if need be.
    let edited = editing::edit(matrix, &finished, &options.device, observer).unwrap_or_else(|error| {
        observer.warn(&format!("{:#}", error.context("luminance editing is left out of the report")));
        Vec::new()
    });
    let missing = matrix.missing(states);
    let files = write(matrix, &results, Gaps { failures: &failures, missing: &missing }, &edited)?;
    Ok(Study::Reported { files, missing, failures })
}

/// The runs that a report is without.
#[derive(Clone, Copy)]
struct Gaps<'a> {
    failures: &'a [Failure],
    missing: &'a [String],
}

/// Writes the report and its data.
fn write(matrix: &Matrix, results: &[CellResult], gaps: Gaps<'_>, edited: &[Edited]) -> Result<StudyFiles> {
    let Gaps { failures, missing } = gaps;
    let tables = Tables::new(matrix, results);
    let profiles = profiles(matrix, results);
    let paths = StudyFiles::new(&matrix.root);
    files::write_text(&paths.runs, &csv::runs(matrix, results))?;
    files::write_text(&paths.means, &csv::means(matrix, results))?;
    files::write_text(&paths.profiles, &csv::profiles(matrix, &profiles))?;
    files::write_text(&paths.editing, &csv::editing(matrix, edited))?;
    files::write_text(
        &paths.tables,
        &(latex::document(matrix, &tables, missing) + &beside::latex(matrix, &tables) + &latex::editing(matrix, edited)),
    )?;
    let editing = editing::section(matrix, edited)?;
    let content = Content { matrix, results, failures, missing, tables: &tables, profiles: &profiles, editing };
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
