//! All open cells, some side by side, with what the user is told meanwhile. Which run where and when changes no result, but their times.

use std::collections::BTreeSet;
use std::process::ChildStdin;
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use luxel::run::Outcome;
use luxel::run::log::LOG_EVERY;
use luxel::text;
use serde_json::json;

use super::matrix::{Cell, CellState, Matrix};
use super::worker::{Ended, Told, Worker};
use crate::interrupt;
use crate::output::console::Console;

/// How soon an interruption is passed on.
const PATIENCE: Duration = Duration::from_millis(50);

/// A cell that did not come to its end.
#[derive(Debug)]
pub(super) struct Failure {
    /// Index into [`Matrix::cells`].
    pub(super) cell: usize,
    pub(super) error: anyhow::Error,
}

/// What comes from the threads that wait for children.
enum Message {
    Started(usize),
    Told(usize, Told),
    Ended(usize, Result<Ended>),
}

/// Cells to do, and the standard inputs of the children at work.
struct Shared {
    /// Last first.
    waiting: Vec<usize>,
    inputs: Vec<(usize, ChildStdin)>,
}

/// Trains every open cell. A cell that fails does not stop the others.
pub(super) fn train(matrix: &Matrix, states: &[CellState], console: &mut Console) -> Result<(Outcome, Vec<Failure>)> {
    let open: Vec<usize> = (0..matrix.cells.len()).filter(|&i| states.get(i) == Some(&CellState::Open)).collect();
    if open.is_empty() {
        return Ok((Outcome::Finished, Vec::new()));
    }
    let program = std::env::current_exe().context("cannot find the program's own file, which trains the cells")?;
    let guard = interrupt::stop().listen();
    let shared = Mutex::new(Shared { waiting: open.iter().rev().copied().collect(), inputs: Vec::new() });
    let (sender, receiver) = channel();
    let work = |sender: Sender<Message>| {
        while let Some(cell) = next(&shared) {
            let _ = sender.send(Message::Started(cell));
            let ended = start(&program, matrix, cell, &shared).and_then(|worker| {
                worker.wait(|told| {
                    // Nobody listens when the main thread has ended, which it does last.
                    let _ = sender.send(Message::Told(cell, told));
                })
            });
            lock(&shared).inputs.retain(|(of, _)| *of != cell);
            let _ = sender.send(Message::Ended(cell, ended));
        }
    };
    let mut progress = Progress::new(matrix, &open, console);
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

fn start(program: &std::path::Path, matrix: &Matrix, cell: usize, shared: &Mutex<Shared>) -> Result<Worker> {
    let mut shared = lock(shared);
    let (worker, input) = Worker::start(program, &matrix.cells[cell])?;
    // Where an interruption came first, the input ends at once.
    if !interrupt::stop().is_requested() {
        shared.inputs.push((cell, input));
    }
    Ok(worker)
}

fn next(shared: &Mutex<Shared>) -> Option<usize> {
    if interrupt::stop().is_requested() { None } else { lock(shared).waiting.pop() }
}

/// What a thread left when it panicked is as good as any.
fn lock(shared: &Mutex<Shared>) -> std::sync::MutexGuard<'_, Shared> {
    shared.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// What the user sees.
struct Progress<'a> {
    matrix: &'a Matrix,
    console: &'a mut Console,
    /// Steps made in each cell, those of earlier times included.
    steps: Vec<u32>,
    /// Steps that were made before this time, by cell.
    steps_before: Vec<Option<u32>>,
    open: usize,
    total_steps: u32,
    done: usize,
    started: Instant,
    failures: Vec<Failure>,
    interrupted: bool,
    /// Warnings that were passed on: every cell of a data set has the same.
    warned: BTreeSet<String>,
}

impl<'a> Progress<'a> {
    fn new(matrix: &'a Matrix, open: &[usize], console: &'a mut Console) -> Self {
        let steps = |&i: &usize| matrix.cells.get(i).map_or(0, |cell| cell.config.train.iterations);
        let total_steps = open.iter().map(steps).fold(0, u32::saturating_add);
        console.note(&format!(
            "training {} of {}, {} at a time with {} each; finished ones are kept",
            text::plural(open.len(), "run"),
            text::count(matrix.cells.len()),
            matrix.jobs.min(open.len()),
            text::plural(matrix.threads, "thread"),
        ));
        console.begin_steps(0, total_steps);
        Self {
            matrix,
            console,
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

    /// Until the last child has ended. An interruption ends the children's inputs.
    fn follow(&mut self, messages: &Receiver<Message>, shared: &Mutex<Shared>) {
        loop {
            match messages.recv_timeout(PATIENCE) {
                Ok(message) => self.take(message),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            if interrupt::stop().is_requested() {
                self.interrupted = true;
                lock(shared).inputs.clear();
            }
        }
    }

    fn take(&mut self, message: Message) {
        match message {
            Message::Started(cell) => {
                let name = self.name(cell);
                self.console.event(&json!({ "event": "run_started", "run": name }), &format!("{name}: training"));
            }
            Message::Told(cell, Told::Progress { iteration }) => {
                self.set_steps(cell, iteration);
                self.tell_progress();
            }
            Message::Told(_, Told::Warning { message }) => {
                if self.warned.insert(message.clone()) {
                    self.console.warn(&message);
                }
            }
            Message::Told(_, Told::Other) => {}
            Message::Ended(cell, Ok(Ended::Finished)) => {
                self.set_steps(cell, self.matrix.cells[cell].config.train.iterations);
                self.done += 1;
                self.tell_finished(cell);
            }
            Message::Ended(_, Ok(Ended::Interrupted)) => self.interrupted = true,
            Message::Ended(cell, Err(error)) => {
                self.console.warn(&format!("{}: {error:#}; the other runs go on", self.name(cell)));
                self.failures.push(Failure { cell, error });
            }
        }
    }

    fn tell_finished(&mut self, cell: usize) {
        let name = self.name(cell);
        let event = json!({ "event": "run_finished", "run": name, "runs_finished": self.done, "runs": self.open });
        self.console.event(&event, &format!("{name}: finished, {} of {}", self.done, text::plural(self.open, "run")));
    }

    fn tell_progress(&mut self) {
        let sum = |steps: &mut dyn Iterator<Item = u32>| steps.fold(0, u32::saturating_add);
        let steps = sum(&mut self.steps.iter().copied());
        let made_now = steps.saturating_sub(sum(&mut self.steps_before.iter().flatten().copied()));
        let left = self.total_steps.saturating_sub(steps);
        let seconds_left = (made_now > 0).then(|| self.started.elapsed().as_secs_f64() * f64::from(left) / f64::from(made_now));
        let event = json!({ "event": "matrix_progress", "steps": steps, "total_steps": self.total_steps, "runs_finished": self.done,
            "runs": self.open, "seconds_left": seconds_left });
        let time = seconds_left.and_then(|s| Duration::try_from_secs_f64(s).ok());
        let time = time.map_or_else(String::new, |time| format!(", about {} left", text::duration(time)));
        let percent = 100.0 * f64::from(steps) / f64::from(self.total_steps.max(1));
        self.console
            .overall(&event, &format!("{percent:.0} % of all steps, {} of {} finished{time}", self.done, text::plural(self.open, "run")));
    }

    fn set_steps(&mut self, cell: usize, steps: u32) {
        if let (Some(of_cell), Some(before)) = (self.steps.get_mut(cell), self.steps_before.get_mut(cell)) {
            // The first word of a run that goes on is a step or a hundred after it began to.
            before.get_or_insert(steps.saturating_sub(LOG_EVERY));
            *of_cell = steps;
        }
        self.console.step(self.steps.iter().fold(0, |sum, steps| sum.saturating_add(*steps)));
    }

    fn name(&self, cell: usize) -> String {
        self.matrix.cells.get(cell).map_or_else(String::new, |cell: &Cell| cell.name(self.matrix))
    }

    fn finish(self) -> (Outcome, Vec<Failure>) {
        self.console.end_steps();
        let outcome = if self.interrupted { Outcome::Interrupted } else { Outcome::Finished };
        (outcome, self.failures)
    }
}
