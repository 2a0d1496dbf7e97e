//! The runs that a study would train, and how long that takes.
//!
//! In: options. Out: [`StudyPlan`]; nothing is written. The time of a step is that of finished runs
//! of the same data set and method, else of the same data set, else of the first steps of a
//! training in memory, which are faster than later ones with more splats. Degenerate: nothing to
//! train takes no time.

use std::time::Instant;

use luxel::{Dataset, Observer, Result, Training};

use super::matrix::{Cell, CellState, Matrix};
use super::options::StudyOptions;
use super::results::CellResult;

/// Steps that are timed where no run has finished, and steps before them.
const TIMED_STEPS: usize = 40;
const WARM_UP_STEPS: usize = 10;

/// The runs of a study, and an estimate of the time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StudyPlan {
    /// Runs in all.
    pub runs: usize,
    /// Runs that are finished.
    pub finished: usize,
    /// Runs to train or continue.
    pub open: usize,
    /// Steps of the runs to train; those that interrupted runs have made count again.
    pub steps: u64,
    /// Runs side by side.
    pub jobs: usize,
    /// Estimate of the time of training, seconds.
    pub seconds: f64,
    /// Whether the speed is that of finished runs for every run to train.
    pub is_from_finished_runs: bool,
}

/// Returns what [`super::run`] would do with these options.
///
/// # Errors
/// As [`super::run`], before it trains.
pub fn plan(options: &StudyOptions, observer: &dyn Observer) -> Result<StudyPlan> {
    let matrix = Matrix::plan(options)?;
    matrix.check_root()?;
    let states = matrix.states(options.word_difference)?;
    matrix.report_readings(observer);
    let is_in_share = |cell: &Cell| options.share.is_none_or(|share| cell.job.is_some_and(|job| share.has(job)));
    let in_state = |wanted: CellState| matrix.cells.iter().zip(&states).filter(move |(_, state)| **state == wanted).map(|(cell, _)| cell);
    let cells = |wanted: CellState| in_state(wanted).filter(|cell| is_in_share(cell));
    let finished: Vec<CellResult> = in_state(CellState::Finished).filter_map(|cell| CellResult::read(cell).ok()).collect();
    let finished_in_share = cells(CellState::Finished).count();
    let (mut seconds, mut steps, mut is_from_finished_runs) = (0.0, 0, true);
    let mut timed: Vec<(usize, f64)> = Vec::new();
    for cell in cells(CellState::Open) {
        let of_run = speed(&finished, |result| result.source == cell.source && result.method == cell.method);
        let of_source = || speed(&finished, |result| result.source == cell.source);
        let of_first_steps = timed.iter().find(|(source, _)| *source == cell.source).map(|(_, seconds)| *seconds);
        let seconds_per_step = match of_run.or_else(of_source).or(of_first_steps) {
            Some(found) => found,
            None => {
                let found = time_first_steps(cell, observer)?;
                timed.push((cell.source, found));
                found
            }
        };
        is_from_finished_runs &= of_run.is_some();
        steps += u64::from(cell.config.train.iterations);
        seconds += seconds_per_step * f64::from(cell.config.train.iterations);
    }
    let open = cells(CellState::Open).count();
    let jobs = matrix.jobs.min(open).max(1);
    let runs = open + finished_in_share;
    Ok(StudyPlan { runs, finished: finished_in_share, open, steps, jobs, seconds: seconds / jobs as f64, is_from_finished_runs })
}

/// Returns the mean seconds per step of some finished runs; `None` if there are none.
fn speed(finished: &[CellResult], is_alike: impl Fn(&CellResult) -> bool) -> Option<f64> {
    let of_run = |result: &CellResult| result.metrics.train_seconds / f64::from(result.metrics.iterations.max(1));
    let found: Vec<f64> = finished.iter().filter(|result| is_alike(result)).map(of_run).filter(|seconds| *seconds > 0.0).collect();
    (!found.is_empty()).then(|| found.iter().sum::<f64>() / found.len() as f64)
}

/// Trains a run's first steps in memory, and returns the seconds per step.
fn time_first_steps(cell: &Cell, observer: &dyn Observer) -> Result<f64> {
    let config = &cell.config;
    if !config.train.method.stores_splats() {
        return crate::non_splat::seconds_per_step(config, [WARM_UP_STEPS, TIMED_STEPS], observer);
    }
    let dataset = Dataset::open_reporting(&config.dataset, &config.load, observer)?;
    let mut training = Training::builder(&dataset).config(config.train.clone()).device(config.device.clone()).start()?;
    for step in training.by_ref().take(WARM_UP_STEPS) {
        step?;
    }
    let start = Instant::now();
    let mut made = 0;
    for step in training.by_ref().take(TIMED_STEPS) {
        step?;
        made += 1;
    }
    Ok(start.elapsed().as_secs_f64() / f64::from(made.max(1)))
}
