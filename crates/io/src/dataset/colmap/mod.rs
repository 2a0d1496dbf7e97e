//! COLMAP models: cameras, posed images with their features, and points with tracks; binary or
//! text.
//!
//! [`parse_binary`] and [`parse_text`] turn the three files' bytes into the same [`ColmapModel`].
//! Lenses: all of COLMAP 4.2's models (`models.rs`). Feature coordinates have pixel centres at
//! +0.5, as here. Where the model has rigs and frames, poses are those of the frames (`rigs.rs`).

mod binary;
mod models;
mod rigs;
mod submodels;
mod text;
mod write;

use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};
use luxel_core::Camera;

use super::intrinsics::{Intrinsics, LensImage};
use crate::lens::{Base, Lens, Warp};
use crate::read_file::read_file;
use crate::{IoError, PlyPoint, read_points_ply};

pub use binary::parse_binary;
pub use rigs::{RigFiles, Rigs, parse_rigs_binary, parse_rigs_text};
pub(super) use submodels::{FoundModel, find_model};
pub use text::parse_text;
pub use write::{MeasuredPoint, PosedImage, write_text};

/// A reconstruction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ColmapModel {
    /// Sorted by image id.
    pub images: Vec<ColmapImage>,
    /// Sorted by point id.
    pub points: Vec<ColmapPoint>,
    /// A line about rigs of several cameras, for people.
    pub rigs: Option<String>,
    /// Warnings about entries that are left out or missing, for people.
    pub warnings: Vec<String>,
}

/// A registered image.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapImage {
    /// COLMAP's number.
    pub id: u32,
    /// Path below the image folder.
    pub name: String,
    /// Pose.
    pub camera_from_world: DAffine3,
    /// Lens; states its size.
    pub(super) intrinsics: Intrinsics,
    /// Pixel coordinates of the features, in the distorted image of the lens's size.
    pub features_px: Vec<[f32; 2]>,
}

impl ColmapImage {
    /// Returns a whole panorama of `size_px` pixels, without features.
    pub fn panorama(id: u32, name: String, camera_from_world: DAffine3, size_px: [u32; 2]) -> Self {
        let size = DVec2::from(size_px.map(f64::from));
        let lens = Lens { base: Base::Equirectangular, warp: Warp::default() };
        let image = LensImage { size_px, focal_px: size / DVec2::new(TAU, PI), center_px: 0.5 * size, lens };
        Self { id, name, camera_from_world, intrinsics: image.intrinsics(), features_px: Vec::new() }
    }

    /// Returns the pose and lens, of the image that COLMAP saw.
    ///
    /// # Errors
    /// An explanation of what is wrong with them, without a place.
    pub fn camera(&self) -> Result<Camera, String> {
        if let Some(lens) = self.intrinsics.foreign_lens {
            return Err(format!("a lens of {} projection with coefficients that no camera has", lens.base.name()));
        }
        self.intrinsics.camera(self.camera_from_world, self.intrinsics.size_px.unwrap_or([0, 0]))
    }
}

/// A point with its track.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapPoint {
    /// World.
    pub position: DVec3,
    /// Colour.
    pub rgb8: [u8; 3],
    /// Index into [`ColmapModel::images`] and feature index there; both in range.
    pub track: Vec<[u32; 2]>,
}

/// The three files of a model, for messages and reading.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColmapFiles<T> {
    /// Lenses.
    pub cameras: T,
    /// Poses and features.
    pub images: T,
    /// Points and tracks.
    pub points: T,
}

impl<T> ColmapFiles<T> {
    fn map<U>(&self, f: impl Fn(&T) -> Result<U, IoError>) -> Result<ColmapFiles<U>, IoError> {
        Ok(ColmapFiles { cameras: f(&self.cameras)?, images: f(&self.images)?, points: f(&self.points)? })
    }
}

/// Reads the model in `folder` itself (`cameras.bin` or `cameras.txt`, and so on).
///
/// # Errors
/// A file is missing or damaged.
pub fn read_colmap_model(folder: &Path) -> Result<ColmapModel, IoError> {
    read_model(folder).map(|(model, _)| model)
}

/// Reads the model in `folder`, binary before text.
pub(super) fn read_model(folder: &Path) -> Result<(ColmapModel, ColmapFiles<PathBuf>), IoError> {
    let binary = folder.join("cameras.bin").is_file();
    let extension = if binary { "bin" } else { "txt" };
    let file = |stem: &str| folder.join(format!("{stem}.{extension}"));
    let paths = ColmapFiles { cameras: file("cameras"), images: file("images"), points: file("points3D") };
    let without_points = !paths.points.exists();
    // No points, as the format writes that: a count of 0, or nothing.
    let none = if binary { vec![0; size_of::<u64>()] } else { Vec::new() };
    let read = |path: &PathBuf| if without_points && *path == paths.points { Ok(none.clone()) } else { read_file(path) };
    let bytes = paths.map(read)?;
    let mut model = if binary { parse_binary(&paths, &bytes) } else { parse_text(&paths, &bytes) }?;
    if without_points {
        add_points_ply(folder, &paths.points, &mut model)?;
    }
    let rigs = RigFiles { rigs: file("rigs"), frames: file("frames") };
    if rigs.rigs.is_file() && rigs.frames.is_file() {
        let bytes = RigFiles { rigs: read_file(&rigs.rigs)?, frames: read_file(&rigs.frames)? };
        let found = if binary { parse_rigs_binary(&rigs, &bytes) } else { parse_rigs_text(&rigs, &bytes) }?;
        found.apply(&rigs, &mut model)?;
    }
    Ok((model, paths))
}

/// Takes the points of a model without any from `points3D.ply` beside it, which 3D Gaussian
/// splatting's programs write.
fn add_points_ply(folder: &Path, missing: &Path, model: &mut ColmapModel) -> Result<(), IoError> {
    let ply = folder.join("points3D.ply");
    if !ply.is_file() {
        model.warnings.push(format!("{} does not exist: training starts from the cameras, without points", missing.display()));
        return Ok(());
    }
    let cloud = read_points_ply(&ply)?;
    model.warnings.push(format!("{} does not exist: points are those of {}, without tracks", missing.display(), ply.display()));
    model.warnings.extend(cloud.warning(&ply));
    let point =
        |point: PlyPoint| ColmapPoint { position: DVec3::from(point.0), rgb8: point.1.unwrap_or([u8::MAX / 2; 3]), track: Vec::new() };
    model.points = cloud.points.into_iter().map(point).collect();
    Ok(())
}

/// Returns the pose from COLMAP's quaternion (w x y z, camera from world) and translation. Errors
/// explain what is wrong, not where.
fn pose(quaternion: [f64; 4], translation: [f64; 3]) -> Result<DAffine3, String> {
    let [w, x, y, z] = quaternion;
    let q = DQuat::from_xyzw(x, y, z, w);
    if !(q.is_finite() && DVec3::from(translation).is_finite()) {
        return Err("pose is not finite".to_owned());
    }
    // COLMAP writes unit quaternions; far from that the bytes are something else.
    if !(0.5..=2.0).contains(&q.length()) {
        return Err(format!("rotation quaternion has length {}, expected 1", q.length()));
    }
    Ok(DAffine3 { matrix3: DMat3::from_quat(q.normalize()), translation: DVec3::from(translation) })
}

/// The content of a model before ids are resolved.
#[derive(Default)]
struct Collected {
    cameras: Vec<(u32, Intrinsics)>,
    /// With the camera's id, which [`Collected::resolve`] replaces by its lens.
    images: Vec<RawImage>,
    /// With the point's id and its track as (image id, feature index).
    points: Vec<(u64, ColmapPoint)>,
}

struct RawImage {
    id: u32,
    name: String,
    camera_from_world: DAffine3,
    camera: u32,
    features_px: Vec<[f32; 2]>,
}

impl Collected {
    /// Sorts by id and replaces ids by indices.
    fn resolve(mut self, paths: &ColmapFiles<PathBuf>) -> Result<ColmapModel, IoError> {
        self.cameras.sort_by_key(|(id, _)| *id);
        self.images.sort_by_key(|image| image.id);
        self.points.sort_by_key(|(id, _)| *id);
        if let Some(twice) = self.cameras.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            return Err(IoError::invalid(&paths.cameras, format!("camera {} occurs twice", twice[0].0)));
        }
        if let Some(twice) = self.images.windows(2).find(|pair| pair[0].id == pair[1].id) {
            return Err(IoError::invalid(&paths.images, format!("image {} occurs twice", twice[0].id)));
        }
        if let Some(twice) = self.points.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            return Err(IoError::invalid(&paths.points, format!("point {} occurs twice", twice[0].0)));
        }
        let mut images = Vec::with_capacity(self.images.len());
        for image in self.images {
            let RawImage { id, name, camera_from_world, camera, features_px } = image;
            let Ok(found) = self.cameras.binary_search_by_key(&camera, |(id, _)| *id) else {
                let cameras = paths.cameras.display();
                return Err(IoError::invalid(&paths.images, format!("image {id} ({name:?}): camera {camera} is not in {cameras}")));
            };
            images.push(ColmapImage { id, name, camera_from_world, intrinsics: self.cameras[found].1, features_px });
        }
        let (mut without_image, mut without_feature) = (0usize, 0usize);
        let mut points = Vec::with_capacity(self.points.len());
        for (_, mut point) in self.points {
            // Images that were deleted, and features that a tool dropped, stay in the tracks.
            point.track.retain_mut(|[image, feature]| match images.binary_search_by_key(image, |i| i.id) {
                Err(_) => {
                    without_image += 1;
                    false
                }
                Ok(found) if *feature as usize >= images[found].features_px.len() => {
                    without_feature += 1;
                    false
                }
                Ok(found) => {
                    *image = found as u32;
                    true
                }
            });
            points.push(point);
        }
        let place = paths.points.display();
        let left_out = [(without_image, "images that the model lacks"), (without_feature, "features that their images lack")];
        let line =
            |(count, what): &(usize, &str)| format!("{place}: {count} entries of tracks name {what} and are left out; the points stay");
        let warnings = left_out.iter().filter(|(count, _)| *count > 0).map(line).collect();
        Ok(ColmapModel { images, points, rigs: None, warnings })
    }
}

#[cfg(test)]
mod tests_support {
    //! A small model in both formats.

    use super::ColmapFiles;
    use std::path::PathBuf;

    pub(super) fn paths(extension: &str) -> ColmapFiles<PathBuf> {
        let file = |stem: &str| PathBuf::from(format!("{stem}.{extension}"));
        ColmapFiles { cameras: file("cameras"), images: file("images"), points: file("points3D") }
    }

    pub(super) fn text_model() -> ColmapFiles<Vec<u8>> {
        ColmapFiles {
            cameras: b"# Camera list\n7 OPENCV 64 48 50 51 32 24 0.1 -0.02 0.001 0.002\n".to_vec(),
            images: b"# two lines an image\n2 0 1 0 0 1 2 3 7 b.exr\n4.5 5.5 9\n1 1 0 0 0 0 0 0 7 a.exr\n1.5 2.5 -1 3.5 4 9\n".to_vec(),
            points: b"9 1 2 3 10 20 30 0.5 1 1 2 0\n".to_vec(),
        }
    }

    pub(super) fn binary_model() -> ColmapFiles<Vec<u8>> {
        let mut files = ColmapFiles { cameras: Vec::new(), images: Vec::new(), points: Vec::new() };
        let doubles = |out: &mut Vec<u8>, values: &[f64]| values.iter().for_each(|v| out.extend(v.to_le_bytes()));
        let c = &mut files.cameras;
        c.extend(1u64.to_le_bytes());
        c.extend(7u32.to_le_bytes());
        c.extend(4u32.to_le_bytes());
        c.extend([64u64, 48].map(u64::to_le_bytes).concat());
        doubles(c, &[50.0, 51.0, 32.0, 24.0, 0.1, -0.02, 0.001, 0.002]);
        let i = &mut files.images;
        i.extend(2u64.to_le_bytes());
        let image = |out: &mut Vec<u8>, id: u32, pose: [f64; 7], name: &[u8], features: &[(f64, f64, i64)]| {
            out.extend(id.to_le_bytes());
            doubles(out, &pose);
            out.extend(7u32.to_le_bytes());
            out.extend(name);
            out.push(0);
            out.extend((features.len() as u64).to_le_bytes());
            for (x, y, point) in features {
                doubles(out, &[*x, *y]);
                out.extend(point.to_le_bytes());
            }
        };
        image(i, 2, [0.0, 1.0, 0.0, 0.0, 1.0, 2.0, 3.0], b"b.exr", &[(4.5, 5.5, 9)]);
        image(i, 1, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], b"a.exr", &[(1.5, 2.5, -1), (3.5, 4.0, 9)]);
        let p = &mut files.points;
        p.extend([1u64, 9].map(u64::to_le_bytes).concat());
        doubles(p, &[1.0, 2.0, 3.0]);
        p.extend([10, 20, 30]);
        doubles(p, &[0.5]);
        p.extend(2u64.to_le_bytes());
        p.extend([1u32, 1, 2, 0].map(u32::to_le_bytes).concat());
        files
    }
}
