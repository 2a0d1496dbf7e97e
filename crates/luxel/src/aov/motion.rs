//! Motion vectors: where what a pixel shows is in another frame.
//!
//! The scene stands still, so a pixel's depth and the two cameras tell. Vectors are in pixels, u to
//! the right and v up, as Nuke has them.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};
use luxel_core::{Camera, CameraProjection};
use luxel_io::{ExrPlane, PlaneValues};

/// Direction in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// To the next frame: channels `forward.u` and `forward.v`.
    Forward,
    /// To the frame before: channels `backward.u` and `backward.v`.
    Backward,
}

/// Returns the channels of the motion from a frame to another: place there minus place here.
/// `depth` is `[H*W]` along the viewing axis, in the coordinates of the cameras. Without another
/// frame, and where the other camera does not see the place, the motion is 0.
///
/// ```
/// use luxel::aov::{Motion, motion};
/// use luxel_core::Camera;
/// use luxel_io::PlaneValues;
///
/// # let camera: Camera = luxel::synthetic::room_camera([4, 2]);
/// let still = motion(Motion::Forward, &camera, &[3.0; 8], Some(&camera));
/// assert_eq!(still[0].name, "forward.u");
/// let PlaneValues::Float(u) = &still[0].values else { unreachable!() };
/// assert!(u.iter().all(|u| u.abs() < 1e-3));
/// ```
pub fn motion(direction: Motion, camera: &Camera, depth: &[f32], other: Option<&Camera>) -> [ExrPlane; 2] {
    let layer = match direction {
        Motion::Forward => "forward",
        Motion::Backward => "backward",
    };
    let width = camera.size_px[0].max(1) as usize;
    let vector = |(n, z): (usize, &f32)| {
        let at_px = DVec2::new((n % width) as f64 + 0.5, (n / width) as f64 + 0.5);
        other.and_then(|other| moved(camera, at_px, f64::from(*z), other)).unwrap_or_default()
    };
    let vectors: Vec<DVec2> = depth.iter().enumerate().map(vector).collect();
    let plane = |name: &str, value: &dyn Fn(&DVec2) -> f64| ExrPlane {
        name: format!("{layer}.{name}"),
        values: PlaneValues::Float(vectors.iter().map(|vector| value(vector) as f32).collect()),
    };
    [plane("u", &|vector| vector.x), plane("v", &|vector| -vector.y)]
}

/// Returns how far the place that is seen at a pixel moves, rows downwards; `None` if the other
/// camera does not see it.
fn moved(camera: &Camera, at_px: DVec2, depth: f64, other: &Camera) -> Option<DVec2> {
    let ray = camera.unproject(at_px)?;
    let other_from_camera = other.camera_from_world * camera.camera_from_world.inverse();
    let there: DVec3 =
        if depth.is_finite() { other_from_camera.transform_point3(depth * ray) } else { other_from_camera.transform_vector3(ray) };
    let place = other.projection.plane_from_point(there)?;
    let mut vector = place.plane * other.focal_px + other.center_px - at_px;
    if other.projection == CameraProjection::Equirectangular {
        // The shorter way round.
        let around = TAU * other.focal_px.x;
        vector.x -= around * (vector.x / around).round();
    }
    Some(vector)
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;
    use luxel_core::Distortion;

    use super::*;

    fn camera() -> Camera {
        Camera {
            camera_from_world: DAffine3::IDENTITY,
            focal_px: DVec2::splat(10.0),
            center_px: DVec2::new(2.0, 1.0),
            size_px: [4, 2],
            distortion: Distortion::default(),
            projection: CameraProjection::Pinhole,
        }
    }

    fn values(plane: &ExrPlane) -> &[f32] {
        match &plane.values {
            PlaneValues::Float(values) => values,
            PlaneValues::Whole(_) => &[],
        }
    }

    #[test]
    fn a_camera_that_moves_right_and_down_sends_the_scene_left_and_up_by_its_depth() {
        let mut next = camera();
        next.camera_from_world.translation = DVec3::new(-0.2, -0.1, 0.0);
        let depth = [1.0, 2.0, 4.0, f32::INFINITY, 1.0, 1.0, 1.0, 1.0];
        let [u, v] = motion(Motion::Forward, &camera(), &depth, Some(&next));
        assert_eq!((u.name.as_str(), v.name.as_str()), ("forward.u", "forward.v"));
        for (found, expected) in values(&u).iter().zip([-2.0, -1.0, -0.5, 0.0]) {
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        }
        assert!((values(&v)[0] - 1.0).abs() < 1e-5, "up is positive");
    }

    #[test]
    fn what_the_other_frame_does_not_see_and_no_other_frame_are_no_motion() {
        let mut behind = camera();
        behind.camera_from_world.translation = DVec3::new(0.0, 0.0, -5.0);
        let [u, v] = motion(Motion::Backward, &camera(), &[1.0; 8], Some(&behind));
        assert!(values(&u).iter().chain(values(&v)).all(|v| *v == 0.0));
        assert_eq!(u.name, "backward.u");
        let [u, _] = motion(Motion::Backward, &camera(), &[1.0; 8], None);
        assert_eq!(values(&u), [0.0; 8]);
    }

    #[test]
    fn panoramas_go_the_shorter_way_round() {
        let panorama = Camera { projection: CameraProjection::Equirectangular, focal_px: DVec2::splat(4.0 / TAU), ..camera() };
        let turned = Camera { camera_from_world: DAffine3::from_rotation_y(0.9), ..panorama.clone() };
        let [u, _] = motion(Motion::Forward, &panorama, &[f32::INFINITY; 8], Some(&turned));
        assert!(values(&u).iter().all(|u| (u.abs() - 0.9 * 4.0 / TAU as f32).abs() < 0.1), "{:?}", values(&u));
    }
}
