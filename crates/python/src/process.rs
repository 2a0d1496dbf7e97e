//! Threads do not come along when a process forks: whoever waited for them would wait for ever, so
//! that work with them is refused in a process that does not have them.

use std::sync::atomic::{AtomicU32, Ordering};

use pyo3::prelude::*;

use crate::errors::with_remedy;

/// The process whose threads something works on.
#[derive(Clone, Copy)]
pub(crate) struct Home(u32);

impl Home {
    /// Returns the present process.
    pub(crate) fn here() -> Self {
        Self(std::process::id())
    }

    /// Works without Python's lock.
    ///
    /// # Errors
    /// The present process is a fork of that one.
    pub(crate) fn detach<T: Send>(self, py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
        self.check()?;
        Ok(py.detach(work))
    }

    fn check(self) -> PyResult<()> {
        if self.0 == std::process::id() { Ok(()) } else { Err(forked(self.0)) }
    }
}

/// The first process that called for work on the threads that all calls share; 0 for none yet.
static FIRST: AtomicU32 = AtomicU32::new(0);

/// Checks that the threads that all calls share are this process's, before work on them.
pub(crate) fn check() -> PyResult<()> {
    let here = std::process::id();
    match FIRST.compare_exchange(0, here, Ordering::Relaxed, Ordering::Relaxed) {
        Ok(_) => Ok(()),
        Err(first) => Home(first).check(),
    }
}

fn forked(from: u32) -> PyErr {
    let remedy = "start processes by multiprocessing's method \"spawn\" or \"forkserver\" (of a DataLoader: \
                  multiprocessing_context=\"spawn\"), or fork before the first call";
    let message = format!("process {} was forked from {from}, which had called luxel, and has none of its threads", std::process::id());
    with_remedy(format!("{message}; {remedy}"), Some(remedy.to_owned()))
}
