//! Arguments of `luxel mix`.

use std::path::PathBuf;

use clap::Args;

use super::ConsoleArgs;

/// `luxel mix`.
#[derive(Debug, Args)]
#[command(
    after_help = "The scenes have the same splats under other light: train the second with --from the first and --freeze geometry. A render of \
    the mix is the sum of the renders of the scenes, each times its weight. Every light stays in the mix: luxel edit --light 2:0.5 changes the \
    weight of the second one afterwards, and luxel view has a slider for it.\n\n\
    Examples:\n  \
    luxel train lamp-images --from day-run --freeze geometry -o lamp-run\n  \
    luxel mix day-run lamp-run --weights 1,0.3 -o evening.ply\n  \
    luxel edit evening.ply --light 1:0.1 -o night.ply"
)]
pub(crate) struct MixArgs {
    /// Folders of runs (their newest scenes) or scene files.
    #[arg(required = true, value_name = "RUN|SCENE.ply")]
    pub(crate) scenes: Vec<PathBuf>,
    /// Weight of each scene's light, 0 or more [default: 1 each].
    #[arg(long, value_name = "W,W,...", value_delimiter = ',', value_parser = parse_weight)]
    pub(crate) weights: Vec<f32>,
    /// Scene file to write.
    #[arg(long, short, value_name = "SCENE.ply")]
    pub(crate) output: PathBuf,
    /// Replace a scene file that exists.
    #[arg(long)]
    pub(crate) overwrite: bool,
    /// Terminal output.
    #[command(flatten)]
    pub(crate) console: ConsoleArgs,
}

fn parse_weight(text: &str) -> Result<f32, String> {
    let weight = text.trim().parse::<f32>().ok().filter(|weight| weight.is_finite() && *weight >= 0.0);
    weight.ok_or_else(|| format!("\"{text}\": expected a finite number, 0 or more"))
}
