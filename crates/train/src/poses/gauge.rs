//! The gauge of corrections: what they have in common is removed.
//!
//! In: motions of cameras from their given poses. Out: the same without the similarity (rotation,
//! scale, translation) that fits all of them best. It minimises, over the cameras, the squared
//! distance between where a camera was moved to and where the similarity would have moved it, plus
//! the squared difference of their rotations times the scene's extent. Motions are small: the
//! similarity is p + a + r x (p - c) + s (p - c), with c the centroid of the given cameras.
//! Degenerate: cameras that share one place have no scale.

use glam::{DMat3, DQuat, DVec3};
use luxel_core::{Camera, CameraMotion};

/// The data of the given cameras that the fit needs.
pub(super) struct Gauge {
    /// Places of the cameras relative to their centroid.
    arms: Vec<DVec3>,
    /// Sum of the squared lengths of the arms.
    spread: f64,
    /// Weight of a squared rotation: the squared extent.
    weight: f64,
    /// Inverse of the rotation's normal equations.
    inverse: DMat3,
}

impl Gauge {
    pub(super) fn new(given: &[Camera], extent: f64) -> Self {
        let count = given.len().max(1) as f64;
        let centroid = given.iter().map(Camera::eye).sum::<DVec3>() / count;
        let arms: Vec<DVec3> = given.iter().map(|camera| camera.eye() - centroid).collect();
        let weight = (extent * extent).max(f64::MIN_POSITIVE);
        let outer = |v: DVec3| DMat3::from_cols(v * v.x, v * v.y, v * v.z);
        let spread = arms.iter().map(|arm| arm.length_squared()).sum::<f64>();
        let moments = arms.iter().fold(DMat3::ZERO, |sum, arm| sum + outer(*arm));
        let normal = DMat3::from_diagonal(DVec3::splat(spread + weight * count)) - moments;
        Self { arms, spread, weight, inverse: normal.inverse() }
    }

    /// Removes the common similarity from the motions of the given cameras.
    pub(super) fn remove_common(&self, given: &[Camera], motions: &mut [CameraMotion]) {
        let count = motions.len().max(1) as f64;
        let world = |camera: &Camera, v: DVec3| camera.camera_from_world.matrix3.transpose() * v;
        let moved: Vec<(DVec3, DVec3)> = given
            .iter()
            .zip(motions.iter())
            .map(|(camera, motion)| (world(camera, motion.translation), world(camera, motion.rotation.to_scaled_axis())))
            .collect();
        let shift = moved.iter().map(|(d, _)| *d).sum::<DVec3>() / count;
        let along = self.arms.iter().zip(&moved).map(|(arm, (d, _))| arm.dot(*d)).sum::<f64>();
        let scale = if self.spread > 0.0 { along / self.spread } else { 0.0 };
        let turns = self.arms.iter().zip(&moved).map(|(arm, (d, r))| arm.cross(*d) + *r * self.weight).sum::<DVec3>();
        let turn = self.inverse * turns;
        if !(shift.is_finite() && scale.is_finite() && turn.is_finite()) {
            return;
        }
        for ((camera, motion), (arm, (d, _))) in given.iter().zip(motions).zip(self.arms.iter().zip(&moved)) {
            let pose = camera.camera_from_world.matrix3;
            motion.translation = pose * (*d - shift - turn.cross(*arm) - *arm * scale);
            motion.rotation = (DQuat::from_scaled_axis(-(pose * turn)) * motion.rotation).normalize();
        }
    }
}
