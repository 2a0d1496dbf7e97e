//! How an image was captured: the meaning of its pixel values, and their noise.

use serde::{Deserialize, Serialize};

use crate::Image;
use crate::response::{BLACK, SATURATED};

/// Full-well capacity of a typical sensor of a system camera at ISO 100, electrons.
const FULL_WELL: f64 = 40_000.0;
/// Read noise of such a sensor, electrons.
const READ_NOISE: f64 = 3.0;

/// The meaning of the pixel values of a view's image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum PixelValues {
    /// Linear radiance.
    #[default]
    Radiance,
    /// Captured LDR values, 0 to 1, of an exposure of this length: radiance times time through an
    /// unknown camera response.
    Recorded {
        /// Exposure time, seconds; above 0.
        exposure_s: f32,
    },
}

/// Exponent of a typical camera response, close enough for averaging neighbouring pixels.
const RECORDING_GAMMA: f32 = 2.2;

impl PixelValues {
    /// Makes values proportional to light, so that they can be averaged or interpolated.
    ///
    /// For captured LDR values the result is as accurate as a power law.
    pub fn to_light(self, image: &mut Image) {
        if let Self::Recorded { .. } = self {
            image.pixels.as_flattened_mut().iter_mut().for_each(|v| *v = v.max(0.0).powf(RECORDING_GAMMA));
        }
    }

    /// Undoes [`Self::to_light`].
    pub fn from_light(self, image: &mut Image) {
        if let Self::Recorded { .. } = self {
            image.pixels.as_flattened_mut().iter_mut().for_each(|v| *v = v.max(0.0).powf(RECORDING_GAMMA.recip()));
        }
    }
}

/// Levels of [`PixelValues::bounds`], chosen so that no mean of different levels equals a level.
const BLACK_LEVEL: f32 = std::f32::consts::FRAC_1_PI;
const SATURATED_LEVEL: f32 = 1.0;
/// Largest error of a level after resampling.
const LEVEL_TOLERANCE: f32 = 1e-4;

impl PixelValues {
    /// Returns an image of the pixels that are mere bounds: black and saturated channels have a
    /// level each, all others 0. `None` for radiance.
    pub fn bounds(self, image: &Image) -> Option<Image> {
        let Self::Recorded { .. } = self else { return None };
        let level = |v: f32| match v {
            v if v >= SATURATED => SATURATED_LEVEL,
            v if v <= BLACK => BLACK_LEVEL,
            _ => 0.0,
        };
        let pixels = image.pixels.iter().map(|pixel| pixel.map(level)).collect();
        Some(Image { width: image.width, height: image.height, pixels })
    }

    /// Returns whether a pixel of resampled [`Self::bounds`] mixes values and bounds.
    ///
    /// Such a pixel is neither: the mean of saturated and other pixels is less than the light that
    /// fell on them.
    pub fn is_mixture(levels: [f32; 3]) -> bool {
        let is_one = |level: f32| [0.0, BLACK_LEVEL, SATURATED_LEVEL].iter().any(|known| (level - known).abs() <= LEVEL_TOLERANCE);
        levels.into_iter().any(|level| !is_one(level))
    }
}

/// Noise of a pixel: the variance of radiance p is read^2 + shot p, in the data set's units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NoiseModel {
    /// Standard deviation without light.
    pub read: f32,
    /// Variance per unit of radiance.
    pub shot: f32,
}

impl NoiseModel {
    /// Returns the noise of a typical sensor at `iso`, where `white` is the radiance that saturates
    /// a pixel.
    ///
    /// The higher the ISO speed, the fewer electrons saturate a pixel. Prefer measured noise of the
    /// camera where it is known.
    pub fn from_iso(iso: f64, white: f64) -> Self {
        let white_electrons = FULL_WELL * 100.0 / iso;
        Self { read: (white * READ_NOISE / white_electrons) as f32, shot: (white / white_electrons) as f32 }
    }

    /// Returns the noise of the mean of `pixels` pixels.
    #[must_use]
    pub fn averaged(self, pixels: usize) -> Self {
        let pixels = pixels.max(1) as f32;
        Self { read: self.read / pixels.sqrt(), shot: self.shot / pixels }
    }

    /// Returns the variance of radiance `p`.
    #[inline]
    pub fn variance(self, p: f32) -> f32 {
        self.read.mul_add(self.read, self.shot * p.max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_grows_with_sensitivity() {
        let (low, high) = (NoiseModel::from_iso(100.0, 1.0), NoiseModel::from_iso(1600.0, 1.0));
        // The square root of 40,000 electrons at white, of 2,500 sixteen times as sensitive.
        assert!((low.variance(1.0).sqrt() - 1.0 / 200.0).abs() < 1e-4);
        assert!((high.variance(1.0).sqrt() - 1.0 / 50.0).abs() < 1e-3);
        assert!((NoiseModel::from_iso(100.0, 8.0).variance(8.0) / 64.0 - low.variance(1.0)).abs() < 1e-7);
    }

    #[test]
    fn recorded_values_are_averaged_as_light() {
        let recorded = PixelValues::Recorded { exposure_s: 1.0 };
        let mut image = Image::from_pixels(2, 1, vec![[0.0, 0.25, 1.0], [0.5, 0.75, 1.0]]).unwrap();
        let before = image.clone();
        PixelValues::Radiance.to_light(&mut image);
        assert_eq!(image, before);
        recorded.to_light(&mut image);
        assert!((image.pixels[1][0] - 0.5f32.powf(2.2)).abs() < 1e-6);
        recorded.from_light(&mut image);
        let pairs = image.pixels.as_flattened().iter().zip(before.pixels.as_flattened());
        assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() < 1e-6));
    }

    #[test]
    fn means_of_values_and_bounds_are_neither() {
        let recorded = PixelValues::Recorded { exposure_s: 1.0 };
        let image = Image::from_pixels(2, 2, vec![[1.0, 0.0, 1.0], [1.0, 0.0, 0.5], [1.0, 0.0, 1.0], [1.0, 0.0, 1.0]]).unwrap();
        assert_eq!(PixelValues::Radiance.bounds(&image), None);
        let bounds = recorded.bounds(&image).unwrap();
        assert!(bounds.pixels.iter().all(|levels| !PixelValues::is_mixture(*levels)));
        let [red, green, blue] = bounds.block_mean([0, 0], 2, |_| true).0;
        assert!(!PixelValues::is_mixture([red, green, 0.0]) && PixelValues::is_mixture([red, green, blue]));
    }

    #[test]
    fn a_mean_of_pixels_has_their_variance_over_their_number() {
        let model = NoiseModel { read: 0.1, shot: 0.3 };
        assert!((model.averaged(4).variance(2.0) - model.variance(2.0) / 4.0).abs() < 1e-6);
    }
}
