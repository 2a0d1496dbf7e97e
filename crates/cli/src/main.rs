//! `luxel`: the command line of Luxel. One match, one error exit.

mod captures;
mod cli;
mod clock;
mod colormap;
mod commands;
mod config;
mod console;
mod data;
mod editing;
mod engine;
mod evaluation;
mod facts;
mod interrupt;
mod preview;
mod report;
mod reporting;
mod run_folder;
mod run_log;
mod run_state;
mod scene_source;
mod session;
mod values;

use std::process::ExitCode;

use anyhow::Result;
use clap::FromArgMatches;

use luxel::{files, machine, memory, text};

use crate::cli::{Cli, Command};
use crate::session::Outcome;

fn main() -> ExitCode {
    let matches = cli::command().get_matches();
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let said = matches.subcommand().map_or(Vec::new(), |(_, matches)| config::said_options(matches));
    cli::check(&cli, &said).unwrap_or_else(|error| error.exit());
    start_logging();
    match interrupt::install().and_then(|()| dispatch(cli.command, &said)) {
        Ok(Outcome::Finished) => ExitCode::SUCCESS,
        Ok(Outcome::Interrupted) => ExitCode::from(interrupt::EXIT_INTERRUPTED),
        Err(error) if reader_has_gone(&error) => ExitCode::SUCCESS,
        Err(error) => {
            console::stderr_line(&format!("error: {error}"));
            for cause in error.chain().skip(1) {
                console::stderr_line(&format!("  caused by: {cause}"));
            }
            ExitCode::FAILURE
        }
    }
}

fn dispatch(command: Command, said: &[String]) -> Result<Outcome> {
    match command {
        Command::Demo(args) => commands::demo::run(&args),
        Command::Prepare(args) => commands::prepare::run(&args).map(|()| Outcome::Finished),
        Command::Train(args) => commands::train::run(&args, said),
        Command::Eval(args) => commands::eval::run(&args, said).map(|()| Outcome::Finished),
        Command::Compare(args) => commands::compare::run(&args).map(|()| Outcome::Finished),
        Command::Render(args) => commands::render::run(&args, said).map(|()| Outcome::Finished),
        Command::Edit(args) => commands::edit::run(&args, said).map(|()| Outcome::Finished),
        Command::Export(args) => commands::export::run(&args, said).map(|()| Outcome::Finished),
        Command::Probe(args) => commands::probe::run(&args, said).map(|()| Outcome::Finished),
        Command::Info(args) => commands::info::run(&args, said).map(|()| Outcome::Finished),
        Command::Bench(args) => commands::bench::run(&args).map(|()| Outcome::Finished),
        Command::Reproduce(args) => commands::reproduce::run(&args, said),
    }
}

/// What the libraries log goes to stderr, warnings and above unless RUST_LOG says otherwise.
fn start_logging() {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "warn".into());
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_target(false).without_time().init();
}

/// `luxel info scene.ply | head -1` is no failure.
fn reader_has_gone(error: &anyhow::Error) -> bool {
    error.chain().filter_map(|cause| cause.downcast_ref::<std::io::Error>()).any(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
}
