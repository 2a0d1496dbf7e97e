//! The 3D smoothing filter of Mip-splatting (Yu et al. 2024, eq. 7).
//!
//! In: positions [N,3] (world units), training cameras. Out: standard deviation of the filter [N]
//! (world units). It is sqrt(0.2) times the smallest size of a pixel at the splat's depth (depth
//! over focal length), over all cameras that see the splat. A splat that no camera sees takes the
//! largest filter of the others, as in the authors' code. If no splat is seen at all, the filter is
//! 0.

use glam::DVec3;
use luxel_core::Camera;
use rayon::prelude::*;

/// Variance of the filter in squared sampling intervals, as chosen by the authors.
const VARIANCE: f32 = 0.2;
/// Margin around the image, as a fraction of its size, in which a splat still counts as seen,
/// because its footprint may reach into the image.
const MARGIN: f64 = 0.15;
/// Sampling interval of a splat that no camera sees.
const NEVER: f32 = f32::INFINITY;

/// Computes the filter of each splat. `near` is the depth below which nothing is drawn, world
/// units.
pub fn smoothing(positions: &[[f32; 3]], cameras: &[&Camera], near: f32) -> Vec<f32> {
    let nearest = |position: &[f32; 3]| {
        let at = DVec3::new(position[0].into(), position[1].into(), position[2].into());
        cameras.iter().filter_map(|camera| sampling_interval(camera, at, near.into())).fold(NEVER, f32::min)
    };
    let mut filter: Vec<f32> = positions.par_iter().map(|position| nearest(position) * VARIANCE.sqrt()).collect();
    let largest = filter.iter().copied().filter(|f| f.is_finite()).fold(0.0, f32::max);
    for value in filter.iter_mut().filter(|f| !f.is_finite()) {
        *value = largest;
    }
    filter
}

/// Returns the size of a pixel at `position`, world units, or `None` if the camera does not see it.
fn sampling_interval(camera: &Camera, position: DVec3, near: f64) -> Option<f32> {
    let (at_px, depth) = camera.project(position)?;
    let [width, height] = camera.size_px.map(f64::from);
    let is_inside = |at: f64, side: f64| at >= -MARGIN * side && at <= (1.0 + MARGIN) * side;
    let is_seen = depth >= near && is_inside(at_px.x, width) && is_inside(at_px.y, height);
    is_seen.then(|| (depth / camera.focal_px.max_element()) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::camera_at;

    #[test]
    fn filter_is_a_pixel_of_the_nearest_camera_that_sees_the_splat() {
        let (far, near) = (camera_at([0.0; 3], [100, 100]), camera_at([0.0, 0.0, 5.0], [100, 100]));
        let filter = smoothing(&[[0.0, 0.0, 10.0], [0.0, 0.0, 4.0], [0.0, 0.0, -4.0]], &[&far, &near], 0.01);
        let pixel = 0.2f32.sqrt() / 100.0;
        // The first is 5 before the nearer camera; the second is behind it; the third behind both.
        for (found, expected) in filter.iter().zip([5.0 * pixel, 4.0 * pixel, 5.0 * pixel]) {
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        }
    }

    #[test]
    fn margin_reaches_fifteen_percent_outside() {
        let camera = camera_at([0.0; 3], [100, 100]);
        // At depth 1 the image spans -0.5..0.5, with its margin -0.65..0.65.
        assert!(sampling_interval(&camera, DVec3::new(0.64, 0.0, 1.0), 0.01).is_some());
        assert!(sampling_interval(&camera, DVec3::new(0.66, 0.0, 1.0), 0.01).is_none());
        assert!(sampling_interval(&camera, DVec3::new(0.0, 0.0, 0.005), 0.01).is_none());
        assert_eq!(smoothing(&[[0.0, 0.0, -1.0]], &[&camera], 0.01), [0.0]);
    }
}
