//! Free space in front of the cameras, in which no splat may be.
//!
//! In: cameras, the positions that training starts from. Out: the radius within which what each
//! camera sees is free, and which splats are there. Nothing but empty space is directly in front of
//! a camera. A splat there covers many pixels of one view and few of any other, so it explains what
//! this view has for itself, such as its exposure or its saturated sky, and is fog from elsewhere.
//! Philip and Deschaintre (2023) reduce the gradients of such splats instead, but Adam's steps do
//! not depend on the size of gradients. Degenerate: a camera that sees no initial position has a
//! radius of 0, and nothing is too near.

use glam::DVec3;
use luxel_core::{Camera, View};
use rayon::prelude::*;

/// Fraction of the initial positions that may be nearer than what counts as the nearest surface:
/// failures of structure from motion.
const OUTLIERS: f64 = 0.02;

/// Returns the radius of free space of each view's camera, world units, for initial `positions`:
/// the fraction `part` of the distance of the nearest surface that it sees.
pub(crate) fn radii(train: &[View], positions: &[[f32; 3]], part: f64) -> Vec<f32> {
    train.par_iter().map(|view| (part * nearest(&view.camera, positions)) as f32).collect()
}

/// Returns the distance of the nearest surface that `camera` sees; 0 if it sees nothing.
fn nearest(camera: &Camera, positions: &[[f32; 3]]) -> f64 {
    let eye = camera.eye();
    let seen = positions.iter().map(world).filter(|at| sees(camera, *at));
    let mut distances: Vec<f64> = seen.map(|at| (at - eye).length()).collect();
    if distances.is_empty() {
        return 0.0;
    }
    let at = (OUTLIERS * distances.len() as f64) as usize;
    *distances.select_nth_unstable_by(at, f64::total_cmp).1
}

/// Returns whether each of `positions` is within the radius of a camera that sees it. What is
/// beside and behind a camera may be as near as it likes.
pub(crate) fn contains(cameras: &[&Camera], radii: &[f32], positions: &[[f32; 3]]) -> Vec<bool> {
    let spheres: Vec<(&Camera, DVec3, f64)> =
        cameras.iter().zip(radii).map(|(camera, radius)| (*camera, camera.eye(), f64::from(*radius).powi(2))).collect();
    let is_in_front = |position: &[f32; 3]| {
        let at = world(position);
        spheres.iter().any(|(camera, eye, square)| at.distance_squared(*eye) < *square && sees(camera, at))
    };
    positions.par_iter().map(is_in_front).collect()
}

fn sees(camera: &Camera, at: DVec3) -> bool {
    let [width, height] = camera.size_px.map(f64::from);
    camera.project(at).is_some_and(|(px, _)| (0.0..=width).contains(&px.x) && (0.0..=height).contains(&px.y))
}

fn world(position: &[f32; 3]) -> DVec3 {
    DVec3::from_array(position.map(f64::from))
}

#[cfg(test)]
mod tests {
    use luxel_core::Image;

    use super::*;
    use crate::testing::{camera_at, view_of};

    #[test]
    fn free_space_reaches_a_part_of_the_way_to_the_nearest_surface() {
        let view = |z: f64| view_of("view", camera_at([0.0, 0.0, z], [40, 30]), Image::filled(40, 30, [0.2; 3]));
        let train = [view(0.0), view(20.0)];
        // One of a hundred points is an outlier directly in front of the first camera.
        let mut positions: Vec<[f32; 3]> = (0..99).map(|i| [0.0, 0.0, 5.0 + 0.01 * i as f32]).collect();
        positions.push([0.0, 0.0, 0.1]);
        let found = radii(&train, &positions, 0.5);
        assert!((found[0] - 2.5).abs() < 0.02, "{found:?}");
        assert_eq!(found[1], 0.0, "it sees nothing");
        // In front of the first camera; behind and beside it; beyond the radius.
        let places = [[0.0, 0.0, 0.1], [0.0, 0.0, -1.0], [1.0, 0.0, 0.1], [0.0, 0.0, 2.6]];
        let cameras = [&train[0].camera, &train[1].camera];
        assert_eq!(contains(&cameras, &found, &places), [true, false, false, false]);
    }
}
