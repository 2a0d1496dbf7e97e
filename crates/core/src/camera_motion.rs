//! Small motions of a camera, for corrections of its pose.
//!
//! In: a camera, a rotation about its centre and a translation of the centre, both along the
//! camera's axes. Out: the moved camera. A point p in camera coordinates becomes q^-1 (p - v).

use glam::{DAffine3, DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::Camera;

/// The motion of a camera about its centre and along its axes.
///
/// ```
/// use glam::DVec3;
/// use luxel_core::{CameraMotion, synthetic::room_camera};
///
/// let camera = room_camera([64, 48]);
/// let forward = CameraMotion::IDENTITY.then(DVec3::ZERO, DVec3::new(0.0, 0.0, 0.5));
/// let moved = forward.apply(&camera);
/// assert!((moved.eye() - camera.eye() - 0.5 * camera.forward()).length() < 1e-12);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraMotion {
    /// Rotation of the camera's axes.
    pub rotation: DQuat,
    /// Displacement of the centre along the unmoved camera's axes, world units.
    pub translation: DVec3,
}

impl Default for CameraMotion {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl CameraMotion {
    /// The motion that moves nothing.
    pub const IDENTITY: Self = Self { rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// Returns the motion that takes the pose `from` to the pose `to` (camera_from_world).
    pub fn between(from: &DAffine3, to: &DAffine3) -> Self {
        let rotation = from.matrix3 * to.matrix3.transpose();
        Self { rotation: DQuat::from_mat3(&rotation).normalize(), translation: from.translation - rotation * to.translation }
    }

    /// Returns this motion followed by another along the axes of the moved camera: a rotation
    /// vector in radians and a translation in world units.
    #[must_use]
    pub fn then(&self, rotation_rad: DVec3, translation: DVec3) -> Self {
        Self {
            rotation: (self.rotation * DQuat::from_scaled_axis(rotation_rad)).normalize(),
            translation: self.translation + self.rotation * translation,
        }
    }

    /// Returns the moved camera; the identity changes no bit of it.
    pub fn apply(&self, camera: &Camera) -> Camera {
        if *self == Self::IDENTITY {
            return camera.clone();
        }
        let unturn = DMat3::from_quat(self.rotation).transpose();
        let pose = camera.camera_from_world;
        let camera_from_world = DAffine3 { matrix3: unturn * pose.matrix3, translation: unturn * (pose.translation - self.translation) };
        Camera { camera_from_world, ..camera.clone() }
    }

    /// Returns whether all numbers are finite and the rotation is one.
    pub fn is_valid(&self) -> bool {
        self.rotation.is_finite() && (self.rotation.length() - 1.0).abs() < 1e-6 && self.translation.is_finite()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::room_camera;

    #[test]
    fn motions_add_up_along_the_moved_axes_and_are_found_again() {
        let camera = room_camera([64, 48]);
        let steps = [(DVec3::new(0.02, -0.3, 0.1), DVec3::new(0.4, 0.1, -0.2)), (DVec3::new(-0.1, 0.2, 0.5), DVec3::new(1.0, -2.0, 0.3))];
        let mut motion = CameraMotion::IDENTITY;
        let mut moved = camera.clone();
        for (rotation, translation) in steps {
            motion = motion.then(rotation, translation);
            moved = CameraMotion::IDENTITY.then(rotation, translation).apply(&moved);
        }
        assert!(motion.is_valid());
        assert!(motion.apply(&camera).camera_from_world.abs_diff_eq(moved.camera_from_world, 1e-12));
        let found = CameraMotion::between(&camera.camera_from_world, &moved.camera_from_world);
        assert!(found.rotation.abs_diff_eq(motion.rotation, 1e-12) && found.translation.abs_diff_eq(motion.translation, 1e-12));
        // A rotation leaves the centre where it is.
        let turned = CameraMotion::IDENTITY.then(steps[0].0, DVec3::ZERO).apply(&camera);
        assert!((turned.eye() - camera.eye()).length() < 1e-12);
        assert_eq!(CameraMotion::IDENTITY.apply(&camera), camera);
    }
}
