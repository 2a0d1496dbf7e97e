//! Cameras of other projections: those of a data set with another lens, one at a point of the
//! world, and pairs for two eyes.
//!
//! In: cameras or a point, a lens. Out: cameras in the same coordinates. Degenerate: sizes that do
//! not hold the field are errors.

use glam::{DAffine3, DMat3, DVec2, DVec3};
use luxel_core::{Camera, CameraProjection, Dataset, Distortion, Fisheye, MAX_FISHEYE_ANGLE_RAD};

use crate::Result;
use crate::error::ensure;
use crate::up::{Up, UpAxis, file_from_world};

/// The kind of a lens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LensKind {
    /// Straight lines stay straight.
    Pinhole,
    /// The distance from the middle is proportional to the angle to the axis; the field is a circle
    /// that touches the nearer borders.
    Fisheye,
    /// Columns are longitudes, rows latitudes.
    Equirectangular,
}

/// A lens and the size of its images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Kind.
    pub kind: LensKind,
    /// Field of view across, degrees; `None` for 90, 180 or 360, by kind.
    pub field_deg: Option<f64>,
    /// Width and height, pixels; `None` for 1024 a side, or 2048 x 1024 for a whole panorama.
    pub size_px: Option<[u32; 2]>,
}

impl Lens {
    /// Returns the camera of this lens at a pose.
    ///
    /// ```
    /// use glam::DAffine3;
    /// use luxel::lens::{Lens, LensKind};
    ///
    /// let lens =
    ///     Lens { kind: LensKind::Equirectangular, field_deg: None, size_px: Some([64, 32]) };
    /// assert_eq!(lens.camera(DAffine3::IDENTITY)?.size_px, [64, 32]);
    /// # Ok::<(), luxel::Error>(())
    /// ```
    ///
    /// # Errors
    /// A field that the kind cannot have; a size of another shape than the field.
    pub fn camera(&self, camera_from_world: DAffine3) -> Result<Camera> {
        let (usual, most) = match self.kind {
            LensKind::Pinhole => (90.0, 175.0),
            LensKind::Fisheye => (180.0, 2.0 * MAX_FISHEYE_ANGLE_RAD.to_degrees()),
            LensKind::Equirectangular => (360.0, 360.0),
        };
        let field = self.field_deg.unwrap_or(usual);
        ensure!((1.0..=most).contains(&field), "a field of view of {field} degrees, expected 1 to {most} for this projection");
        let usual_size = if self.kind == LensKind::Equirectangular && field > 180.0 { [2048, 1024] } else { [1024; 2] };
        let size_px = self.size_px.unwrap_or(usual_size);
        let size = DVec2::from_array(size_px.map(f64::from));
        let half = 0.5 * field.to_radians();
        let (focal_px, projection) = match self.kind {
            LensKind::Pinhole => (DVec2::splat(0.5 * size.x / half.tan()), CameraProjection::Pinhole),
            LensKind::Fisheye => {
                let lens = Fisheye { coefficients: [0.0; 4], max_angle_rad: half };
                (DVec2::splat(0.5 * size.min_element() / half), CameraProjection::Fisheye(lens))
            }
            LensKind::Equirectangular => {
                let expected = size.x * 180.0 / field;
                ensure!(
                    (expected - 1.0..=expected + 1.0).contains(&size.y),
                    "a panorama of {field} degrees is {} x {} pixels, expected {} x {}: its height spans 180 degrees",
                    size.x,
                    size.y,
                    size.x,
                    expected.round()
                );
                (size / DVec2::new(2.0 * half, std::f64::consts::PI), CameraProjection::Equirectangular)
            }
        };
        let distortion = Distortion::default();
        Ok(Camera { camera_from_world, focal_px, center_px: 0.5 * size, size_px, distortion, projection })
    }
}

/// Returns the pose at a point of the world that looks as the middle of a light probe does: level,
/// with the data set's up direction above.
///
/// # Errors
/// An up direction that cannot be used.
pub fn pose_at(at: [f64; 3], up: Up, dataset: Option<&Dataset>) -> Result<DAffine3> {
    let environment_from_world = file_from_world(up, UpAxis::PlusY, dataset, 1.0)?.rotation();
    let matrix3 = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0)) * environment_from_world;
    Ok(DAffine3 { matrix3, translation: -(matrix3 * DVec3::from_array(at)) })
}

/// Returns the cameras of the left and the right eye, `distance` apart along the image's rows, in
/// the units of the camera's coordinates.
pub fn stereo_pair(camera: &Camera, distance: f64) -> [Camera; 2] {
    [-0.5, 0.5].map(|side| {
        let mut eye = camera.clone();
        // An eye to the right sees everything further to the left.
        eye.camera_from_world.translation.x -= side * distance;
        eye
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens(kind: LensKind, field_deg: Option<f64>, size_px: Option<[u32; 2]>) -> Result<Camera> {
        Lens { kind, field_deg, size_px }.camera(DAffine3::IDENTITY)
    }

    #[test]
    fn lenses_show_their_field() {
        let at = |camera: &Camera, degrees: f64| {
            let angle = degrees.to_radians();
            camera.project(DVec3::new(angle.sin(), 0.0, angle.cos())).map(|(px, _)| px)
        };
        let pinhole = lens(LensKind::Pinhole, Some(120.0), Some([600, 400])).unwrap();
        assert!((at(&pinhole, 60.0).unwrap() - DVec2::new(600.0, 200.0)).length() < 1e-9);
        let fisheye = lens(LensKind::Fisheye, Some(220.0), Some([600, 400])).unwrap();
        assert!((at(&fisheye, 109.9).unwrap().x - 500.0).abs() < 0.5 && at(&fisheye, 110.1).is_none());
        let half = lens(LensKind::Equirectangular, Some(180.0), None).unwrap();
        assert!((at(&half, 89.9).unwrap().x - 1024.0).abs() < 1.0 && half.period_px().is_none());
        let whole = lens(LensKind::Equirectangular, None, None).unwrap();
        assert_eq!((whole.size_px, whole.validate()), ([2048, 1024], Ok(())));
        for camera in [pinhole, fisheye, half] {
            assert_eq!(camera.validate(), Ok(()));
        }
        let message = |result: Result<Camera>| result.unwrap_err().to_string();
        assert!(message(lens(LensKind::Equirectangular, None, Some([64, 64]))).contains("expected 64 x 32"));
        assert!(message(lens(LensKind::Pinhole, Some(180.0), None)).contains("expected 1 to 175"));
        assert!(message(lens(LensKind::Fisheye, Some(f64::NAN), None)).contains("NaN"));
    }

    #[test]
    fn eyes_are_apart_along_the_rows() {
        let camera = luxel_core::synthetic::room_camera([64, 48]);
        let [left, right] = stereo_pair(&camera, 0.06);
        let across = right.eye() - left.eye();
        assert!((across - 0.06 * camera.camera_from_world.matrix3.row(0)).length() < 1e-12);
        assert!(((left.eye() + right.eye()) * 0.5 - camera.eye()).length() < 1e-12);
    }

    #[test]
    fn a_camera_at_a_point_looks_as_a_probe_does() {
        let pose = pose_at([1.0, 2.0, 3.0], Up::Axis(DVec3::Y), None).unwrap();
        let camera = Lens { kind: LensKind::Equirectangular, field_deg: None, size_px: None }.camera(pose).unwrap();
        assert!((camera.eye() - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-12);
        // +z in the middle, +x to the left, up above.
        assert_eq!(camera.forward(), DVec3::Z);
        assert!(camera.project(camera.eye() + DVec3::X).unwrap().0.x < 1024.0);
        assert!(camera.project(camera.eye() + DVec3::Y).unwrap().0.y < 512.0);
    }
}
