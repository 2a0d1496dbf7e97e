//! The loss that a training step minimises, the same for every engine.
//!
//! In: weights of the parts, which a run sets, the target of each view, and means over pixels and
//! channels from the engine. Images are compared under a [`ToneCurve`], not clamped above.

use serde::{Deserialize, Serialize};

use crate::{ToneCurve, Vignetting};

/// Difference under the tone curve at which the squared part of the loss is as steep as the
/// absolute one: see [`LossWeights::squared_share`].
pub const SQUARED_KNEE: f32 = 0.03;

/// Target of a view's image in training: the curve under which it is compared, its scale, and its
/// vignetting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Tone curve under which the image is compared.
    pub curve: ToneCurve,
    /// Factor of the image's channels before the comparison: from the data set's units to
    /// normalised units without gain.
    pub scale: [f32; 3],
    /// Vignetting of the image: the prediction is multiplied by its gain before the comparison.
    pub vignetting: Option<Vignetting>,
}

impl Default for Target {
    fn default() -> Self {
        Self { curve: ToneCurve::MuLaw { mu: crate::tone::MU }, scale: [1.0; 3], vignetting: None }
    }
}

/// Weights of the loss of images under a tone curve: `(1 - ssim_weight) D + ssim_weight (1 -
/// SSIM)`.
///
/// D is the mean of |d| over the pixels' differences d (LCD-GS eq. 5 with lambda = 1 -
/// ssim_weight), or of `(1 - squared_share) |d| + squared_share d^2 / (2 SQUARED_KNEE)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LossWeights {
    /// Weight of 1 - SSIM, 0 to 1.
    pub ssim_weight: f32,
    /// Part of the absolute difference that its square replaces, 0 to 1. Squares give large errors
    /// more weight.
    pub squared_share: f32,
    /// Weight of the mean opacity (3DGS-MCMC), 0 for none.
    pub opacity_weight: f32,
    /// Weight of the mean scale (3DGS-MCMC), 0 for none.
    pub scale_weight: f32,
}

impl Default for LossWeights {
    fn default() -> Self {
        Self { ssim_weight: 0.2, squared_share: 0.0, opacity_weight: 0.0, scale_weight: 0.0 }
    }
}

impl LossWeights {
    /// Returns the loss of an image with mean absolute difference `l1`, mean squared difference
    /// `l2` and mean SSIM `ssim`.
    pub fn total(&self, l1: f32, l2: f32, ssim: f32) -> f32 {
        let difference = (1.0 - self.squared_share) * l1 + self.squared_share * (l2 / (2.0 * SQUARED_KNEE));
        (1.0 - self.ssim_weight) * difference + self.ssim_weight * (1.0 - ssim)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_total_is_that_of_equation_5_and_its_squares() {
        let total =
            |ssim_weight, squared_share| LossWeights { ssim_weight, squared_share, ..LossWeights::default() }.total(0.1, 0.02, 0.75);
        let expected =
            [(0.0, 0.0, 0.1), (1.0, 0.5, 0.25), (0.2, 0.0, 0.13), (0.0, 1.0, 0.02 / 0.06), (0.2, 0.5, 0.8 * (0.05 + 0.01 / 0.06) + 0.05)];
        for (ssim_weight, squared_share, expected) in expected {
            assert!((total(ssim_weight, squared_share) - expected).abs() < 1e-7, "{ssim_weight}, {squared_share}");
        }
    }

    #[test]
    fn the_squared_part_is_as_steep_as_the_absolute_one_at_the_knee() {
        let loss = |difference: f32, squared_share| {
            LossWeights { ssim_weight: 0.0, squared_share, ..LossWeights::default() }.total(difference, difference * difference, 1.0)
        };
        let slope = |squared_share| (loss(SQUARED_KNEE + 1e-3, squared_share) - loss(SQUARED_KNEE - 1e-3, squared_share)) / 2e-3;
        assert!((slope(1.0) / slope(0.0) - 1.0).abs() < 1e-4);
    }
}
