//! A data set into blocks.
//!
//! In: a data set with points, and a grid or limits from which one is chosen. Out: a folder of
//! blocks. Degenerate: without points, with captured LDR images (each block would find a camera
//! response of its own), or with a block that no training view sees, it is an error and nothing is
//! written.

use std::path::{Path, PathBuf};

use luxel::error::{Context, bail};
use luxel::{Dataset, Error, ImageLimits, Observer, Result};
use luxel_core::Remedy;
use luxel_io::{BLOCK_FILE, Block, ImageMemory, LoadOptions, Supervision};
use luxel_train::{TrainConfig, radiance_scale_of};

use super::ground::Ground;
use super::plan::{Part, PartViews, Sight, parts};
use super::{BlockList, LIST, run_folder};
use crate::{files, output, schema};

/// Fewest points that the ground is divided by.
const LEAST_POINTS: usize = 100;

/// Most blocks that are chosen.
const MOST_BLOCKS: usize = 1024;

/// Most training views of a block where no other limit is given.
const MOST_VIEWS: usize = 150;

/// A grid is not chosen if its blocks would be longer than so many times their width.
const MOST_SLENDER: f64 = 3.0;

/// How the ground is divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GridChoice {
    /// By the limits.
    Auto,
    /// Into columns along the long side of the scene, and rows of each.
    Fixed {
        /// Number of columns.
        columns: usize,
        /// Number of rows in each.
        rows: usize,
    },
}

/// Options of [`split()`].
#[derive(Clone, Debug)]
pub struct SplitOptions {
    /// The data set.
    pub dataset: PathBuf,
    /// A new folder for the blocks.
    pub output: PathBuf,
    /// The grid.
    pub grid: GridChoice,
    /// Largest number of splats of a block; with [`GridChoice::Auto`] there are as many blocks as
    /// keep each one's part of the splats of the whole below it.
    pub max_splats: Option<u32>,
    /// Width of the border around each block, as a fraction of the block's side.
    pub border: f64,
    /// Reading the data set.
    pub load: LoadOptions,
    /// Memory that images may take while the radiance scale is found.
    pub image_memory: ImageMemory,
    /// Options of training, for the radiance scale and the number of splats of the whole.
    pub train: TrainConfig,
}

/// A block that was written.
#[derive(Clone, Debug, PartialEq)]
pub struct SplitBlock {
    /// Its folder, a data set.
    pub dataset: PathBuf,
    /// The folder in which [`super::merge()`] looks for its run.
    pub run: PathBuf,
    /// Number of views to train on.
    pub train_views: usize,
    /// Number of held-out views.
    pub test_views: usize,
    /// Share of the points in the block and its border, 0 to 1.
    pub share: f64,
}

/// The blocks that were written.
#[derive(Clone, Debug, PartialEq)]
pub struct SplitBlocks {
    /// The blocks, column by column.
    pub blocks: Vec<SplitBlock>,
    /// Columns and rows.
    pub grid: [usize; 2],
    /// Radiance of one normalised unit.
    pub radiance_scale: f32,
    /// How the whole data set was read, with the reduction of its images as a number: blocks are to
    /// be read in the same way.
    pub load: LoadOptions,
}

/// A division of the ground with what falls into each part.
struct Plan {
    grid: [usize; 2],
    parts: Vec<Part>,
    views: Vec<PartViews>,
    shares: Vec<f64>,
}

/// Divides a data set, and writes the blocks.
///
/// # Errors
/// An output folder with content, a data set that cannot be read or divided, the file system's
/// refusal.
pub fn split(options: &SplitOptions, observer: &dyn Observer) -> Result<SplitBlocks> {
    output::check_new_folder(&options.output)?;
    if options.load.supervision == Supervision::Ldr {
        let message = "captured LDR images cannot be split: each block would find a camera response of its own";
        return Err(Error::new(message).with_remedy(Remedy::advice("merge them to radiance first, with luxel prepare")));
    }
    let path =
        std::fs::canonicalize(&options.dataset).with_context(|| format!("{}: cannot open the data set", options.dataset.display()))?;
    if Block::read(&path)?.is_some() {
        bail!("{}: is a block; split the whole data set", path.display());
    }
    let limits = ImageLimits { image_memory: options.image_memory, ..ImageLimits::default() };
    let load = Dataset::resolve_options(&path, &options.load, observer)?;
    let dataset = Dataset::open_within(&path, &load, limits, observer)?.into_core();
    if dataset.points.len() < LEAST_POINTS {
        let found = crate::text::plural(dataset.points.len(), "point");
        bail!("{}: has {found}, expected {LEAST_POINTS} or more to divide the ground by", path.display());
    }
    let scale = radiance_scale_of(&dataset, &options.train, None).context("cannot find the radiance scale")?.get();
    let ground = Ground::new(&dataset);
    let plan = choose(options, &dataset, &ground)?;
    let mut blocks = Vec::with_capacity(plan.parts.len());
    for (i, (part, views)) in plan.parts.iter().zip(&plan.views).enumerate() {
        let name = format!("block_{i:03}");
        let block = Block {
            dataset: path.clone(),
            views: views.names.clone(),
            radiance_scale: scale,
            axes: ground.axes.map(|axis| axis.to_array()),
            core: part.core,
            reach: part.reach,
        };
        let folder = options.output.join(&name);
        files::write_json(&folder.join(BLOCK_FILE), schema::BLOCK, &block)?;
        let (train_views, test_views) = (views.train, views.names.len() - views.train);
        blocks.push(SplitBlock {
            dataset: folder,
            run: run_folder(&options.output, &name),
            train_views,
            test_views,
            share: plan.shares[i],
        });
    }
    write_list(&options.output, &blocks, plan.grid, scale)?;
    Ok(SplitBlocks { blocks, grid: plan.grid, radiance_scale: scale, load })
}

/// Writes the list of the blocks, which marks the folder: last.
fn write_list(folder: &Path, blocks: &[SplitBlock], grid: [usize; 2], radiance_scale: f32) -> Result<()> {
    let name = |block: &SplitBlock| block.dataset.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let list = BlockList { blocks: blocks.iter().map(name).collect(), grid, radiance_scale };
    files::write_json(&folder.join(LIST), schema::BLOCKS, &list)
}

/// Returns the division that the options ask for.
fn choose(options: &SplitOptions, dataset: &luxel_core::Dataset, ground: &Ground) -> Result<Plan> {
    let sight = Sight::new(dataset, ground);
    let divide = |grid: [usize; 2]| {
        let parts = parts(ground, grid, options.border);
        let (views, shares) = (sight.views_of(&parts), sight.shares(&parts));
        Plan { grid, parts, views, shares }
    };
    if let GridChoice::Fixed { columns, rows } = options.grid {
        let plan = divide([columns, rows]);
        return match plan.unseen() {
            None => Ok(plan),
            Some(block) => bail!("a grid of {columns}x{rows} has block {block}, which no training view sees; give a coarser grid"),
        };
    }
    let train_px: u64 = dataset.train.iter().map(luxel_core::View::pixel_count).sum();
    let splats = TrainConfig { max_splats: None, ..options.train.clone() }.splat_limit(train_px) as f64;
    let aspect = ground.aspect();
    for count in 1..=MOST_BLOCKS {
        let Some(grid) = squarest(count, aspect) else { continue };
        let plan = divide(grid);
        if plan.unseen().is_some() {
            break;
        }
        let fits = match options.max_splats {
            Some(most) => plan.shares.iter().all(|share| share * splats <= f64::from(most)),
            None => plan.views.iter().all(|views| views.train <= MOST_VIEWS),
        };
        if fits {
            return Ok(plan);
        }
    }
    let wish = match options.max_splats {
        Some(most) => format!("{most} splats a block, of {splats} in all"),
        None => format!("{MOST_VIEWS} views a block"),
    };
    let error = Error::new(format!("{}: no grid keeps to {wish}, with views to train every block on", options.dataset.display()));
    Err(error.with_remedy(Remedy::give("grid")))
}

/// Returns the grid of so many blocks whose blocks are nearest to squares; `None` if all are
/// slender.
fn squarest(count: usize, aspect: f64) -> Option<[usize; 2]> {
    let slenderness = |[columns, rows]: &[usize; 2]| (aspect * *rows as f64 / *columns as f64).ln().abs();
    let grids = (1..=count).filter(|columns| count.is_multiple_of(*columns)).map(|columns| [columns, count / columns]);
    let best = grids.min_by(|a, b| slenderness(a).total_cmp(&slenderness(b)))?;
    (slenderness(&best) <= MOST_SLENDER.ln()).then_some(best)
}

impl Plan {
    /// Returns the first block without a view to train on.
    fn unseen(&self) -> Option<usize> {
        self.views.iter().position(|views| views.train == 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_nearly_square() {
        assert_eq!(squarest(1, 2.0), Some([1, 1]));
        assert_eq!(squarest(2, 2.0), Some([2, 1]));
        assert_eq!(squarest(6, 1.0), Some([2, 3]));
        assert_eq!(squarest(8, 2.0), Some([4, 2]));
        // A street.
        assert_eq!(squarest(7, 7.0), Some([7, 1]));
        assert_eq!(squarest(7, 1.0), None);
    }
}
