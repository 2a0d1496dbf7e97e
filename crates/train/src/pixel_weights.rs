//! Weights of pixels by their noise, for captures with a known noise model.
//!
//! In: views in the data set's units with masks, a [`NoiseModel`] (variance of a pixel's radiance:
//! read^2 + shot * radiance). Out: masks with weights. The loss compares values under the mu-law T,
//! where noise of standard deviation s becomes T'(p) s, which is large in the dark. The weight of a
//! pixel is `1 / sqrt(1 + (T'(p) s / TOLERANCE)^2)`. It is 1 if the noise is smaller than the usual
//! error of a trained scene. For larger noise it approaches 1 / noise, which is the right weight
//! for an absolute difference with that spread.
//!
//! The radiance p is the mean of the pixel's neighbourhood. The pixel's own value would favour
//! pixels that noise made brighter, and would so brighten the dark.

use luxel_core::{Image, Mask, NoiseModel, RadianceScale, View, luminance_sum};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Noise under the mu-law at which the weight of a pixel is 1 / sqrt(2): five 8-bit steps, which is
/// about the error of a well trained scene.
const TOLERANCE: f32 = 0.02;
/// Radius of the neighbourhood whose mean is taken as the signal, pixels.
const RADIUS: usize = 2;

/// The source of the noise model of the training images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub enum NoiseChoice {
    /// The data set, if it states the noise.
    #[default]
    Auto,
    /// None: all pixels have the same weight.
    Off,
    /// The given model, for all images.
    Given(NoiseModel),
}

impl std::str::FromStr for NoiseChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let values: Result<Vec<f32>, _> = text.split(',').map(|part| part.trim().parse::<f32>()).collect();
        match (text, values.as_deref()) {
            ("auto", _) => Ok(Self::Auto),
            ("off", _) => Ok(Self::Off),
            (_, Ok([read, shot])) if [read, shot].iter().all(|v| v.is_finite() && **v >= 0.0) => {
                Ok(Self::Given(NoiseModel { read: *read, shot: *shot }))
            }
            _ => Err(format!("\"{text}\" is not a noise model, expected auto, off, or two numbers of at least 0 such as 0.001,0.0002")),
        }
    }
}

impl std::fmt::Display for NoiseChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Off => f.write_str("off"),
            Self::Given(NoiseModel { read, shot }) => write!(f, "{read},{shot}"),
        }
    }
}

impl From<NoiseChoice> for String {
    fn from(choice: NoiseChoice) -> Self {
        choice.to_string()
    }
}

impl TryFrom<String> for NoiseChoice {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl NoiseChoice {
    /// Returns the noise model by which the pixels of `view` are weighted, if there is one.
    pub(crate) fn model(self, view: &View) -> Option<NoiseModel> {
        match self {
            Self::Auto => view.noise,
            Self::Off => None,
            Self::Given(model) => Some(model),
        }
    }
}

/// The scale and curve through which the loss sees radiance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ToneScale {
    /// Radiance of one normalised unit, in the units of the data set.
    pub(crate) radiance_scale: RadianceScale,
    /// The mu of the mu-law.
    pub(crate) mu: f32,
}

/// Returns the mask of `view` with weights by `model`.
pub(crate) fn weighted(view: &View, model: NoiseModel, tone: ToneScale) -> Mask {
    let image = &view.image;
    let weight = |i: usize| {
        let worth = view.mask.as_ref().map_or(1.0, |mask| mask.weights.get(i).copied().unwrap_or(0.0));
        if worth > 0.0 { worth * weight_of(signal(image, view, i), model, tone) } else { 0.0 }
    };
    Mask { weights: (0..image.pixels.len()).into_par_iter().map(weight).collect() }
}

/// Returns the weight of a pixel with mean radiance `signal` over its channels.
fn weight_of(signal: f32, model: NoiseModel, tone: ToneScale) -> f32 {
    let scale = tone.radiance_scale;
    let slope = tone.mu / ((1.0 + scale.normalised_value(tone.mu * signal)) * tone.mu.ln_1p());
    let noise = scale.normalised_value(slope * model.variance(signal).sqrt()) / TOLERANCE;
    (1.0 + noise * noise).sqrt().recip()
}

/// Returns the mean radiance of the valid pixels around pixel `i`, which must be valid itself.
fn signal(image: &Image, view: &View, i: usize) -> f32 {
    let (x, y) = (i % image.width, i / image.width);
    let (mut sum, mut count) = (0.0, 0.0);
    for row in y.saturating_sub(RADIUS)..(y + RADIUS + 1).min(image.height) {
        for column in x.saturating_sub(RADIUS)..(x + RADIUS + 1).min(image.width) {
            let at = row * image.width + column;
            if view.is_valid(at) {
                sum += luminance_sum(image.pixels[at]) / 3.0;
                count += 1.0;
            }
        }
    }
    sum / f32::max(count, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{camera_at, view_of};

    const TONE: ToneScale = ToneScale { radiance_scale: RadianceScale::new(2.0).unwrap(), mu: 5000.0 };

    #[test]
    fn a_weight_follows_the_noise_under_the_mu_law() {
        let model = NoiseModel { read: 1e-3, shot: 1e-4 };
        let at = |p: f32| weight_of(p, model, TONE);
        // Checked by central differences: the spread of T over one standard deviation.
        for p in [0.01f32, 0.3, 4.0] {
            let s = (1e-6 + 1e-4 * p).sqrt();
            let of = |v: f32| luxel_core::tone::mu_law(v / 2.0, 5000.0);
            let noise = 0.5 * (of(p + 0.01 * s) - of(p - 0.01 * s)) / 0.01 / TOLERANCE;
            let expected = 1.0 / (1.0 + noise * noise).sqrt();
            assert!((at(p) - expected).abs() < 1e-2 * expected, "{p}: {} {expected}", at(p));
        }
        assert!(at(0.0) < at(0.01) && at(0.01) < at(1.0) && at(100.0) > 0.99);
        // The mean of sixteen pixels has a quarter of the noise.
        assert!(weight_of(0.01, model.averaged(16), TONE) > at(0.01));
        assert_eq!(weight_of(0.5, NoiseModel { read: 0.0, shot: 0.0 }, TONE), 1.0);
    }

    #[test]
    fn weights_do_not_follow_the_noise_itself_and_masks_stay() {
        let pixels = (0..100).map(|i| [if i % 2 == 0 { 0.0 } else { 0.2 }; 3]).collect();
        let mut view = view_of("a", camera_at([0.0; 3], [10, 10]), Image::from_pixels(10, 10, pixels).unwrap());
        view.mask = Some(Mask::from_valid((0..100).map(|i| i != 40)).into());
        let mask = weighted(&view, NoiseModel { read: 0.01, shot: 0.01 }, TONE);
        assert_eq!(mask.weights[40], 0.0);
        // In the neighbourhood of a dark pixel, 2 of 5 columns are bright; around a bright one, 3
        // are. The weights must be close; by the pixels' own values they would differ by a factor
        // of ten.
        let (dark, bright) = (mask.weights[54], mask.weights[55]);
        assert!(dark > 0.0 && dark < 1.0 && (dark / bright - 1.0).abs() < 0.2, "{dark} {bright}");
        assert!(mask.total().is_some());
    }

    #[test]
    fn models_are_read_from_text() {
        for (text, choice) in [("auto", NoiseChoice::Auto), ("off", NoiseChoice::Off)] {
            assert_eq!((text.parse(), choice.to_string().as_str()), (Ok(choice), text));
        }
        let given = NoiseChoice::Given(NoiseModel { read: 0.5, shot: 2e-3 });
        assert_eq!(("0.5, 2e-3".parse(), given.to_string().parse()), (Ok(given), Ok(given)));
        for bad in ["", "1", "1,2,3", "-1,2", "nan,1", "1,inf"] {
            assert!(bad.parse::<NoiseChoice>().unwrap_err().contains("noise model"), "{bad}");
        }
    }
}
