//! The state that changes while a viewer is open: the version of the scene, and the progress of a
//! training.
//!
//! In: steps and lines of the log from the thread that trains; out: the newest [`Status`] to every
//! page that listens, and the whole history to pages that have just opened. A slow page misses
//! states in between, never the newest.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use serde::Serialize;
use tokio::sync::watch;

/// The newest state.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Status {
    /// Version of the scene: steps of a training, 0 otherwise.
    pub(crate) version: u64,
    /// Number of splats.
    pub(crate) splats: usize,
    /// Number of times that the cameras of the views have moved.
    pub(crate) cameras: u64,
    /// Progress; `None` where nothing is trained.
    pub(crate) training: Option<TrainingStatus>,
}

impl Status {
    /// Takes over steps and splats, and leaves the rest.
    pub(crate) fn advance(&mut self, newest: Self) {
        (self.version, self.splats) = (newest.version, newest.splats);
        if let (Some(training), Some(newest)) = (&mut self.training, newest.training) {
            (training.done, training.total) = (newest.done, newest.total);
        }
    }
}

/// The progress of a training.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct TrainingStatus {
    /// Steps made.
    pub(crate) done: u32,
    /// Steps in all.
    pub(crate) total: u32,
    /// Whether it waits to be continued.
    pub(crate) is_paused: bool,
    /// Whether it has ended.
    pub(crate) is_finished: bool,
    /// Lines of the history that there are.
    pub(crate) records: usize,
}

/// A line of the history: a line of the run's log.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Record {
    pub(crate) iteration: u32,
    pub(crate) loss: f64,
    pub(crate) psnr_train: Option<f64>,
    pub(crate) psnr_test: Option<f64>,
    pub(crate) splats: usize,
    pub(crate) iterations_per_second: f64,
    pub(crate) elapsed_s: f64,
}

/// Requests of the page to a training.
#[derive(Debug, Default)]
pub(crate) struct Wishes {
    /// Wait after the step.
    pub(crate) pause: AtomicBool,
    /// Write a checkpoint after the step.
    pub(crate) save: AtomicBool,
    /// Save and end after the step.
    pub(crate) stop: AtomicBool,
}

/// The state that the server and the thread that renders share.
#[derive(Debug)]
pub(crate) struct Shared {
    newest: watch::Sender<Status>,
    history: Mutex<Vec<Record>>,
    /// Requests of the page.
    pub(crate) wishes: Wishes,
}

impl Shared {
    pub(crate) fn new(status: Status) -> Self {
        Self { newest: watch::Sender::new(status), history: Mutex::default(), wishes: Wishes::default() }
    }

    /// Changes the state, and sends it to the pages.
    pub(crate) fn update(&self, change: impl FnOnce(&mut Status)) {
        self.newest.send_modify(change);
    }

    /// Changes the state of the training; pages hear of it if `change` returns that it did.
    pub(crate) fn update_if(&self, change: impl FnOnce(&mut TrainingStatus) -> bool) {
        self.newest.send_if_modified(|status| status.training.as_mut().is_some_and(change));
    }

    /// Returns the newest state.
    pub(crate) fn status(&self) -> Status {
        self.newest.borrow().clone()
    }

    /// Returns a receiver of states, whose first is the newest.
    pub(crate) fn listen(&self) -> watch::Receiver<Status> {
        let mut receiver = self.newest.subscribe();
        receiver.mark_changed();
        receiver
    }

    /// Adds a line to the history.
    pub(crate) fn record(&self, record: Record) {
        let mut history = self.history.lock().unwrap_or_else(PoisonError::into_inner);
        // A training that was resumed repeats the steps after its checkpoint.
        history.retain(|line| line.iteration < record.iteration);
        history.push(record);
        let records = history.len();
        drop(history);
        self.update(|status| status.training.get_or_insert_default().records = records);
    }

    /// Returns the history from line `from` on.
    pub(crate) fn history(&self, from: usize) -> Vec<Record> {
        let history = self.history.lock().unwrap_or_else(PoisonError::into_inner);
        history.get(from..).unwrap_or_default().to_vec()
    }

    /// Takes a wish back and returns whether there was one.
    pub(crate) fn take(wish: &AtomicBool) -> bool {
        wish.swap(false, Ordering::SeqCst)
    }
}
