//! Ctrl-C and SIGTERM. First: training finishes its step, saves and exits with 130. Second: the
//! process exits at once. Outside of training there is nothing to save, and the first one ends the
//! process. After SIGTERM the exit code is that of `--requeue-code` if it is given, by which a job
//! system knows to put the job back into its queue. Job systems send SIGTERM in several ways at
//! once: another within [`SAME_REQUEST`] is the same request.

#[cfg(unix)]
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{LazyLock, Mutex, PoisonError, mpsc};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use luxel::StopFlag;
use luxel_app::run::EXIT_INTERRUPTED;

use crate::output::console;

static STOP: LazyLock<StopFlag> = LazyLock::new(StopFlag::new);

/// Time of the first signal.
static FIRST_SIGNAL: Mutex<Option<Instant>> = Mutex::new(None);

/// Whether a job system asked for the end.
static IS_PREEMPTED: AtomicBool = AtomicBool::new(false);

/// The exit code that asks for requeuing; 0 for none.
static REQUEUE_CODE: AtomicU8 = AtomicU8::new(0);

/// Time during which another SIGTERM is the same request.
const SAME_REQUEST: Duration = Duration::from_secs(1);

/// A signal that asks for the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Asked {
    /// By a person: Ctrl-C, a terminal that closes.
    ByHand,
    /// By SIGTERM.
    ToTerminate,
}

/// Returns the flag that an interruption sets.
pub(crate) fn stop() -> &'static StopFlag {
    &STOP
}

/// Sets the exit code after SIGTERM.
pub(crate) fn set_requeue_code(code: u8) {
    REQUEUE_CODE.store(code, Ordering::SeqCst);
}

/// Takes note that this process stopped because another rank was asked to: unless it was asked,
/// too, its exit code is that after SIGTERM.
pub(crate) fn stopped_with_other_ranks() {
    if first_signal().is_none() {
        IS_PREEMPTED.store(true, Ordering::SeqCst);
    }
}

/// Returns the exit code after an interruption.
pub(crate) fn exit_code() -> u8 {
    match REQUEUE_CODE.load(Ordering::SeqCst) {
        0 => EXIT_INTERRUPTED,
        code if IS_PREEMPTED.load(Ordering::SeqCst) => code,
        _ => EXIT_INTERRUPTED,
    }
}

/// Installs the handler; once per process. Also makes a write beyond a limit on file sizes an error
/// that can be reported, where its signal would end the process.
pub(crate) fn install() -> Result<()> {
    #[cfg(unix)]
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::new(AtomicBool::new(false)))
        .context("cannot install the handler of limits on file sizes")?;
    watch().map_err(|error| {
        let remedy = luxel::Remedy::advice("raise the limit on processes of this user or container");
        luxel::Error::new(format!("cannot start the thread that waits for Ctrl-C: {error}")).with_remedy(remedy).into()
    })
}

/// Starts the thread that waits for signals.
#[cfg(unix)]
fn watch() -> std::io::Result<()> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    let mut signals = signal_hook::iterator::Signals::new([SIGINT, SIGTERM, SIGHUP])?;
    let wait = move || signals.forever().for_each(|signal| take(if signal == SIGTERM { Asked::ToTerminate } else { Asked::ByHand }));
    std::thread::Builder::new().name("signals".into()).spawn(wait).map(|_| ())
}

/// Starts the thread that waits for signals.
#[cfg(not(unix))]
fn watch() -> Result<(), ctrlc::Error> {
    ctrlc::set_handler(|| take(Asked::ByHand))
}

/// Answers a signal.
fn take(asked: Asked) {
    let first = first_signal();
    match (asked, first) {
        (Asked::ToTerminate, Some(at)) if at.elapsed() < SAME_REQUEST => return,
        (Asked::ToTerminate, None) => IS_PREEMPTED.store(true, Ordering::SeqCst),
        _ => {}
    }
    FIRST_SIGNAL.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(Instant::now);
    STOP.request();
    if first.is_some() || !STOP.has_listener() {
        leave();
    }
    console::note_from_handler("interrupted: finishing the step and saving; once more exits at once");
}

fn first_signal() -> Option<Instant> {
    *FIRST_SIGNAL.lock().unwrap_or_else(PoisonError::into_inner)
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
    std::process::exit(exit_code().into());
}
