//! The gradient of a step's loss by the camera: its pose and its focal lengths.
//!
//! In: sums over splats of what both engines compute for each splat. Out: [`CameraGradient`].
//!
//! Moving the camera is moving all splats the other way. With e the camera's centre, p a splat's
//! position, g its gradient through the projection alone, c its gradient through the direction that
//! colours depend on, and t the gradient by a rotation of the splat's own axes: a translation of
//! the camera has the gradient -sum (g + c), and a rotation about its centre
//! -sum ((p - e) x g + t), because it leaves directions from the centre as they are. That holds for
//! any projection. Degenerate: only a pinhole has a gradient by its focal lengths; for other
//! projections it is zero.

use glam::DVec3;

use crate::Camera;

/// Whether a step computes the gradient by its camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CameraGradientChoice {
    /// It does not.
    #[default]
    Skip,
    /// [`super::StepReport::camera`] has it. An engine that works ahead then waits for the step.
    Compute,
}

/// The gradient of a loss by a camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CameraGradient {
    /// By a rotation about the camera's centre: a rotation vector along the camera's axes, per
    /// radian.
    pub rotation: DVec3,
    /// By a translation of the centre along the camera's axes, per world unit.
    pub translation: DVec3,
    /// By the focal lengths of a pinhole, per pixel of the camera as it was given; else zero.
    pub focal_px: [f64; 2],
}

/// Numbers of a [`CameraSums`] in a row.
pub const CAMERA_SUMS: usize = 8;

/// Sums over splats from which the gradient by the camera follows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CameraSums {
    /// sum ((p - e) x g + t), world axes.
    pub turn: DVec3,
    /// sum (g + c), world axes.
    pub shift: DVec3,
    /// Gradient by the focal lengths of the samples' camera, if it is a pinhole; else zero.
    pub focal_px: [f64; 2],
}

impl CameraSums {
    /// Adds up rows of numbers in the order of the fields, from the first row to the last.
    pub fn of_rows(rows: impl IntoIterator<Item = [f64; CAMERA_SUMS]>) -> Self {
        let mut sums = [0.0; CAMERA_SUMS];
        for row in rows {
            sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
        }
        let [tx, ty, tz, sx, sy, sz, fx, fy] = sums;
        Self { turn: DVec3::new(tx, ty, tz), shift: DVec3::new(sx, sy, sz), focal_px: [fx, fy] }
    }

    /// Returns the gradient by `camera`, whose pixels have `samples` samples a side.
    pub fn gradient(&self, camera: &Camera, samples: u8) -> CameraGradient {
        let camera_axes = |world: DVec3| -(camera.camera_from_world.matrix3 * world);
        let samples = f64::from(samples.max(1));
        CameraGradient {
            rotation: camera_axes(self.turn),
            translation: camera_axes(self.shift),
            focal_px: self.focal_px.map(|d| d * samples),
        }
    }
}

impl CameraGradient {
    /// Returns whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        self.rotation.is_finite() && self.translation.is_finite() && self.focal_px.iter().all(|d| d.is_finite())
    }
}
