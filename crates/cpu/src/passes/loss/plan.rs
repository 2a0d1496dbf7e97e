//! The sizes and constants of a step's loss.
//!
//! In: camera, view, [`LossWeights`]. Out: [`LossPlan`], which all stages read.

use luxel_core::{LossWeights, Response, SQUARED_KNEE, ToneCurve, View};

use super::convolution::{Weights, weights};
use super::strips::strip_px;
use crate::passes::rasterize::TilePixels;
use crate::view::ScreenCamera;

/// The prediction and the view that it is compared with.
#[derive(Clone, Copy)]
pub(super) struct LossInputs<'a> {
    pub(super) pixels: &'a [TilePixels],
    pub(super) view: &'a View,
}

/// The sizes and constants of a step.
pub(super) struct LossPlan {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Vectors in a row.
    pub(super) strip: usize,
    /// Tiles in a row.
    pub(super) across: usize,
    pub(super) window: Weights,
    pub(super) curve: Curve,
    /// See [`Target::scale`](luxel_core::Target::scale).
    pub(super) target_scale: [f32; 3],
    /// Planes of values that are kept for each pixel.
    pub(super) planes: Planes,
    /// Factor of the sign of the difference (L1) in the gradient by radiance, without the curve's
    /// slope relative to [`Curve::slope`].
    pub(super) l1_factor: f32,
    /// Factor of the difference itself (squares).
    pub(super) l2_factor: f32,
    /// Factor of half the derivative of the sum of SSIM.
    pub(super) ssim_factor: f32,
}

/// The tone curve, with its constants.
#[expect(clippy::large_enum_variant, reason = "there is one per step")]
pub(super) enum Curve {
    MuLaw {
        mu: f32,
        /// 1 / ln(1 + mu).
        scale: f32,
        log2_1p_mu: f32,
    },
    Response(Response),
}

impl Curve {
    /// Computes the constants of a curve.
    pub(super) fn new(curve: &ToneCurve) -> Self {
        match *curve {
            ToneCurve::MuLaw { mu } => {
                let log = mu.ln_1p();
                Self::MuLaw { mu, scale: 1.0 / log, log2_1p_mu: log * std::f32::consts::LOG2_E }
            }
            ToneCurve::Response(response) => Self::Response(response),
        }
    }

    /// Returns the derivative to which the others are relative: for the mu-law, the one at radiance
    /// 0.
    pub(super) fn slope(&self) -> f32 {
        match self {
            Self::MuLaw { mu, scale, .. } => mu * scale,
            Self::Response(_) => 1.0,
        }
    }
}

/// The planes of values that are kept for a channel.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Planes {
    /// Prediction and target; the slope follows from the prediction.
    Values,
    /// Prediction, target, and the slope times the weight.
    Weighted,
    /// Prediction, target, slope times weight, weight, and position on the response.
    Response,
}

impl Planes {
    /// Returns the number of planes.
    pub(super) fn count(self) -> usize {
        match self {
            Self::Values => 2,
            Self::Weighted => 3,
            Self::Response => 5,
        }
    }
}

impl LossPlan {
    /// Makes the plan of a step towards `view`. `total` is the sum of weights over pixels and
    /// channels, over which L1 is averaged; SSIM is averaged over all pixels.
    pub(super) fn new(camera: &ScreenCamera, view: &View, loss: &LossWeights, total: f64) -> Self {
        let [width, height] = camera.size_px;
        let curve = Curve::new(&view.target.curve);
        let slope = curve.slope();
        let by_difference = slope * (1.0 - loss.ssim_weight) / total as f32;
        let planes = match (&curve, view.mask.is_some()) {
            (Curve::MuLaw { .. }, false) => Planes::Values,
            (Curve::MuLaw { .. }, true) => Planes::Weighted,
            (Curve::Response(_), _) => Planes::Response,
        };
        Self {
            width,
            height,
            strip: strip_px(width),
            across: camera.tiles()[0],
            window: weights(),
            curve,
            target_scale: view.target.scale,
            planes,
            l1_factor: by_difference * (1.0 - loss.squared_share),
            l2_factor: by_difference * loss.squared_share / SQUARED_KNEE,
            ssim_factor: slope * -2.0 * loss.ssim_weight / (3 * width * height) as f32,
        }
    }
}
