//! Arguments of `luxel split` and `luxel merge`.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::Args;
use luxel_app::blocks::GridChoice;
use luxel_io::ImageMemory;

use super::{ConsoleArgs, LoadArgs};

/// Largest number of columns and of rows.
const MOST_SIDE: usize = 1000;

/// `luxel split`.
#[derive(Debug, Args)]
#[command(
    after_help = "Every block is a folder that luxel train takes like any data set; it refers to the images and copies none. BLOCKS/jobs.txt has a \
    command a block, with the options behind --; luxel merge joins the runs.\n\n\
    Examples:\n  \
    luxel split street -o blocks --max-splats 2000000 -- --iterations 30000\n  \
    sh blocks/jobs.txt\n  \
    luxel merge blocks -o street.ply"
)]
pub(crate) struct SplitArgs {
    /// Folder of the data set, with points.
    pub(crate) dataset: PathBuf,
    /// New folder for the blocks.
    #[arg(long, short, value_name = "BLOCKS")]
    pub(crate) output: PathBuf,
    /// Columns along the longer side of the ground, and rows of each: 4x2. auto: as many blocks as
    /// --max-splats takes, or without it at most 150 training views a block.
    #[arg(long, default_value = "auto", value_name = "auto|NxM", value_parser = parse_grid)]
    pub(crate) grid: GridChoice,
    /// Largest number of splats of a block, which bounds the memory of its training.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) max_splats: Option<u32>,
    /// Width of the border around a block in which it overlaps others, as a fraction of its side, 0
    /// to 1.
    #[arg(long, default_value_t = 0.2, value_name = "FRACTION", value_parser = parse_border)]
    pub(crate) border: f64,
    /// Memory that images may take while the data set is read: auto, or a size such as 8GiB.
    #[arg(long, default_value_t, value_name = "SIZE", help_heading = "Machine")]
    pub(crate) image_memory: ImageMemory,
    /// Options of luxel train for the commands in jobs.txt.
    #[arg(last = true, value_name = "OPTIONS")]
    pub(crate) train: Vec<OsString>,
    /// Reading the data set.
    #[command(flatten)]
    pub(crate) load: LoadArgs,
    /// Terminal output.
    #[command(flatten)]
    pub(crate) console: ConsoleArgs,
}

/// `luxel merge`.
#[derive(Debug, Args)]
pub(crate) struct MergeArgs {
    /// Folder of luxel split, with the runs of all blocks in BLOCKS/runs.
    #[arg(value_name = "BLOCKS")]
    pub(crate) blocks: PathBuf,
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

fn parse_grid(text: &str) -> Result<GridChoice, String> {
    if text == "auto" {
        return Ok(GridChoice::Auto);
    }
    let side = |text: &str| text.parse().ok().filter(|side| (1..=MOST_SIDE).contains(side));
    let sides = text.split_once('x').and_then(|(columns, rows)| Some((side(columns)?, side(rows)?)));
    let (columns, rows) =
        sides.ok_or_else(|| format!("\"{text}\": expected auto, or columns and rows such as 4x2, each 1 to {MOST_SIDE}"))?;
    Ok(GridChoice::Fixed { columns, rows })
}

fn parse_border(text: &str) -> Result<f64, String> {
    let border = text.parse::<f64>().ok().filter(|border| (0.0..=1.0).contains(border));
    border.ok_or_else(|| format!("\"{text}\": expected a number from 0 to 1"))
}
