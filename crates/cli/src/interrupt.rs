//! Ctrl-C and SIGTERM. First: training finishes its step, saves and exits with 130. Second: the process exits at once. Outside of
//! training there is nothing to save, and the first one ends the process.

use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};

/// Exit code of an interrupted program: 128 + SIGINT.
pub(crate) const EXIT_INTERRUPTED: u8 = 130;

static REQUESTED: AtomicBool = AtomicBool::new(false);
static TRAINING: AtomicBool = AtomicBool::new(false);

/// Installs the handler; once per process.
pub(crate) fn install() -> Result<()> {
    ctrlc::set_handler(|| {
        let second = REQUESTED.swap(true, Ordering::SeqCst);
        if second || !TRAINING.load(Ordering::SeqCst) {
            leave();
        }
        crate::console::note_from_handler("interrupted: finishing the step and saving; once more exits at once");
    })
    .context("cannot install the handler of Ctrl-C")
}

/// The end of standard input counts as one interruption, from a thread of its own: whoever started the program and holds its input open stops it by
/// letting go, also by ending.
pub(crate) fn at_end_of_input() {
    std::thread::spawn(|| {
        // What is said there is nobody's business.
        let _ = std::io::copy(&mut std::io::stdin().lock(), &mut std::io::sink());
        REQUESTED.store(true, Ordering::SeqCst);
        if !TRAINING.load(Ordering::SeqCst) {
            leave();
        }
    });
}

/// Ends the process without half of a file left behind.
fn leave() -> ! {
    luxel_io::remove_unfinished();
    std::process::exit(EXIT_INTERRUPTED.into());
}

/// Whether the user asked to stop.
pub(crate) fn requested() -> bool {
    REQUESTED.load(Ordering::SeqCst)
}

/// While it lives, the first interruption asks training to save instead of ending the process.
pub(crate) struct SaveOnInterrupt(());

impl SaveOnInterrupt {
    /// From here on there is something to save.
    pub(crate) fn begin() -> Self {
        TRAINING.store(true, Ordering::SeqCst);
        Self(())
    }
}

impl Drop for SaveOnInterrupt {
    fn drop(&mut self) {
        TRAINING.store(false, Ordering::SeqCst);
    }
}
