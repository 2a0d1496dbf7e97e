//! Points for a data set without any: random places in the space that at least two cameras see.
//!
//! In: training cameras. Out: up to `count` positions, world units. Depths lie between 0.3 and 3
//! times the distance of the point that is closest to all optical axes, so that the space before
//! and behind it is covered too. There is no such point if the axes are parallel or meet behind the
//! cameras (a panorama from within). Then depths lie between 1 and 20 times the spread of the
//! cameras. For a single camera, or cameras in one place (see [`LEAST_DISTANCE`]), depths lie
//! between 1 and 10, because nothing determines the unit. Positions are uniform over pixels and
//! depth, so their density follows the resolution at which the cameras see a place.

use glam::{DMat3, DVec2, DVec3};
use luxel_core::{Camera, CameraProjection, Point, View};
use rand::Rng;

/// Number of tries per point before one camera suffices and, after that, before fewer points
/// suffice.
const TRIES_PER_POINT: usize = 40;

/// Largest distance of two positions that count as one, relative to the largest coordinate of the
/// cameras. Programs that write six digits round poses by as much, and at smaller distances `f32`
/// positions of splats have too few digits.
const LEAST_DISTANCE: f64 = 1e-6;

/// Returns up to `count` points in the volume that two cameras see, filled up with points that one
/// camera sees.
pub(super) fn random_points(train: &[View], count: usize, rng: &mut impl Rng) -> Vec<Point> {
    let cameras: Vec<&Camera> = train.iter().map(|view| &view.camera).collect();
    let Some(depths) = DepthRange::new(&cameras) else { return Vec::new() };
    let mut points = Vec::new();
    for needed in [2.min(cameras.len()), 1] {
        let mut tries = count.saturating_mul(TRIES_PER_POINT);
        while points.len() < count && tries > 0 {
            tries -= 1;
            let (camera, range) = depths.draw(&cameras, rng);
            let position = unproject(camera, rng.random_range(range[0]..=range[1]), rng);
            let seen = cameras.iter().zip(&depths.ranges).filter(|(camera, range)| sees(camera, **range, position)).take(needed).count();
            if seen >= needed {
                points.push(Point { position: position.as_vec3().to_array(), rgb8: None, observations: Vec::new() });
            }
        }
    }
    points
}

/// Returns the nearest and the farthest depth of each view between which points are drawn, world
/// units; `None` if the cameras do not tell.
pub(super) fn depth_ranges(train: &[View]) -> Option<Vec<[f64; 2]>> {
    let cameras: Vec<&Camera> = train.iter().map(|view| &view.camera).collect();
    DepthRange::new(&cameras).map(|depths| depths.ranges)
}

/// The range of depths of each camera.
struct DepthRange {
    ranges: Vec<[f64; 2]>,
}

impl DepthRange {
    fn new(cameras: &[&Camera]) -> Option<Self> {
        let reach = cameras.iter().map(|camera| camera.eye().abs().max_element()).fold(0.0, f64::max);
        let is_apart = |distance: f64| distance > LEAST_DISTANCE * reach;
        let focus = focus(cameras).filter(|focus| cameras.iter().all(|camera| is_apart((*focus - camera.eye()).length())));
        let centroid = cameras.iter().map(|camera| camera.eye()).sum::<DVec3>() / cameras.len().max(1) as f64;
        let spread = cameras.iter().map(|camera| (camera.eye() - centroid).length()).fold(0.0, f64::max);
        let range = |camera: &&Camera| match focus {
            Some(focus) => {
                let distance = (focus - camera.eye()).length();
                [0.3 * distance, 3.0 * distance]
            }
            None if is_apart(spread) => [spread, 20.0 * spread],
            None => [1.0, 10.0],
        };
        let ranges: Vec<[f64; 2]> = cameras.iter().map(range).collect();
        ranges.iter().flatten().all(|depth| depth.is_finite() && *depth > 0.0).then_some(Self { ranges })
    }

    fn draw<'a>(&self, cameras: &[&'a Camera], rng: &mut impl Rng) -> (&'a Camera, [f64; 2]) {
        let i = rng.random_range(0..cameras.len());
        (cameras[i], self.ranges[i])
    }
}

/// Returns the point closest to all optical axes in the least-squares sense, or `None` if the axes
/// are almost parallel or the point does not lie before most cameras.
fn focus(cameras: &[&Camera]) -> Option<DVec3> {
    // The axis of a panorama is no direction that somebody looked in.
    if cameras.iter().any(|camera| camera.projection == CameraProjection::Equirectangular) {
        return None;
    }
    let (mut across, mut sum) = (DMat3::ZERO, DVec3::ZERO);
    for camera in cameras {
        let axis = camera.forward();
        let projector = DMat3::IDENTITY - DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        across += projector;
        sum += projector * camera.eye();
    }
    // For axes one degree apart, the mean projector has the eigenvalues 1, 1 and sin^2(0.5 degrees)
    // = 8e-5.
    let count = cameras.len() as f64;
    if across.determinant() < 8e-5 * count.powi(3) {
        return None;
    }
    let focus = across.inverse() * sum;
    let before = cameras.iter().filter(|camera| camera.project(focus).is_some()).count();
    (focus.is_finite() && 4 * before >= 3 * cameras.len()).then_some(focus)
}

/// Returns a random position in `camera`'s view at `depth`; on its axis where the image shows
/// nothing.
fn unproject(camera: &Camera, depth: f64, rng: &mut impl Rng) -> DVec3 {
    let [width, height] = camera.size_px.map(f64::from);
    let at_px = DVec2::new(rng.random::<f64>() * width, rng.random::<f64>() * height);
    let direction = camera.unproject(at_px).unwrap_or(DVec3::Z);
    camera.camera_from_world.matrix3.transpose() * (direction * depth) + camera.eye()
}

fn sees(camera: &Camera, range: [f64; 2], position: DVec3) -> bool {
    let [width, height] = camera.size_px.map(f64::from);
    // Depth is drawn within the range, so rounding must not exclude the bounds.
    let slack = 1e-9 * range[1];
    camera.project(position).is_some_and(|(at_px, depth)| {
        (0.0..=width).contains(&at_px.x) && (0.0..=height).contains(&at_px.y) && depth >= range[0] - slack && depth <= range[1] + slack
    })
}

#[cfg(test)]
mod tests {
    use luxel_core::Image;
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::testing::{camera_at, camera_looking_at, view_of};

    fn views(cameras: Vec<Camera>) -> Vec<View> {
        let image = |camera: &Camera| Image::filled(camera.size_px[0] as usize, camera.size_px[1] as usize, [1.0; 3]);
        cameras.into_iter().enumerate().map(|(i, camera)| view_of(&format!("{i}"), camera.clone(), image(&camera))).collect()
    }

    fn ring(count: usize, is_outward: bool) -> Vec<View> {
        let eye = |i: usize| {
            let angle = i as f64 / count as f64 * std::f64::consts::TAU;
            DVec3::new(angle.cos(), 0.1, angle.sin()) * 5.0
        };
        let target = |i: usize| if is_outward { eye(i) * 2.0 } else { DVec3::new(0.5, 0.0, 0.0) };
        views((0..count).map(|i| camera_looking_at(eye(i), target(i), [40, 30])).collect())
    }

    #[test]
    fn axes_of_a_ring_meet_at_its_target() {
        let views = ring(12, false);
        let cameras: Vec<&Camera> = views.iter().map(|view| &view.camera).collect();
        let focus = focus(&cameras).unwrap();
        assert!((focus - DVec3::new(0.5, 0.0, 0.0)).length() < 1e-9, "{focus}");
    }

    /// A panorama from one place: rounding leaves small distances between its cameras, which must
    /// not count.
    #[test]
    fn cameras_in_one_place_see_from_one_to_ten_wherever_it_is() {
        for eye in [DVec3::ZERO, DVec3::new(1.3, 2.1, 0.7), DVec3::new(-3e4, 0.1, 7.7e5)] {
            for count in [1, 2, 6, 7] {
                let around = |i: usize| {
                    let angle = i as f64 / count as f64 * std::f64::consts::TAU;
                    DVec3::new(angle.cos(), 0.3 * (3.0 * angle).sin(), angle.sin())
                };
                let views = views((0..count).map(|i| camera_looking_at(eye, eye + around(i), [40, 30])).collect());
                let cameras: Vec<&Camera> = views.iter().map(|view| &view.camera).collect();
                let ranges = DepthRange::new(&cameras).unwrap().ranges;
                assert!(ranges.iter().all(|range| *range == [1.0, 10.0]), "{count} at {eye}: {ranges:?}");
            }
        }
    }

    #[test]
    fn every_arrangement_of_cameras_gives_points_that_are_seen() {
        let parallel = views((0..3).map(|i| camera_at([i as f64, 0.0, 0.0], [40, 30])).collect());
        let single = views(vec![camera_at([0.0; 3], [40, 30])]);
        let coincident = views(vec![camera_at([1.0; 3], [40, 30]); 3]);
        for (name, views) in [
            ("ring", ring(12, false)),
            ("panorama", ring(12, true)),
            ("parallel", parallel),
            ("single", single),
            ("coincident", coincident),
        ] {
            let points = random_points(&views, 200, &mut Pcg64Mcg::seed_from_u64(5));
            assert_eq!(points.len(), 200, "{name}");
            for point in &points {
                let [x, y, z] = point.position.map(f64::from);
                let seen = views.iter().any(|view| {
                    view.camera
                        .project(DVec3::new(x, y, z))
                        .is_some_and(|(at, _)| at.cmpge(DVec2::splat(-0.1)).all() && at.x < 40.1 && at.y < 30.1)
                });
                assert!(seen, "{name}: {point:?}");
            }
        }
    }
}
