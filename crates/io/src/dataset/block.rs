//! A block of a data set: a folder with `block.json` in place of images and cameras.
//!
//! In: the file, and the data set that it names. Out: that data set with the block's views only,
//! held in the coordinates and split of the whole, with all points within the block's reach, and of
//! those beyond that its views see, one of [`BEYOND_EVERY`]: what lies behind the block needs
//! splats, too, but not as many. Degenerate: a view that the data set does not have is an error.
//!
//! ```text
//! dataset          path of the data set, absolute or relative to the folder
//! views            names of the views, of both sides of the split
//! radiance_scale   radiance of one normalised unit, of all blocks
//! axes             two unit vectors that span the ground, in the coordinates of the files
//! core, reach      ranges along them, [from, to]; null has no end. The cores of all blocks fill
//!                  the ground, and reaches overlap
//! ```

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use glam::DVec3;
use luxel_core::{Point, Remedy, Similarity, View};
use serde::{Deserialize, Serialize};

use super::source::SourceFrame;
use super::split::Part;
use crate::IoError;
use crate::read_file::read_file;

/// Name of the file.
pub const BLOCK_FILE: &str = "block.json";

/// One of so many points beyond a block's reach that its views see is kept.
const BEYOND_EVERY: usize = 8;

/// A part of the ground plane: along each of two axes the range from one bound to another, `None`
/// where it has no end.
pub type GroundRange = [[Option<f64>; 2]; 2];

/// Contents of `block.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Block {
    /// Path of the data set, absolute or relative to the block's folder.
    pub dataset: PathBuf,
    /// Names of the views.
    pub views: Vec<String>,
    /// Radiance of one normalised unit, in the data set's units.
    pub radiance_scale: f32,
    /// Unit vectors that span the ground, world coordinates.
    pub axes: [[f64; 3]; 2],
    /// The block itself, world units along the axes.
    pub core: GroundRange,
    /// The block with its border.
    pub reach: GroundRange,
}

impl Block {
    /// Reads the block in a folder; `None` if the folder is none.
    ///
    /// # Errors
    /// A file that cannot be read or has another content.
    pub fn read(folder: &Path) -> Result<Option<Self>, IoError> {
        let path = folder.join(BLOCK_FILE);
        if path.is_file() { parse_block(&path, &read_file(&path)?).map(Some) } else { Ok(None) }
    }

    /// Returns the path of the data set of the block in `folder`.
    pub fn dataset_path(&self, folder: &Path) -> PathBuf {
        folder.join(&self.dataset)
    }

    /// Returns the path of the data set of the block in `folder`, which must be there and whole.
    pub(super) fn whole(&self, folder: &Path) -> Result<PathBuf, IoError> {
        let (whole, path) = (self.dataset_path(folder), folder.join(BLOCK_FILE));
        if !whole.exists() {
            let remedy = Remedy::advice("put the data set back, or split it again where it is now");
            return Err(IoError::invalid(&path, format!("its data set {} is missing", whole.display())).with_remedy(remedy));
        }
        if whole.join(BLOCK_FILE).is_file() {
            return Err(IoError::invalid(&path, "its data set is a block, too, expected a whole one"));
        }
        Ok(whole)
    }

    /// Returns whether a place of the world is in the core, which no two blocks share.
    pub fn owns(&self, place: DVec3) -> bool {
        self.holds(&self.core, place)
    }

    /// Returns whether a place of the world is in the block or its border.
    pub fn reaches(&self, place: DVec3) -> bool {
        self.holds(&self.reach, place)
    }

    fn holds(&self, range: &GroundRange, place: DVec3) -> bool {
        self.axes.iter().zip(range).all(|(axis, [from, to])| {
            let at = DVec3::from_array(*axis).dot(place);
            from.is_none_or(|from| at >= from) && to.is_none_or(|to| at < to)
        })
    }

    /// Takes the views of other blocks from the split; `frames` are those of `parts`, sorted.
    pub(super) fn restrict(&self, frames: &[&SourceFrame], parts: &mut [Option<Part>], folder: &Path) -> Result<(), IoError> {
        let mut wanted: HashSet<&str> = self.views.iter().map(String::as_str).collect();
        for (frame, part) in frames.iter().zip(parts) {
            if !wanted.remove(frame.name.as_str()) {
                *part = None;
            }
        }
        match wanted.iter().min() {
            None => Ok(()),
            Some(name) => {
                let message = format!("names view {name:?}, which {} does not have", self.dataset_path(folder).display());
                let remedy = Remedy::advice("the data set has changed: split it again");
                Err(IoError::invalid(folder.join(BLOCK_FILE), message).with_remedy(remedy))
            }
        }
    }

    /// Leaves the points that the block trains with. `train` are the block's views.
    pub(super) fn choose_points(&self, points: &mut Vec<Point>, train: &[&View], world_from_local: &Similarity) {
        let mut beyond = 0_usize;
        points.retain(|point| {
            let local = DVec3::from_array(point.position.map(f64::from));
            if self.reaches(world_from_local.point(local)) {
                return true;
            }
            if point.observations.is_empty() && !train.iter().any(|view| sees(view, local)) {
                return false;
            }
            beyond += 1;
            beyond % BEYOND_EVERY == 1
        });
    }
}

/// Parses the content of a `block.json`; `path` is for messages.
///
/// # Errors
/// [`crate::IoErrorKind::Invalid`].
pub fn parse_block(path: &Path, bytes: &[u8]) -> Result<Block, IoError> {
    let block: Block = serde_json::from_slice(bytes).map_err(|error| IoError::invalid(path, format!("not a block: {error}")))?;
    if !(block.radiance_scale.is_finite() && block.radiance_scale > 0.0) {
        return Err(IoError::invalid(path, format!("\"radiance_scale\" is {}, expected a number above 0", block.radiance_scale)));
    }
    if !block.axes.iter().all(|axis| (DVec3::from_array(*axis).length() - 1.0).abs() < 1e-6) {
        return Err(IoError::invalid(path, "\"axes\" are not two unit vectors"));
    }
    Ok(block)
}

/// Returns whether a place, in the coordinates of the view's camera, is within its image. What
/// stands before the place is not considered.
pub fn sees(view: &View, place: DVec3) -> bool {
    let [width, height] = view.camera.size_px.map(f64::from);
    view.camera.project(place).is_some_and(|(px, depth)| depth > 0.0 && px.x >= 0.0 && px.y >= 0.0 && px.x < width && px.y < height)
}
