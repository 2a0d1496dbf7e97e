//! FLIP: how visible the difference of two images is when one flips between them, for displays and for high dynamic range.
//!
//! In: reference and test, linear Rec.709, with an optional mask. Out: [`FlipMap`], an error in `[0, 1]` per pixel. LDR-FLIP: what the eye can't resolve at
//! [`FLIP_PIXELS_PER_DEGREE`] is filtered away per opponent channel, the rest compared as colours, and the error raised where edges and points differ (Andersson et al.,
//! "FLIP: A Difference Evaluator for Alternating Images", HPG 2020). HDR-FLIP: both images at exposures from where the reference's brightest pixel is
//! just not white to where its median is, a stop apart, under a filmic curve; the greatest LDR-FLIP of all exposures (Andersson et al., "Visualizing
//! Errors in Rendered High Dynamic Range Images", Eurographics 2021). Images are extended by their border pixels.
//!
//! Masked pixels show the reference in both, count for no exposure and for no mean, and are 0 in the map. A black reference is seen at one exposure,
//! under which [`MEDIAN_FLOOR`] would be bright. Single precision, as in the authors' program, which this agrees with to rounding.

mod color;
mod filter;
mod hdr;

use super::{MetricsError, Pair};
use color::{HuntLab, YCxCz, hunt_lab, largest_color_difference, linear_of_ycxcz, ycxcz_of_linear};
use filter::{ContrastSensitivity, FeatureFilters, Plane};
use luxel_core::tone::{rec709_of, srgb_decode};
use luxel_core::{ColorSpace, Image, Mask};

pub use hdr::{FlipExposures, MEDIAN_FLOOR};

/// Viewing condition: 0.7 m from a display 0.7 m and 3840 pixels wide; pixels per degree of visual angle.
pub const FLIP_PIXELS_PER_DEGREE: f32 = 67.020_64;

/// Exponent of colour differences.
const COLOR_EXPONENT: f32 = 0.7;
/// Share of the largest colour difference that maps to [`KNEE_ERROR`]: what is above it is hardly told apart.
const KNEE_SHARE: f32 = 0.4;
/// Error at the knee.
const KNEE_ERROR: f32 = 0.95;
/// Exponent of feature differences.
const FEATURE_EXPONENT: f32 = 0.5;

/// FLIP of every pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct FlipMap {
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// `[H*W]`, 0 to 1; 0 where masked.
    pub error: Vec<f32>,
    /// Mean over the valid pixels.
    pub mean: f64,
    /// Exposures of HDR-FLIP; `None` of LDR-FLIP.
    pub exposures: Option<FlipExposures>,
}

/// HDR-FLIP of `test` against `reference`, radiance with the primaries of `color_space`; only ratios to the reference's brightness matter.
///
/// # Errors
/// [`MetricsError`]: sizes differ, no pixel is valid, or a valid pixel is NaN or infinite.
pub fn hdr_flip(test: &Image, reference: &Image, mask: Option<&Mask>, color_space: ColorSpace) -> Result<FlipMap, MetricsError> {
    let pair = Pair::new(test, reference, mask)?;
    let exposures = FlipExposures::of(&pair, color_space);
    let flip = Flip::new(pair.target.width, pair.target.height);
    let mut error = vec![0f32; reference.pixels.len()];
    for exposure_ev in exposures.each() {
        let (reference, test) = planes(&pair, |rgb| hdr::expose(rec709_of(color_space, rgb), exposure_ev));
        for (largest, found) in error.iter_mut().zip(flip.compare(&reference, &test)) {
            *largest = largest.max(found);
        }
    }
    Ok(map(&pair, error, Some(exposures)))
}

/// LDR-FLIP of two sRGB-encoded images with values in `[0, 1]`, what is outside being clipped.
///
/// # Errors
/// As [`hdr_flip`].
pub fn ldr_flip(test: &Image, reference: &Image, mask: Option<&Mask>) -> Result<FlipMap, MetricsError> {
    let pair = Pair::new(test, reference, mask)?;
    let flip = Flip::new(pair.target.width, pair.target.height);
    let (reference, test) = planes(&pair, |rgb| rgb.map(|v| srgb_decode(v.clamp(0.0, 1.0))));
    let error = flip.compare(&reference, &test);
    Ok(map(&pair, error, None))
}

fn map(pair: &Pair, mut error: Vec<f32>, exposures: Option<FlipExposures>) -> FlipMap {
    let mut sum = 0.0;
    for (i, error) in error.iter_mut().enumerate() {
        // A feature beside the mask can reach into it.
        if pair.is_valid(i) {
            sum += f64::from(*error);
        } else {
            *error = 0.0;
        }
    }
    FlipMap { width: pair.target.width, height: pair.target.height, error, mean: sum / pair.valid_count as f64, exposures }
}

/// Reference and test in YCxCz, of displayed linear light in `[0, 1]`.
fn planes(pair: &Pair, display: impl Fn([f32; 3]) -> [f32; 3]) -> (YCxCz, YCxCz) {
    let finite = |rgb: [f32; 3]| rgb.map(|v| if v.is_finite() { v } else { 0.0 });
    let mut both = [YCxCz::with_capacity(pair.target.pixels.len()), YCxCz::with_capacity(pair.target.pixels.len())];
    for (i, (&p, &t)) in pair.prediction.pixels.iter().zip(&pair.target.pixels).enumerate() {
        let reference = ycxcz_of_linear(display(finite(t)));
        both[0].push(reference);
        both[1].push(if pair.is_valid(i) { ycxcz_of_linear(display(p)) } else { reference });
    }
    let [reference, test] = both;
    (reference, test)
}

/// LDR-FLIP for one image size.
struct Flip {
    plane: Plane,
    sensitivity: ContrastSensitivity,
    features: FeatureFilters,
    largest_difference: f32,
}

impl Flip {
    fn new(width: usize, height: usize) -> Self {
        Self {
            plane: Plane { width, height },
            sensitivity: ContrastSensitivity::new(FLIP_PIXELS_PER_DEGREE),
            features: FeatureFilters::new(FLIP_PIXELS_PER_DEGREE),
            largest_difference: largest_color_difference().powf(COLOR_EXPONENT),
        }
    }

    /// The error of every pixel.
    fn compare(&self, reference: &YCxCz, test: &YCxCz) -> Vec<f32> {
        let (seen_reference, seen_test) = (self.seen(reference), self.seen(test));
        let (reference, test) = (self.features.of(self.plane, &reference.y), self.features.of(self.plane, &test.y));
        let colors = seen_reference.iter().zip(&seen_test).map(|(a, b)| self.color_error(a.difference(*b)));
        let features = reference.iter().zip(&test).map(|(a, b)| feature_error(*a, *b));
        colors.zip(features).map(|(color, feature)| color.powf(1.0 - feature)).collect()
    }

    /// The image as the eye resolves it, as colours.
    fn seen(&self, image: &YCxCz) -> Vec<HuntLab> {
        let filtered = self.sensitivity.filter(self.plane, image);
        let pixels = filtered.y.iter().zip(&filtered.cx).zip(&filtered.cz);
        pixels.map(|((&y, &cx), &cz)| hunt_lab(linear_of_ycxcz([y, cx, cz]).map(|v| v.clamp(0.0, 1.0)))).collect()
    }

    /// A colour difference on a scale from 0 to 1.
    fn color_error(&self, difference: f32) -> f32 {
        let difference = difference.powf(COLOR_EXPONENT);
        let knee = KNEE_SHARE * self.largest_difference;
        if difference < knee {
            KNEE_ERROR / knee * difference
        } else {
            KNEE_ERROR + (difference - knee) / (self.largest_difference - knee) * (1.0 - KNEE_ERROR)
        }
    }
}

/// How differently strong the edges and points of a pixel are, 0 to 1: `[edge, point]` of either image.
fn feature_error(reference: [f32; 2], test: [f32; 2]) -> f32 {
    let largest = (reference[0] - test[0]).abs().max((reference[1] - test[1]).abs());
    (largest * std::f32::consts::FRAC_1_SQRT_2).powf(FEATURE_EXPONENT).min(1.0)
}

#[cfg(test)]
mod tests;
