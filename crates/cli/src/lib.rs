//! The command line of Luxel, for the program `luxel` and for the Python package's command of the
//! same name. One match, one error exit.

mod args;
mod commands;
mod inputs;
mod interrupt;
mod output;
mod remedy;

use std::ffi::OsString;
use std::io::{IsTerminal, Write};

use anyhow::Result;
use clap::FromArgMatches;
use luxel_app::run::{ExplicitArgs, Outcome};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use crate::args::{Cli, Command};
use crate::output::console::{self, LogFormat};

/// Exit code of a command that could not do its work.
const FAILURE: u8 = 1;

/// Runs the command that `args` ask for, of which the first is the program's name, and returns its
/// exit code: 0, 1 after an error, 2 for a command line that cannot be understood, 130 after an
/// interruption, or after SIGTERM what `--requeue-code` says. Handlers of Ctrl-C and SIGTERM are
/// installed for the process.
pub fn run(args: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> u8 {
    run_with(args, interrupt::install)
}

/// Runs a command as [`run`] does, within a program that handles signals itself and calls
/// [`interrupt`].
///
/// ```
/// assert_eq!(luxel_cli::run_within(["luxel", "info", "no/such/scene.ply"]), 1);
/// ```
pub fn run_within(args: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> u8 {
    interrupt::stop().withdraw();
    run_with(args, || Ok(()))
}

/// Asks a command that runs to save its state and stop. Returns whether it will: only training and
/// what is like it has something to save.
pub fn interrupt() -> bool {
    interrupt::stop().request();
    interrupt::stop().has_listener()
}

/// Runs a command; `handle_signals` comes before its first event.
fn run_with(args: impl IntoIterator<Item = impl Into<OsString> + Clone>, handle_signals: impl FnOnce() -> Result<()>) -> u8 {
    let words: Vec<OsString> = args.into_iter().map(Into::into).collect();
    let matches = match args::command().try_get_matches_from(&words) {
        Ok(matches) => matches,
        Err(error) => return answer(&args::with_new_names(error)),
    };
    let cli = match Cli::from_arg_matches(&matches) {
        Ok(cli) => cli,
        Err(error) => return answer(&error),
    };
    let explicit = matches.subcommand().map_or_else(ExplicitArgs::default, |(_, matches)| args::run_config::explicit_args(matches));
    if let Err(error) = args::check(&cli, &explicit) {
        return answer(&error);
    }
    start_logging();
    // Before the first event: who reads that may interrupt.
    let installed = handle_signals();
    if let Some((name, matches)) = matches.subcommand()
        && let Ok(Some(format)) = matches.try_get_one::<LogFormat>("log_format")
    {
        console::start(*format, name);
    }
    // GiB; the option of this name of prepare is another number and another type.
    let memory = matches.subcommand().and_then(|(_, matches)| matches.try_get_one::<u64>(args::MEMORY).ok().flatten().copied());
    if let Some(gib) = memory {
        luxel_io::set_memory_limit(gib << 30);
    }
    if let Some(code) = matches.subcommand().and_then(|(_, matches)| matches.try_get_one::<u8>("requeue_code").ok().flatten()) {
        interrupt::set_requeue_code(*code);
    }
    let threads = matches.subcommand().and_then(|(_, matches)| matches.try_get_one::<u32>("threads").ok().flatten().copied());
    match installed.and_then(|()| start(&cli.command, threads)).and_then(|()| on_large_stack(|| dispatch(cli.command, &explicit, &words))) {
        Ok(Outcome::Finished) => 0,
        Ok(Outcome::Interrupted) => interrupt::exit_code(),
        Err(error) => fail(&error),
    }
}

/// Prints what the command line's parser says, help or an error, and returns the exit code.
fn answer(error: &clap::Error) -> u8 {
    match error.print().and_then(|()| std::io::stdout().flush()) {
        Err(failed) if !error.use_stderr() => fail(&anyhow::Error::new(failed).context("cannot write to standard output")),
        _ => u8::try_from(error.exit_code()).unwrap_or(FAILURE),
    }
}

/// Prints an error with its causes and its remedy, and returns the exit code.
pub(crate) fn fail(error: &anyhow::Error) -> u8 {
    if reader_has_left(error) {
        return 0;
    }
    let message = remedy::text_of(error.as_ref());
    let causes: Vec<String> = error.chain().skip(1).map(remedy::text_of).collect();
    let remedy = remedy::of_error(error).map(remedy::word);
    console::failed(&message, &causes, remedy.as_deref());
    console::stderr_line(&format!("error: {message}"));
    for cause in &causes {
        console::stderr_line(&format!("  caused by: {cause}"));
    }
    if let Some(remedy) = remedy {
        console::stderr_line(&format!("  remedy: {remedy}"));
    }
    FAILURE
}

/// Starts the threads that files are decoded with.
fn start(command: &Command, threads: Option<u32>) -> Result<()> {
    match command {
        // A configuration file may name the number, which opening the engine takes from there.
        Command::Train(_) if threads.is_none() => Ok(()),
        // These read no files.
        Command::Doctor(_) | Command::Completions(_) | Command::Man(_) => Ok(()),
        // These commands have no such option.
        Command::Info(_) | Command::Compare(_) => luxel::start_threads(None).map_err(|error| {
            let remedy = luxel::Remedy::advice("raise the limit on processes, or set the environment variable RAYON_NUM_THREADS to 1");
            error.with_remedy(remedy).into()
        }),
        _ => Ok(luxel::start_threads(threads)?),
    }
}

/// Stack of the thread that a command runs on, bytes.
const STACK_BYTES: usize = 8 << 20;

/// Runs a command on a stack of its own: that of the first thread may be limited (`ulimit -s`) to
/// less than a decoder needs. Where no more threads are to be had, it runs on the first one.
fn on_large_stack(run: impl FnOnce() -> Result<Outcome> + Send) -> Result<Outcome> {
    let run = std::sync::Mutex::new(Some(run));
    let take = || run.lock().ok().and_then(|mut run| run.take());
    std::thread::scope(|scope| {
        let builder = std::thread::Builder::new().name("command".into()).stack_size(STACK_BYTES);
        match builder.spawn_scoped(scope, || take().map(|run| run())) {
            Ok(thread) => thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)),
            Err(_) => take().map(|run| run()),
        }
    })
    .unwrap_or_else(|| anyhow::bail!("the command did not run"))
}

/// Runs a command; `words` are those of the command line.
fn dispatch(command: Command, explicit: &ExplicitArgs, words: &[OsString]) -> Result<Outcome> {
    match command {
        Command::Demo(args) => commands::demo::run(&args),
        Command::Prepare(args) => commands::prepare::run(&args).map(|()| Outcome::Finished),
        Command::Train(args) => commands::train::run(&args, explicit),
        Command::Eval(args) => commands::eval::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Compare(args) => commands::compare::run(&args).map(|()| Outcome::Finished),
        Command::Render(args) => commands::render::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Edit(args) => commands::edit::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Export(args) => commands::export::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Mix(args) => commands::mix::run(&args).map(|()| Outcome::Finished),
        Command::Lights(args) => commands::lights::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Probe(args) => commands::probe::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Mesh(args) => commands::mesh::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Pick(args) => commands::pick::run(&args, explicit).map(|()| Outcome::Finished),
        #[cfg(feature = "view")]
        Command::View(args) => commands::view::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Info(args) => commands::info::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Doctor(args) => commands::doctor::run(&args).map(|()| Outcome::Finished),
        Command::Bench(args) => commands::bench::run(&args).map(|()| Outcome::Finished),
        Command::Reproduce(args) => commands::reproduce::run(&args, explicit, words),
        Command::Split(args) => commands::blocks::run_split(&args, explicit, words).map(|()| Outcome::Finished),
        Command::Merge(args) => commands::blocks::run_merge(&args).map(|()| Outcome::Finished),
        Command::Completions(args) => commands::completions::completions(&args, args::command()).map(|()| Outcome::Finished),
        Command::Man(args) => commands::completions::man(&args, args::command()).map(|()| Outcome::Finished),
    }
}

/// Sends what the libraries log to stderr: warnings and above, unless RUST_LOG lists other levels
/// by target, such as `info,luxel_io=debug`.
fn start_logging() {
    let stated = std::env::var("RUST_LOG").ok().and_then(|levels| levels.parse().ok());
    let filter = stated.unwrap_or_else(|| Targets::new().with_default(LevelFilter::WARN));
    let colors = std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    // A program that uses this library may log already.
    let _ = tracing_subscriber::fmt()
        .with_ansi(colors)
        .with_writer(std::io::stderr)
        .with_target(false)
        .without_time()
        .with_max_level(LevelFilter::TRACE)
        .finish()
        .with(filter)
        .try_init();
}

/// Returns whether the reader of standard output has left: `luxel info scene.ply | head -1` is no
/// failure.
fn reader_has_left(error: &anyhow::Error) -> bool {
    error.chain().filter_map(|cause| cause.downcast_ref::<std::io::Error>()).any(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
}
