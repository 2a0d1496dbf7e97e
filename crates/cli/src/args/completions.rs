//! Arguments of `luxel completions` and `luxel man`.

use std::path::PathBuf;

use clap::Args;
use clap_complete::Shell;

use super::ConsoleArgs;

/// `luxel completions`.
#[derive(Debug, Args)]
#[command(after_help = "bash: luxel completions bash > ~/.local/share/bash-completion/completions/luxel\n\
                        zsh:  luxel completions zsh > ~/.zfunc/_luxel\n\
                        fish: luxel completions fish > ~/.config/fish/completions/luxel.fish")]
pub(crate) struct CompletionsArgs {
    /// Shell to complete for.
    #[arg(value_enum)]
    pub(crate) shell: Shell,
}

/// `luxel man`.
#[derive(Debug, Args)]
pub(crate) struct ManArgs {
    /// Folder for the pages; it is created if it is missing.
    #[arg(value_name = "DIR")]
    pub(crate) folder: PathBuf,
    /// Terminal output.
    #[command(flatten)]
    pub(crate) console: ConsoleArgs,
}
