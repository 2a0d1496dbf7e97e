//! Events of a task as log records and calls of a progress function.
//!
//! Notes are records of level INFO, warnings of level WARNING, of the logger `luxel`.

use std::sync::Mutex;

use luxel::{Event, Observer};
use pyo3::prelude::*;

use crate::wait::locked;

/// Reports to `logging` and to a function `progress(done, total, name)`.
#[derive(Default)]
pub(crate) struct PyObserver {
    progress: Option<Py<PyAny>>,
    total: Mutex<u32>,
    failure: Mutex<Option<PyErr>>,
}

impl PyObserver {
    /// Returns an observer that calls `progress` if there is one.
    pub(crate) fn new(progress: Option<Py<PyAny>>) -> Self {
        Self { progress, ..Self::default() }
    }

    /// Returns the first exception that a call raised.
    pub(crate) fn failure(&self) -> PyResult<()> {
        locked(&self.failure).take().map_or(Ok(()), Err)
    }

    fn call(&self, done: u32, total: u32, name: &str) {
        let Some(progress) = &self.progress else { return };
        if locked(&self.failure).is_some() {
            return;
        }
        let called = Python::attach(|py| progress.call1(py, (done, total, name)).map(drop));
        if let Err(error) = called {
            *locked(&self.failure) = Some(error);
        }
    }
}

impl Observer for PyObserver {
    fn event(&self, event: Event) {
        match event {
            Event::Note(text) => log("info", &text),
            Event::Warning(text) => log("warning", &text),
            Event::StepsBegin { done, total } => {
                *locked(&self.total) = total;
                self.call(done, total, "steps");
            }
            Event::Step { done } => {
                let total = *locked(&self.total);
                self.call(done, total, "steps");
            }
            Event::Item { name, done, total, .. } | Event::Frame { name, done, total, .. } => self.call(done, total, &name),
            _ => {}
        }
    }
}

/// Writes a record of the logger `luxel`.
pub(crate) fn log(level: &str, text: &str) {
    Python::attach(|py| {
        let logged =
            py.import("logging").and_then(|logging| logging.call_method1("getLogger", ("luxel",))?.call_method1(level, ("%s", text)));
        if let Err(error) = logged {
            error.write_unraisable(py, None);
        }
    });
}
