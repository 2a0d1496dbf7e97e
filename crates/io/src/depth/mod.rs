//! Depth maps of any program, in a folder beside the images: found, read, checked and described.
//! Nothing is trained on them yet.
//!
//! In: `depth/` (`depths/`, `depth_maps/`, or Polycam's `keyframes/depth/`) with a file for each
//! view, named like the image, also below the same folders or with `_depth` at the end: PFM,
//! OpenEXR (channel Z or depth, else a single one), PNG of 16 bits, floating-point TIFF, `.npy`.
//! Out: [`DepthMap`] with a number for each pixel, 0 where there is none (0, negative, NaN and
//! infinite numbers). Maps may have another size than the image, but its shape.
//!
//! What the numbers are ([`DepthKind`]) says `depth.json` in the folder, with `"kind"` (`metric`,
//! `relative`, `disparity` or `distance`), `"scale"` (units of the data set for one of the file) and
//! for distances `"near"` (the plane that rays begin at, in the file's unit); without it, PNGs hold millimetres, and others are compared with the data set's points.

mod decode;
mod pfm;
mod report;
mod statement;

use std::fmt;
use std::path::{Path, PathBuf};

use luxel_core::Dataset;
use serde::{Deserialize, Serialize};

use crate::IoError;
use crate::read_file::read_file;
use statement::Statement;

pub use decode::decode_depth_map;
pub use report::DepthReport;

/// Folders of depth maps in that of the scene, in the order they are looked in.
const FOLDERS: [&str; 4] = ["depth", "depths", "depth_maps", "keyframes/depth"];
/// Extensions of depth maps, in the order they are tried.
const EXTENSIONS: [&str; 6] = ["exr", "pfm", "npy", "png", "tif", "tiff"];
/// Ends of names that programs add to those of images.
const ENDS: [&str; 2] = ["", "_depth"];

/// The meaning of a map's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DepthKind {
    /// Depth in one unit for all views.
    Metric,
    /// Depth up to a factor, and perhaps an offset, of each view.
    Relative,
    /// Inverse depth, up to a factor and an offset of each view.
    Disparity,
    /// Length of the ray through the pixel, in one unit for all views: from the camera, or from a near
    /// plane.
    Distance,
}

impl fmt::Display for DepthKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Metric => "metric",
            Self::Relative => "relative",
            Self::Disparity => "disparity",
            Self::Distance => "distance",
        })
    }
}

/// A depth map.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    /// Width and height, pixels.
    pub size_px: [usize; 2],
    /// Numbers of the file by row from the top, in its own unit; 0 where there is none.
    pub values: Vec<f32>,
    /// Bits of an integer format; `None` for floating point.
    pub integer_bits: Option<u8>,
}

/// The depth maps of a data set.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthFolder {
    /// The folder.
    pub folder: PathBuf,
    /// File of each view, the training views before the test views; `None` where there is none.
    pub files: Vec<Option<PathBuf>>,
    statement: Statement,
}

/// Finds the depth maps of the data set that was read from `path`; `None` if there is no folder of
/// them.
///
/// # Errors
/// A `depth.json` that is wrong, or a folder in which no file is named like an image.
pub fn find_depth(path: &Path, dataset: &Dataset) -> Result<Option<DepthFolder>, IoError> {
    let root = if path.is_dir() { path } else { path.parent().unwrap_or(path) };
    // The folder of a model of COLMAP may have been named.
    let roots = [root.to_path_buf(), root.join(".."), root.join("../..")];
    let roots = roots.iter().take(if root.join("images").is_dir() { 1 } else { 3 });
    let Some(folder) = roots.flat_map(|root| FOLDERS.map(|sub| root.join(sub))).find(|folder| folder.is_dir()) else { return Ok(None) };
    let names = dataset.train.iter().chain(&dataset.test).map(|view| view.name.as_str());
    let files: Vec<Option<PathBuf>> = names.map(|name| file_of(&folder, name)).collect();
    if files.iter().all(Option::is_none) {
        let example = dataset.train.first().map_or("image", |view| view.stem());
        return Err(IoError::invalid(&folder, format!("no depth map is named like an image, expected {example}.exr, .pfm, .npy or .png")));
    }
    let statement = Statement::read(&folder)?;
    Ok(Some(DepthFolder { folder, files, statement }))
}

/// Returns the map of a view, by the whole of its name, without its first folder, or by its last
/// part.
fn file_of(folder: &Path, name: &str) -> Option<PathBuf> {
    let below_first = name.split_once('/').map(|(_, rest)| rest);
    let last = name.rsplit('/').next();
    [Some(name), below_first, last].into_iter().flatten().find_map(|name| {
        ENDS.iter().find_map(|end| {
            let path = |extension: &&str| folder.join(format!("{name}{end}.{extension}"));
            EXTENSIONS.iter().map(path).find(|path| path.is_file())
        })
    })
}

impl DepthFolder {
    /// Reads the map of view `index` (the training views before the test views); `None` where there
    /// is none.
    ///
    /// # Errors
    /// A damaged file.
    pub fn read(&self, index: usize) -> Result<Option<DepthMap>, IoError> {
        let Some(Some(path)) = self.files.get(index) else { return Ok(None) };
        decode_depth_map(path, &read_file(path)?).map(Some)
    }

    /// Reads all maps, checks them against the views and describes them.
    ///
    /// # Errors
    /// A damaged file, or one of another shape than its view.
    pub fn report(&self, dataset: &Dataset) -> Result<DepthReport, IoError> {
        report::report(self, dataset)
    }
}
