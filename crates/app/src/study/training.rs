//! Training of all open cells, some side by side.
//!
//! In: the matrix and its cells to train. Out: whether it was interrupted, and the cells that
//! failed. The order of the runs and their number side by side change their times, but no result.
//! Degenerate: nothing open, nothing started.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::ChildStdin;
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use luxel::{Event, Observer, Result, StopFlag};

use super::Failure;
use super::matrix::{Cell, Matrix};
use super::worker::{Ended, Worker, WorkerEvent};
use crate::run::Outcome;
use crate::run::log::LOG_EVERY;
use crate::text;

/// Interval at which a request to stop is looked for.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Messages from the threads that wait for children.
enum Message {
    Started(usize),
    FromWorker(usize, WorkerEvent),
    Ended(usize, Result<Ended>),
}

/// Cells to train, and the standard inputs of running children.
struct Shared {
    /// Indices of cells, last first.
    waiting: Vec<usize>,
    inputs: Vec<(usize, ChildStdin)>,
    stop: StopFlag,
}

/// The runs to train, and what becomes of those that another process trains meanwhile.
#[derive(Clone, Copy)]
pub(super) struct Todo<'a> {
    /// Indices of cells.
    pub(super) open: &'a [usize],
    /// Whether a run that another process works in is left to it; else it counts as failed.
    pub(super) is_shared: bool,
}

/// Trains cells. A cell that fails does not stop the others.
pub(super) fn train(
    matrix: &Matrix,
    todo: Todo<'_>,
    program: &Path,
    observer: &dyn Observer,
    stop: &StopFlag,
) -> Result<(Outcome, Vec<Failure>)> {
    let Todo { open, is_shared } = todo;
    if open.is_empty() {
        return Ok((Outcome::Finished, Vec::new()));
    }
    let guard = stop.listen();
    let shared = Mutex::new(Shared { waiting: open.iter().rev().copied().collect(), inputs: Vec::new(), stop: stop.clone() });
    let (sender, receiver) = channel();
    let work = |sender: Sender<Message>| {
        while let Some(cell) = next(&shared) {
            let _ = sender.send(Message::Started(cell));
            let is_elsewhere = || is_shared && matrix.cells[cell].folder.is_locked();
            let train = || {
                start(program, matrix, cell, &shared)?.wait(|event| {
                    // Sending fails only after the main thread has ended, which it does last.
                    let _ = sender.send(Message::FromWorker(cell, event));
                })
            };
            let ended = match if is_elsewhere() { Ok(Ended::Elsewhere) } else { train() } {
                // Another process took the folder just before.
                Err(_) if is_elsewhere() => Ok(Ended::Elsewhere),
                ended => ended,
            };
            lock(&shared).inputs.retain(|(owner, _)| *owner != cell);
            let _ = sender.send(Message::Ended(cell, ended));
        }
    };
    let mut progress = Progress::new(matrix, open, observer);
    std::thread::scope(|scope| {
        for _ in 0..matrix.jobs.min(open.len()) {
            let (work, sender) = (&work, sender.clone());
            scope.spawn(move || work(sender));
        }
        drop(sender);
        progress.follow(&receiver, &shared);
    });
    let (outcome, failures) = progress.finish();
    drop(guard);
    Ok((outcome, failures))
}

fn start(program: &Path, matrix: &Matrix, cell: usize, shared: &Mutex<Shared>) -> Result<Worker> {
    let mut shared = lock(shared);
    let (worker, input) = Worker::start(program, &matrix.cells[cell], matrix.memory_gib)?;
    // After a request to stop, the input ends at once.
    if !shared.stop.is_requested() {
        shared.inputs.push((cell, input));
    }
    Ok(worker)
}

fn next(shared: &Mutex<Shared>) -> Option<usize> {
    let mut shared = lock(shared);
    if shared.stop.is_requested() { None } else { shared.waiting.pop() }
}

/// Locks; the state that a thread left when it panicked is consistent.
fn lock(shared: &Mutex<Shared>) -> std::sync::MutexGuard<'_, Shared> {
    shared.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// Progress as it is reported.
struct Progress<'a> {
    matrix: &'a Matrix,
    observer: &'a dyn Observer,
    /// Steps made in each cell, by earlier calls too.
    steps: Vec<u32>,
    /// Steps that earlier calls made, by cell.
    steps_before: Vec<Option<u32>>,
    open: usize,
    total_steps: u32,
    done: usize,
    started: Instant,
    failures: Vec<Failure>,
    interrupted: bool,
    /// Warnings that were reported: every cell of a data set has the same.
    warned: BTreeSet<String>,
}

impl<'a> Progress<'a> {
    fn new(matrix: &'a Matrix, open: &[usize], observer: &'a dyn Observer) -> Self {
        let steps = |&i: &usize| matrix.cells.get(i).map_or(0, |cell| cell.config.train.iterations);
        let total_steps = open.iter().map(steps).fold(0, u32::saturating_add);
        observer.note(&format!(
            "training {} of {}, {} at a time with {} each; finished runs are kept",
            text::plural(open.len(), "run"),
            text::count(matrix.cells.len()),
            matrix.jobs.min(open.len()),
            text::plural(matrix.threads, "thread"),
        ));
        observer.event(Event::StepsBegin { done: 0, total: total_steps });
        Self {
            matrix,
            observer,
            steps: vec![0; matrix.cells.len()],
            steps_before: vec![None; matrix.cells.len()],
            open: open.len(),
            total_steps,
            done: 0,
            started: Instant::now(),
            failures: Vec::new(),
            interrupted: false,
            warned: BTreeSet::new(),
        }
    }

    /// Handles messages until the last child has ended. A request to stop ends the children's
    /// inputs.
    fn follow(&mut self, messages: &Receiver<Message>, shared: &Mutex<Shared>) {
        loop {
            match messages.recv_timeout(POLL_INTERVAL) {
                Ok(message) => self.take(message),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            let mut shared = lock(shared);
            if shared.stop.is_requested() {
                self.interrupted = true;
                shared.inputs.clear();
            }
        }
    }

    fn take(&mut self, message: Message) {
        match message {
            Message::Started(cell) => {
                self.observer.event(Event::RunStarted { run: self.name(cell) });
            }
            Message::FromWorker(cell, WorkerEvent::Progress { iteration }) => {
                self.set_steps(cell, iteration);
                self.report_progress();
            }
            Message::FromWorker(_, WorkerEvent::Warning { message }) => {
                if self.warned.insert(message.clone()) {
                    self.observer.warn(&message);
                }
            }
            Message::FromWorker(_, WorkerEvent::Other) => {}
            Message::Ended(cell, Ok(Ended::Finished)) => {
                self.set_steps(cell, self.matrix.cells[cell].config.train.iterations);
                self.done += 1;
                self.report_finished(cell);
            }
            Message::Ended(_, Ok(Ended::Interrupted)) => self.interrupted = true,
            Message::Ended(cell, Ok(Ended::Elsewhere)) => {
                self.observer.note(&format!("{}: another process trains it", self.name(cell)));
            }
            Message::Ended(cell, Err(error)) => {
                self.observer.warn(&format!("{}: {error:#}; the other runs continue", self.name(cell)));
                self.failures.push(Failure { run: self.name(cell), error });
            }
        }
    }

    fn report_finished(&mut self, cell: usize) {
        self.observer.event(Event::RunFinished { run: self.name(cell), finished: self.done, total: self.open });
    }

    fn report_progress(&mut self) {
        let sum = |steps: &mut dyn Iterator<Item = u32>| steps.fold(0, u32::saturating_add);
        let steps = sum(&mut self.steps.iter().copied());
        let made_now = steps.saturating_sub(sum(&mut self.steps_before.iter().flatten().copied()));
        let left = self.total_steps.saturating_sub(steps);
        let seconds_left = (made_now > 0).then(|| self.started.elapsed().as_secs_f64() * f64::from(left) / f64::from(made_now));
        self.observer.event(Event::StudyProgress {
            steps,
            total_steps: self.total_steps,
            runs_finished: self.done,
            runs: self.open,
            seconds_left,
        });
    }

    fn set_steps(&mut self, cell: usize, steps: u32) {
        if let (Some(of_cell), Some(before)) = (self.steps.get_mut(cell), self.steps_before.get_mut(cell)) {
            // The first report of a continued run comes up to this many steps after it started.
            before.get_or_insert(steps.saturating_sub(LOG_EVERY));
            *of_cell = steps;
        }
        self.observer.event(Event::Step { done: self.steps.iter().fold(0, |sum, steps| sum.saturating_add(*steps)) });
    }

    fn name(&self, cell: usize) -> String {
        self.matrix.cells.get(cell).map_or_else(String::new, |cell: &Cell| cell.name(self.matrix))
    }

    fn finish(self) -> (Outcome, Vec<Failure>) {
        self.observer.event(Event::StepsEnd);
        let outcome = if self.interrupted { Outcome::Interrupted } else { Outcome::Finished };
        (outcome, self.failures)
    }
}
