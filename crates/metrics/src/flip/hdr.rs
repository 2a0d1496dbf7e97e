//! The exposures of HDR-FLIP and its tone curve.

use super::Pair;
use luxel_core::tone::rec709_of;
use luxel_core::{ColorSpace, luminance_rec709};

/// The floor of the reference's median and maximum luminance: half of all pixels may be black.
pub const MEDIAN_FLOOR: f32 = f32::EPSILON;

/// The display value of the brightest pixel at the first exposure, and of the median at the last.
const BRIGHT: f64 = 0.85;

/// The filmic curve (a x^2 + b x) / (c x^2 + d x + e): K. Narkowicz's fit of ACES with 0.6 of the
/// exposure.
const CURVE: [f64; 5] = [0.6 * 0.6 * 2.51, 0.6 * 0.03, 0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14];

/// Exposures in stops, evenly spaced from `start_ev` to `stop_ev`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlipExposures {
    /// The exposure at which the reference's brightest pixel is just below white.
    pub start_ev: f32,
    /// The exposure at which the reference's median luminance is just below white.
    pub stop_ev: f32,
    /// The number of exposures, at least 2.
    pub count: u32,
}

impl FlipExposures {
    /// Chooses the exposures from the luminance of the reference's valid pixels.
    pub(super) fn from_reference(pair: &Pair, color_space: ColorSpace) -> Self {
        let display = |rgb| rec709_of(color_space, rgb).map(|v: f32| v.max(0.0));
        let mut luminances: Vec<f32> = pair.valid().map(|(_, target)| luminance_rec709(display(target))).collect();
        let middle = luminances.len() / 2;
        let (_, median, above) = luminances.select_nth_unstable_by(middle, f32::total_cmp);
        let median = *median;
        let brightest = above.iter().copied().fold(median, f32::max);
        // A luminance that overflows in the conversion counts as the largest float, which bounds
        // the number of exposures by that of octaves.
        let exposure = |luminance: f32| (bright_input() / f64::from(luminance.clamp(MEDIAN_FLOOR, f32::MAX))).log2() as f32;
        let (start_ev, stop_ev) = (exposure(brightest), exposure(median));
        Self { start_ev, stop_ev, count: ((stop_ev - start_ev).ceil() as u32).max(2) }
    }

    /// Returns the exposures in stops, from the darkest image to the brightest.
    pub fn each(self) -> impl Iterator<Item = f32> {
        let step = (self.stop_ev - self.start_ev) / (self.count.max(2) - 1) as f32;
        // With all pixels equally bright, all exposures are the same.
        let count = if self.stop_ev > self.start_ev { self.count } else { 1 };
        (0..count).map(move |i| self.start_ev + i as f32 * step)
    }
}

/// Converts radiance to linear display light in `[0, 1]`; negative radiance counts as black.
pub(super) fn expose(rgb: [f32; 3], exposure_ev: f32) -> [f32; 3] {
    let gain = exposure_ev.exp2();
    let [a, b, c, d, e] = CURVE.map(|v| v as f32);
    rgb.map(|v| {
        // Above this limit the curve is flat and clipped, and the square would overflow.
        let x = (v.max(0.0) * gain).min(1e9);
        ((x * (a * x + b)) / (x * (c * x + d) + e)).clamp(0.0, 1.0)
    })
}

/// Returns the input that the curve maps to [`BRIGHT`].
fn bright_input() -> f64 {
    let [a, b, c, d, e] = CURVE;
    let (quadratic, linear, constant) = (a - BRIGHT * c, b - BRIGHT * d, -BRIGHT * e);
    let half = -0.5 * linear / quadratic;
    half + (half * half - constant / quadratic).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_brightest_pixel_is_bright_at_the_first_exposure() {
        let shown = expose([bright_input() as f32 / 8.0; 3], 3.0);
        assert!((shown[1] - BRIGHT as f32).abs() < 1e-6, "{shown:?}");
    }

    #[test]
    fn hostile_radiance_is_shown_black_or_white() {
        assert_eq!(expose([f32::MAX, -1.0, 0.0], 100.0), [1.0, 0.0, 0.0]);
    }
}
