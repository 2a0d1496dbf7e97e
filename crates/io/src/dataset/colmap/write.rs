//! COLMAP models out, as text: pinhole cameras and whole panoramas, one per lens.
//!
//! In: images with their undistorted cameras and features, and points whose tracks are indices into
//! them. Out: `cameras.txt`, `images.txt`, `points3D.txt` in a folder. Ids count from 1. Numbers
//! are written such that they are read back to the bit.

use std::f64::consts::{PI, TAU};
use std::fmt::Write;
use std::path::Path;

use glam::{DQuat, DVec2};
use luxel_core::{Camera, CameraProjection};

use super::ColmapPoint;
use crate::{IoError, write_atomically};

/// An image of a model to write.
#[derive(Clone, Debug, PartialEq)]
pub struct PosedImage {
    /// Name of the file.
    pub name: String,
    /// Undistorted camera.
    pub camera: Camera,
    /// Features `[x, y]`, pixels.
    pub features_px: Vec<[f32; 2]>,
}

/// A point of a model to write.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredPoint {
    /// The point, with a track of indices into the images and their features.
    pub point: ColmapPoint,
    /// Mean error of its reprojection, pixels.
    pub error_px: f64,
}

/// Writes a model.
///
/// # Errors
/// The system's, or a track that points to no image or feature, or a name with a line break.
pub fn write_text(folder: &Path, images: &[PosedImage], points: &[MeasuredPoint]) -> Result<(), IoError> {
    let mut lenses: Vec<&Camera> = Vec::new();
    let mut cameras = String::from("# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n");
    let mut poses = String::from("# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then X Y POINT3D_ID of each feature\n");
    let mut point_of: Vec<Vec<i64>> = images.iter().map(|image| vec![-1; image.features_px.len()]).collect();
    for (id, MeasuredPoint { point, .. }) in (1i64..).zip(points) {
        for [image, feature] in &point.track {
            match point_of.get_mut(*image as usize).and_then(|features| features.get_mut(*feature as usize)) {
                Some(slot) => *slot = id,
                None => return Err(IoError::invalid(folder, format!("point {id}: feature {feature} of image {image} does not exist"))),
            }
        }
    }
    for ((id, PosedImage { name, camera, features_px }), ids) in (1..).zip(images).zip(&point_of) {
        if name.contains(['\n', '\r']) {
            return Err(IoError::invalid(folder, format!("image name {name:?} has a line break")));
        }
        let model = model_of(camera).ok_or_else(|| {
            let projection = camera.projection.name();
            let message = format!("image {name} has a camera with {projection} projection, expected a pinhole or a whole panorama");
            IoError::unsupported(folder, message)
        })?;
        let lens_of = |camera: &Camera| (camera.size_px, camera.focal_px, camera.center_px, camera.projection);
        let same = |lens: &&Camera| lens_of(lens) == lens_of(camera);
        let lens = lenses.iter().position(same).unwrap_or_else(|| {
            lenses.push(camera);
            // Writing into a string does not fail.
            let _ = writeln!(cameras, "{} {model}", lenses.len());
            lenses.len() - 1
        });
        let q = DQuat::from_mat3(&camera.camera_from_world.matrix3).normalize();
        let t = camera.camera_from_world.translation;
        let _ = writeln!(poses, "{id} {} {} {} {} {} {} {} {} {name}", q.w, q.x, q.y, q.z, t.x, t.y, t.z, lens + 1);
        let line: Vec<String> = features_px.iter().zip(ids).map(|([x, y], id)| format!("{x} {y} {id}")).collect();
        let _ = writeln!(poses, "{}", line.join(" "));
    }
    let mut positions = String::from("# POINT3D_ID X Y Z R G B ERROR, then IMAGE_ID POINT2D_IDX of each sighting\n");
    for (id, MeasuredPoint { point, error_px }) in (1..).zip(points) {
        let (p, [r, g, b]) = (point.position, point.rgb8);
        let track: Vec<String> = point.track.iter().map(|[image, feature]| format!("{} {feature}", image + 1)).collect();
        let _ = writeln!(positions, "{id} {} {} {} {r} {g} {b} {error_px} {}", p.x, p.y, p.z, track.join(" "));
    }
    for (file, text) in [("cameras.txt", cameras), ("images.txt", poses), ("points3D.txt", positions)] {
        let path = folder.join(file);
        write_atomically(&path, |out| out.write_all(text.as_bytes()).map_err(|e| IoError::system(&path, "write", &e)))?;
    }
    Ok(())
}

/// Returns COLMAP's model of a camera, its size and its parameters; `None` for a projection that no
/// model has.
fn model_of(camera: &Camera) -> Option<String> {
    let ([w, h], f, c) = (camera.size_px, camera.focal_px, camera.center_px);
    match camera.projection {
        CameraProjection::Pinhole => Some(format!("PINHOLE {w} {h} {} {} {} {}", f.x, f.y, c.x, c.y)),
        CameraProjection::Equirectangular => {
            let size = DVec2::new(w.into(), h.into());
            let is_whole = f.abs_diff_eq(size / DVec2::new(TAU, PI), 1e-6) && c.abs_diff_eq(0.5 * size, 1e-6);
            is_whole.then(|| format!("EQUIRECTANGULAR {w} {h} {w} {h}"))
        }
        CameraProjection::Fisheye(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DMat3, DVec3};
    use luxel_core::Distortion;

    use super::super::{ColmapImage, read_colmap_model};
    use super::*;

    fn camera(angle: f64) -> Camera {
        Camera {
            camera_from_world: DAffine3 { matrix3: DMat3::from_rotation_y(angle), translation: DVec3::new(0.1, -2.0, angle) },
            focal_px: DVec2::new(300.25, 301.5),
            center_px: DVec2::new(100.0, 75.5),
            size_px: [200, 150],
            distortion: Distortion::default(),
            projection: CameraProjection::Pinhole,
        }
    }

    fn image(name: &str, angle: f64, features_px: Vec<[f32; 2]>) -> PosedImage {
        PosedImage { name: name.to_owned(), camera: camera(angle), features_px }
    }

    #[test]
    fn a_model_is_read_back_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let images: Vec<_> =
            (0..3).map(|i| image(&format!("view {i}.exr"), f64::from(i) * 0.3, vec![[1.5, 2.25], [100.125, 7.0]])).collect();
        let point = ColmapPoint { position: DVec3::new(0.1, 0.2, 1.0 / 3.0), rgb8: [1, 2, 3], track: vec![[0, 1], [2, 0]] };
        write_text(folder.path(), &images, &[MeasuredPoint { point: point.clone(), error_px: 0.4 }]).unwrap();
        let model = read_colmap_model(folder.path()).unwrap();
        assert_eq!(model.points, [point]);
        for (found, PosedImage { name, camera: expected, features_px }) in model.images.iter().zip(&images) {
            assert_eq!((&found.name, &found.features_px), (name, features_px));
            let found = found.camera().unwrap();
            assert!(found.camera_from_world.abs_diff_eq(expected.camera_from_world, 1e-12));
            assert_eq!((found.focal_px, found.center_px, found.size_px), (expected.focal_px, expected.center_px, expected.size_px));
        }
        assert!(std::fs::read_to_string(folder.path().join("cameras.txt")).unwrap().lines().count() == 2);
    }

    #[test]
    fn panoramas_are_read_back_and_parts_of_them_refused() {
        let folder = tempfile::tempdir().unwrap();
        let whole = Camera::panorama(camera(0.3).camera_from_world, 64);
        let image = |camera: Camera| PosedImage { name: "a.exr".to_owned(), camera, features_px: vec![[1.5, 30.0]] };
        write_text(folder.path(), &[image(whole.clone())], &[]).unwrap();
        let model = read_colmap_model(folder.path()).unwrap();
        let found = model.images[0].camera().unwrap();
        assert_eq!((found.size_px, found.projection), (whole.size_px, whole.projection));
        assert!(found.focal_px.abs_diff_eq(whole.focal_px, 1e-12) && found.camera_from_world.abs_diff_eq(whole.camera_from_world, 1e-12));
        let made = ColmapImage::panorama(1, "a.exr".to_owned(), whole.camera_from_world, [64, 32]).camera().unwrap();
        assert!(made.focal_px.abs_diff_eq(whole.focal_px, 1e-12) && made.center_px == whole.center_px);
        let part = Camera { center_px: DVec2::new(32.0, 8.0), ..whole };
        assert!(write_text(folder.path(), &[image(part)], &[]).unwrap_err().message.contains("expected a pinhole or a whole panorama"));
    }

    #[test]
    fn tracks_to_nowhere_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let point = ColmapPoint { position: DVec3::ZERO, rgb8: [0; 3], track: vec![[0, 5]] };
        assert!(write_text(folder.path(), &[image("a", 0.0, vec![])], &[MeasuredPoint { point, error_px: 0.0 }]).is_err());
    }
}
