//! The anchors that a camera may see.
//!
//! In: anchors, a camera. Out: their indices, ascending: those whose ball of three times the
//! largest unit of offsets reaches the view of a pinhole beyond the near plane. Of other
//! projections, all anchors. Splats whose offsets are longer are decoded with their anchor or not
//! at all, in training and renders alike.

use glam::{DVec3, DVec4};
use luxel_core::Camera;
use rayon::prelude::*;

use super::SCALES;
use super::scene::Anchors;

/// Radius of an anchor, in units of offsets.
const RADIUS: f64 = 3.0;

/// The half spaces that a view is made of: normals that point inwards, and distances.
struct View(Vec<DVec4>);

impl View {
    /// Returns the half spaces of a pinhole's view, world units; none for other projections.
    fn new(camera: &Camera, near: f32) -> Self {
        if !camera.projection.is_pinhole() {
            return Self(Vec::new());
        }
        let [width, height] = camera.size_px.map(f64::from);
        let (f, c) = (camera.focal_px, camera.center_px);
        // A point is right of the left border if fx x + cx z > 0, and so on.
        let normals =
            [DVec3::new(f.x, 0.0, c.x), DVec3::new(-f.x, 0.0, width - c.x), DVec3::new(0.0, f.y, c.y), DVec3::new(0.0, -f.y, height - c.y)];
        let rotation = camera.camera_from_world.matrix3;
        let in_world = |normal: DVec3, distance: f64| {
            let normal = normal.normalize();
            (rotation.transpose() * normal).extend(normal.dot(camera.camera_from_world.translation) + distance)
        };
        let sides = normals.into_iter().map(|normal| in_world(normal, 0.0));
        Self(sides.chain([in_world(DVec3::Z, -f64::from(near))]).collect())
    }

    fn shows(&self, center: DVec3, radius: f64) -> bool {
        self.0.iter().all(|plane| plane.truncate().dot(center) + plane.w > -radius)
    }
}

/// Returns the indices of the anchors that the camera may see; `near` is the distance below which
/// splats are culled.
pub(super) fn visible(anchors: &Anchors, camera: &Camera, near: f32) -> Vec<u32> {
    let view = View::new(camera, near);
    let is_visible = |i: &u32| {
        let scales = &anchors.log_scale[*i as usize * SCALES..][..3];
        let largest = scales.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        view.shows(DVec3::from_array(anchors.position[*i as usize].map(f64::from)), RADIUS * f64::from(largest).exp())
    };
    (0..anchors.len() as u32).into_par_iter().filter(is_visible).collect()
}

#[cfg(test)]
mod tests {
    use super::super::FEATURE;
    use super::*;
    use crate::testing::camera_at;

    #[test]
    fn anchors_beside_and_behind_the_camera_are_left_out() {
        let mut anchors = Anchors::default();
        // The camera looks along z with half a radian to each side.
        for (position, size) in [
            ([0.0, 0.0, 4.0], 0.01),
            ([1.9, 0.0, 4.0], 0.01),
            ([2.2, 0.0, 4.0], 0.01),
            ([2.2, 0.0, 4.0], 0.2),
            ([0.0, -2.2, 4.0], 0.01),
            ([0.0, 0.0, -1.0], 0.01),
            ([0.0, 0.0, 0.1], 0.01),
        ] {
            anchors.push(position, size, [0.0; FEATURE]);
        }
        let camera = camera_at([0.0; 3], [40, 40]);
        assert_eq!(visible(&anchors, &camera, 0.2), [0, 1, 3]);
        let moved = camera_at([0.0, 0.0, -3.0], [40, 40]);
        assert_eq!(visible(&anchors, &moved, 0.2), [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(visible(&Anchors::default(), &camera, 0.2), [0u32; 0]);
    }
}
