//! Long work without Python's lock, on a thread of its own, so that Ctrl-C is answered at once.

use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use pyo3::prelude::*;

use crate::errors::invalid;
use crate::process;

/// Time between two looks for Ctrl-C.
const PATIENCE: Duration = Duration::from_millis(50);

/// Stack of the thread, bytes: as much as decoders need.
const STACK_BYTES: usize = 8 << 20;

/// Runs `work` and returns its result; refused in a fork of a process that did so before. After
/// Ctrl-C the exception is raised at once; the work, which cannot be stopped in between, comes to
/// its end unseen.
pub(crate) fn interruptible<T: Send + 'static>(py: Python<'_>, work: impl FnOnce() -> T + Send + 'static) -> PyResult<T> {
    process::check()?;
    let (sender, receiver) = channel();
    let work = move || drop(sender.send(work()));
    let builder = std::thread::Builder::new().name("luxel".into()).stack_size(STACK_BYTES);
    builder.spawn(work).map_err(|error| invalid(format!("cannot start a thread: {error}")))?;
    let receiver = Mutex::new(receiver);
    loop {
        match py.detach(|| locked(&receiver).recv_timeout(PATIENCE)) {
            Ok(result) => return Ok(result),
            Err(RecvTimeoutError::Timeout) => py.check_signals()?,
            Err(RecvTimeoutError::Disconnected) => return Err(without_result()),
        }
    }
}

/// Waits for a result without looking for Ctrl-C.
pub(crate) fn wait<T: Send>(py: Python<'_>, receiver: Receiver<T>) -> PyResult<T> {
    py.detach(move || receiver.recv()).map_err(|_| without_result())
}

fn without_result() -> PyErr {
    invalid("the work stopped without a result; please report this")
}

/// Works on what a lock guards, without Python's lock: whoever holds this one may be waiting for
/// that one. `work` must not call Python.
pub(crate) fn with_locked<T: Send, R: Send>(py: Python<'_>, mutex: &Mutex<T>, work: impl FnOnce(&mut T) -> R + Send) -> R {
    py.detach(|| work(&mut locked(mutex)))
}

/// Returns what a lock guards, whatever became of a thread that held it. With Python's lock, only
/// for what is held for a moment and never while Python is called.
pub(crate) fn locked<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
