//! The runs of a study as jobs for several processes.
//!
//! In: options, which number the runs by their own order of seeds, data sets and methods, whatever
//! the folder holds. Out: [`StudyJob`]s; which of them a [`super::StudyShare`] has.

use std::path::PathBuf;

use luxel::Result;

use super::matrix::{CellState, Matrix};
use super::options::StudyOptions;

/// A run of a study as a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StudyJob {
    /// Its name: `desk-lamp lcd seed 42`.
    pub run: String,
    /// Its folder.
    pub folder: PathBuf,
    /// Steps of its training.
    pub steps: u32,
    /// Whether it is trained and evaluated.
    pub is_finished: bool,
}

/// Returns the runs that the options ask for, in an order that depends on nothing else; writes
/// nothing. The share `K/N` of N runs is the K-th.
///
/// # Errors
/// As [`super::run`], before it trains.
pub fn jobs(options: &StudyOptions) -> Result<Vec<StudyJob>> {
    let matrix = Matrix::plan(options)?;
    matrix.check_root()?;
    let states = matrix.states(options.word_difference)?;
    let mut jobs: Vec<(usize, StudyJob)> = Vec::new();
    for (cell, state) in matrix.cells.iter().zip(states) {
        let Some(number) = cell.job else { continue };
        let (run, folder) = (cell.name(&matrix), cell.folder.root().to_owned());
        let (steps, is_finished) = (cell.config.train.iterations, state == CellState::Finished);
        jobs.push((number, StudyJob { run, folder, steps, is_finished }));
    }
    jobs.sort_by_key(|(number, _)| *number);
    Ok(jobs.into_iter().map(|(_, job)| job).collect())
}
