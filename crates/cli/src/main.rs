//! `luxel`: the program. All of it is in the library of this crate.

mod environment;

use std::process::ExitCode;

fn main() -> ExitCode {
    environment::prepare();
    ExitCode::from(luxel_cli::run(std::env::args_os()))
}
