//! Large scenes in blocks of the ground, each trained as a run of its own, and joined.
//!
//! In: a data set with points ([`split()`]); the runs of its blocks ([`merge()`]). Out: a folder of
//! blocks, each a data set that refers to the images of the whole; one scene.
//!
//! ```text
//! blocks.json            the blocks; marks the folder
//! block_000/block.json   a data set: views, points and ground of the block
//! runs/block_000         where merge looks for its run
//! jobs.txt               a command a block, which trains it
//! ```
//!
//! Blocks have borders that overlap, so that splats at the edge of each are trained with what lies
//! beyond; merging cuts every block's splats at its own edge. All blocks share the radiance scale
//! of the whole data set. Degenerate: one block is the data set.

mod gauge;
mod ground;
mod merge;
mod plan;
mod split;

pub use merge::{BlockPart, MergedScene, merge};
pub use split::{GridChoice, SplitBlock, SplitBlocks, SplitOptions, split};

use std::path::{Path, PathBuf};

use luxel::Result;
use luxel::error::Context;
use luxel_io::Block;
use luxel_train::TrainConfig;
use serde::{Deserialize, Serialize};

use crate::files;

/// Name of the file that lists the blocks.
const LIST: &str = "blocks.json";

/// The file has a line per block.
const LIMIT_BYTES: u64 = 16 << 20;

/// Contents of `blocks.json`.
#[derive(Debug, Serialize, Deserialize)]
struct BlockList {
    /// Names of the blocks' folders, in order.
    blocks: Vec<String>,
    /// Columns and rows.
    grid: [usize; 2],
    /// Radiance of one normalised unit.
    radiance_scale: f32,
}

impl BlockList {
    fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(LIST);
        let list: Self = serde_json::from_str(&files::read_text(&path, LIMIT_BYTES)?)
            .with_context(|| format!("{}: not a list of blocks, which luxel split writes", path.display()))?;
        let is_plain = |name: &String| name.strip_prefix("block_").is_some_and(|number| number.chars().all(|c| c.is_ascii_digit()));
        if !list.blocks.iter().all(is_plain) {
            luxel::error::bail!("{}: a block has a name other than block_NUMBER", path.display());
        }
        Ok(list)
    }
}

/// Returns the folder of a block's run.
fn run_folder(folder: &Path, block: &str) -> PathBuf {
    folder.join("runs").join(block)
}

/// Returns the training options for a data set: those of a block have the radiance scale that all
/// its blocks share, unless they state another.
///
/// # Errors
/// A block that cannot be read.
pub(crate) fn train_config(dataset: &Path, train: TrainConfig) -> Result<TrainConfig> {
    if train.radiance_scale.is_some() || !dataset.is_dir() {
        return Ok(train);
    }
    let block = Block::read(dataset)?;
    Ok(TrainConfig { radiance_scale: block.map(|block| block.radiance_scale), ..train })
}
