//! The form that every layout is brought to before any pixel is read: frames with images, poses and
//! lenses; a split; points.

use std::path::{Path, PathBuf};

use glam::DAffine3;
use luxel_core::NoiseModel;

use super::intrinsics::Intrinsics;
use super::split::{Part, SplitRule, parse_split};
use crate::IoError;
use crate::read_file::read_file;

/// A data set without its pixels.
#[derive(Debug)]
pub(super) struct DatasetSource {
    /// For people.
    pub(super) format: String,
    /// Folder of the scene: what lies beside the images, such as masks, lies in it.
    pub(super) folder: PathBuf,
    /// In any order.
    pub(super) frames: Vec<SourceFrame>,
    /// Train and test.
    pub(super) split: SplitRule,
    /// May be empty.
    pub(super) points: Vec<SourcePoint>,
    /// The file or key that the points are from, for people.
    pub(super) points_from: String,
    /// Facts about the files, for people.
    pub(super) notes: Vec<String>,
    /// For people.
    pub(super) warnings: Vec<String>,
}

/// An image to be read.
#[derive(Clone, Debug)]
pub(super) struct SourceFrame {
    /// View name.
    pub(super) name: String,
    /// Existing file; where captured LDR images are read, it may be missing beside them.
    pub(super) image: PathBuf,
    /// Captured LDR images from this pose; only where these are read.
    pub(super) recordings: Vec<Recording>,
    /// Exposure of the image if it is a captured LDR image, seconds.
    pub(super) exposure_s: Option<f32>,
    /// Noise of the image, if the frame states it.
    pub(super) noise: Option<NoiseModel>,
    /// Existing file of weights.
    pub(super) mask: Option<PathBuf>,
    /// Pose.
    pub(super) camera_from_world: DAffine3,
    /// Lens.
    pub(super) intrinsics: Intrinsics,
    /// Place that describes it.
    pub(super) origin: Origin,
    /// Side of the split, if the frame states it itself.
    pub(super) part: Option<Part>,
}

impl SourceFrame {
    /// Returns whether there is radiance, and captured images of the same pose.
    pub(super) fn has_both(&self) -> bool {
        !self.recordings.is_empty() && self.image.is_file()
    }
}

/// A display-referred image of a known exposure.
#[derive(Clone, Debug)]
pub(super) struct Recording {
    /// View name.
    pub(super) name: String,
    /// Existing file.
    pub(super) image: PathBuf,
    /// Seconds.
    pub(super) exposure_s: f32,
}

/// The place that describes a frame.
#[derive(Clone, Debug)]
pub(super) struct Origin {
    /// File.
    pub(super) path: PathBuf,
    /// `frame 12 ("images/012.exr")`.
    pub(super) place: String,
}

impl Origin {
    pub(super) fn error(&self, message: impl std::fmt::Display) -> IoError {
        IoError::invalid(&self.path, format!("{}: {message}", self.place))
    }
}

/// A point of structure from motion.
#[derive(Debug)]
pub(super) struct SourcePoint {
    /// World; finite also as f32.
    pub(super) position: [f64; 3],
    /// Display colour.
    pub(super) rgb8: Option<[u8; 3]>,
    /// Track.
    pub(super) sightings: Vec<Sighting>,
}

/// A place where a point was seen.
#[derive(Debug)]
pub(super) struct Sighting {
    /// Index into [`DatasetSource::frames`].
    pub(super) frame: usize,
    /// Position in the distorted image as a fraction of its width and height: holds for every size
    /// of the image.
    pub(super) at: [f32; 2],
}

/// Returns the split of a data set whose layout has none of its own: `split.json` beside it, or
/// every 8th.
pub(super) fn split_beside(folder: &Path) -> Result<SplitRule, IoError> {
    let path = folder.join("split.json");
    if path.is_file() { Ok(SplitRule::Lists(parse_split(&path, &read_file(&path)?)?)) } else { Ok(SplitRule::EveryEighth) }
}
