//! How much of a point cloud the cameras of a data set see, so that a cloud of another world is
//! noticed before anything is trained on it.
//!
//! In: points and views of one data set. Out: [`PointCoverage`]. Clouds of structure from motion
//! are seen as a whole; a scan of a building may reach beyond what the cameras see. Degenerate:
//! without points or views nothing is seen. Of many points, one of
//! each row of neighbours is measured, chosen at random.

use glam::DVec3;

use crate::random::Stream;
use crate::{Point, View};

/// Largest number of points that are measured.
const MOST_POINTS: usize = 20_000;
/// Share of seen points below which a cloud is no start for training: random places in view are
/// better.
const LEAST_SEEN: f64 = 1.0 / 3.0;
/// Share of seen points below which the user hears of it.
const EXPECTED_SEEN: f64 = 0.5;
/// Largest extent of a cloud, relative to its distance from the cameras, that counts as one place.
const ONE_PLACE: f64 = 1e-4;

/// The part of a point cloud that cameras see.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointCoverage {
    /// Number of points.
    pub points: usize,
    /// Share of the points that at least one camera sees, 0 to 1.
    pub seen: f64,
    /// Share of the points that a camera sees on average, 0 to 1.
    pub seen_by_average: f64,
    /// Whether all points are at one place.
    pub is_one_place: bool,
}

impl PointCoverage {
    /// Measures which of `points` are in front of the cameras of `views` and within their images.
    pub fn new(points: &[Point], views: &[View]) -> Self {
        let stride = points.len().div_ceil(MOST_POINTS).max(1);
        let mut random = Stream::new(0);
        let part = points.chunks(stride).map(|points| &points[((1.0 - random.uniform()) * points.len() as f32) as usize]);
        let measured: Vec<DVec3> = part.map(|point| DVec3::from_array(point.position.map(f64::from))).collect();
        let is_seen = |view: &View, point: DVec3| {
            let [width, height] = view.camera.size_px.map(f64::from);
            let inside = |px: glam::DVec2| px.x >= 0.0 && px.y >= 0.0 && px.x < width && px.y < height;
            view.camera.project(point).is_some_and(|(px, depth)| depth > 0.0 && inside(px))
        };
        let sightings: Vec<usize> = measured.iter().map(|point| views.iter().filter(|view| is_seen(view, *point)).count()).collect();
        let share = |count: usize, of: usize| count as f64 / of.max(1) as f64;
        Self {
            points: points.len(),
            seen: share(sightings.iter().filter(|count| **count > 0).count(), measured.len()),
            seen_by_average: share(sightings.iter().sum(), measured.len() * views.len()),
            is_one_place: is_one_place(&measured, views),
        }
    }

    /// Returns whether training can start from the points.
    pub fn is_useful(&self) -> bool {
        self.points > 0 && self.seen >= LEAST_SEEN && !self.is_one_place
    }

    /// Returns a warning about points that came from `source`, or `None` if they are as expected or
    /// absent.
    ///
    /// ```
    /// use luxel_core::PointCoverage;
    ///
    /// let coverage =
    ///     PointCoverage { points: 6000, seen: 0.21, seen_by_average: 0.025, is_one_place: false };
    /// let warning = coverage.warning("\"ply_file_path\" of transforms.json").unwrap();
    /// assert!(warning.starts_with("cameras see 21 % of the 6000 points of \"ply_file_path\""));
    /// ```
    pub fn warning(&self, source: &str) -> Option<String> {
        let Self { points, seen, seen_by_average, .. } = self;
        // Readers have their own words for a single point.
        if *points < 2 || (*seen >= EXPECTED_SEEN && !self.is_one_place) {
            return None;
        }
        let found = if self.is_one_place {
            format!("all {points} points of {source} are at one place")
        } else {
            let [seen, average] = [seen, seen_by_average].map(|share| 100.0 * share);
            format!("cameras see {seen:.0} % of the {points} points of {source}, the average camera {average:.1} %")
        };
        let start = if self.is_useful() { "training starts from them all the same" } else { "training starts from the cameras instead" };
        Some(format!("{found}: are they in the same coordinates as the cameras? {start}"))
    }
}

fn is_one_place(points: &[DVec3], views: &[View]) -> bool {
    // A single point is at one place, too.
    let Some(first) = points.first() else { return false };
    let extent = points.iter().map(|point| point.distance(*first)).fold(0.0, f64::max);
    let distance = views.iter().map(|view| view.camera.eye().distance(*first)).fold(0.0, f64::max);
    extent <= ONE_PLACE * distance
}

#[cfg(test)]
mod tests {

    use glam::{DAffine3, DVec2};

    use super::*;
    use crate::{Camera, CameraProjection, Distortion, Image, PixelValues, Target};

    /// Cameras at `x` that look along +z.
    fn views(x: &[f64]) -> Vec<View> {
        let view = |x: &f64| View {
            name: format!("{x}"),
            camera: Camera {
                camera_from_world: DAffine3::from_translation(DVec3::new(-x, 0.0, 0.0)),
                focal_px: DVec2::splat(10.0),
                center_px: DVec2::splat(5.0),
                size_px: [10, 10],
                distortion: Distortion::default(),
                projection: CameraProjection::Pinhole,
            },
            image: Image::filled(10, 10, [1.0; 3]).into(),
            values: PixelValues::Radiance,
            noise: None,
            mask: None,
            recordings: Vec::new(),
            target: Target::default(),
        };
        x.iter().map(view).collect()
    }

    fn points(positions: &[[f32; 3]]) -> Vec<Point> {
        positions.iter().map(|position| Point { position: *position, rgb8: None, observations: Vec::new() }).collect()
    }

    #[test]
    fn shares_are_of_points_in_front_of_a_camera_and_in_its_image() {
        // Seen by both, by the second alone, behind both, beside both.
        let cloud = points(&[[0.5, 0.0, 4.0], [1.9, 0.0, 2.0], [0.0, 0.0, -4.0], [0.0, 9.0, 4.0]]);
        let coverage = PointCoverage::new(&cloud, &views(&[0.0, 1.0]));
        assert_eq!(coverage, PointCoverage { points: 4, seen: 0.5, seen_by_average: 0.375, is_one_place: false });
        assert!(coverage.is_useful() && coverage.warning("x").is_none());
        let few = PointCoverage::new(&cloud[1..], &views(&[0.0]));
        assert!(!few.is_useful());
        assert_eq!(
            few.warning("points.ply").unwrap(),
            "cameras see 0 % of the 3 points of points.ply, the average camera 0.0 %: are they in the same coordinates as the cameras? \
             training starts from the cameras instead"
        );
    }

    #[test]
    fn points_at_one_place_are_no_start() {
        let heap = points(&[[0.0, 0.0, 4.0], [0.0, 1e-5, 4.0], [1e-5, 0.0, 4.0]]);
        let coverage = PointCoverage::new(&heap, &views(&[0.0, 1.0]));
        assert!(coverage.is_one_place && !coverage.is_useful() && coverage.seen == 1.0);
        assert!(coverage.warning("points.ply").unwrap().starts_with("all 3 points of points.ply are at one place"));
        let none = PointCoverage::new(&[], &views(&[0.0]));
        assert!(!none.is_useful() && none.warning("points.ply").is_none());
    }

    #[test]
    fn a_part_of_many_points_is_measured() {
        let cloud = points(&(0..90_000).map(|i| [0.0, 0.1 * (i % 7) as f32, if i % 10 < 4 { 4.0 } else { -4.0 }]).collect::<Vec<_>>());
        let coverage = PointCoverage::new(&cloud, &views(&[0.0]));
        assert!((coverage.seen - 0.4).abs() < 0.05 && coverage.points == 90_000, "{coverage:?}");
    }
}
