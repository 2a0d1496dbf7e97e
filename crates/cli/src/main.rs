//! `luxel`: the command line of Luxel. One match, one error exit.

mod args;
mod commands;
mod environment;
mod inputs;
mod interrupt;
mod output;
mod remedy;

use std::io::{IsTerminal, Write};
use std::process::ExitCode;

use anyhow::Result;
use clap::FromArgMatches;
use luxel::run::{ExplicitArgs, Outcome};

use crate::args::{Cli, Command};
use crate::output::console::{self, LogFormat};

fn main() -> ExitCode {
    environment::prepare();
    let matches = match args::command().try_get_matches() {
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
    let installed = interrupt::install();
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
    let threads = matches.subcommand().and_then(|(_, matches)| matches.try_get_one::<u32>("threads").ok().flatten().copied());
    match installed.and_then(|()| start(&cli.command, threads)).and_then(|()| on_large_stack(|| dispatch(cli.command, &explicit))) {
        Ok(Outcome::Finished) => ExitCode::SUCCESS,
        Ok(Outcome::Interrupted) => ExitCode::from(interrupt::EXIT_INTERRUPTED),
        Err(error) => fail(&error),
    }
}

/// Prints what the command line's parser says, help or an error, and returns the exit code.
fn answer(error: &clap::Error) -> ExitCode {
    match error.print().and_then(|()| std::io::stdout().flush()) {
        Err(failed) if !error.use_stderr() => fail(&anyhow::Error::new(failed).context("cannot write to standard output")),
        _ => ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(1)),
    }
}

/// Prints an error with its causes and its remedy, and returns the exit code.
fn fail(error: &anyhow::Error) -> ExitCode {
    if reader_has_left(error) {
        return ExitCode::SUCCESS;
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
    ExitCode::FAILURE
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

fn dispatch(command: Command, explicit: &ExplicitArgs) -> Result<Outcome> {
    match command {
        Command::Demo(args) => commands::demo::run(&args),
        Command::Prepare(args) => commands::prepare::run(&args).map(|()| Outcome::Finished),
        Command::Train(args) => commands::train::run(&args, explicit),
        Command::Eval(args) => commands::eval::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Compare(args) => commands::compare::run(&args).map(|()| Outcome::Finished),
        Command::Render(args) => commands::render::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Edit(args) => commands::edit::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Export(args) => commands::export::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Probe(args) => commands::probe::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Pick(args) => commands::pick::run(&args, explicit).map(|()| Outcome::Finished),
        #[cfg(feature = "view")]
        Command::View(args) => commands::view::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Info(args) => commands::info::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Doctor(args) => commands::doctor::run(&args).map(|()| Outcome::Finished),
        Command::Bench(args) => commands::bench::run(&args).map(|()| Outcome::Finished),
        Command::Reproduce(args) => commands::reproduce::run(&args, explicit),
        Command::Completions(args) => commands::completions::completions(&args, args::command()).map(|()| Outcome::Finished),
        Command::Man(args) => commands::completions::man(&args, args::command()).map(|()| Outcome::Finished),
    }
}

/// Sends what the libraries log to stderr: warnings and above unless RUST_LOG sets another filter.
fn start_logging() {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "warn".into());
    let colors = std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    tracing_subscriber::fmt()
        .with_ansi(colors)
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_target(false)
        .without_time()
        .init();
}

/// Returns whether the reader of standard output has left: `luxel info scene.ply | head -1` is no
/// failure.
fn reader_has_left(error: &anyhow::Error) -> bool {
    error.chain().filter_map(|cause| cause.downcast_ref::<std::io::Error>()).any(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
}
