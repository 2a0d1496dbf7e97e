//! Events that a long task reports to an observer while it works.
//!
//! A task takes `&dyn Observer` and calls it from the thread it works in; a call must not block for
//! long, as the task waits for it. Events are owned values, so that an observer may send them
//! through a channel.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use luxel_metrics::ViewMetrics;

use crate::live::LiveRun;
use crate::log_record::LogRecord;

/// Something that happened during a task.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Event {
    /// Something good to know.
    Note(String),
    /// Something that may need attention; the task continues.
    Warning(String),
    /// Steps begin: `done` of `total` are made already.
    StepsBegin {
        /// Steps made by earlier parts of the task.
        done: u32,
        /// Steps in all.
        total: u32,
    },
    /// A step was made: `done` so far.
    Step {
        /// Steps made so far.
        done: u32,
    },
    /// The numbers of the last steps, which are in the run's log too.
    Progress {
        /// A line of the log.
        record: LogRecord,
        /// Steps in all.
        total: u32,
    },
    /// Views were measured.
    Evaluation {
        /// Steps made.
        step: u32,
        /// Name of the split: `test`, `train`.
        split: String,
        /// Means over the views.
        mean: ViewMetrics,
        /// Number of views.
        views: usize,
    },
    /// One of several things of a kind is done.
    Item {
        /// The kind.
        kind: ItemKind,
        /// The name of the thing, or of the stage that it went through.
        name: String,
        /// Things done so far.
        done: u32,
        /// Things in all.
        total: u32,
    },
    /// One of several images is done.
    Frame {
        /// Name of the view or of the direction.
        name: String,
        /// The files that were written of it.
        files: Vec<PathBuf>,
        /// Images done so far.
        done: u32,
        /// Images in all.
        total: u32,
    },
    /// Training of a run of a study began.
    RunStarted {
        /// Name of the run.
        run: String,
    },
    /// A run of a study finished.
    RunFinished {
        /// Name of the run.
        run: String,
        /// Runs finished by this call.
        finished: usize,
        /// Runs that this call trains.
        total: usize,
    },
    /// Steps of a study's runs were made.
    StudyProgress {
        /// Steps made, by earlier calls too.
        steps: u32,
        /// Steps in all.
        total_steps: u32,
        /// Runs finished by this call.
        runs_finished: usize,
        /// Runs that this call trains.
        runs: usize,
        /// Estimate of the time that training still takes.
        seconds_left: Option<f64>,
    },
    /// Steps have ended, all of them or not.
    StepsEnd,
    /// A checkpoint or a scene was written.
    Saved {
        /// The file.
        path: PathBuf,
    },
}

/// The kind of an [`Event::Item`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ItemKind {
    /// A view's radiance and proxy.
    View,
    /// A view of a data set that was read.
    LoadedView,
    /// A view's undistorted image.
    UndistortedImage,
    /// A view in a stage of structure from motion, which the item is named by.
    StructureFromMotion,
}

/// Receives the events of a task.
///
/// Closures are observers:
///
/// ```
/// use luxel::{Event, Observer};
///
/// let (sender, receiver) = std::sync::mpsc::channel();
/// let observer = move |event: Event| sender.send(event).unwrap();
/// observer.warn("8-bit images are not HDR");
/// drop(observer);
/// assert_eq!(receiver.recv().unwrap(), Event::Warning("8-bit images are not HDR".into()));
/// ```
pub trait Observer {
    /// Takes note of an event.
    fn event(&self, event: Event);

    /// Reports [`Event::Note`].
    fn note(&self, message: &str) {
        self.event(Event::Note(message.to_owned()));
    }

    /// Reports [`Event::Warning`].
    fn warn(&self, message: &str) {
        self.event(Event::Warning(message.to_owned()));
    }

    /// Looks at a run between two steps, for example to render what it has learned; returns what
    /// the run is to do. Training waits for the visit, whose time does not count as training's, and
    /// its result does not depend on it.
    fn visit(&self, _run: &mut LiveRun<'_>) -> VisitAction {
        VisitAction::Continue
    }
}

/// A visitor's request to a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum VisitAction {
    /// Make the next step.
    #[default]
    Continue,
    /// Write a checkpoint before the next step.
    Save,
}

impl<F: Fn(Event)> Observer for F {
    fn event(&self, event: Event) {
        self(event);
    }
}

/// An observer that ignores every event.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Observer for Silent {
    fn event(&self, _: Event) {}
}

/// Counts images and reports them as [`Event::Frame`].
#[derive(Clone, Copy)]
pub struct FrameProgress<'a> {
    /// Receives the events.
    pub observer: &'a dyn Observer,
    /// Images done so far.
    pub done: u32,
    /// Images in all.
    pub total: u32,
}

impl FrameProgress<'_> {
    /// Reports one more image.
    pub fn add(&mut self, name: &str, files: Vec<PathBuf>) {
        self.done += 1;
        self.observer.event(Event::Frame { name: name.to_owned(), files, done: self.done, total: self.total });
    }
}

/// Asks a task to stop at the next place where it can save its state. Clones share the request.
///
/// ```
/// let stop = luxel::StopFlag::new();
/// let handle = stop.clone();
/// std::thread::spawn(move || handle.request()).join().unwrap();
/// assert!(stop.is_requested());
/// ```
#[derive(Clone, Debug, Default)]
pub struct StopFlag(Arc<StopState>);

#[derive(Debug, Default)]
struct StopState {
    requested: AtomicBool,
    listeners: AtomicUsize,
}

impl StopFlag {
    /// Returns a flag that is not set.
    pub fn new() -> Self {
        Self::default()
    }

    /// Sets the flag; returns whether it was set before.
    pub fn request(&self) -> bool {
        self.0.requested.swap(true, Ordering::SeqCst)
    }

    /// Takes the request back, before another task begins.
    pub fn withdraw(&self) {
        self.0.requested.store(false, Ordering::SeqCst);
    }

    /// Returns whether the flag is set.
    pub fn is_requested(&self) -> bool {
        self.0.requested.load(Ordering::SeqCst)
    }

    /// Marks, until the returned value is dropped, that a task looks at the flag and has something
    /// to save.
    pub fn listen(&self) -> StopListener {
        self.0.listeners.fetch_add(1, Ordering::SeqCst);
        StopListener(self.clone())
    }

    /// Returns whether a task looks at the flag. Where none does, nothing is lost by ending the
    /// process at once.
    pub fn has_listener(&self) -> bool {
        self.0.listeners.load(Ordering::SeqCst) > 0
    }
}

/// The mark of a task that looks at a [`StopFlag`].
#[derive(Debug)]
pub struct StopListener(StopFlag);

impl Drop for StopListener {
    fn drop(&mut self) {
        self.0.0.listeners.fetch_sub(1, Ordering::SeqCst);
    }
}
