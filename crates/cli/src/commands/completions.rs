//! `luxel completions` and `luxel man`: completion scripts and man pages, generated from the
//! program's arguments.
//!
//! In: the definition of the arguments. Out: a script on standard output, or a page per command in
//! a folder.

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, Result};
use serde_json::json;

use crate::args::{CompletionsArgs, ManArgs};
use crate::output::console::{self, Console};

/// Prints the completion script of a shell for `command`.
pub(crate) fn completions(args: &CompletionsArgs, mut command: clap::Command) -> Result<()> {
    // In memory first: clap_complete panics if it cannot write.
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "luxel", &mut script);
    let mut out = std::io::stdout().lock();
    out.write_all(&script).and_then(|()| out.flush()).context("cannot write to standard output")
}

/// Writes a man page for `command` and one for each of its subcommands.
pub(crate) fn man(args: &ManArgs, command: clap::Command) -> Result<()> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    let folder = args.folder.display();
    std::fs::create_dir_all(&args.folder).with_context(|| format!("{folder}: cannot create the folder"))?;
    let mut command = command;
    command.build();
    let pages = command
        .get_subcommands()
        .filter(|subcommand| !subcommand.is_hide_set())
        .map(|subcommand| format!("luxel-{}.1", subcommand.get_name()));
    let pages: Vec<PathBuf> = pages.chain(["luxel.1".to_owned()]).map(|name| args.folder.join(name)).collect();
    clap_mangen::generate_to(command, &args.folder).with_context(|| format!("{folder}: cannot write the pages"))?;
    pages.iter().filter(|page| page.is_file()).for_each(|page| console::wrote(page));
    console.finish_silently(json!({ "output": folder.to_string() }));
    Ok(())
}
