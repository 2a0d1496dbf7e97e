//! The loss of a pixel.

use luxel_core::tone::mu_law;
use serde::{Deserialize, Serialize};

/// The values whose squared difference is minimised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PixelLoss {
    /// Radiance in normalised units: lamps outweigh everything else.
    Linear,
    /// The mu-law of both, which is not clamped.
    #[default]
    Mulaw,
}

impl PixelLoss {
    /// Returns the mean squared difference over the channels, and writes its derivative by the
    /// prediction.
    pub(crate) fn pixel(self, prediction: &[f32], target: [f32; 3], mu: f32, by_prediction: &mut [f32]) -> f32 {
        let mut total = 0.0;
        for c in 0..3 {
            let p = prediction[c];
            let (difference, slope) = match self {
                Self::Linear => (p - target[c], 1.0),
                // Predictions are not negative, roundings apart.
                Self::Mulaw => (mu_law(p.max(0.0), mu) - mu_law(target[c], mu), mu / ((1.0 + mu * p.max(0.0)) * mu.ln_1p())),
            };
            total += difference * difference / 3.0;
            by_prediction[c] = 2.0 / 3.0 * difference * slope;
        }
        total
    }
}
