//! The ground plane of a data set, and where its points are on it.
//!
//! In: cameras and points, in local coordinates. Out: two unit vectors of the world that span the
//! ground, the first along the longer side of the scene; places of points along them. Up is the
//! mean up direction of the cameras. Points far off, such as those of the sky, have no say in where
//! the scene lies. Degenerate: cameras without a common up direction stand on the plane across z.

use glam::{DVec2, DVec3};
use luxel::export::up_of_cameras;
use luxel_core::Dataset;

/// Points further from the middle than so many times the median distance are far off.
const FAR: f64 = 4.0;

/// The ground of a data set.
pub(super) struct Ground {
    /// Unit vectors, world coordinates.
    pub(super) axes: [DVec3; 2],
    /// Places of the points that are not far off, world units along the axes.
    pub(super) places: Vec<DVec2>,
}

impl Ground {
    pub(super) fn new(dataset: &Dataset) -> Self {
        let turn = dataset.world_from_local.rotation();
        let up = up_of_cameras(dataset).map_or(DVec3::Z, |up| (turn * up).normalize());
        let first = up.any_orthonormal_vector();
        let plain = [first, up.cross(first)];
        let world = dataset.points.iter().map(|point| dataset.world_from_local.point(DVec3::from_array(point.position.map(f64::from))));
        let world: Vec<DVec3> = world.collect();
        let near = without_far(world.iter().map(|place| on(plain, *place)).collect());
        let [cos, sin] = long_side(&near).to_array();
        let axes = [plain[0] * cos + plain[1] * sin, plain[1] * cos - plain[0] * sin].map(DVec3::normalize);
        let places = near.iter().map(|place| DVec2::new(place.x * cos + place.y * sin, place.y * cos - place.x * sin)).collect();
        Self { axes, places }
    }
}

impl Ground {
    /// Returns the length of the scene over its width.
    pub(super) fn aspect(&self) -> f64 {
        let spread = |values: Vec<f64>| {
            let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
            values.iter().map(|v| (v - mean).powi(2)).sum::<f64>().sqrt().max(1e-9)
        };
        spread(self.places.iter().map(|place| place.x).collect()) / spread(self.places.iter().map(|place| place.y).collect())
    }
}

/// Returns where a place is along two axes.
pub(super) fn on(axes: [DVec3; 2], place: DVec3) -> DVec2 {
    DVec2::new(axes[0].dot(place), axes[1].dot(place))
}

/// Returns the places that are not far off.
fn without_far(places: Vec<DVec2>) -> Vec<DVec2> {
    let middle = DVec2::new(median(places.iter().map(|place| place.x)), median(places.iter().map(|place| place.y)));
    let limit = FAR * median(places.iter().map(|place| place.distance(middle)));
    places.into_iter().filter(|place| place.distance(middle) <= limit).collect()
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// Returns the direction in which places spread most.
fn long_side(places: &[DVec2]) -> DVec2 {
    let mean = places.iter().sum::<DVec2>() / places.len().max(1) as f64;
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for place in places {
        let d = *place - mean;
        (xx, xy, yy) = (xx + d.x * d.x, xy + d.x * d.y, yy + d.y * d.y);
    }
    DVec2::from_angle(0.5 * (2.0 * xy).atan2(xx - yy))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_long_side_is_found_and_the_sky_is_left_out() {
        let along = DVec2::from_angle(0.4);
        let street: Vec<DVec2> = (0..100).map(|i| along * f64::from(i) + along.perp() * f64::from(i % 7)).collect();
        let found = long_side(&street);
        assert!(found.dot(along).abs() > 0.999, "{found}");
        let with_sky: Vec<DVec2> = street.iter().copied().chain([DVec2::new(1e5, 0.0), DVec2::new(0.0, -1e5)]).collect();
        assert_eq!(without_far(with_sky), street);
    }
}
