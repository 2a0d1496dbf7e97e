//! The point that cameras look at.
//!
//! In: [`WorldView`]s and points. Out: [`Focus`]. It is the point nearest to all viewing rays, in
//! which rays that pass far from it have little weight. Degenerate: rays that are parallel, one
//! camera, and cameras that look outwards have none; then it is the middle of the points, or of the
//! cameras.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use super::WorldView;
use super::eigen::{eigen3, median, median_point, outer};

/// The origin of the world's coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OriginSource {
    /// The point nearest to the viewing rays.
    ViewingRays,
    /// The middle of the points: rays are nearly parallel.
    Points,
    /// The middle of the cameras: they look outwards, or there are no points.
    Cameras,
}

impl OriginSource {
    /// Returns the source in words for people.
    pub fn words(self) -> &'static str {
        match self {
            Self::ViewingRays => "the point nearest to all viewing rays",
            Self::Points => "the middle of the points, because cameras look one way",
            Self::Cameras => "the middle of the cameras, because they do not look at one place",
        }
    }
}

/// A point with its source.
#[derive(Clone, Copy, Debug)]
pub(super) struct Focus {
    pub(super) point: DVec3,
    pub(super) source: OriginSource,
}

/// Rounds of reweighting.
const ROUNDS: usize = 20;
/// Smallest eigenvalue of the mean of I - d d^T from which rays determine a point: directions
/// within six degrees.
const LEAST_CROSSING: f64 = 0.01;

/// Returns the point that cameras look at.
pub(super) fn focus(views: &[WorldView], points: &[DVec3]) -> Focus {
    let eyes: Vec<DVec3> = views.iter().map(WorldView::eye).collect();
    let cameras = Focus { point: median_point(&eyes), source: OriginSource::Cameras };
    match crossing(views, &eyes) {
        // They look everywhere.
        _ if views.iter().any(|view| view.is_panorama) => cameras,
        Some(point) => {
            let in_front = views.iter().zip(&eyes).filter(|(view, eye)| view.forward().dot(point - **eye) > 0.0).count();
            if 2 * in_front > views.len() { Focus { point, source: OriginSource::ViewingRays } } else { cameras }
        }
        None if !points.is_empty() => Focus { point: median_point(points), source: OriginSource::Points },
        None => cameras,
    }
}

/// Returns the point nearest to the lines through the cameras along their directions.
fn crossing(views: &[WorldView], eyes: &[DVec3]) -> Option<DVec3> {
    let across: Vec<DMat3> = views.iter().map(|view| DMat3::IDENTITY - outer(view.forward())).collect();
    let mut point: Option<DVec3> = None;
    for _ in 0..ROUNDS {
        let distance = |(m, eye): (&DMat3, &DVec3)| point.map_or(0.0, |point| (*m * (point - *eye)).length());
        let usual = median(across.iter().zip(eyes).map(distance));
        let weight = |ray: (&DMat3, &DVec3)| if usual > 0.0 { 1.0 / (1.0 + (distance(ray) / usual).powi(2)) } else { 1.0 };
        let (mut total, mut matrix, mut right) = (0.0, DMat3::ZERO, DVec3::ZERO);
        for (m, eye) in across.iter().zip(eyes) {
            let w = weight((m, eye));
            total += w;
            matrix += *m * w;
            right += *m * *eye * w;
        }
        let parts = eigen3(&matrix);
        // A camera far from the others is not weighed down to where the rest is parallel.
        if parts[2].0 <= LEAST_CROSSING * total || parts[2].0.is_nan() {
            return None;
        }
        point = Some(parts.iter().map(|(value, v)| *v * (v.dot(right) / value)).sum());
    }
    point.filter(|point| point.is_finite())
}
