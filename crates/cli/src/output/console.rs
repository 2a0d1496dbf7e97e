//! Progress, notes and results of a command.
//!
//! Text: a progress bar on a terminal, a plain line every few seconds elsewhere, both on stderr;
//! results on stdout. JSON: one object a line on stdout, whose `event` names its kind. Each file
//! that was written is a line, whoever wrote it; the last line has all of them.

use std::cell::{Cell, RefCell};
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use luxel::{Event, ItemKind, LogRecord, Observer};
use luxel_app::{schema, text};
use serde_json::json;

use super::metrics_table::mean_line;

/// Form of progress reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// For programs: one JSON object a line on stdout.
    Json,
}

/// Time between plain progress lines: short enough to see progress, long enough for a readable log
/// of a night.
const LINE_INTERVAL: Duration = Duration::from_secs(5);
/// A bar shows the time left from this part of its steps on.
const LEAST_KNOWN: u64 = 20;
/// Time between lines about many runs together, which take hours.
const OVERALL_INTERVAL: Duration = Duration::from_secs(30);

/// Whether events are printed, for those that come from outside of a command.
static PRINTS_EVENTS: AtomicBool = AtomicBool::new(false);

/// The files that were written.
static WRITTEN: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Reports the start of a command, and from now on each file that is written, as `format` asks.
pub(crate) fn start(format: LogFormat, command: &str) {
    if format == LogFormat::Json {
        PRINTS_EVENTS.store(true, Ordering::Relaxed);
        emit(&json!({ "event": "started", "command": command, "luxel_version": luxel::VERSION }));
        luxel_io::notice_written(wrote);
    }
}

/// Reports a file that was written.
pub(crate) fn wrote(path: &Path) {
    if !PRINTS_EVENTS.load(Ordering::Relaxed) {
        return;
    }
    let mut written = WRITTEN.lock().unwrap_or_else(PoisonError::into_inner);
    if !written.iter().any(|other| other == path) {
        written.push(path.to_owned());
    }
    drop(written);
    emit(&json!({ "event": "written", "path": path.display().to_string() }));
}

/// Reports an error, for programs.
pub(crate) fn failed(message: &str, causes: &[String], remedy: Option<&str>) {
    if PRINTS_EVENTS.load(Ordering::Relaxed) {
        emit(&last(json!({ "event": "error", "message": message, "causes": causes, "remedy": remedy })));
    }
}

/// Reports an interruption that ends the process at once, for programs.
pub(crate) fn interrupted() {
    if PRINTS_EVENTS.load(Ordering::Relaxed) {
        emit(&last(json!({ "event": "interrupted" })));
    }
}

/// Returns the last event of a command, with the files that were written and are still there.
fn last(mut event: serde_json::Value) -> serde_json::Value {
    let written = WRITTEN.lock().unwrap_or_else(PoisonError::into_inner);
    let paths: Vec<String> = written.iter().filter(|path| path.exists()).map(|path| path.display().to_string()).collect();
    event["written"] = paths.into();
    event
}

/// The one place that writes to the terminal.
pub(crate) struct Console {
    style: Style,
    bar: RefCell<Option<ProgressBar>>,
    /// Whether the bar shows numbers of a training, in place of the time left.
    has_numbers: Cell<bool>,
    last_line: Cell<Option<Instant>>,
    since: Instant,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Style {
    Bar,
    Lines,
    Json,
    Quiet,
}

impl Console {
    /// Returns a console; `quiet` leaves warnings, errors and results.
    pub(crate) fn new(format: LogFormat, quiet: bool) -> Self {
        let style = match (format, quiet) {
            (LogFormat::Json, _) => Style::Json,
            (LogFormat::Text, true) => Style::Quiet,
            (LogFormat::Text, false) if std::io::stderr().is_terminal() => Style::Bar,
            (LogFormat::Text, false) => Style::Lines,
        };
        let (has_numbers, last_line) = (Cell::default(), Cell::default());
        Self { style, bar: RefCell::default(), has_numbers, last_line, since: Instant::now() }
    }

    /// Reports something good to know.
    pub(crate) fn note(&self, message: &str) {
        match self.style {
            Style::Json => emit(&json!({ "event": "note", "message": message })),
            Style::Bar | Style::Lines => self.line(message),
            Style::Quiet => {}
        }
    }

    /// Reports something that may need attention.
    pub(crate) fn warn(&self, message: &str) {
        match self.style {
            Style::Json => emit(&json!({ "event": "warning", "message": message })),
            _ => self.line(&format!("warning: {message}")),
        }
    }

    /// Reports an event: an object for programs, text for people.
    pub(crate) fn event(&self, event: &serde_json::Value, text: &str) {
        match self.style {
            Style::Json => emit(event),
            Style::Bar | Style::Lines => self.line(text),
            Style::Quiet => {}
        }
    }

    /// Reports the end of the command: the event `finished` for programs, with `facts` and all
    /// files that were written; for people the text on stdout.
    pub(crate) fn finish(&self, facts: serde_json::Value, text: &str) -> Result<()> {
        self.result(&finished(facts), text)
    }

    /// Reports the end of the command as [`Self::finish`], with a text that is progress, not a
    /// result.
    pub(crate) fn finish_with_note(&self, facts: serde_json::Value, text: &str) {
        self.event(&finished(facts), text);
    }

    /// Reports the end of a command whose results are reported already: for programs alone.
    pub(crate) fn finish_silently(&self, facts: serde_json::Value) {
        if self.style == Style::Json {
            emit(&finished(facts));
        }
    }

    /// Reports that the command was interrupted and has saved its state.
    pub(crate) fn interrupted(&self, text: &str) {
        self.event(&last(json!({ "event": "interrupted", "message": text })), text);
    }

    /// Prints the result of the command on stdout: an event for programs, text for people.
    pub(crate) fn result(&self, event: &serde_json::Value, text: &str) -> Result<()> {
        match self.style {
            Style::Json => print(&versioned(event)),
            Style::Bar | Style::Lines | Style::Quiet => print(text),
        }
    }

    fn line(&self, message: &str) {
        match &*self.bar.borrow() {
            Some(bar) => bar.suspend(|| stderr_line(message)),
            None => stderr_line(message),
        }
    }

    /// Starts the bar of `total` steps at `step`.
    pub(crate) fn begin_steps(&self, step: u32, total: u32) {
        if self.style != Style::Bar {
            return;
        }
        self.end_steps();
        let bar = ProgressBar::with_draw_target(Some(total.into()), ProgressDrawTarget::stderr_with_hz(5));
        // The template is a constant; if the library should reject it, its own style is as good.
        if let Ok(style) = ProgressStyle::with_template("{bar:24.cyan/blue} {pos}/{len}  {wide_msg}") {
            bar.set_style(style);
        }
        bar.set_position(step.into());
        self.has_numbers.set(false);
        *self.bar.borrow_mut() = Some(bar);
    }

    /// Moves the bar to `step`.
    pub(crate) fn step(&self, step: u32) {
        if let Some(bar) = &*self.bar.borrow() {
            bar.set_position(step.into());
            // The first steps of many tell little, and those of a training cost less than the later
            // ones.
            let is_known = u64::from(step) * LEAST_KNOWN >= bar.length().unwrap_or(0);
            if is_known && !self.has_numbers.get() {
                bar.set_message(format!("{} left", text::duration(bar.eta())));
            }
        }
    }

    /// Reports that one of several images is done.
    fn frame(&self, name: &str, files: &[PathBuf], [done, total]: [u32; 2]) {
        match self.style {
            Style::Json => {
                let files: Vec<String> = files.iter().map(|path| path.display().to_string()).collect();
                emit(&json!({ "event": "frame", "name": name, "files": files, "done": done, "frames": total }));
            }
            Style::Bar => {
                let has_bar = self.bar.borrow().is_some();
                if !has_bar {
                    self.begin_steps(0, total);
                }
                self.step(done);
                if done >= total {
                    self.end_steps();
                }
            }
            Style::Lines => {
                if self.last_line.get().unwrap_or(self.since).elapsed() >= LINE_INTERVAL {
                    self.last_line.set(Some(Instant::now()));
                    stderr_line(&format!("image {done}/{total}  {}", text::one_line(name)));
                }
            }
            Style::Quiet => {}
        }
    }

    /// Reports the numbers of the last steps.
    pub(crate) fn progress(&self, record: &LogRecord, total: u32) {
        match self.style {
            Style::Json => {
                let mut event = json!({ "event": "progress", "iterations": total, "seconds_left": record.seconds_left(total) });
                if let (Some(event), Ok(serde_json::Value::Object(fields))) = (event.as_object_mut(), serde_json::to_value(record)) {
                    event.extend(fields);
                }
                emit(&event);
            }
            Style::Bar => {
                if let Some(bar) = &*self.bar.borrow() {
                    self.has_numbers.set(true);
                    bar.set_message(numbers(record, total));
                }
            }
            Style::Lines => {
                if self.last_line.get().is_none_or(|at| at.elapsed() >= LINE_INTERVAL) || record.iteration == total {
                    self.last_line.set(Some(Instant::now()));
                    let percent = 100.0 * f64::from(record.iteration) / f64::from(total.max(1));
                    stderr_line(&format!("step {}/{total} ({percent:.0} %)  {}", record.iteration, numbers(record, total)));
                }
            }
            Style::Quiet => {}
        }
    }

    /// Reports how far several runs are together.
    pub(crate) fn overall(&self, event: &serde_json::Value, text: &str) {
        match self.style {
            Style::Json => emit(event),
            Style::Bar => {
                if let Some(bar) = &*self.bar.borrow() {
                    bar.set_message(text::one_line(text).into_owned());
                }
            }
            Style::Lines => {
                if self.last_line.get().is_none_or(|at| at.elapsed() >= OVERALL_INTERVAL) {
                    self.last_line.set(Some(Instant::now()));
                    stderr_line(text);
                }
            }
            Style::Quiet => {}
        }
    }

    /// Reports that one of several things of a kind is done.
    fn item(&self, kind: ItemKind, name: &str, [done, total]: [u32; 2]) {
        let (event, text) = match kind {
            ItemKind::View => (json!({ "event": "view", "name": name }), format!("view {done}/{total}  {name}")),
            ItemKind::LoadedView => (json!({ "event": "loaded", "name": name }), format!("read {done} of {total} images")),
            ItemKind::UndistortedImage => (json!({ "event": "image", "name": name }), format!("undistorted {done}/{total}")),
            ItemKind::StructureFromMotion => (json!({ "event": "sfm", "step": name }), format!("{name}: {done} of {total}")),
            _ => return,
        };
        let mut event = event;
        event["done"] = done.into();
        event["views"] = total.into();
        self.overall(&event, &text);
    }

    /// Removes the bar.
    pub(crate) fn end_steps(&self) {
        if let Some(bar) = self.bar.borrow_mut().take() {
            bar.finish_and_clear();
        }
    }
}

impl Observer for Console {
    fn event(&self, event: Event) {
        match event {
            Event::Note(message) => self.note(&message),
            Event::Warning(message) => self.warn(&message),
            Event::StepsBegin { done, total } => self.begin_steps(done, total),
            Event::Step { done } => self.step(done),
            Event::StepsEnd => self.end_steps(),
            Event::RunStarted { run } => self.event(&json!({ "event": "run_started", "run": run }), &format!("{run}: training")),
            Event::RunFinished { run, finished, total } => {
                let event = json!({ "event": "run_finished", "run": run, "runs_finished": finished, "runs": total });
                self.event(&event, &format!("{run}: finished, {finished} of {}", text::plural(total, "run")));
            }
            Event::StudyProgress { steps, total_steps, runs_finished, runs, seconds_left } => {
                let event = json!({ "event": "matrix_progress", "steps": steps, "total_steps": total_steps,
                    "runs_finished": runs_finished, "runs": runs, "seconds_left": seconds_left });
                let left = seconds_left.and_then(|s| Duration::try_from_secs_f64(s).ok());
                let left = left.map_or_else(String::new, |left| format!(", about {} left", text::duration(left)));
                let percent = 100.0 * f64::from(steps) / f64::from(total_steps.max(1));
                let runs = text::plural(runs, "run");
                self.overall(&event, &format!("{percent:.0} % of all steps, {runs_finished} of {runs} finished{left}"));
            }
            Event::Progress { record, total } => self.progress(&record, total),
            Event::Evaluation { step, split, mean, views } => {
                let event = json!({ "event": "evaluation", "iteration": step, "split": split, "mean": mean });
                self.event(&event, &format!("step {step}: {split} {}", mean_line(&mean, views)));
            }
            Event::Frame { name, files, done, total } => self.frame(&name, &files, [done, total]),
            Event::Item { kind, name, done, total } => self.item(kind, &name, [done, total]),
            // Saved files are named at the end.
            _ => {}
        }
    }
}

/// Returns the event of a command that has finished.
fn finished(mut facts: serde_json::Value) -> serde_json::Value {
    facts["event"] = "finished".into();
    last(facts)
}

/// `12.3 it/s  39 min 12 s left  loss 0.0412  psnr 31.2 train 29.9 test  45,210 splats  812.0 MiB`.
fn numbers(record: &LogRecord, total: u32) -> String {
    let left = record.seconds_left(total).and_then(|s| Duration::try_from_secs_f64(s).ok());
    let left = left.map_or(String::new(), |left| format!("  {} left", text::duration(left)));
    let train = record.psnr_train.map(|v| format!("{v:.2} train"));
    let test = record.psnr_test_sample.or(record.psnr_test).map(|v| format!("{v:.2} test"));
    let psnr = match (train, test) {
        (None, None) => String::new(),
        (train, test) => format!("  psnr {}", [train, test].into_iter().flatten().collect::<Vec<_>>().join(" ")),
    };
    let memory = record.rss_bytes.map_or(String::new(), |b| format!("  {}", text::bytes(b)));
    format!("{:.1} it/s{left}  loss {:.4}{psnr}  {} splats{memory}", record.iterations_per_second, record.loss, text::count(record.splats))
}

/// Prints a line of a result on stdout. Fails when the reader has left, which `main` takes for a
/// quiet end.
pub(crate) fn print(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    let text = text::printable(text);
    writeln!(out, "{text}").and_then(|()| out.flush()).context("cannot write to standard output")
}

/// Returns the line of an event, with the version of its schema.
fn versioned(event: &serde_json::Value) -> String {
    let mut event = event.clone();
    if let Some(entries) = event.as_object_mut() {
        entries.insert(schema::VERSION_FIELD.to_owned(), schema::EVENT.version.into());
    }
    event.to_string()
}

/// Prints one JSON object on stdout; a reader that has left does not end a training run.
fn emit(event: &serde_json::Value) {
    let mut out = std::io::stdout().lock();
    let _ = writeln!(out, "{}", versioned(event)).and_then(|()| out.flush());
}

/// Prints a line on stderr; a closed stderr is no reason to stop.
pub(crate) fn stderr_line(message: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{}", text::printable(message));
}

/// Prints a line on stderr from the interrupt handler's thread, below the bar.
pub(crate) fn note_from_handler(message: &str) {
    let _ = writeln!(std::io::stderr(), "\n{message}");
}
