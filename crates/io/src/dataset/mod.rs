//! Data sets in: posed images, their split, and points.
//!
//! In: a folder (or a `transforms.json`). Out: [`Dataset`] with linear radiance, undistorted and
//! reduced cameras, bad pixels masked. Layouts: [`DatasetFormat`]; recognised by [`detect_format`].
//! Nothing is guessed silently: everything that is left out is among the warnings.
//!
//! - Split: the frames' own (files, names); else `split.json` with lists "train" and "test"; else
//!   every 8th of the sorted names is test.
//! - Names: the image's path with its folders and without its extension. Views are sorted by name,
//!   byte by byte.
//! - Sizes: an image is of its camera's size, or a copy at 1/2, 1/4 or 1/8 of it (rounded either
//!   way), whose camera is scaled.
//! - Alpha: images are composited over black. Premultiplied colour (EXR) stays as it is, straight
//!   colour (PNG) is multiplied; TIFF states which it has.
//! - Pixels that are NaN, infinite or negative become 0 and are masked, before anything is
//!   resampled.
//! - Masks: [`MaskSource`]; white counts, black does not.
//! - Captured LDR images ([`Supervision::Ldr`]; beside radiance [`Supervision::Both`]): brackets or
//!   single exposures are trained on as they are, each image with its exposure in seconds; held-out
//!   views are radiance where there is any.
//! - Lens distortion is removed, then the image is reduced, both in linear light; observations of
//!   points follow.

mod assemble;
mod block;
mod candidates;
mod checks;
pub mod colmap;
mod components;
mod described;
mod detect;
mod developed;
mod downscale;
mod files;
mod fingerprint;
mod image_memory;
mod in_memory;
mod intrinsics;
mod json_fields;
mod layouts;
mod lens_fields;
mod load;
mod masks;
mod metres;
mod observations;
mod posed;
mod recordings;
mod selected;
mod source;
mod split;
mod transforms;
mod view_cache;
mod xml;

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use luxel_core::{ColorSpace, Dataset};
use serde::{Deserialize, Serialize};

use crate::IoError;
use crate::image::Transfer;

use assemble::BlockOf;
pub use block::{BLOCK_FILE, Block, GroundRange, parse_block, sees};
pub use described::{DatasetDescription, describe_dataset};
pub use detect::detect_format;
pub use downscale::{AUTO_SIDE_PX, ChosenDownscale, Downscale, MAX_DOWNSCALE, choose_downscale};
pub use files::composed;
pub use image_memory::{CheckPlan, ImageMemory, ImagePlan, KeepView, LoadProgress, Loading, VIEWS_IN_USE, ViewPlace};
pub use in_memory::{MemoryDataset, MemoryPoint, MemoryView, dataset_in_memory};
pub use layouts::llff::{RecordedPose, parse_recorded_poses};
pub use layouts::metashape::{MetashapeCameras, parse_metashape};
pub use layouts::phone::{parse_polycam_camera, parse_record3d};
pub use layouts::poses_bounds::{BoundedPose, parse_poses_bounds};
pub use layouts::realityscan::{parse_realityscan_table, parse_realityscan_xmp};
pub use masks::{MaskSource, decode_mask};
pub use metres::prepared_metres_per_unit;
pub use posed::PosedCamera;
pub(crate) use posed::{from_opengl, rigid};
pub use recordings::{Exposures, Supervision, parse_exposures};
pub use split::{SplitLists, parse_split};
pub use transforms::{Transforms, TransformsFrame, parse_transforms};
pub use view_cache::MAX_RELATIVE_ERROR;

/// A layout of files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DatasetFormat {
    /// `transforms.json` of nerfstudio, instant-ngp or Blender, or `transforms_train.json` with
    /// `transforms_test.json`.
    Transforms,
    /// COLMAP model in `sparse/0`, `sparse` or the folder itself, images in `images/`.
    Colmap,
    /// HDR-NeRF's synthetic scenes: `transforms_{train,test}.json` with
    /// `{train,test}_hdr/hdr_000.exr`.
    HdrNerf,
    /// HDR-NeRF's real scenes: `poses_bounds_exps.npy` with `input_images/000_0.jpg`, captured
    /// images alone.
    HdrNerfReal,
    /// HDR-GS's repack of the synthetic ones: COLMAP with `exr/0.exr`.
    HdrGs,
    /// GaussHDR's repack: COLMAP with `images_hdr/train_hdr_000.exr`.
    #[serde(rename = "gausshdr")]
    GaussHdr,
    /// LLFF: `poses_bounds.npy` with `images/` or a reduced copy of them.
    Llff,
    /// RealityScan and RealityCapture: a table of cameras (.csv), or XMP files beside the images.
    #[serde(rename = "realityscan")]
    RealityScan,
    /// Agisoft Metashape: cameras as XML.
    Metashape,
    /// Cameras of OpenUSD, with `images/`.
    Usd,
    /// Polycam's raw data: `keyframes/`.
    Polycam,
    /// Record3D's "EXR + RGB": `metadata.json` with `rgb/`.
    #[serde(rename = "record3d")]
    Record3d,
}

impl DatasetFormat {
    /// All of them.
    pub const ALL: [Self; 12] = [
        Self::Transforms,
        Self::Colmap,
        Self::HdrNerf,
        Self::HdrNerfReal,
        Self::HdrGs,
        Self::GaussHdr,
        Self::Llff,
        Self::RealityScan,
        Self::Metashape,
        Self::Usd,
        Self::Polycam,
        Self::Record3d,
    ];

    /// Returns the name of this source.
    pub fn name(self) -> &'static str {
        match self {
            Self::Transforms => "transforms",
            Self::Colmap => "colmap",
            Self::HdrNerf => "hdr-nerf",
            Self::HdrNerfReal => "hdr-nerf-real",
            Self::HdrGs => "hdr-gs",
            Self::GaussHdr => "gausshdr",
            Self::Llff => "llff",
            Self::RealityScan => "realityscan",
            Self::Metashape => "metashape",
            Self::Usd => "usd",
            Self::Polycam => "polycam",
            Self::Record3d => "record3d",
        }
    }
}

impl fmt::Display for DatasetFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Not the name of a [`DatasetFormat`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("data set format {found:?}, expected {known}", found = .0, known = DatasetFormat::ALL.map(DatasetFormat::name).join(", "))]
pub struct UnknownFormat(pub String);

impl FromStr for DatasetFormat {
    type Err = UnknownFormat;

    fn from_str(text: &str) -> Result<Self, UnknownFormat> {
        Self::ALL.into_iter().find(|format| format.name() == text).ok_or_else(|| UnknownFormat(text.to_owned()))
    }
}

/// How a data set is read.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoadOptions {
    /// `None`: recognised by [`detect_format`].
    pub format: Option<DatasetFormat>,
    /// Transfer function of integer images that do not state theirs.
    pub transfer: Option<Transfer>,
    /// Colour space of images that do not state theirs; `None`: linear Rec.709.
    pub color_space: Option<ColorSpace>,
    /// Reduction of the images along each side, by area average. Full size by default.
    pub downscale: Downscale,
    /// Kind of images that are trained on: radiance, captured LDR images, or both.
    #[serde(default)]
    pub supervision: Supervision,
    /// Which exposures of each bracket are trained on, under [`Supervision::Ldr`] and
    /// [`Supervision::Both`].
    #[serde(default)]
    pub exposures: Exposures,
    /// Source of the weights of pixels.
    #[serde(default)]
    pub masks: MaskSource,
    /// Part, layer or view of OpenEXR files that have several: [`crate::ReadOptions::layer`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub layer: Option<String>,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            format: None,
            transfer: None,
            color_space: None,
            downscale: Downscale::FULL_SIZE,
            supervision: Supervision::Hdr,
            exposures: Exposures::All,
            masks: MaskSource::Auto,
            layer: None,
        }
    }
}

/// Reads a data set. `path` is a folder, or the file that has the cameras.
///
/// ```
/// use luxel_core::Image;
/// use luxel_io::{ExrOptions, LoadOptions, load_dataset, write_exr};
///
/// let folder = tempfile::tempdir()?;
/// let mut frames = Vec::new();
/// for i in 0..9 {
///     let image = Image::filled(8, 6, [i as f32; 3]);
///     let path = folder.path().join(format!("images/{i:03}.exr"));
///     write_exr(&path, &image, &ExrOptions::default())?;
///     frames.push(format!(
///         r#"{{"file_path": "images/{i:03}.exr", "transform_matrix":
///         [[1, 0, 0, {i}], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]}}"#
///     ));
/// }
/// let json = format!(r#"{{"fl_x": 10, "frames": [{}]}}"#, frames.join(", "));
/// std::fs::write(folder.path().join("transforms.json"), json)?;
///
/// let dataset = load_dataset(folder.path(), &LoadOptions::default())?;
/// // Without a split in the files, every eighth view is held out.
/// assert_eq!((dataset.train.len(), dataset.test.len()), (7, 2));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Whatever is wrong with the files: each error names file, place, expectation and remedy.
pub fn load_dataset(path: &Path, options: &LoadOptions) -> Result<Dataset, IoError> {
    load_dataset_within(path, options, &Loading::default())
}

/// Reads a data set as [`load_dataset`] does, within a limit of memory for its images. Those that
/// have no room are read on demand: training views from half floats in the folder of `loading`,
/// within [`MAX_RELATIVE_ERROR`] of their values, and all others from their files.
///
/// # Errors
/// Those of [`load_dataset`]; a limit below what reading takes; a cache that cannot be written.
pub fn load_dataset_within(path: &Path, options: &LoadOptions, loading: &Loading<'_>) -> Result<Dataset, IoError> {
    let options = &downscale::resolved(path, options)?;
    let Some(block) = Block::read(path)? else {
        return assemble::assemble(path, read_source(path, options)?, None, options, loading);
    };
    let whole = block.whole(path)?;
    let source = read_source(&whole, options)?;
    assemble::assemble(&whole, source, Some(BlockOf { block: &block, folder: path }), options, loading)
}

/// Reads everything but pixels.
fn read_source(path: &Path, options: &LoadOptions) -> Result<source::DatasetSource, IoError> {
    use layouts::colmap::{ColmapLayout, colmap_source};
    use layouts::transforms::{TransformsFiles, hdr_nerf_source, transforms_source};

    options.downscale.check(path)?;
    std::fs::metadata(path).map_err(|e| IoError::system(path, "read", &e))?;
    let format = match options.format {
        Some(format) => format,
        None => detect_format(path)?,
    };
    let json = || {
        TransformsFiles::find(path)
            .ok_or_else(|| IoError::invalid(path, format!("not of format {format}: no transforms.json or transforms_train.json in it")))
    };
    match format {
        DatasetFormat::Transforms => transforms_source(&json()?),
        DatasetFormat::HdrNerf => hdr_nerf_source(&json()?, options.supervision),
        DatasetFormat::HdrNerfReal => layouts::llff::llff_source(path, options.supervision),
        DatasetFormat::Colmap => colmap_source(path, ColmapLayout::Plain, options.supervision),
        DatasetFormat::HdrGs => colmap_source(path, ColmapLayout::HdrGs, options.supervision),
        DatasetFormat::GaussHdr => colmap_source(path, ColmapLayout::GaussHdr, options.supervision),
        DatasetFormat::Llff => layouts::poses_bounds::poses_bounds_source(path),
        DatasetFormat::RealityScan => layouts::realityscan::realityscan_source(path, options.supervision),
        DatasetFormat::Metashape => layouts::metashape::metashape_source(path, options.supervision),
        DatasetFormat::Usd => layouts::usd::usd_source(path, options.supervision),
        DatasetFormat::Polycam => layouts::phone::polycam_source(path, options.supervision),
        DatasetFormat::Record3d => layouts::phone::record3d_source(path, options.supervision),
    }
}
