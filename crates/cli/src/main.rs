//! `luxel`: the command line of Luxel. One match, one error exit.

mod args;
mod commands;
mod inputs;
mod interrupt;
mod output;
mod remedy;

use std::process::ExitCode;

use anyhow::Result;
use clap::FromArgMatches;
use luxel::run::{ExplicitArgs, Outcome};

use crate::args::{Cli, Command};
use crate::output::console;

fn main() -> ExitCode {
    let matches = args::command().get_matches();
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let explicit = matches.subcommand().map_or_else(ExplicitArgs::default, |(_, matches)| args::run_config::explicit_args(matches));
    args::check(&cli, &explicit).unwrap_or_else(|error| error.exit());
    start_logging();
    match interrupt::install().and_then(|()| dispatch(cli.command, &explicit)) {
        Ok(Outcome::Finished) => ExitCode::SUCCESS,
        Ok(Outcome::Interrupted) => ExitCode::from(interrupt::EXIT_INTERRUPTED),
        Err(error) if reader_has_left(&error) => ExitCode::SUCCESS,
        Err(error) => {
            console::stderr_line(&format!("error: {}", remedy::text_of(error.as_ref())));
            for cause in error.chain().skip(1) {
                console::stderr_line(&format!("  caused by: {}", remedy::text_of(cause)));
            }
            if let Some(remedy) = remedy::of_error(&error) {
                console::stderr_line(&format!("  remedy: {}", remedy::word(remedy)));
            }
            ExitCode::FAILURE
        }
    }
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
        Command::Info(args) => commands::info::run(&args, explicit).map(|()| Outcome::Finished),
        Command::Bench(args) => commands::bench::run(&args).map(|()| Outcome::Finished),
        Command::Reproduce(args) => commands::reproduce::run(&args, explicit),
        Command::Completions(args) => commands::completions::completions(&args, args::command()).map(|()| Outcome::Finished),
        Command::Man(args) => commands::completions::man(&args, args::command()).map(|()| Outcome::Finished),
    }
}

/// Sends what the libraries log to stderr: warnings and above unless RUST_LOG sets another filter.
fn start_logging() {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "warn".into());
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_target(false).without_time().init();
}

/// Returns whether the reader of standard output has left: `luxel info scene.ply | head -1` is no
/// failure.
fn reader_has_left(error: &anyhow::Error) -> bool {
    error.chain().filter_map(|cause| cause.downcast_ref::<std::io::Error>()).any(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
}
