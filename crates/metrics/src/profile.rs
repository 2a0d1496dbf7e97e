//! The luminance-error profile: the error as a function of the ground truth's luminance, as in
//! LCD-GS.
//!
//! Pixels are converted to linear Rec.709 and binned by the ground truth's relative luminance
//! (normalised units) in quarter decades from 1e-4 to 1e4, with one bin for everything below and
//! one for everything above. Bins hold sums and counts, so that profiles of several views add up.

use serde::{Deserialize, Serialize};

use super::{LOG_FLOOR, MetricsError, Pair};
use luxel_core::tone::rec709_of;
use luxel_core::{ColorSpace, Image, Mask, luminance_rec709};

/// Bins per factor of ten.
pub const PROFILE_BINS_PER_DECADE: usize = 4;
/// log10 of the lowest bin edge.
const LOW_DECADE: f64 = -4.0;
/// log10 of the highest bin edge.
const HIGH_DECADE: f64 = 4.0;
/// The number of bins: quarter decades, and an open bin at either end.
const BINS: usize = (HIGH_DECADE - LOW_DECADE) as usize * PROFILE_BINS_PER_DECADE + 2;

/// Sums over the pixels of one bin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ProfileBin {
    /// Number of pixels.
    pub count: u64,
    /// Sum over pixels of the absolute error (mean of the three channels), normalised units, not
    /// clipped.
    pub absolute_error: f64,
    /// Sum over pixels of the squared error of the luminance in stops (log2 of the ratio, with
    /// luminances raised to at least [`LOG_FLOOR`]).
    pub squared_stops: f64,
    /// Sum over pixels of the ground truth's luminance.
    pub luminance: f64,
}

impl ProfileBin {
    /// Returns the mean absolute error in normalised units; `None` for an empty bin.
    pub fn mean_absolute_error(&self) -> Option<f64> {
        (self.count > 0).then(|| self.absolute_error / self.count as f64)
    }

    /// Returns the root mean squared error of the luminance in stops; `None` for an empty bin.
    pub fn rms_stops(&self) -> Option<f64> {
        (self.count > 0).then(|| (self.squared_stops / self.count as f64).sqrt())
    }

    /// Returns the mean luminance of the ground truth; `None` for an empty bin.
    pub fn mean_luminance(&self) -> Option<f64> {
        (self.count > 0).then(|| self.luminance / self.count as f64)
    }

    fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.absolute_error += other.absolute_error;
        self.squared_stops += other.squared_stops;
        self.luminance += other.luminance;
    }
}

/// Error by luminance of one or several views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LuminanceProfile {
    /// Bins from the darkest: below 1e-4, quarter decades, 1e4 and above.
    pub bins: Vec<ProfileBin>,
}

impl Default for LuminanceProfile {
    fn default() -> Self {
        Self { bins: vec![ProfileBin::default(); BINS] }
    }
}

impl LuminanceProfile {
    /// Returns the luminances `[lower, upper)` of bin `i`. The first bin begins at 0, and the last
    /// ends at infinity.
    pub fn edges(i: usize) -> (f64, f64) {
        let edge = |i: usize| match i {
            0 => 0.0,
            i if i < BINS => 10f64.powf(LOW_DECADE + (i - 1) as f64 / PROFILE_BINS_PER_DECADE as f64),
            _ => f64::INFINITY,
        };
        (edge(i), edge(i + 1))
    }

    /// Computes the profile of `prediction` against `target`, radiance with the primaries of
    /// `color_space`, both in normalised units.
    ///
    /// # Errors
    /// [`MetricsError`]: sizes differ, no pixel is valid, or a valid pixel is NaN or infinite.
    pub fn measure(prediction: &Image, target: &Image, mask: Option<&Mask>, color_space: ColorSpace) -> Result<Self, MetricsError> {
        let mut profile = Self::default();
        for (prediction, target) in Pair::new(prediction, target, mask)?.valid() {
            profile.add(rec709_of(color_space, prediction), rec709_of(color_space, target));
        }
        Ok(profile)
    }

    /// Adds a pixel in linear Rec.709.
    pub fn add(&mut self, prediction: [f32; 3], target: [f32; 3]) {
        let (found, expected) = (luminance_rec709(prediction), luminance_rec709(target));
        let error: f64 = (0..3).map(|c| (f64::from(prediction[c]) - f64::from(target[c])).abs()).sum();
        let stops = f64::from(found.max(LOG_FLOOR)).log2() - f64::from(expected.max(LOG_FLOOR)).log2();
        let pixel = ProfileBin { count: 1, absolute_error: error / 3.0, squared_stops: stops * stops, luminance: f64::from(expected) };
        if let Some(bin) = self.bins.get_mut(Self::bin_of(expected)) {
            bin.merge(&pixel);
        }
    }

    /// Adds the pixels of another profile.
    pub fn merge(&mut self, other: &Self) {
        for (bin, other) in self.bins.iter_mut().zip(&other.bins) {
            bin.merge(other);
        }
    }

    /// Returns the number of pixels in all bins.
    pub fn count(&self) -> u64 {
        self.bins.iter().map(|bin| bin.count).sum()
    }

    fn bin_of(luminance: f32) -> usize {
        let place = (f64::from(luminance).log10() - LOW_DECADE) * PROFILE_BINS_PER_DECADE as f64;
        // Luminance 0 gives minus infinity and a negative one NaN: both belong to the first bin.
        if place >= 0.0 { (place as usize).min(BINS - 2) + 1 } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_core::Conversion;

    #[test]
    fn every_luminance_falls_between_the_edges_of_its_bin() {
        for step in -120..=120 {
            // Edges themselves are avoided: rounding decides which side they fall on.
            let luminance = 10f64.powf(f64::from(step) * 0.05 + 0.011) as f32;
            let (lower, upper) = LuminanceProfile::edges(LuminanceProfile::bin_of(luminance));
            assert!(lower <= luminance.into() && f64::from(luminance) < upper, "{luminance}: {lower} to {upper}");
        }
        for dark in [0.0, -1.0, f32::NAN] {
            assert_eq!(LuminanceProfile::bin_of(dark), 0);
        }
        assert_eq!(LuminanceProfile::bin_of(f32::INFINITY), BINS - 1);
    }

    #[test]
    fn errors_are_means_over_the_pixels_of_a_bin() {
        let mut profile = LuminanceProfile::default();
        profile.add([2.2; 3], [2.0; 3]);
        profile.add([1.8; 3], [2.0; 3]);
        profile.add([0.0; 3], [0.02; 3]);
        let bin = profile.bins[LuminanceProfile::bin_of(2.0)];
        assert_eq!(bin.count, 2);
        assert!((bin.mean_absolute_error().unwrap() - 0.2).abs() < 1e-6);
        let expected = ((1.1f64.log2().powi(2) + 0.9f64.log2().powi(2)) / 2.0).sqrt();
        assert!((bin.rms_stops().unwrap() - expected).abs() < 1e-6);
        assert!((bin.mean_luminance().unwrap() - 2.0).abs() < 1e-6);
        assert_eq!(profile.count(), 3);
        assert_eq!(profile.bins[0].mean_absolute_error(), None);
    }

    #[test]
    fn the_same_light_has_one_profile_in_any_space() {
        let pixels = |scale: f32| (0..40).map(move |i| [0.9f32, 0.2, 0.05 * (i % 5) as f32].map(|v| v * scale * 1.3f32.powi(i)));
        let [target, prediction] = [1.0, 1.2].map(|scale| Image::from_pixels(8, 5, pixels(scale).collect()).unwrap());
        let expected = LuminanceProfile::measure(&prediction, &target, None, ColorSpace::LinearRec709).unwrap();
        let conversion = Conversion::between(ColorSpace::LinearRec709, ColorSpace::Aces2065);
        let in_aces = |image: &Image| Image { pixels: image.pixels.iter().map(|rgb| conversion.apply(*rgb)).collect(), ..*image };
        let found = LuminanceProfile::measure(&in_aces(&prediction), &in_aces(&target), None, ColorSpace::Aces2065).unwrap();
        for (found, expected) in found.bins.iter().zip(&expected.bins) {
            assert_eq!(found.count, expected.count);
            assert!((found.absolute_error - expected.absolute_error).abs() <= 1e-4 * expected.absolute_error, "{found:?} {expected:?}");
        }
    }

    #[test]
    fn merged_profiles_equal_the_profile_of_all_pixels() {
        let pixels = [[0.001f32, 0.01, 0.1], [5.0, 2.0, 1.0], [300.0, 200.0, 90.0], [0.0, 0.0, 0.0]];
        let (mut all, mut first, mut second) = (LuminanceProfile::default(), LuminanceProfile::default(), LuminanceProfile::default());
        for (i, pixel) in pixels.iter().enumerate() {
            let prediction = pixel.map(|v| v * 1.5);
            all.add(prediction, *pixel);
            if i % 2 == 0 { &mut first } else { &mut second }.add(prediction, *pixel);
        }
        first.merge(&second);
        assert_eq!(first, all);
    }
}
