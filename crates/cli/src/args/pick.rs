//! Arguments of `luxel pick`.

use clap::Args;

use super::SceneDataArgs;
use crate::args::values::parse_pixel;

/// `luxel pick`.
#[derive(Debug, Args)]
#[command(
    mut_arg("data", |arg| arg.help("Data set with the view [default for a run: its own]")),
    after_help = "luxel pick run --view 004 --px 230,180\n\
    The point is where half of the pixel's weight lies in front, and can be used in selections: luxel edit run --where \"sphere(x,y,z,r) ~w\". \
    luminance_sum is their L."
)]
pub(crate) struct PickArgs {
    /// Name of the view, or the last part of its name.
    #[arg(long, value_name = "VIEW")]
    pub(crate) view: String,
    /// Pixel: column and row, counted from 0 at the top left.
    #[arg(long, value_name = "X,Y", value_parser = parse_pixel)]
    pub(crate) px: [u32; 2],
    /// Number of splats to list, those with the largest weight.
    #[arg(long, default_value_t = 10, value_name = "N")]
    pub(crate) count: usize,
    /// Print one JSON object.
    #[arg(long)]
    pub(crate) json: bool,
    /// The scene, its data set, the device and the terminal.
    #[command(flatten)]
    pub(crate) input: SceneDataArgs,
}
