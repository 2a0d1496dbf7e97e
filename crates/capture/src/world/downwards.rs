//! Flights whose cameras all look straight down.
//!
//! In: cameras that look one way, with the points they see. Out: the direction that is down. Such
//! cameras have no common up: headings turn, or alternate from line to line of a flight, which
//! nobody does with a camera that looks at a wall. With one heading they are told from those by
//! their places: they are spread in both directions of the image further than what they see is
//! away. Degenerate: cameras that look several ways, and those for which neither holds, have none;
//! a survey of a wall that is as wide and high is taken for one of the ground, unless its files
//! state the pitch.

use glam::DVec3;

use super::directions::robust_mean;
use super::eigen::{median, median_point};
use super::{ImageAxes, WorldView};

/// Least number of cameras: fewer are no flight.
const LEAST_VIEWS: usize = 4;
/// Largest angle between viewing directions that count as one, as a cosine: 12 degrees.
const ONE_WAY: f64 = 0.978;
/// Share of the cameras that look that way.
const MOST: f64 = 0.8;
/// Length of the mean of the images' up directions below which they have none in common. Lines of a
/// flight there and back have 0; a fifth of the cameras the other way up leaves 0.6.
const COMMON_UP: f64 = 0.6;
/// Spread of the cameras in each direction of the image, in distances of what they see.
const LEAST_SPREAD: f64 = 1.0;
/// Parts of the cameras between which the spread is measured.
const QUANTILES: [f64; 2] = [0.05, 0.95];

/// Returns the direction that is down; `None` unless the cameras look straight down.
pub(super) fn down_of_cameras(views: &[WorldView], axes: &[ImageAxes], points: &[DVec3]) -> Option<DVec3> {
    let looking: Vec<DVec3> = views.iter().map(WorldView::forward).collect();
    let down = robust_mean(&looking).filter(|_| views.len() >= LEAST_VIEWS)?;
    let agreeing = looking.iter().filter(|forward| forward.dot(down) > ONE_WAY).count();
    if (agreeing as f64) < MOST * views.len() as f64 {
        return None;
    }
    let mean_up = axes.iter().map(|axes| axes.up).sum::<DVec3>() / views.len() as f64;
    let is_down = mean_up.length() < COMMON_UP || is_flown_over(views, down, mean_up, points);
    is_down.then_some(down)
}

/// Returns whether cameras of one heading are spread as those of a flight.
fn is_flown_over(views: &[WorldView], down: DVec3, mean_up: DVec3, points: &[DVec3]) -> bool {
    let eyes: Vec<DVec3> = views.iter().map(WorldView::eye).collect();
    let middle = median_point(&eyes);
    let distance = median(points.iter().map(|point| (*point - middle).dot(down)).filter(|distance| *distance > 0.0));
    let Some(along) = mean_up.reject_from(down).try_normalize() else { return false };
    let spread = |axis: DVec3| {
        let mut places: Vec<f64> = eyes.iter().map(|eye| (*eye - middle).dot(axis)).collect();
        places.sort_by(f64::total_cmp);
        let [low, high] = QUANTILES.map(|part| places.get((part * places.len() as f64) as usize).copied().unwrap_or_default());
        high - low
    };
    distance > 0.0 && [along, down.cross(along)].into_iter().all(|axis| spread(axis) > LEAST_SPREAD * distance)
}
