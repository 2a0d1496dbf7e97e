//! A data set: posed images, their split, and the points structure from motion found.

use std::sync::Arc;

use crate::{Camera, ColorSpace, Image};

/// Pixels that take part: `true` is valid. Row-major, `[H*W]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    /// One per pixel.
    pub valid: Vec<bool>,
}

/// A posed image.
#[derive(Clone, Debug)]
pub struct View {
    /// Unique within the data set, with the image's folders and without its extension (`images/000`); its last part names outputs.
    pub name: String,
    /// Undistorted, of the image's size.
    pub camera: Camera,
    /// Radiance in the data set's units; invalid pixels are 0.
    pub image: Arc<Image>,
    /// `None`: all pixels are valid.
    pub mask: Option<Arc<Mask>>,
}

impl View {
    /// The last part of the name: `000` for `images/000`.
    pub fn stem(&self) -> &str {
        self.name.rsplit('/').next().unwrap_or(&self.name)
    }

    /// Whether pixel `i` (row-major) takes part in loss and metrics.
    pub fn is_valid(&self, i: usize) -> bool {
        self.mask.as_ref().is_none_or(|mask| mask.valid[i])
    }
}

/// Where a 3D point was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Index into [`Dataset::train`]; observations in test views are dropped by the reader.
    pub view: u32,
    /// Pixel coordinates in the (undistorted, downscaled) image.
    pub pixel_px: [f32; 2],
}

/// A point of structure from motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// World.
    pub position: [f32; 3],
    /// Display colour 0..=255 as the file gave it, if it did.
    pub rgb8: Option<[u8; 3]>,
    /// Track; may be empty.
    pub observations: Vec<Observation>,
}

/// Pixels that were masked out of one image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BadPixels {
    /// View name.
    pub name: String,
    /// Pixels with a NaN channel.
    pub nan: usize,
    /// Pixels with an infinite channel and no NaN.
    pub infinite: usize,
    /// Pixels with a negative channel and otherwise finite.
    pub negative: usize,
}

/// Everything training needs.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// What the reader took it for, for people: `nerfstudio transforms.json`.
    pub format: String,
    /// Views trained on, sorted by name.
    pub train: Vec<View>,
    /// Views held out, sorted by name; may be empty.
    pub test: Vec<View>,
    /// May be empty.
    pub points: Vec<Point>,
    /// Of all images.
    pub color_space: ColorSpace,
    /// Images with masked pixels.
    pub bad_pixels: Vec<BadPixels>,
    /// Digest of names, split, cameras and file contents: equal exactly for equal inputs.
    pub fingerprint: String,
    /// Things a user should know, such as 8-bit input.
    pub warnings: Vec<String>,
}
