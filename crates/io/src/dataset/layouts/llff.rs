//! HDR-NeRF's real scenes: `poses_bounds_exps.npy` with `input_images/<pose>_<k>.jpg`, captured
//! images without radiance as ground truth.
//!
//! A row of the table is an image, in the order of the images' names: 3 rows of 5 numbers (the
//! camera's axes down, right and backwards in the world, its place, and height, width and focal
//! length in pixels), nearest and farthest depth, exposure in seconds (LLFF with one more column).
//! Images of one pose are a bracket. The size is of the images as they were photographed; a copy at
//! 1/2, 1/4 or 1/8 is recognised.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec2, DVec3};
use luxel_core::{Camera, CameraProjection, Distortion, Remedy};

use crate::IoError;
use crate::dataset::Supervision;
use crate::dataset::files::{is_image, view_name};
use crate::dataset::intrinsics::{Focal, Intrinsics};
use crate::dataset::source::{DatasetSource, Origin, Recording, SourceFrame, split_beside};
use crate::image::npy::decode_table;
use crate::input::Input;
use crate::read_file::read_file;

const TABLE: &str = "poses_bounds_exps.npy";
const IMAGES: &str = "input_images";
/// Numbers of a row: 15 of the pose, 2 bounds, 1 exposure.
const COLUMNS: usize = 18;

/// The pose, lens and exposure of an image: a row of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedPose {
    /// Pose.
    pub camera_from_world: DAffine3,
    /// Size of the images as they were photographed, pixels.
    pub size_px: [u32; 2],
    /// Focal length of both axes, pixels.
    pub focal_px: f64,
    /// Exposure, seconds.
    pub exposure_s: f32,
}

/// Returns whether the folder has this layout, by names only.
pub(in crate::dataset) fn is_one(folder: &Path) -> bool {
    folder.join(TABLE).is_file() && folder.join(IMAGES).is_dir()
}

/// Reads the table and finds the images.
pub(in crate::dataset) fn llff_source(folder: &Path, supervision: Supervision) -> Result<DatasetSource, IoError> {
    let path = folder.join(TABLE);
    if supervision.reads_radiance() {
        let error = IoError::invalid(folder, "holds captured LDR images and no radiance to train on");
        return Err(error.with_remedy(Remedy::set("supervision", "ldr")));
    }
    let table = parse_recorded_poses(&path, &read_file(&path)?)?;
    let images = images(&folder.join(IMAGES))?;
    if images.len() != table.len() {
        let found = images.len();
        return Err(IoError::invalid(
            &path,
            format!("{} rows, but {IMAGES} holds {found} images: expected one row per image", table.len()),
        ));
    }
    let mut frames: Vec<SourceFrame> = Vec::new();
    for (row, (recorded, image)) in table.iter().zip(images).enumerate() {
        let file = image.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let origin = Origin { path: path.clone(), place: format!("row {row} ({file:?})") };
        let recording = Recording { name: view_name(&format!("{IMAGES}/{file}")), image: image.clone(), exposure_s: recorded.exposure_s };
        let pose = recording.name.rsplit_once('_').map_or(recording.name.clone(), |(pose, _)| pose.to_owned());
        if let Some(last) = frames.last_mut().filter(|last| last.name == pose) {
            last.recordings.push(recording);
            continue;
        }
        frames.push(frame(recorded, pose, folder, recording, origin));
    }
    let split = split_beside(folder)?;
    let (format, folder) = ("HDR-NeRF real".to_owned(), folder.to_path_buf());
    Ok(DatasetSource {
        format,
        folder,
        frames,
        split,
        points: Vec::new(),
        points_from: String::new(),
        notes: Vec::new(),
        warnings: Vec::new(),
    })
}

/// Returns images of the folder, sorted by name.
pub(in crate::dataset) fn images(folder: &Path) -> Result<Vec<PathBuf>, IoError> {
    let system = |e: std::io::Error| IoError::system(folder, "read folder", &e);
    let mut images = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(system)? {
        let path = entry.map_err(system)?.path();
        // Systems leave files of their own, `._a.jpg`.
        let is_one = |name: &str| is_image(name) && !name.starts_with('.');
        if path.file_name().is_some_and(|name| is_one(&name.to_string_lossy())) {
            images.push(path);
        }
    }
    images.sort();
    Ok(images)
}

/// Parses `poses_bounds_exps.npy`: one row per image.
///
/// # Errors
/// No table of 18 columns, or a row that holds no pose, size, focal length or exposure; rows are
/// counted from 0.
pub fn parse_recorded_poses(path: &Path, bytes: &[u8]) -> Result<Vec<RecordedPose>, IoError> {
    let table = decode_table::<COLUMNS>(Input::new(path, bytes))?;
    let row = |(row, numbers): (usize, &[f64; COLUMNS])| {
        recorded_pose(numbers).map_err(|message| IoError::invalid(path, format!("row {row}: {message}")))
    };
    table.iter().enumerate().map(row).collect()
}

fn recorded_pose(numbers: &[f64; COLUMNS]) -> Result<RecordedPose, String> {
    let exposure_s = numbers[COLUMNS - 1] as f32;
    if !(exposure_s.is_normal() && exposure_s > 0.0) {
        return Err(format!("an exposure of {} s, expected a number above 0", numbers[COLUMNS - 1]));
    }
    let [pose @ .., _near, _far, _exposure] = numbers;
    let LlffPose { camera_from_world, size_px, focal_px } = llff_pose(pose)?;
    Ok(RecordedPose { camera_from_world, size_px, focal_px, exposure_s })
}

/// Pose and lens of a row, in LLFF's order.
pub(in crate::dataset) struct LlffPose {
    pub(in crate::dataset) camera_from_world: DAffine3,
    pub(in crate::dataset) size_px: [u32; 2],
    pub(in crate::dataset) focal_px: f64,
}

/// Returns the pose of 3 rows of 5 numbers; an error says what is wrong, without a place.
pub(in crate::dataset) fn llff_pose(numbers: &[f64; 15]) -> Result<LlffPose, String> {
    let column = |c: usize| DVec3::new(numbers[c], numbers[5 + c], numbers[10 + c]);
    let [down, right, back, eye, lens] = [0, 1, 2, 3, 4].map(column);
    // OpenGL's axes are right, up and backwards.
    let rotation = DMat3::from_cols(right, -down, back);
    let [height, width] = [lens.x, lens.y].map(|side| side.round());
    let sides = 1.0..=f64::from(luxel_core::MAX_SIDE_PX);
    if !sides.contains(&height) || !sides.contains(&width) {
        return Err(format!("an image of {width} x {height} pixels, expected sides from 1 to {}", luxel_core::MAX_SIDE_PX));
    }
    if !(lens.z.is_normal() && lens.z > 0.0) {
        return Err(format!("a focal length of {} pixels, expected a number above 0", lens.z));
    }
    let camera = Camera {
        camera_from_world: Camera::pose_from_opengl(rotation, eye),
        focal_px: DVec2::splat(lens.z),
        center_px: DVec2::new(0.5 * width, 0.5 * height),
        size_px: [width as u32, height as u32],
        distortion: Distortion::default(),
        projection: CameraProjection::Pinhole,
    };
    camera.validate().map_err(|e| e.to_string())?;
    Ok(LlffPose { camera_from_world: camera.camera_from_world, size_px: camera.size_px, focal_px: lens.z })
}

fn frame(recorded: &RecordedPose, name: String, folder: &Path, recording: Recording, origin: Origin) -> SourceFrame {
    let intrinsics = Intrinsics {
        size_px: Some(recorded.size_px),
        focal: Focal::Pixels(DVec2::splat(recorded.focal_px)),
        center_px: [None; 2],
        distortion: Distortion::default(),
        projection: CameraProjection::Pinhole,
        foreign_lens: None,
    };
    SourceFrame {
        // No radiance was measured there.
        image: folder.join(format!("{name}.exr")),
        name,
        recordings: vec![recording],
        exposure_s: None,
        noise: None,
        mask: None,
        camera_from_world: recorded.camera_from_world,
        intrinsics,
        origin,
        part: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera that looks along -z, 16 x 8 pixels, 2 s.
    const ROW: [f64; COLUMNS] = [0.0, 1.0, 0.0, 0.5, 8.0, -1.0, 0.0, 0.0, 0.0, 16.0, 0.0, 0.0, 1.0, 4.0, 20.0, 1.0, 9.0, 2.0];

    #[test]
    fn a_row_is_a_camera_or_an_error() {
        let pose = recorded_pose(&ROW).unwrap();
        assert_eq!((pose.size_px, pose.focal_px, pose.exposure_s), ([16, 8], 20.0, 2.0));
        for (column, value) in [(4, 0.0), (9, 1e9), (14, -1.0), (14, 0.0), (17, 0.0), (17, f64::MAX), (0, 0.9), (1, -1.0), (3, f64::MAX)] {
            let mut row = ROW;
            row[column] = value;
            row[13] = if column == 3 { f64::MAX } else { row[13] };
            // Far away is far away, and no error as long as it is a number.
            assert!(recorded_pose(&row).is_err() || column == 3, "{column} {value}");
        }
    }

    #[test]
    fn what_is_no_rotation_either_way_is_refused() {
        // Rows are orthonormal to 1e-3, columns are not.
        let mut row = ROW;
        let rotation = [0.406207024, 0.138173716, 0.903273977, -0.0566707190, 0.990408009, -0.125000008, -0.912022085, 0.0, 0.410141093];
        for (i, value) in rotation.into_iter().enumerate() {
            row[i / 3 * 5 + i % 3] = value;
        }
        assert!(recorded_pose(&row).unwrap_err().contains("rotation"), "{:?}", recorded_pose(&row));
    }
}
