//! Cameras that another program wrote, each with the name of its image: found, measured, and made
//! frames.
//!
//! In: cameras with poses and lenses, from a file in the scene's folder. Out: frames in the order
//! of the cameras, and warnings about images without a camera. Images are looked for in the folder
//! itself and in its folders of images, under the name in the file, then under its last part;
//! programs of photogrammetry run on 8-bit copies, so that radiance of the same name goes first.

use std::collections::{BTreeSet, HashSet};
use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec2, DVec3};
use luxel_core::Camera;

use super::Supervision;
use super::files::{Finder, Substitute, composed, is_image, list_images, view_name};
use super::intrinsics::{Intrinsics, LensImage};
use super::source::{DatasetSource, Origin, SourceFrame, split_beside};
use crate::IoError;
use crate::image::image_size;
use crate::lens::Lens;

/// Folders of images in the scene's folder, in the order they are looked in; the first is the
/// folder itself.
const IMAGE_FOLDERS: [&str; 6] = ["", "images", "input", "photos", "plates", "undistorted"];
/// Names that a warning lists.
const MAX_LISTED: usize = 3;
/// Width of the film that focal lengths of 35 mm cameras refer to, millimetres.
const FILM_WIDTH_MM: f64 = 36.0;
/// Largest deviation from a rotation that is rounding of the numbers in a file.
const MAX_DEVIATION: f64 = 1e-3;

/// A camera of a file with the name of its image.
#[derive(Clone, Debug, PartialEq)]
pub struct PosedCamera {
    /// Image as the file names it.
    pub name: String,
    /// Pose: rigid motion from world to camera coordinates, OpenCV axes.
    pub camera_from_world: DAffine3,
    /// Lens.
    pub(super) lens: PosedLens,
    /// Place in the file, for messages: `row 3`.
    pub(super) place: String,
}

impl PosedCamera {
    /// Returns the camera of an image of `image_px` pixels; without its distortion where no camera
    /// can have it.
    ///
    /// # Errors
    /// An explanation of what is wrong with pose, lens or size.
    pub fn camera(&self, image_px: [u32; 2]) -> Result<Camera, String> {
        self.lens.intrinsics(image_px).camera(self.camera_from_world, image_px)
    }
}

/// The lens of a file's camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum PosedLens {
    /// In pixels of a stated size.
    Pixels(LensImage),
    /// Relative to the image's longer side, whatever its size.
    Film(FilmLens),
    /// Relative to the image's width, whatever its size.
    Width(WidthLens),
}

/// A lens in units of the image's longer side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FilmLens {
    /// For film of 36 mm along the longer side.
    pub(super) focal_mm: f64,
    /// Principal point from the middle as a share of the longer side.
    pub(super) shift: [f64; 2],
    pub(super) lens: Lens,
}

/// A lens in units of the image's width, with square pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct WidthLens {
    /// Focal length as a share of the width.
    pub(super) focal: f64,
    /// Principal point from the middle as a share of the width.
    pub(super) shift: [f64; 2],
}

impl PosedLens {
    fn intrinsics(&self, image_px: [u32; 2]) -> Intrinsics {
        let [width, height] = image_px.map(f64::from);
        let relative = |focal_px: f64, shift: [f64; 2], unit: f64, lens: Lens| {
            let center_px = DVec2::new(0.5 * width, 0.5 * height) + DVec2::from(shift) * unit;
            LensImage { size_px: image_px, focal_px: DVec2::splat(focal_px), center_px, lens }.intrinsics()
        };
        match self {
            Self::Pixels(image) => image.intrinsics(),
            Self::Film(FilmLens { focal_mm, shift, lens }) => {
                let side = width.max(height);
                relative(focal_mm / FILM_WIDTH_MM * side, *shift, side, *lens)
            }
            Self::Width(WidthLens { focal, shift }) => relative(focal * width, *shift, width, Lens::default()),
        }
    }
}

/// Returns the pose of a camera with these axes (OpenCV: right, down, forward) and place in the
/// world. Rounding of the axes is removed; what is no rotation is an error without a place.
pub(crate) fn rigid(world_from_camera: DMat3, eye: DVec3) -> Result<DAffine3, String> {
    let mut rotation = world_from_camera.transpose();
    let deviation = (rotation * rotation.transpose() - DMat3::IDENTITY).to_cols_array();
    let determinant = rotation.determinant();
    if !(eye.is_finite() && deviation.iter().all(|v| v.abs() <= MAX_DEVIATION) && determinant > 0.0) {
        return Err(format!("the pose is not a rotation and translation (determinant {determinant:.4}, expected 1)"));
    }
    // One Newton step towards the nearest rotation.
    rotation = rotation * ((DMat3::IDENTITY * 3.0 - rotation.transpose() * rotation) * 0.5);
    Ok(DAffine3 { matrix3: rotation, translation: -(rotation * eye) })
}

/// Returns the OpenCV axes of a camera from its OpenGL axes (right, up, backwards).
pub(crate) fn from_opengl(world_from_camera: DMat3) -> DMat3 {
    world_from_camera * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0))
}

/// The file that cameras are from, and how its images are found.
pub(super) struct CameraFile<'a> {
    /// Format in words.
    pub(super) format: String,
    /// Folder of the scene.
    pub(super) folder: &'a Path,
    /// File or folder of the cameras.
    pub(super) path: &'a Path,
    pub(super) supervision: Supervision,
}

impl CameraFile<'_> {
    /// Makes a data set without points of the cameras.
    pub(super) fn source(self, cameras: Vec<PosedCamera>, mut warnings: Vec<String>) -> Result<DatasetSource, IoError> {
        if cameras.is_empty() {
            return Err(IoError::invalid(self.path, "no cameras with a pose, expected at least one"));
        }
        let finder = Finder::default();
        let mut frames = Vec::with_capacity(cameras.len());
        let mut substituted = Vec::new();
        for camera in &cameras {
            let origin = Origin { path: self.path.to_path_buf(), place: format!("{} ({:?})", camera.place, camera.name) };
            let Some((image, file_path)) = self.image(&finder, &camera.name) else {
                let tried: Vec<String> = IMAGE_FOLDERS.iter().map(|sub| self.folder.join(sub)).filter(|f| f.is_dir()).map(text).collect();
                return Err(origin.error(format!("no image of this name, expected it in {}", tried.join(" or "))));
            };
            let named = is_image(&camera.name).then(|| Path::new(&camera.name).extension()).flatten();
            if named.is_some_and(|named| image.extension().is_some_and(|found| !found.eq_ignore_ascii_case(named))) {
                substituted.push((camera.name.clone(), image.clone()));
            }
            let intrinsics = match camera.lens {
                PosedLens::Pixels(image) => image.intrinsics(),
                relative => relative.intrinsics(image_size(&image)?),
            };
            frames.push(SourceFrame {
                name: view_name(&file_path),
                image,
                recordings: Vec::new(),
                exposure_s: None,
                noise: None,
                mask: None,
                camera_from_world: camera.camera_from_world,
                intrinsics,
                origin,
                part: None,
            });
        }
        if let [(name, path), ..] = substituted.as_slice() {
            let (n, path) = (substituted.len(), path.display());
            warnings.push(format!("{n} images are read in another format than the cameras name, such as {path} for {name}"));
        }
        warnings.extend(finder.warnings());
        warnings.extend(self.without_camera(&frames));
        let split = split_beside(self.folder)?;
        let folder = self.folder.to_path_buf();
        Ok(DatasetSource {
            format: self.format,
            folder,
            frames,
            split,
            points: Vec::new(),
            points_from: String::new(),
            notes: Vec::new(),
            warnings,
        })
    }

    /// Finds an image; with its path below the scene's folder.
    fn image(&self, finder: &Finder, name: &str) -> Option<(PathBuf, String)> {
        let slashed = name.replace('\\', "/");
        let last = slashed.rsplit('/').next().unwrap_or(&slashed).to_owned();
        let substitute = match self.supervision {
            Supervision::Hdr | Supervision::Both => Substitute::Radiance,
            Supervision::Ldr => Substitute::Allowed,
        };
        let is_relative = !Path::new(&slashed).is_absolute() && !slashed.contains(':');
        let names = [is_relative.then_some(slashed), Some(last)];
        names.into_iter().flatten().find_map(|name| {
            IMAGE_FOLDERS.iter().find_map(|sub| {
                let path = finder.find_image(&self.folder.join(sub), &name, substitute)?;
                Some((path, if sub.is_empty() { name.clone() } else { format!("{sub}/{name}") }))
            })
        })
    }

    /// Says which images have no camera.
    fn without_camera(&self, frames: &[SourceFrame]) -> Option<String> {
        let used: HashSet<String> = frames.iter().map(|frame| composed(&frame.name)).collect();
        let mut others = BTreeSet::new();
        // Of the folder itself, only what lies in a folder of images counts: masks and depth lie
        // beside it.
        for sub in &IMAGE_FOLDERS[1..] {
            list_images(&self.folder.join(sub), sub, &mut others);
        }
        let total = others.len();
        others.retain(|name| !used.contains(&composed(name)));
        let listed: Vec<&str> = others.iter().take(MAX_LISTED).map(String::as_str).collect();
        let more = if others.len() > MAX_LISTED { ", ..." } else { "" };
        (!others.is_empty()).then(|| {
            format!("{} of {total} images have no camera with a pose and are left out ({}{more})", others.len(), listed.join(", "))
        })
    }
}

fn text(path: PathBuf) -> String {
    path.display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_of_few_digits_become_rotations() {
        let turned = DMat3::from_cols_array(&[0.8660, 0.5, 0.0, -0.5, 0.8660, 0.0, 0.0, 0.0, 1.0]);
        let pose = rigid(turned, DVec3::new(1.0, 2.0, 3.0)).unwrap();
        let gram = pose.matrix3 * pose.matrix3.transpose() - DMat3::IDENTITY;
        assert!(gram.to_cols_array().iter().all(|v| v.abs() < 1e-8));
        assert!(pose.transform_point3(DVec3::new(1.0, 2.0, 3.0)).length() < 1e-7);
        assert!(rigid(DMat3::IDENTITY * 2.0, DVec3::ZERO).unwrap_err().contains("determinant 8.0"));
        assert!(rigid(-DMat3::IDENTITY, DVec3::ZERO).is_err());
        assert!(rigid(DMat3::IDENTITY, DVec3::NAN).is_err());
    }

    #[test]
    fn lenses_on_film_follow_the_longer_side() {
        let film = PosedLens::Film(FilmLens { focal_mm: 18.0, shift: [0.01, -0.02], lens: Lens::default() });
        for (size, center) in [([400, 300], [204.0, 142.0]), ([300, 400], [154.0, 192.0])] {
            let found = film.intrinsics(size);
            assert_eq!((found.focal, found.center_px), (super::super::intrinsics::Focal::Pixels(DVec2::splat(200.0)), center.map(Some)));
        }
    }
}
