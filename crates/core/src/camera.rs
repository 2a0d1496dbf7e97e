//! Cameras: pose, projection, intrinsics and lens distortion.
//!
//! Axes are OpenCV's: x right, y down, z forward. Pixel centres are at +0.5.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::{DAffine3, DMat3, DVec2, DVec3};
use serde::{Deserialize, Serialize};

use crate::projection::{CameraProjection, MAX_FISHEYE_ANGLE_RAD, Placed};

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
    /// Focal lengths, pixels; of a panorama, pixels per radian.
    pub focal_px: DVec2,
    /// Principal point, pixels from the image's top left corner.
    pub center_px: DVec2,
    /// Width and height, pixels.
    pub size_px: [u32; 2],
    /// Lens distortion of a pinhole camera; engines take undistorted cameras only.
    pub distortion: Distortion,
    /// Projection of directions to the image.
    #[serde(default, skip_serializing_if = "CameraProjection::is_pinhole")]
    pub projection: CameraProjection,
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
    /// A lens of another projection has coefficients of a pinhole's distortion.
    #[error("a camera with {projection} projection has distortion coefficients of a pinhole (k1 k2 p1 p2), expected none")]
    Distortion {
        /// Name of the projection.
        projection: &'static str,
    },
    /// A fisheye's radius does not grow over all of its field.
    #[error(
        "the fisheye lens sees up to {field:.1} degrees from its axis, expected an angle above 0 and up to {grows_to:.1}, to which its radius grows"
    )]
    Fisheye {
        /// Angle to the axis up to which the lens sees, degrees.
        field: f64,
        /// Angle up to which the radius grows, degrees.
        grows_to: f64,
    },
    /// A panorama is larger than the sphere.
    #[error("the panorama spans {across:.1} x {down:.1} degrees, expected at most 360 x 180 with the horizon between its rows")]
    Panorama {
        /// Horizontal extent, degrees.
        across: f64,
        /// Vertical extent, degrees.
        down: f64,
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

    /// Returns a camera that renders a whole panorama of `width` x `width / 2` pixels; the middle
    /// shows the direction that the pose looks in.
    pub fn panorama(camera_from_world: DAffine3, width: u32) -> Self {
        let size_px = [width, width / 2];
        let size = DVec2::from_array(size_px.map(f64::from));
        Self {
            camera_from_world,
            focal_px: size / DVec2::new(TAU, PI),
            center_px: 0.5 * size,
            size_px,
            distortion: Distortion::default(),
            projection: CameraProjection::Equirectangular,
        }
    }

    /// Returns pixel coordinates and depth of a point in the world; `None` where it is not seen:
    /// behind the camera, or outside of a fisheye's field. Ignores distortion. Depth is along the
    /// axis for a pinhole, and the distance from the camera for other projections.
    pub fn project(&self, point: DVec3) -> Option<(DVec2, f64)> {
        let p = self.camera_from_world.transform_point3(point);
        let Placed { plane, depth } = self.projection.plane_from_point(p)?;
        Some((plane * self.focal_px + self.center_px, depth))
    }

    /// Returns the point in camera space at depth 1 that is seen at a place of the image: the
    /// inverse of [`Self::project`]. `None` where the image shows nothing. Ignores distortion.
    pub fn unproject(&self, at_px: DVec2) -> Option<DVec3> {
        self.projection.point_from_plane((at_px - self.center_px) / self.focal_px)
    }

    /// Returns whether the image shows anything at a place: whether [`Self::unproject`] finds a
    /// point there.
    pub fn shows(&self, at_px: DVec2) -> bool {
        let plane = (at_px - self.center_px) / self.focal_px;
        match self.projection {
            CameraProjection::Pinhole => true,
            CameraProjection::Fisheye(lens) => plane.length() <= lens.radius(lens.max_angle_rad),
            CameraProjection::Equirectangular => plane.y.abs() <= FRAC_PI_2 + 1e-12,
        }
    }

    /// Returns the derivatives of the pixel coordinates x and y by a point in camera space; `None`
    /// where it is not seen.
    pub fn jacobian(&self, point_in_camera: DVec3) -> Option<[DVec3; 2]> {
        let [x, y] = self.projection.jacobian(point_in_camera)?;
        Some([x * self.focal_px.x, y * self.focal_px.y])
    }

    /// Returns the period of the columns in pixels, if the image goes round the whole horizon.
    pub fn period_px(&self) -> Option<f64> {
        let period = TAU * self.focal_px.x;
        let is_round = self.projection == CameraProjection::Equirectangular && f64::from(self.size_px[0]) >= period - 1.0;
        is_round.then_some(period)
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
        self.validate_projection()?;
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

    fn validate_projection(&self) -> Result<(), CameraError> {
        if !self.projection.is_pinhole() && !self.distortion.is_none() {
            return Err(CameraError::Distortion { projection: self.projection.name() });
        }
        match self.projection {
            CameraProjection::Pinhole => Ok(()),
            CameraProjection::Fisheye(lens) => {
                let angle = lens.max_angle_rad;
                if !(angle.is_finite() && lens.coefficients.iter().all(|k| k.is_finite())) {
                    return Err(CameraError::NotFinite("fisheye lens"));
                }
                let grows_to = lens.growing_to(MAX_FISHEYE_ANGLE_RAD);
                // The limit is found in steps, of which one is allowed.
                let is_usable = angle > 0.0 && angle <= grows_to + 1e-3 * MAX_FISHEYE_ANGLE_RAD && angle <= MAX_FISHEYE_ANGLE_RAD;
                if is_usable { Ok(()) } else { Err(CameraError::Fisheye { field: angle.to_degrees(), grows_to: grows_to.to_degrees() }) }
            }
            CameraProjection::Equirectangular => {
                // Within a pixel: sizes and focal lengths are rounded.
                let size = DVec2::from_array(self.size_px.map(f64::from));
                let (low, high) = (-self.center_px.y / self.focal_px.y, (size.y - self.center_px.y) / self.focal_px.y);
                let pixel = 1.0 / self.focal_px;
                let is_on_sphere = size.x * pixel.x <= TAU + pixel.x && low >= -FRAC_PI_2 - pixel.y && high <= FRAC_PI_2 + pixel.y;
                let extent = (size * pixel).map(f64::to_degrees);
                if is_on_sphere { Ok(()) } else { Err(CameraError::Panorama { across: extent.x, down: extent.y }) }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::projection::Fisheye;

    #[test]
    fn opengl_camera_looks_along_minus_z() {
        let camera = Camera {
            camera_from_world: Camera::pose_from_opengl(DMat3::IDENTITY, DVec3::new(1.0, 2.0, 3.0)),
            focal_px: DVec2::splat(100.0),
            center_px: DVec2::new(50.0, 40.0),
            size_px: [100, 80],
            distortion: Distortion::default(),
            projection: CameraProjection::Pinhole,
        };
        assert_eq!(camera.validate(), Ok(()));
        assert!((camera.eye() - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-12);
        assert_eq!(camera.forward(), DVec3::new(0.0, 0.0, -1.0));
        // A point ahead, right and up lands right of and above the centre.
        let (px, depth) = camera.project(DVec3::new(1.5, 2.5, 2.0)).unwrap();
        assert_eq!((px, depth), (DVec2::new(100.0, -10.0), 1.0));
        assert_eq!(camera.project(DVec3::new(1.0, 2.0, 4.0)), None);
    }

    #[test]
    fn a_panorama_shows_every_direction_once() {
        let camera = Camera::panorama(DAffine3::IDENTITY, 64);
        assert_eq!((camera.validate(), camera.size_px, camera.period_px().map(f64::round)), (Ok(()), [64, 32], Some(64.0)));
        let (px, depth) = camera.project(DVec3::new(-2.0, 0.0, 0.0)).unwrap();
        assert!((px - DVec2::new(16.0, 16.0)).length() < 1e-12 && depth == 2.0);
        // What unproject gives at depth 1 lies where it was asked for, at any size.
        for camera in [camera.clone(), camera.downscaled(2), camera.upscaled(3)] {
            assert_eq!(camera.validate(), Ok(()));
            for at in [DVec2::new(0.5, 0.5), DVec2::new(7.25, 15.0), DVec2::from_array(camera.size_px.map(f64::from)) - 0.5] {
                let point = camera.unproject(at).unwrap();
                let (found, depth) = camera.project(point).unwrap();
                assert!((found - at).length() < 1e-9 && (depth - 1.0).abs() < 1e-12, "{at} {found}");
            }
        }
        let too_large = Camera { size_px: [80, 32], ..camera.clone() };
        assert!(too_large.validate().unwrap_err().to_string().contains("spans 450.0 x 180.0 degrees"));
        let distorted = Camera { distortion: Distortion { k1: 0.1, ..Distortion::default() }, ..camera };
        assert!(distorted.validate().unwrap_err().to_string().contains("equirectangular projection has distortion coefficients"));
    }

    #[test]
    fn a_fisheye_that_folds_within_its_field_is_refused() {
        let mut camera = Camera::panorama(DAffine3::IDENTITY, 64);
        let lens = Fisheye::new([-0.2, 0.0, 0.0, 0.0]);
        camera.projection = CameraProjection::Fisheye(lens);
        assert_eq!((camera.validate(), camera.period_px()), (Ok(()), None));
        camera.projection = CameraProjection::Fisheye(Fisheye { max_angle_rad: 1.6, ..lens });
        assert!(camera.validate().unwrap_err().to_string().contains("sees up to 91.7 degrees"));
        camera.projection = CameraProjection::Fisheye(Fisheye { max_angle_rad: f64::NAN, ..lens });
        assert_eq!(camera.validate(), Err(CameraError::NotFinite("fisheye lens")));
    }
}
