//! The floor that points show.
//!
//! In: points, cameras and an up direction. Out: the floor's normal, if a plane near level has a
//! good share of the points, the cameras above it and next to nothing below it. Planes through
//! three points are tried in a fixed order of pseudo-random choices; the best is fitted to its
//! points. Degenerate: few points, or no such plane.

use glam::{DMat3, DVec3};

use super::choice::Choice;
use super::eigen::{eigen3, median, median_point, outer};

/// Points that are looked at.
const POINTS: usize = 4000;
/// Planes that are tried.
const TRIALS: usize = 600;
/// Least number of points that say anything.
const LEAST_POINTS: usize = 100;
/// Distance to the plane of what belongs to it, over the scene's size.
const THICKNESS: f64 = 0.01;
/// Least share of points on a floor.
const LEAST_ON: f64 = 0.15;
/// Largest share of points below a floor: outliers, and what windows and mirrors show.
const MOST_BELOW: f64 = 0.05;
/// Least share of cameras above it.
const LEAST_ABOVE: f64 = 0.95;

/// A plane.
#[derive(Clone, Copy, Debug)]
struct Plane {
    /// Unit vector, upwards.
    normal: DVec3,
    point: DVec3,
}

impl Plane {
    fn height(&self, p: DVec3) -> f64 {
        self.normal.dot(p - self.point)
    }
}

/// Returns the normal of the floor, at most `max_tilt_rad` from `up`.
pub(super) fn floor_normal(points: &[DVec3], eyes: &[DVec3], up: DVec3, max_tilt_rad: f64) -> Option<DVec3> {
    let points: Vec<DVec3> = points.iter().step_by(points.len().div_ceil(POINTS).max(1)).copied().collect();
    if points.len() < LEAST_POINTS || eyes.is_empty() {
        return None;
    }
    let middle = median_point(&points);
    let thickness = THICKNESS * 2.0 * median(points.iter().map(|p| p.distance(middle)));
    let count = |plane: &Plane| points.iter().filter(|p| plane.height(**p).abs() < thickness).count();
    let mut best: Option<(usize, Plane)> = None;
    let mut choice = Choice(1);
    for _ in 0..TRIALS {
        let [a, b, c] = std::array::from_fn(|_| points[choice.below(points.len())]);
        let Some(normal) = (b - a).cross(c - a).try_normalize() else { continue };
        let plane = Plane { normal: if normal.dot(up) < 0.0 { -normal } else { normal }, point: a };
        if plane.normal.angle_between(up) > max_tilt_rad || !bounds_the_scene(&plane, &points, eyes, thickness) {
            continue;
        }
        let on = count(&plane);
        if best.is_none_or(|(most, _)| on > most) {
            best = Some((on, plane));
        }
    }
    let (on, mut plane) = best?;
    if (on as f64) < LEAST_ON * points.len() as f64 {
        return None;
    }
    for _ in 0..3 {
        plane = fitted(&plane, &points, thickness)?;
    }
    (plane.normal.angle_between(up) <= max_tilt_rad).then_some(plane.normal)
}

/// Returns whether cameras are above a plane, and points too but for a few.
fn bounds_the_scene(plane: &Plane, points: &[DVec3], eyes: &[DVec3], thickness: f64) -> bool {
    let below = points.iter().filter(|p| plane.height(**p) < -3.0 * thickness).count();
    let above = eyes.iter().filter(|eye| plane.height(**eye) > thickness).count();
    below as f64 <= MOST_BELOW * points.len() as f64 && above as f64 >= LEAST_ABOVE * eyes.len() as f64
}

/// Returns the plane that fits the points near a plane best.
fn fitted(plane: &Plane, points: &[DVec3], thickness: f64) -> Option<Plane> {
    let near: Vec<DVec3> = points.iter().filter(|p| plane.height(**p).abs() < 2.0 * thickness).copied().collect();
    let mean = near.iter().sum::<DVec3>() / near.len().max(1) as f64;
    let spread = near.iter().map(|p| outer(*p - mean)).fold(DMat3::ZERO, |a, b| a + b);
    let [_, (second, _), (third, normal)] = eigen3(&spread);
    // Points along a line lie in many planes.
    let is_plane = near.len() >= 3 && second > 10.0 * third;
    is_plane.then_some(Plane { normal: if normal.dot(plane.normal) < 0.0 { -normal } else { normal }, point: mean })
}
