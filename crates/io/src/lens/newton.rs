//! The place that a map of the image plane takes to a given one, by Newton's method with numerical
//! derivatives.
//!
//! In: the map, the image, a place to begin at. Out: the place, whose image is within a tolerance.
//! Degenerate: `None` where steps do not converge, or leave the finite numbers.

use glam::DVec2;

/// Steps; real lenses need about five.
const MAX_STEPS: usize = 30;
/// Step of numerical derivatives.
const STEP: f64 = 1e-6;

/// Returns the place near `start` that `map` takes to `image`, within `tolerance`.
pub(crate) fn inverse(map: impl Fn(DVec2) -> DVec2, image: DVec2, start: DVec2, tolerance: f64) -> Option<DVec2> {
    let mut p = start;
    for _ in 0..MAX_STEPS {
        let residual = map(p) - image;
        if residual.length() <= tolerance {
            return Some(p);
        }
        let column = |e: DVec2| (map(p + e * STEP) - map(p - e * STEP)) / (2.0 * STEP);
        let (a, b) = (column(DVec2::X), column(DVec2::Y));
        let determinant = a.perp_dot(b);
        p -= DVec2::new(residual.perp_dot(b), a.perp_dot(residual)) / determinant;
        if !p.is_finite() {
            return None;
        }
    }
    None
}
