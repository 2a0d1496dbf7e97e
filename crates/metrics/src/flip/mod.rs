//! FLIP: the visible difference of two images that a viewer flips between.
//!
//! In: reference and test, sRGB-encoded for LDR-FLIP and radiance for HDR-FLIP, and an optional
//! mask. Out: [`FlipMap`], an error in `[0, 1]` per pixel.
//!
//! LDR-FLIP filters out the detail that the eye cannot resolve at [`FLIP_PIXELS_PER_DEGREE`], per
//! opponent channel. It compares the rest as colours, and raises the error where edges and points
//! differ. Source: Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", HPG
//! 2020.
//!
//! HDR-FLIP is the maximum of LDR-FLIP over several exposures under a filmic curve, about a stop
//! apart: from the one at which the reference's brightest pixel is just below white to the one at
//! which its median is. Source: Andersson et al., "Visualizing Errors in Rendered High Dynamic
//! Range Images", Eurographics 2021.
//!
//! Images are extended by their border pixels. Masked pixels have the reference's value in both
//! images, count neither for exposures nor for the mean, and are 0 in the map. A black reference
//! gets one exposure, at which [`MEDIAN_FLOOR`] would be bright. Computed in single precision, like
//! the authors' program, with which it agrees up to rounding.

mod color;
mod filter;
mod hdr;

use super::{MetricsError, Pair};
use color::{HuntLab, YCxCz, hunt_lab, largest_color_difference, linear_of_ycxcz, ycxcz_of_linear};
use filter::{ContrastSensitivity, FeatureFilters, Plane};
use luxel_core::tone::{rec709_of, srgb_decode};
use luxel_core::{ColorSpace, Image, Mask};

pub use hdr::{FlipExposures, MEDIAN_FLOOR};

/// Pixels per degree of visual angle: a display 0.7 m and 3840 pixels wide, seen from 0.7 m.
pub const FLIP_PIXELS_PER_DEGREE: f32 = 67.020_64;

/// Exponent of colour differences.
const COLOR_EXPONENT: f32 = 0.7;
/// The share of the largest colour difference that maps to [`KNEE_ERROR`]: larger differences are
/// hardly distinguishable.
const KNEE_SHARE: f32 = 0.4;
/// Error at the knee.
const KNEE_ERROR: f32 = 0.95;
/// Exponent of feature differences.
const FEATURE_EXPONENT: f32 = 0.5;

/// FLIP error of every pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct FlipMap {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Error `[H*W]`, 0 to 1; 0 where masked.
    pub error: Vec<f32>,
    /// Mean over the valid pixels.
    pub mean: f64,
    /// Exposures of HDR-FLIP; `None` for LDR-FLIP.
    pub exposures: Option<FlipExposures>,
}

/// Computes HDR-FLIP of `test` against `reference`, radiance with the primaries of `color_space`.
/// The unit of radiance does not matter.
///
/// # Errors
/// [`MetricsError`]: sizes differ, no pixel is valid, or a valid pixel is NaN or infinite.
pub fn hdr_flip(test: &Image, reference: &Image, mask: Option<&Mask>, color_space: ColorSpace) -> Result<FlipMap, MetricsError> {
    let pair = Pair::new(test, reference, mask)?;
    let exposures = FlipExposures::from_reference(&pair, color_space);
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

/// Computes LDR-FLIP of two sRGB-encoded images with values in `[0, 1]`; values outside are
/// clipped.
///
/// # Errors
/// The same as of [`hdr_flip`].
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
        // A feature beside the mask can extend into it.
        if pair.is_valid(i) {
            sum += f64::from(*error);
        } else {
            *error = 0.0;
        }
    }
    FlipMap { width: pair.target.width, height: pair.target.height, error, mean: sum / pair.valid_count as f64, exposures }
}

/// Returns reference and test in YCxCz, converted from displayed linear light in `[0, 1]`.
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

    /// Returns the error of every pixel.
    fn compare(&self, reference: &YCxCz, test: &YCxCz) -> Vec<f32> {
        let (reference_colors, test_colors) = (self.perceived(reference), self.perceived(test));
        let (reference, test) = (self.features.strengths(self.plane, &reference.y), self.features.strengths(self.plane, &test.y));
        let colors = reference_colors.iter().zip(&test_colors).map(|(a, b)| self.color_error(a.difference(*b)));
        let features = reference.iter().zip(&test).map(|(a, b)| feature_error(*a, *b));
        colors.zip(features).map(|(color, feature)| color.powf(1.0 - feature)).collect()
    }

    /// Returns the colours of the image as the eye resolves it.
    fn perceived(&self, image: &YCxCz) -> Vec<HuntLab> {
        let filtered = self.sensitivity.filter(self.plane, image);
        let pixels = filtered.y.iter().zip(&filtered.cx).zip(&filtered.cz);
        pixels.map(|((&y, &cx), &cz)| hunt_lab(linear_of_ycxcz([y, cx, cz]).map(|v| v.clamp(0.0, 1.0)))).collect()
    }

    /// Maps a colour difference to an error from 0 to 1.
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

/// Returns the difference in strength of the edges and points of a pixel, 0 to 1. Each argument is
/// `[edge, point]` of one image.
fn feature_error(reference: [f32; 2], test: [f32; 2]) -> f32 {
    let largest = (reference[0] - test[0]).abs().max((reference[1] - test[1]).abs());
    (largest * std::f32::consts::FRAC_1_SQRT_2).powf(FEATURE_EXPONENT).min(1.0)
}

#[cfg(test)]
mod tests;
