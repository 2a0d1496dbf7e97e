//! Pass `loss`: L1, partly squared, + SSIM against the view's image through a tone curve, and its gradient by the pixels' radiance.
//!
//! In: the tiles' radiance, target image and weights, [`LossConfig`]. Out: means of L1, squares and SSIM, [`BlockGradient`]s row by row, and the gradient by
//! the knots of a response. Source: LCD-GS eq. 5; SSIM as in 3DGS: 11x11 Gaussian window of sigma 1.5, zero padding, mean over pixels and
//! channels. The window is symmetric and the padding zero, so the convolution is its own adjoint.
//!
//! A pixel of weight w takes `w x + (1 - w) y` of its prediction x and target y under the curve for the prediction, in L1 and squares (means over weights) and
//! in the windows: one of weight 0 takes no part, one of weight 1 is as if there were no weights, to the bit.
//!
//! One [`sweep`] down the image: [`values`], their [`similarity`] and the [`gradient`], a group of rows at a time, so that what is in use stays in a
//! core's cache. Rows are laid out in [`strips`], so that windows along rows and down columns are the same code, [`convolution`], on whole vectors.
//! The mu-law is vector code; a response is looked up pixel by pixel.

mod convolution;
mod gradient;
mod similarity;
mod strips;
mod sweep;
mod values;

use std::sync::{Mutex, MutexGuard, PoisonError};

use fearless_simd::Level;
use luxel_core::{Knots, LossConfig, RESPONSE_KNOTS, Response, SQUARED_KNEE, ToneCurve, View};
use rayon::prelude::*;

use self::convolution::{Weights, weights};
use self::strips::strip_px;
use self::sweep::{BAND_PX, Sweep, differentiate_band};
use self::values::Differences;
use super::rasterize::TilePixels;
use super::rasterize_backward::BlockGradient;
use crate::view::{BLOCK_PX, ScreenCamera, TILE_BLOCKS};

/// Buffers of the pass, kept between steps.
#[derive(Default)]
pub(crate) struct LossBuffers {
    /// Of each band.
    sums: Vec<BandSums>,
    /// Per thread: what it works on stays in its core's cache. Nobody waits for another's.
    sweeps: Vec<Mutex<Sweep>>,
    /// Gradient by the pixels' radiance, row by row of blocks, whole tiles across and down.
    pub(crate) gradient: Vec<BlockGradient>,
}

/// What the pass found.
pub(crate) struct LossSums {
    pub(crate) l1: f32,
    pub(crate) l2: f32,
    pub(crate) ssim: f32,
    pub(crate) by_knots: Option<Knots>,
}

/// Sums over a band, in f64: they are added in the order of the bands, whoever made them.
#[derive(Clone)]
struct BandSums {
    differences: Differences,
    ssim: f64,
    by_knots: [[f64; RESPONSE_KNOTS]; 3],
}

impl BandSums {
    const ZERO: Self = Self { differences: Differences { absolute: 0.0, squared: 0.0 }, ssim: 0.0, by_knots: [[0.0; RESPONSE_KNOTS]; 3] };
}

/// Sizes and constants of a step.
struct Plan {
    width: usize,
    height: usize,
    /// Vectors of a row.
    strip: usize,
    /// Tiles of a row.
    across: usize,
    window: Weights,
    curve: Curve,
    /// [`LossConfig::target_scale`].
    target_scale: [f32; 3],
    /// What is known of each pixel.
    planes: Planes,
    /// Gradient of the loss, but for the curve's slope relative to [`Curve::slope`]: by L1's sign, and by half the derivative of the sum of SSIM.
    l1_factor: f32,
    /// By the difference itself.
    l2_factor: f32,
    ssim_factor: f32,
}

/// The tone curve with its constants.
#[expect(clippy::large_enum_variant, reason = "there is one a step")]
enum Curve {
    MuLaw {
        mu: f32,
        /// 1 / ln(1 + mu).
        scale: f32,
        log2_1p_mu: f32,
    },
    Response(Response),
}

impl Curve {
    fn new(curve: &ToneCurve) -> Self {
        match *curve {
            ToneCurve::MuLaw { mu } => {
                let log = mu.ln_1p();
                Self::MuLaw { mu, scale: 1.0 / log, log2_1p_mu: log * std::f32::consts::LOG2_E }
            }
            ToneCurve::Response(response) => Self::Response(response),
        }
    }

    /// The derivative that the others are relative to: of the mu-law that at radiance 0.
    fn slope(&self) -> f32 {
        match self {
            Self::MuLaw { mu, scale, .. } => mu * scale,
            Self::Response(_) => 1.0,
        }
    }
}

/// Planes of values of a channel.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Planes {
    /// Prediction and target: the slope follows from the prediction.
    Values,
    /// Those, and the slope times the weight.
    Weighted,
    /// Those, and the weight and the place on the response.
    Response,
}

impl Planes {
    fn count(self) -> usize {
        match self {
            Self::Values => 2,
            Self::Weighted => 3,
            Self::Response => 5,
        }
    }
}

impl LossBuffers {
    /// Evaluates the loss.
    pub(crate) fn loss(
        &mut self,
        level: Level,
        camera: &ScreenCamera,
        pixels: &[TilePixels],
        view: &View,
        config: &LossConfig,
    ) -> LossSums {
        let [width, height] = camera.size_px;
        let [across, down] = camera.tiles();
        let all = (width * height) as f64;
        let total = view.mask.as_ref().map_or(all, |mask| mask.weights.iter().map(|weight| f64::from(*weight)).sum());
        // Of no pixel at all the mean is 0.
        let total = 3.0 * if total > 0.0 { total } else { 1.0 };
        let plan = Plan::new(camera, config, view.mask.is_some(), total);
        let bands = height.div_ceil(BAND_PX);
        self.sums.resize(bands, BandSums::ZERO);
        let (blocks_across, band_blocks) = (across * TILE_BLOCKS, BAND_PX / BLOCK_PX);
        self.gradient.resize(blocks_across * (down * TILE_BLOCKS).max(bands * band_blocks), BlockGradient::default());
        self.sweeps.resize_with(rayon::current_num_threads(), Mutex::default);
        self.sweeps.iter().for_each(|sweep| own(sweep).begin());

        let sweeps = &self.sweeps;
        let bands = self.gradient.par_chunks_exact_mut(blocks_across * band_blocks).zip(&mut self.sums).enumerate();
        bands.with_max_len(1).for_each(|(band, (blocks, sums))| {
            let sweep = &mut *own(&sweeps[rayon::current_thread_index().unwrap_or(0)]);
            *sums = differentiate_band(level, &plan, (pixels, view), band, sweep, blocks);
        });
        let by_knots = (plan.planes == Planes::Response).then(|| self.by_knots());
        let sum = |of: fn(&BandSums) -> f64| self.sums.iter().map(of).sum::<f64>();
        let [absolute, squared] = [sum(|band| band.differences.absolute), sum(|band| band.differences.squared)];
        let ssim = sum(|band| band.ssim);
        LossSums { l1: (absolute / total) as f32, l2: (squared / total) as f32, ssim: (ssim / (3.0 * all)) as f32, by_knots }
    }

    fn by_knots(&self) -> Knots {
        let mut total = [[0.0f64; RESPONSE_KNOTS]; 3];
        for sums in &self.sums {
            for (total, value) in total.as_flattened_mut().iter_mut().zip(sums.by_knots.as_flattened()) {
                *total += value;
            }
        }
        total.map(|channel| channel.map(|value| value as f32))
    }
}

/// Locks what no two threads use at once.
fn own(sweep: &Mutex<Sweep>) -> MutexGuard<'_, Sweep> {
    sweep.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Plan {
    /// Means are over weights that sum to `total` over pixels and channels for L1, over all pixels for SSIM.
    fn new(camera: &ScreenCamera, config: &LossConfig, is_weighted: bool, total: f64) -> Self {
        let [width, height] = camera.size_px;
        let curve = Curve::new(&config.curve);
        let slope = curve.slope();
        let by_difference = slope * (1.0 - config.ssim_weight) / total as f32;
        let planes = match (&curve, is_weighted) {
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
            target_scale: config.target_scale,
            planes,
            l1_factor: by_difference * (1.0 - config.squared_share),
            l2_factor: by_difference * config.squared_share / SQUARED_KNEE,
            ssim_factor: slope * -2.0 * config.ssim_weight / (3 * width * height) as f32,
        }
    }
}
