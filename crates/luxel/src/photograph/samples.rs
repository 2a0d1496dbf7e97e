//! The samples of a photograph: places in the aperture and moments of the exposure.

use std::f64::consts::{PI, TAU};
use std::ops::RangeInclusive;

/// Numbers of blades that an aperture may have.
pub const BLADES: RangeInclusive<u8> = 3..=32;

/// Part of a turn from one seed of a sunflower to the next.
pub(crate) const GOLDEN_TURN: f64 = 0.618_033_988_749_894_9;
/// Step of the sequence of moments: the first of the two numbers of Roberts' R2 sequence, which no
/// pattern of the golden turn repeats.
const MOMENT_STEP: f64 = 0.754_877_666_246_692_7;

/// A sample of a photograph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LensSample {
    /// Place in the aperture, along the camera's x and y, in radii: within the unit circle.
    pub place: [f64; 2],
    /// Moment, in lengths of the exposure: -0.5 to 0.5.
    pub moment: f64,
}

/// Returns `count` samples that share the area of the aperture and the time of the exposure evenly.
/// Sets of other indices are turned and begin at another moment.
///
/// ```
/// use luxel::photograph::lens_samples;
///
/// let in_circle = |[x, y]: [f64; 2]| x.hypot(y) < 1.0;
/// assert!(lens_samples(64, Some(5), 0).all(|sample| in_circle(sample.place)));
/// ```
pub fn lens_samples(count: u32, blades: Option<u8>, set: u32) -> impl Iterator<Item = LensSample> {
    let start = (f64::from(set) * GOLDEN_TURN * GOLDEN_TURN).fract();
    (0..count).map(move |i| {
        let radius = ((f64::from(i) + 0.5) / f64::from(count)).sqrt();
        let turn = (start + f64::from(i) * GOLDEN_TURN).fract();
        let (radius, angle) = blades.map_or((radius, TAU * turn), |blades| in_polygon(radius, turn, f64::from(blades)));
        let moment = (0.5 + start + f64::from(i) * MOMENT_STEP).fract() - 0.5;
        LensSample { place: [radius * angle.cos(), radius * angle.sin()], moment }
    })
}

/// Returns radius and angle, radians, in a regular polygon with corners on the unit circle, one of
/// them up, for a point of the disc: equal areas stay equal.
fn in_polygon(radius: f64, turn: f64, blades: f64) -> (f64, f64) {
    let (wedge, within) = ((turn * blades).floor(), (turn * blades).fract());
    let half = PI / blades;
    // A triangle from the middle to a side has equal areas for equal steps along the side.
    let from_middle = ((2.0 * within - 1.0) * half.tan()).atan();
    let angle = TAU * wedge / blades + half + from_middle - 0.5 * PI;
    (radius * half.cos() / from_middle.cos(), angle)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_fill_the_aperture_evenly() {
        let count = 20_000;
        for blades in [None, Some(3), Some(7)] {
            let places: Vec<[f64; 2]> = lens_samples(count, blades, 0).map(|sample| sample.place).collect();
            let mean = |value: &dyn Fn(&[f64; 2]) -> f64| places.iter().map(value).sum::<f64>() / f64::from(count);
            // Second moments of a disc of radius 1 are 1/4; of a regular polygon with corners on it
            // (2 + cos(2 pi / n)) / 12.
            let expected = blades.map_or(0.25, |n| (2.0 + (TAU / f64::from(n)).cos()) / 12.0);
            assert!(mean(&|p| p[0]).abs() < 1e-3 && mean(&|p| p[1]).abs() < 1e-3, "{blades:?}");
            assert!((mean(&|p| p[0] * p[0]) - expected).abs() < 2e-3, "{blades:?}");
            assert!((mean(&|p| p[1] * p[1]) - expected).abs() < 2e-3 && mean(&|p| p[0] * p[1]).abs() < 1e-3, "{blades:?}");
        }
    }

    #[test]
    fn a_corner_of_the_blades_is_up() {
        let highest = lens_samples(5000, Some(5), 0).map(|sample| sample.place).min_by(|a, b| a[1].total_cmp(&b[1])).unwrap();
        assert!(highest[1] < -0.97 && highest[0].abs() < 0.05, "{highest:?}");
    }

    #[test]
    fn moments_do_not_depend_on_places() {
        let samples: Vec<LensSample> = lens_samples(256, None, 3).collect();
        let mean = |value: &dyn Fn(&LensSample) -> f64| samples.iter().map(value).sum::<f64>() / 256.0;
        assert!(mean(&|s| s.moment).abs() < 0.01);
        assert!((mean(&|s| s.moment * s.moment) - 1.0 / 12.0).abs() < 0.002);
        for axis in 0..2 {
            assert!(mean(&|s| s.moment * s.place[axis]).abs() < 0.01);
        }
        assert!(mean(&|s| s.moment * s.place[0].hypot(s.place[1])).abs() < 0.01);
    }

    #[test]
    fn sets_differ() {
        let first = |set| lens_samples(16, None, set).next().unwrap();
        assert_eq!(first(0), first(0));
        assert!(first(0) != first(1) && first(1) != first(2));
    }
}
