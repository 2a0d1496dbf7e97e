//! HDR-NeRF's real scenes: `poses_bounds_exps.npy` with `input_images/<pose>_<k>.jpg`, recordings without ground truth.
//!
//! A row of the table is an image, in the order of the images' names: 3 rows of 5 numbers (the camera's axes down, right and backwards in the world,
//! its place, and height, width and focal length in pixels), nearest and farthest depth, exposure in seconds (LLFF with one more column). Images of
//! one pose are a bracket. The size is of the images as they were photographed; a copy at 1/2, 1/4 or 1/8 is recognised.

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec2, DVec3};
use luxel_core::{Camera, Distortion};

use super::Supervision;
use super::files::{is_image, view_name};
use super::intrinsics::{Focal, Intrinsics};
use super::source::{Frame, Origin, Recording, Source, split_beside};
use crate::IoError;
use crate::image::npy::decode_table;
use crate::regular::read_file;

const TABLE: &str = "poses_bounds_exps.npy";
const IMAGES: &str = "input_images";
/// Numbers of a row: 15 of the pose, 2 bounds, 1 exposure.
const COLUMNS: usize = 18;

/// Whether the folder has this layout, by names only.
pub(super) fn is_one(folder: &Path) -> bool {
    folder.join(TABLE).is_file() && folder.join(IMAGES).is_dir()
}

/// Reads the table and finds the images.
pub(super) fn llff_source(folder: &Path, supervision: Supervision) -> Result<Source, IoError> {
    let path = folder.join(TABLE);
    if supervision == Supervision::Hdr {
        return Err(IoError::invalid(folder, "holds recordings and no radiance to train on; give --supervision ldr"));
    }
    let table = decode_table::<COLUMNS>(&path, &read_file(&path)?)?;
    let images = images(&folder.join(IMAGES))?;
    if images.len() != table.len() {
        let found = images.len();
        return Err(IoError::invalid(&path, format!("{} rows, but {IMAGES} holds {found} images: expected a row an image", table.len())));
    }
    let mut frames: Vec<Frame> = Vec::new();
    for (row, (numbers, image)) in table.iter().zip(images).enumerate() {
        let file = image.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let origin = Origin { path: path.clone(), place: format!("row {row} ({file:?})") };
        let exposure_s = numbers[COLUMNS - 1] as f32;
        if !(exposure_s.is_normal() && exposure_s > 0.0) {
            return Err(origin.error(format!("an exposure of {} s, expected a number above 0", numbers[COLUMNS - 1])));
        }
        let recording = Recording { name: view_name(&format!("{IMAGES}/{file}")), image: image.clone(), exposure_s };
        let pose = recording.name.rsplit_once('_').map_or(recording.name.clone(), |(pose, _)| pose.to_owned());
        if let Some(last) = frames.last_mut().filter(|last| last.name == pose) {
            last.recordings.push(recording);
            continue;
        }
        frames.push(frame(numbers, pose, folder, recording, origin)?);
    }
    let split = split_beside(folder)?;
    Ok(Source { format: "HDR-NeRF real".to_owned(), frames, split, points: Vec::new(), warnings: Vec::new() })
}

/// Images of the folder, sorted by name.
fn images(folder: &Path) -> Result<Vec<PathBuf>, IoError> {
    let system = |e: std::io::Error| IoError::system(folder, "read folder", &e);
    let mut images = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(system)? {
        let path = entry.map_err(system)?.path();
        if path.file_name().is_some_and(|name| is_image(&name.to_string_lossy())) {
            images.push(path);
        }
    }
    images.sort();
    Ok(images)
}

fn frame(numbers: &[f64; COLUMNS], name: String, folder: &Path, recording: Recording, origin: Origin) -> Result<Frame, IoError> {
    let column = |c: usize| DVec3::new(numbers[c], numbers[5 + c], numbers[10 + c]);
    let [down, right, back, eye, lens] = [0, 1, 2, 3, 4].map(column);
    // OpenGL's axes are right, up and backwards.
    let rotation = DMat3::from_cols(right, -down, back);
    let deviation = (rotation * rotation.transpose() - DMat3::IDENTITY).to_cols_array();
    if deviation.iter().any(|v| v.abs() > 1e-3) || rotation.determinant() < 0.0 {
        return Err(origin.error("the pose is not a rotation and translation"));
    }
    let [height, width] = [lens.x, lens.y].map(|side| side.round());
    if !(1.0..=f64::from(luxel_core::MAX_SIDE_PX)).contains(&height) || !(1.0..=f64::from(luxel_core::MAX_SIDE_PX)).contains(&width) {
        return Err(origin.error(format!("an image of {width} x {height} pixels, expected sides from 1 to {}", luxel_core::MAX_SIDE_PX)));
    }
    let intrinsics = Intrinsics {
        size_px: Some([width as u32, height as u32]),
        focal: Focal::Pixels(DVec2::splat(lens.z)),
        center_px: [None; 2],
        distortion: Distortion::default(),
    };
    Ok(Frame {
        // No radiance was measured there.
        image: folder.join(format!("{name}.exr")),
        name,
        recordings: vec![recording],
        exposure_s: None,
        noise: None,
        mask: None,
        camera_from_world: Camera::pose_from_opengl(rotation, eye),
        intrinsics,
        origin,
        part: None,
    })
}
