//! Whether cameras can tell where something that shines is.

use glam::DVec3;
use luxel_core::Scene;

use super::emitters::Emitter;

/// Least number of cameras that must see a lamp.
pub(super) const LEAST_CAMERAS: usize = 2;
/// A lamp that all cameras see within this angle is too far to be placed.
pub(super) const LEAST_PARALLAX_DEG: f64 = 2.0;

/// Returns a group's middle in words, world coordinates.
pub(super) fn place(scene: &Scene, emitter: &Emitter) -> String {
    scene.world_from_local.point(emitter.middle).to_array().map(|v| format!("{v:.3}")).join(",")
}

/// Returns the largest angle to the mean of directions, degrees.
pub(super) fn widest_angle_deg(directions: &[DVec3]) -> f64 {
    let mean = directions.iter().sum::<DVec3>().normalize_or_zero();
    directions.iter().map(|direction| direction.dot(mean).clamp(-1.0, 1.0).acos().to_degrees()).fold(0.0, f64::max)
}
