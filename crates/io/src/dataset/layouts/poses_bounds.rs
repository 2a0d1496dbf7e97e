//! LLFF's folders: `poses_bounds.npy` with images, which many programs write and read.
//!
//! A row of the table is an image, in the order of the images' names: 3 rows of 5 numbers (the
//! camera's axes down, right and backwards in the world, its place, and height, width and focal
//! length in pixels), then the nearest and farthest depth. Images are those of `images/`, else of
//! the least reduced of `images_2`, `images_4` and so on. The size is of the images as they were
//! photographed: reduced ones scale the lens, by any factor that keeps their shape, with a warning
//! where that is not 1/2, 1/4 or 1/8.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec2};
use luxel_core::{CameraProjection, Distortion};

use super::llff::{LlffPose, images, llff_pose};
use crate::IoError;
use crate::dataset::files::view_name;
use crate::dataset::intrinsics::{Focal, Intrinsics};
use crate::dataset::source::{DatasetSource, Origin, SourceFrame, split_beside};
use crate::image::image_size;
use crate::image::npy::decode_table;
use crate::input::Input;
use crate::read_file::read_file;

pub(in crate::dataset) const TABLE: &str = "poses_bounds.npy";
/// Numbers of a row: 15 of the pose, 2 bounds.
const COLUMNS: usize = 17;
/// Pixels by which a reduced image's sides may be rounded.
const ROUNDING_PX: f64 = 1.0;

/// Pose, lens and bounds of an image: a row of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct BoundedPose {
    /// Pose.
    pub camera_from_world: DAffine3,
    /// Size of the images as they were photographed, pixels.
    pub size_px: [u32; 2],
    /// Focal length of both axes, pixels.
    pub focal_px: f64,
    /// Nearest and farthest depth of the scene.
    pub bounds: [f64; 2],
}

/// Returns whether the folder has this layout, by names only.
pub(in crate::dataset) fn is_one(folder: &Path) -> bool {
    folder.join(TABLE).is_file() && image_folder(folder).is_some()
}

/// Returns the folder of images.
fn image_folder(folder: &Path) -> Option<PathBuf> {
    let full = folder.join("images");
    if full.is_dir() {
        return Some(full);
    }
    let factor = |name: &str| name.strip_prefix("images_")?.parse::<u32>().ok();
    let entries = std::fs::read_dir(folder).ok()?.flatten();
    let reduced = entries.filter_map(|entry| Some((factor(&entry.file_name().to_string_lossy())?, entry.path())));
    reduced.filter(|(_, path)| path.is_dir()).min().map(|(_, path)| path)
}

/// Parses `poses_bounds.npy`: one row per image.
///
/// # Errors
/// No table of 17 columns, or a row that holds no pose, size or focal length; rows are counted from
/// 0.
pub fn parse_poses_bounds(path: &Path, bytes: &[u8]) -> Result<Vec<BoundedPose>, IoError> {
    let table = decode_table::<COLUMNS>(Input::new(path, bytes))?;
    let row = |(row, numbers): (usize, &[f64; COLUMNS])| {
        let [pose @ .., near, far] = numbers;
        let LlffPose { camera_from_world, size_px, focal_px } =
            llff_pose(pose).map_err(|message| IoError::invalid(path, format!("row {row}: {message}")))?;
        Ok(BoundedPose { camera_from_world, size_px, focal_px, bounds: [*near, *far] })
    };
    table.iter().enumerate().map(row).collect()
}

/// Reads the table and finds the images.
pub(in crate::dataset) fn poses_bounds_source(folder: &Path) -> Result<DatasetSource, IoError> {
    let path = folder.join(TABLE);
    let table = parse_poses_bounds(&path, &read_file(&path)?)?;
    let Some(of_images) = image_folder(folder) else {
        return Err(IoError::invalid(folder, format!("no images: expected images/, images_2/, images_4/ or the like beside {TABLE}")));
    };
    let found = images(&of_images)?;
    if found.len() != table.len() {
        return Err(IoError::invalid(
            &path,
            format!("{} rows, but {} holds {} images: expected one row per image", table.len(), of_images.display(), found.len()),
        ));
    }
    let prefix = of_images.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let mut warnings = Vec::new();
    let mut rescaled: Option<String> = None;
    let mut frames = Vec::with_capacity(table.len());
    for (row, (pose, image)) in table.iter().zip(found).enumerate() {
        let file = image.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let origin = Origin { path: path.clone(), place: format!("row {row} ({file:?})") };
        let mut intrinsics = Intrinsics {
            size_px: Some(pose.size_px),
            focal: Focal::Pixels(DVec2::splat(pose.focal_px)),
            center_px: [None; 2],
            distortion: Distortion::default(),
            projection: CameraProjection::Pinhole,
            foreign_lens: None,
        };
        let size_px = image_size(&image)?;
        if !intrinsics.fits(size_px) {
            let factor = same_shape(pose.size_px, size_px).map_err(|message| origin.error(message))?;
            let ([w, h], [fw, fh]) = (size_px, pose.size_px);
            rescaled
                .get_or_insert_with(|| format!("{w} x {h} pixels, the table's {fw} x {fh}: the focal length is multiplied by {factor:.4}"));
            intrinsics.size_px = Some(size_px);
            intrinsics.focal = Focal::Pixels(DVec2::splat(pose.focal_px * factor));
        }
        frames.push(SourceFrame {
            name: view_name(&format!("{prefix}/{file}")),
            image,
            recordings: Vec::new(),
            exposure_s: None,
            noise: None,
            mask: None,
            camera_from_world: pose.camera_from_world,
            intrinsics,
            origin,
            part: None,
        });
    }
    warnings.extend(rescaled.map(|text| format!("images of {} have {text}", of_images.display())));
    if prefix != "images" {
        warnings.push(format!("no images/: the reduced images of {} are read", of_images.display()));
    }
    let split = split_beside(folder)?;
    let folder = folder.to_path_buf();
    Ok(DatasetSource {
        format: "LLFF".to_owned(),
        folder,
        frames,
        split,
        points: Vec::new(),
        points_from: String::new(),
        notes: Vec::new(),
        warnings,
    })
}

/// Returns the factor from one size to another of the same shape.
fn same_shape(full: [u32; 2], image: [u32; 2]) -> Result<f64, String> {
    let ([fw, fh], [w, h]) = (full.map(f64::from), image.map(f64::from));
    let factor = w / fw;
    if (h - fh * factor).abs() <= ROUNDING_PX {
        return Ok(factor);
    }
    Err(format!("the image is {w} x {h} pixels, its row's {fw} x {fh}: another shape; use the images the table was made for"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_same_shape_is_scaled() {
        assert_eq!(same_shape([4032, 3024], [1008, 756]), Ok(0.25));
        assert_eq!(same_shape([4032, 3024], [800, 600]).map(|f| (f * 4032.0).round()), Ok(800.0));
        assert!(same_shape([4032, 3024], [3024, 4032]).unwrap_err().contains("another shape"));
    }
}
