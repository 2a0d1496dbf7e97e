//! Ctrl-C and SIGTERM. First: training finishes its step, saves and exits with 130. Second: the
//! process exits at once. Outside of training there is nothing to save, and the first one ends the
//! process.

#[cfg(unix)]
use std::sync::{Arc, atomic::AtomicBool};
use std::sync::{LazyLock, mpsc};
use std::time::Duration;

use anyhow::{Context, Result};
use luxel::StopFlag;
pub(crate) use luxel::run::EXIT_INTERRUPTED;

use crate::output::console;

static STOP: LazyLock<StopFlag> = LazyLock::new(StopFlag::new);

/// Returns the flag that an interruption sets.
pub(crate) fn stop() -> &'static StopFlag {
    &STOP
}

/// Installs the handler; once per process. Also makes a write beyond a limit on file sizes an error
/// that can be reported, where its signal would end the process.
pub(crate) fn install() -> Result<()> {
    #[cfg(unix)]
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::new(AtomicBool::new(false)))
        .context("cannot install the handler of limits on file sizes")?;
    ctrlc::set_handler(|| {
        let is_second = STOP.request();
        if is_second || !STOP.has_listener() {
            leave();
        }
        console::note_from_handler("interrupted: finishing the step and saving; once more exits at once");
    })
    .map_err(|error| {
        let remedy = luxel::Remedy::advice("raise the limit on processes of this user or container");
        luxel::Error::new(format!("cannot start the thread that waits for Ctrl-C: {error}")).with_remedy(remedy).into()
    })
}

/// Counts the end of standard input as one interruption, from a thread of its own: a program that
/// starts this one and holds its input open stops it by closing the input, also by ending.
pub(crate) fn at_end_of_input() {
    std::thread::spawn(|| {
        // The input's content has no meaning.
        let _ = std::io::copy(&mut std::io::stdin().lock(), &mut std::io::sink());
        STOP.request();
        if !STOP.has_listener() {
            leave();
        }
    });
}

/// Longest wait for a reader of standard output, which may have stopped to read.
const LONGEST_WAIT: Duration = Duration::from_millis(500);

/// Ends the process without half of a file left behind.
fn leave() -> ! {
    luxel_io::remove_unfinished();
    let (done, wait) = mpsc::channel();
    std::thread::spawn(move || {
        console::interrupted();
        // Nobody waits any longer where this fails.
        let _ = done.send(());
    });
    let _ = wait.recv_timeout(LONGEST_WAIT);
    std::process::exit(EXIT_INTERRUPTED.into());
}
