//! The mean of directions, in which outliers have little weight.
//!
//! In: unit vectors. Out: their mean, of unit length. Degenerate: directions that cancel have none.

use glam::DVec3;

use super::eigen::median;

/// Rounds of reweighting.
pub(super) const ROUNDS: usize = 20;
/// Least deviation that costs weight, radians: what a hand-held camera rolls.
pub(super) const USUAL_ROLL_RAD: f64 = 0.035;

/// Returns the mean direction, in which outliers have little weight.
pub(super) fn robust_mean(directions: &[DVec3]) -> Option<DVec3> {
    let mut mean = directions.iter().sum::<DVec3>().try_normalize()?;
    for _ in 0..ROUNDS {
        let angle = |d: &DVec3| d.angle_between(mean);
        let usual = median(directions.iter().map(angle)).max(USUAL_ROLL_RAD);
        mean = directions.iter().map(|d| *d / (1.0 + (angle(d) / usual).powi(2))).sum::<DVec3>().try_normalize()?;
    }
    Some(mean)
}
