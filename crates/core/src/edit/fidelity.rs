//! How near a render of an edited scene comes to the ideally edited render of the scene as it was.
//!
//! Ideal: the maps on each pixel's luminance (R + G + B), its chromaticity kept. Splats are edited before they are blended, so that even a
//! perfect edit of splats is not this edit of pixels where bright and dark splats share a pixel: the error of luminance tells how
//! much. Chromaticity error of a pixel: the sum of the absolute differences of the channels' shares, 0 to 2; pixels that are black on
//! either side have none.

use super::MapChain;
use crate::{Image, luminance_sum};

/// `image`, in the units of the data set, with the maps applied to each pixel's luminance.
pub fn ideally_edited(image: &Image, chain: &MapChain<'_>) -> Image {
    let mut edited = image.clone();
    for pixel in &mut edited.pixels {
        let factor = chain.factor(luminance_sum(*pixel), 1.0).unwrap_or(1.0);
        *pixel = pixel.map(|c| c * factor);
    }
    edited
}

/// Sum of the absolute differences of two colours' chromaticities, channels below 0 counting as 0; `None` if one of them is black.
pub fn chromaticity_distance(a: [f32; 3], b: [f32; 3]) -> Option<f64> {
    let chromaticity = |rgb: [f32; 3]| {
        let rgb = rgb.map(|c| f64::from(c.max(0.0)));
        let sum: f64 = rgb.iter().sum();
        (sum > 0.0).then(|| rgb.map(|c| c / sum))
    };
    let (a, b) = (chromaticity(a)?, chromaticity(b)?);
    Some(a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum())
}

/// Differences of edited and ideally edited pixels.
#[derive(Clone, Debug, Default)]
pub struct FidelityMeter {
    chromaticity: Vec<f32>,
    light: Vec<f32>,
    stops: Vec<f32>,
}

/// Figures of a [`FidelityMeter`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fidelity {
    /// Chromaticity error, mean over pixels.
    pub chromaticity: f64,
    /// Chromaticity error that 95 % of the pixels do not exceed.
    pub chromaticity_p95: f64,
    /// Chromaticity error, mean over light: pixels by their ideal luminance.
    pub chromaticity_by_light: f64,
    /// Mean absolute error of luminance, stops.
    pub luminance_stops: f64,
    /// Pixels that are not black.
    pub pixels: usize,
}

impl FidelityMeter {
    /// Adds the pixels of an image; both of one size and unit.
    pub fn add(&mut self, edited: &Image, ideal: &Image) {
        for (edited, ideal) in edited.pixels.iter().zip(&ideal.pixels) {
            if let Some(distance) = chromaticity_distance(*edited, *ideal) {
                self.chromaticity.push(distance as f32);
                self.light.push(luminance_sum(*ideal));
                self.stops.push((luminance_sum(*edited) / luminance_sum(*ideal)).log2().abs());
            }
        }
    }

    /// `None` of no pixels.
    pub fn figures(&self) -> Option<Fidelity> {
        let pixels = self.chromaticity.len();
        let mean = |values: &[f32]| values.iter().map(|v| f64::from(*v)).sum::<f64>() / pixels as f64;
        let light: f64 = self.light.iter().map(|l| f64::from(*l)).sum();
        let by_light: f64 = self.chromaticity.iter().zip(&self.light).map(|(d, l)| f64::from(*d) * f64::from(*l)).sum();
        Some(Fidelity {
            chromaticity_p95: super::select::percentile(self.chromaticity.clone(), 95.0)?.into(),
            chromaticity: mean(&self.chromaticity),
            chromaticity_by_light: by_light / light,
            luminance_stops: mean(&self.stops),
            pixels,
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
        let figures = meter.figures().unwrap();
        assert_eq!((figures.chromaticity, figures.luminance_stops, figures.pixels), (0.0, 0.0, 3));

        let mut channels = image.clone();
        channels.pixels.as_flattened_mut().iter_mut().for_each(|c| *c = c.powf(1.2));
        let mut meter = FidelityMeter::default();
        meter.add(&channels, &ideal);
        let figures = meter.figures().unwrap();
        assert!(figures.chromaticity > 0.02 && figures.chromaticity_p95 >= figures.chromaticity, "{figures:?}");
        assert_eq!(FidelityMeter::default().figures(), None);
    }

    #[test]
    fn chromaticity_distance_is_of_shares() {
        assert_eq!(chromaticity_distance([1.0, 0.0, 0.0], [0.0, 5.0, 0.0]), Some(2.0));
        assert_eq!(chromaticity_distance([1.0, 2.0, 1.0], [2.0, 4.0, 2.0]), Some(0.0));
        assert_eq!(chromaticity_distance([0.0; 3], [2.0, 4.0, 2.0]), None);
    }
}
