//! Whether cameras saw a point: a scene knows only what they looked at.
//!
//! In: a scene, cameras, a point in the scene's coordinates. Out: how many cameras have the point
//! in their image, and how many of them see it, with no surface between. A ray's transmittance is
//! the product over the splats of 1 - alpha at the ray's closest approach, in front of the point.
//! Degenerate: a point at a camera is seen by it.

use glam::{DMat3, DQuat, DVec3};
use luxel_core::{Camera, Scene, sigmoid};
use rayon::prelude::*;

/// Cameras that are looked through; of more, these are spread evenly.
const MOST_CAMERAS: usize = 64;

/// Transmittance from which on a point is seen.
const LEAST_TRANSMITTANCE: f64 = 0.5;

/// Part of the distance to the point within which a surface does not hide it: a point may lie on
/// the surface.
const MARGIN: f64 = 0.02;

/// Distance from a camera, as a share of the cameras' largest distance from their middle, within
/// which a point is at the camera.
const AT_CAMERA: f64 = 0.02;

/// The cameras that see a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Visibility {
    /// Cameras that have the point in their image, of those that were asked.
    pub(crate) in_view: usize,
    /// Those of them that see it.
    pub(crate) seen: usize,
    /// Place of the camera that is nearest to the point.
    pub(crate) nearest_camera: DVec3,
}

/// Returns what cameras see of a point; `None` without cameras.
pub(crate) fn visibility_of(scene: &Scene, cameras: &[&Camera], at: DVec3) -> Option<Visibility> {
    let step = cameras.len().div_ceil(MOST_CAMERAS).max(1);
    let asked: Vec<&Camera> = cameras.iter().copied().step_by(step).collect();
    let nearest = cameras.iter().map(|camera| camera.eye()).min_by(|a, b| a.distance_squared(at).total_cmp(&b.distance_squared(at)))?;
    let middle = cameras.iter().map(|camera| camera.eye()).sum::<DVec3>() / cameras.len() as f64;
    let spread = cameras.iter().map(|camera| camera.eye().distance(middle)).fold(0.0, f64::max);
    let is_viewing = |camera: &&&Camera| camera.eye().distance(at) <= AT_CAMERA * spread || is_in_image(camera, at);
    let viewing: Vec<DVec3> = asked.iter().filter(is_viewing).map(|camera| camera.eye()).collect();
    let seen = viewing.par_iter().filter(|from| transmittance(scene, **from, at) >= LEAST_TRANSMITTANCE).count();
    Some(Visibility { in_view: viewing.len(), seen, nearest_camera: nearest })
}

/// Returns whether a point is in front of a camera and in its image.
fn is_in_image(camera: &Camera, at: DVec3) -> bool {
    let [width, height] = camera.size_px.map(f64::from);
    let is_inside = |pixel: glam::DVec2| (0.0..=width).contains(&pixel.x) && (0.0..=height).contains(&pixel.y);
    camera.project(at).is_some_and(|(pixel, _)| is_inside(pixel))
}

/// Returns the share of light from `at` that reaches `from`.
fn transmittance(scene: &Scene, from: DVec3, at: DVec3) -> f64 {
    let splats = &scene.splats;
    let (direction, length) = ((at - from).normalize_or_zero(), (at - from).length());
    let mut share = 1.0;
    for i in 0..splats.len() {
        let offset = DVec3::from_array(splats.position[i].map(f64::from)) - from;
        let scale = DVec3::from_array(splats.log_scale[i].map(|log| f64::from(log).exp()));
        // Nearer than three standard deviations of the largest axis, or not at all.
        let along = offset.dot(direction);
        let reach = 3.0 * scale.max_element();
        if along < 0.0 || along > length * (1.0 - MARGIN) || (offset - along * direction).length_squared() > reach * reach {
            continue;
        }
        let [w, x, y, z] = splats.rotation[i].map(f64::from);
        let to_axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize()).transpose();
        let (o, d) = (to_axes * offset / scale, to_axes * direction / scale);
        let t = o.dot(d) / d.length_squared();
        if t > 0.0 && t < length * (1.0 - MARGIN) {
            share *= 1.0 - f64::from(sigmoid(splats.opacity_logit[i])) * (-0.5 * (o - t * d).length_squared()).exp();
        }
        if share < 0.01 {
            return share;
        }
    }
    share
}

#[cfg(test)]
mod tests {
    use luxel_core::{Splats, synthetic};

    use super::*;

    #[test]
    fn a_point_behind_a_wall_or_beside_the_image_is_not_seen() {
        let camera = synthetic::room_camera([64, 48]);
        let ahead = |distance: f64| camera.eye() + distance * camera.forward();
        let room = crate::synthetic::room(1, 1).into_core();
        let empty = Scene { splats: Splats::empty(room.splats.color_model), ..room.clone() };
        let of = |scene: &Scene, at: DVec3| {
            let found = visibility_of(scene, &[&camera], at).unwrap();
            [found.in_view, found.seen]
        };
        assert_eq!(of(&empty, ahead(2.0)), [1, 1]);
        assert_eq!(of(&empty, camera.eye()), [1, 1]);
        assert_eq!(of(&empty, ahead(-2.0)), [0, 0]);
        // An opaque splat one unit ahead.
        let mut wall = room.splats.clone();
        wall.position[0] = ahead(1.0).to_array().map(|v| v as f32);
        (wall.log_scale[0], wall.opacity_logit[0]) = ([-1.2; 3], 9.0);
        let walled = Scene { splats: wall, ..room.clone() };
        assert_eq!(of(&walled, ahead(0.2)), [1, 1]);
        assert_eq!(of(&walled, ahead(4.0)), [1, 0]);
        assert_eq!(visibility_of(&empty, &[], ahead(1.0)), None);
    }
}
