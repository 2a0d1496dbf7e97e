//! The program `luxel` within Python.

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::mpsc::channel;

use pyo3::prelude::*;

use crate::wait::{interruptible, wait};

fn with_name(args: Vec<PathBuf>) -> Vec<OsString> {
    std::iter::once("luxel".into()).chain(args.into_iter().map(PathBuf::into_os_string)).collect()
}

/// Runs a command of the program `luxel` in this process, and returns its exit code: 0, 1 after an
/// error, 2 for a command line that cannot be understood. What the command prints goes to standard
/// output and error. After Ctrl-C, training saves its state before KeyboardInterrupt is raised.
///
/// Args:
///     args: the command and its options, such as ["info", "scene.ply"]; text or paths.
#[pyfunction]
pub(crate) fn run_command(py: Python<'_>, args: Vec<PathBuf>) -> PyResult<u8> {
    let args = with_name(args);
    let (done, receiver) = channel();
    let run = move || {
        // Nobody waits any longer where this fails.
        let _ = done.send(luxel_cli::run_within(args));
    };
    let interrupted = match interruptible(py, run) {
        Ok(()) => None,
        Err(error) if luxel_cli::interrupt() => Some(error),
        Err(error) => return Err(error),
    };
    let code = wait(py, receiver)?;
    interrupted.map_or(Ok(code), Err)
}

/// The program itself, with its own handlers of signals.
#[pyfunction]
pub(crate) fn main(py: Python<'_>, args: Vec<PathBuf>) -> u8 {
    py.detach(|| luxel_cli::run(with_name(args)))
}
