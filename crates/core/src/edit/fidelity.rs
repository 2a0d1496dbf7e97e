//! Fidelity of an edited scene: the difference between its render and the ideally edited render of
//! the original scene.
//!
//! In: pairs of images. Out: errors of chromaticity and luminance.
//!
//! The ideal edit applies the maps to each pixel's luminance (R + G + B) and keeps its
//! chromaticity. Splats are edited before they are blended, so even a perfect edit of splats
//! differs from this edit of pixels where bright and dark splats share a pixel; the luminance error
//! measures by how much. The chromaticity error of a pixel is the sum of the absolute differences
//! of the channels' shares, 0 to 2; pixels that are black in either image have none.

use super::MapChain;
use crate::{Image, luminance_sum};

/// Returns `image`, in the units of the data set, with the maps applied to each pixel's luminance.
pub fn ideally_edited(image: &Image, chain: &MapChain<'_>) -> Image {
    let mut edited = image.clone();
    for pixel in &mut edited.pixels {
        let factor = chain.factor(luminance_sum(*pixel), 1.0).unwrap_or(1.0);
        *pixel = pixel.map(|c| c * factor);
    }
    edited
}

/// Returns the sum of the absolute differences of two colours' chromaticities; `None` if one of
/// them is black.
///
/// Channels below 0 count as 0.
pub fn chromaticity_distance(a: [f32; 3], b: [f32; 3]) -> Option<f64> {
    let chromaticity = |rgb: [f32; 3]| {
        let rgb = rgb.map(|c| f64::from(c.max(0.0)));
        let sum: f64 = rgb.iter().sum();
        (sum > 0.0).then(|| rgb.map(|c| c / sum))
    };
    let (a, b) = (chromaticity(a)?, chromaticity(b)?);
    Some(a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum())
}

/// Number of low bits of an f32 distance that its bin ignores: a bin is 2^-10 of its value wide.
const BIN_SHIFT: u32 = f32::MANTISSA_DIGITS - 1 - 10;
/// Number of bins up to the largest distance, 2.
const BINS: usize = (2f32.to_bits() >> BIN_SHIFT) as usize + 1;

/// A running sum of the differences between edited and ideally edited pixels, of constant size for
/// any number of pixels.
#[derive(Clone, Debug)]
pub struct FidelityMeter {
    /// Number of pixels by chromaticity error.
    histogram: Vec<u64>,
    pixels: u64,
    chromaticity: f64,
    chromaticity_times_light: f64,
    light: f64,
    stops: f64,
}

impl Default for FidelityMeter {
    fn default() -> Self {
        let histogram = vec![0; BINS];
        Self { histogram, pixels: 0, chromaticity: 0.0, chromaticity_times_light: 0.0, light: 0.0, stops: 0.0 }
    }
}

/// The metrics of a [`FidelityMeter`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fidelity {
    /// Chromaticity error, mean over pixels.
    pub chromaticity: f64,
    /// 95th percentile of the pixels' chromaticity errors, to a thousandth of itself.
    pub chromaticity_p95: f64,
    /// Chromaticity error, mean over pixels weighted by their ideal luminance.
    pub chromaticity_by_light: f64,
    /// Mean absolute error of luminance, stops.
    pub luminance_stops: f64,
    /// Number of pixels that are not black.
    pub pixels: u64,
}

impl FidelityMeter {
    /// Adds the pixels of a pair of images of equal size and unit.
    pub fn add(&mut self, edited: &Image, ideal: &Image) {
        for (edited, ideal) in edited.pixels.iter().zip(&ideal.pixels) {
            if let Some(distance) = chromaticity_distance(*edited, *ideal) {
                let [edited, ideal] = [edited, ideal].map(|rgb| rgb.iter().map(|c| f64::from(c.max(0.0))).sum::<f64>());
                let bin = ((distance as f32).to_bits() >> BIN_SHIFT) as usize;
                self.histogram[bin.min(BINS - 1)] += 1;
                self.pixels += 1;
                self.chromaticity += distance;
                self.chromaticity_times_light += distance * ideal;
                self.light += ideal;
                self.stops += (edited / ideal).log2().abs();
            }
        }
    }

    /// Returns the metrics; `None` if no pixel was counted.
    pub fn fidelity(&self) -> Option<Fidelity> {
        let pixels = self.pixels as f64;
        let mut reached = 0;
        let bin = self.histogram.iter().position(|count| {
            reached += count;
            *count > 0 && reached as f64 >= 0.95 * pixels
        })?;
        Some(Fidelity {
            chromaticity: self.chromaticity / pixels,
            chromaticity_p95: f32::from_bits((bin as u32) << BIN_SHIFT).into(),
            chromaticity_by_light: self.chromaticity_times_light / self.light,
            luminance_stops: self.stops / pixels,
            pixels: self.pixels,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Map;

    #[test]
    fn an_ideal_edit_has_no_error_and_a_power_of_channels_has() {
        let image = Image::from_pixels(2, 2, vec![[0.1, 0.2, 0.3], [4.0, 2.0, 0.0], [0.0; 3], [1e-3, 1e-3, 1e-3]]).unwrap();
        let maps = [Map::Power { exponent: 1.2, pivot: Some(0.5) }];
        let ideal = ideally_edited(&image, &MapChain::new(&maps, 1.0));
        let expected = 0.5 * (6f32 / 0.5).powf(1.2);
        assert!((luminance_sum(ideal.pixels[1]) - expected).abs() < 1e-5 * expected);
        let mut meter = FidelityMeter::default();
        meter.add(&ideal, &ideal);
        let found = meter.fidelity().unwrap();
        assert_eq!((found.chromaticity, found.luminance_stops, found.pixels), (0.0, 0.0, 3));
        assert_eq!((found.chromaticity_p95, found.chromaticity_by_light), (0.0, 0.0));

        let mut channels = image.clone();
        channels.pixels.as_flattened_mut().iter_mut().for_each(|c| *c = c.powf(1.2));
        let mut meter = FidelityMeter::default();
        meter.add(&channels, &ideal);
        let found = meter.fidelity().unwrap();
        assert!(found.chromaticity > 0.02 && found.chromaticity_p95 >= found.chromaticity, "{found:?}");
        assert_eq!(FidelityMeter::default().fidelity(), None);
    }

    #[test]
    fn figures_are_those_of_the_distances() {
        // Chromaticities (1 - d, d, 0) and (1, 0, 0) differ by 2 d. Luminance grows with d and is
        // half of what it should be.
        let pixels = |edited: bool| {
            let pixel = |i: u16| {
                let (d, l) = (f32::from(i) / 100.0, 1.0 + f32::from(i));
                if edited { [0.5 * l * (1.0 - d), 0.5 * l * d, 0.0] } else { [l, 0.0, 0.0] }
            };
            Image::from_pixels(100, 1, (0..100).map(pixel).collect()).unwrap()
        };
        let mut meter = FidelityMeter::default();
        meter.add(&pixels(true), &pixels(false));
        let found = meter.fidelity().unwrap();
        let light: f64 = (0..100).map(|i| 1.0 + f64::from(i)).sum();
        let by_light = (0..100).map(|i| 0.02 * f64::from(i) * (1.0 + f64::from(i))).sum::<f64>() / light;
        let pairs = [
            (found.chromaticity, 0.99, 1e-6),
            (found.chromaticity_p95, 0.02 * 94.0, 2e-3),
            (found.chromaticity_by_light, by_light, 1e-6),
            (found.luminance_stops, 1.0, 1e-6),
        ];
        for (found, expected, tolerance) in pairs {
            assert!((found - expected).abs() <= tolerance, "{found} {expected}");
        }
    }

    #[test]
    fn chromaticity_distance_is_of_shares() {
        assert_eq!(chromaticity_distance([1.0, 0.0, 0.0], [0.0, 5.0, 0.0]), Some(2.0));
        assert_eq!(chromaticity_distance([1.0, 2.0, 1.0], [2.0, 4.0, 2.0]), Some(0.0));
        assert_eq!(chromaticity_distance([0.0; 3], [2.0, 4.0, 2.0]), None);
    }
}
