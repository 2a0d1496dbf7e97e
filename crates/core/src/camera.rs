//! Cameras: pose, intrinsics and lens distortion.
//!
//! Axes are OpenCV's: x right, y down, z forward. Pixel centres are at +0.5.

use glam::{DAffine3, DMat3, DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// Lens distortion of OpenCV's model: radial k1, k2 and tangential p1, p2, on normalised image
/// coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Distortion {
    /// Radial coefficient of r^2.
    pub k1: f64,
    /// Radial coefficient of r^4.
    pub k2: f64,
    /// First tangential coefficient.
    pub p1: f64,
    /// Second tangential coefficient.
    pub p2: f64,
}

impl Distortion {
    /// Returns whether all coefficients are zero.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Returns the distorted normalised coordinates of the undistorted point `p`.
    pub fn distort(&self, p: DVec2) -> DVec2 {
        let r2 = p.length_squared();
        let radial = 1.0 + r2 * (self.k1 + r2 * self.k2);
        let xy = p.x * p.y;
        DVec2::new(
            p.x * radial + 2.0 * self.p1 * xy + self.p2 * (r2 + 2.0 * p.x * p.x),
            p.y * radial + self.p1 * (r2 + 2.0 * p.y * p.y) + 2.0 * self.p2 * xy,
        )
    }
}

/// A posed camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Rigid motion from world to camera coordinates.
    pub camera_from_world: DAffine3,
    /// Focal lengths, pixels.
    pub focal_px: DVec2,
    /// Principal point, pixels from the image's top left corner.
    pub center_px: DVec2,
    /// Width and height, pixels.
    pub size_px: [u32; 2],
    /// Lens distortion; engines take undistorted cameras only.
    pub distortion: Distortion,
}

/// Explains why a camera cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// A value is NaN or infinite.
    #[error("{0} is not finite")]
    NotFinite(&'static str),
    /// The pose's matrix is not a rotation.
    #[error("the pose's 3x3 part is not a rotation (determinant {determinant:.4}, expected 1): remove scale, shear and mirroring")]
    NotARotation {
        /// Determinant of the matrix.
        determinant: f64,
    },
    /// A focal length is not positive.
    #[error("focal length {x} x {y} px, expected positive numbers")]
    Focal {
        /// Horizontal focal length, pixels.
        x: f64,
        /// Vertical focal length, pixels.
        y: f64,
    },
    /// The image is empty or implausibly large.
    #[error("image size {width} x {height}, expected 1 to {MAX_SIDE_PX} pixels a side")]
    Size {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
    },
}

/// Largest side of an image that is accepted, pixels; a larger one points to a broken file.
pub const MAX_SIDE_PX: u32 = 1 << 16;

impl Camera {
    /// Returns the camera's position in the world.
    pub fn eye(&self) -> DVec3 {
        let rotation = self.camera_from_world.matrix3;
        -(rotation.transpose() * self.camera_from_world.translation)
    }

    /// Returns the viewing direction in the world, a unit vector.
    pub fn forward(&self) -> DVec3 {
        self.camera_from_world.matrix3.row(2)
    }

    /// Returns the pose given by a camera-to-world matrix in OpenGL axes (x right, y up, z
    /// backwards), as in transforms.json.
    ///
    /// The 3x3 part is not checked here; [`Self::validate`] checks that it is a rotation.
    pub fn pose_from_opengl(world_from_camera_rotation: DMat3, eye: DVec3) -> DAffine3 {
        let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let rotation = (world_from_camera_rotation * flip).transpose();
        DAffine3 { matrix3: rotation, translation: -(rotation * eye) }
    }

    /// Returns pixel coordinates and depth of a point in the world; `None` behind the camera.
    /// Ignores distortion.
    pub fn project(&self, point: DVec3) -> Option<(DVec2, f64)> {
        let p = self.camera_from_world.transform_point3(point);
        (p.z > 0.0).then(|| (DVec2::new(p.x / p.z, p.y / p.z) * self.focal_px + self.center_px, p.z))
    }

    /// Returns the camera of an image reduced `factor` times by area average.
    ///
    /// Sizes are rounded down, because only whole blocks are averaged.
    pub fn downscaled(&self, factor: u32) -> Self {
        let f = f64::from(factor);
        Self {
            focal_px: self.focal_px / f,
            center_px: self.center_px / f,
            size_px: self.size_px.map(|s| (s / factor).max(1)),
            ..self.clone()
        }
    }

    /// Returns the same camera with `factor` times as many pixels a side.
    pub fn upscaled(&self, factor: u32) -> Self {
        let f = f64::from(factor);
        Self {
            focal_px: self.focal_px * f,
            center_px: self.center_px * f,
            size_px: self.size_px.map(|s| s.saturating_mul(factor)),
            ..self.clone()
        }
    }

    /// Checks that the camera can be used.
    ///
    /// # Errors
    /// The first violation found.
    pub fn validate(&self) -> Result<(), CameraError> {
        if !self.camera_from_world.is_finite() {
            return Err(CameraError::NotFinite("pose"));
        }
        if !(self.focal_px.is_finite() && self.center_px.is_finite()) {
            return Err(CameraError::NotFinite("focal length or principal point"));
        }
        let d = self.distortion;
        if ![d.k1, d.k2, d.p1, d.p2].iter().all(|v| v.is_finite()) {
            return Err(CameraError::NotFinite("distortion"));
        }
        if self.focal_px.x <= 0.0 || self.focal_px.y <= 0.0 {
            return Err(CameraError::Focal { x: self.focal_px.x, y: self.focal_px.y });
        }
        let [width, height] = self.size_px;
        if width == 0 || height == 0 || width > MAX_SIDE_PX || height > MAX_SIDE_PX {
            return Err(CameraError::Size { width, height });
        }
        let r = self.camera_from_world.matrix3;
        let gram = r * r.transpose() - DMat3::IDENTITY;
        let determinant = r.determinant();
        if determinant < 0.0 || gram.to_cols_array().iter().any(|v| v.abs() > 1e-3) {
            return Err(CameraError::NotARotation { determinant });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opengl_camera_looks_along_minus_z() {
        let camera = Camera {
            camera_from_world: Camera::pose_from_opengl(DMat3::IDENTITY, DVec3::new(1.0, 2.0, 3.0)),
            focal_px: DVec2::splat(100.0),
            center_px: DVec2::new(50.0, 40.0),
            size_px: [100, 80],
            distortion: Distortion::default(),
        };
        assert_eq!(camera.validate(), Ok(()));
        assert!((camera.eye() - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-12);
        assert_eq!(camera.forward(), DVec3::new(0.0, 0.0, -1.0));
        // A point ahead, right and up lands right of and above the centre.
        let (px, depth) = camera.project(DVec3::new(1.5, 2.5, 2.0)).unwrap();
        assert_eq!((px, depth), (DVec2::new(100.0, -10.0), 1.0));
        assert_eq!(camera.project(DVec3::new(1.0, 2.0, 4.0)), None);
    }
}
