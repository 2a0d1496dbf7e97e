//! Arguments of `luxel view`.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;

use super::SceneDataArgs;
use super::look::OcioLookArgs;

/// `luxel view`.
#[derive(Debug, Args)]
#[command(
    mut_arg("ocio", |arg| arg.help("Show the scene with a display of this OpenColorIO configuration: a file, or a built-in one such as \
    ocio://cg-config-v4.0.0_aces-v2.0_ocio-v2.5. The page draws by a table of it, and still has its own curves").help_heading(None::<&str>)),
    mut_arg("display", |arg| arg.help_heading(None::<&str>)),
    mut_arg("view", |arg| arg.help_heading(None::<&str>)),
    mut_arg("data", |arg| arg.help("Data set whose cameras and images are shown beside the scene [default for a run: its own]")),
    after_help = "The page shows radiance: exposure, tone curve and false colour are chosen in the browser, and the value under the cursor is \
    in the units of the data set. Press ? on the page for its keys.\n\
    Over SSH: ssh -L 7007:127.0.0.1:7007 MACHINE, start luxel view there, and open the printed address here.\n\
    The device auto is the CPU, whose engine alone renders depth; a GPU is faster and shows none."
)]
pub(crate) struct ViewArgs {
    /// Address and port to serve the page at; port 0 is any free one. An address that other
    /// machines reach asks them for the token of the printed address.
    #[arg(long, default_value = luxel_view::DEFAULT_ADDRESS, value_name = "ADDR:PORT", value_parser = address)]
    pub(crate) listen: SocketAddr,
    /// Another scene of the same place, a run or a file, to look at beside the first: side by side,
    /// wipe, difference. Both are held in memory, each in an engine of its own.
    #[arg(long, value_name = "RUN|SCENE")]
    pub(crate) with: Option<PathBuf>,
    /// Proxy mesh of the scene, as `luxel mesh RUN -o proxy.glb` writes it: walking stays above its
    /// floor and stops before its walls, and a double click finds the pivot on it.
    #[arg(long, value_name = "FILE.glb")]
    pub(crate) mesh: Option<PathBuf>,
    /// Print the address and open no browser.
    #[arg(long)]
    pub(crate) no_browser: bool,
    /// The display that the page shows the scene with.
    #[command(flatten)]
    pub(crate) ocio_look: OcioLookArgs,
    /// The scene, its data set, the device and the terminal.
    #[command(flatten)]
    pub(crate) input: SceneDataArgs,
}

/// Reads the address of `luxel train --view`, behind which a data set may have been meant.
pub(super) fn training_address(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| String::from("expected an address such as 127.0.0.1:7007; the data set stands before --view"))
}

fn address(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| String::from("expected an address and a port such as 127.0.0.1:7007"))
}
