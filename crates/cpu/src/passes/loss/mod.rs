//! Pass `loss`: computes L1, partly squared, plus SSIM against the view's image under a tone curve,
//! and the gradient by the pixels' radiance.
//!
//! In: the tiles' radiance, the view with its target, [`LossWeights`]. Out: means of L1, squares
//! and SSIM, [`BlockGradient`]s row by row, and the gradient by the knots of a response curve.
//! Source: LCD-GS eq. 5; SSIM as in 3DGS: 11x11 Gaussian window of sigma 1.5, zero padding, mean
//! over pixels and channels. The window is symmetric and the padding is zero, so the convolution is
//! its own adjoint.
//!
//! With x a pixel's prediction under the curve, y its target and w its weight, `w x + (1 - w) y`
//! takes the place of the prediction, in L1 and squares (means over weights) and in the windows. A
//! pixel of weight 0 has no effect; with all weights 1 the result is the same bits as without
//! weights. Degenerate: if all weights are 0, the means are 0.
//!
//! If the view has vignetting, the pixels are multiplied by its gain first, and the gradient is
//! taken back ([`super::vignetting`]).
//!
//! One [`sweep`] down the image computes [`values`], their [`similarity`] and the [`gradient`], one
//! group of [`rows`] at a time, so that the data in use stays in a core's cache. Rows are laid out
//! in [`strips`], so that windows along rows and down columns are the same code, [`convolution`],
//! on whole vectors. The mu-law is vector code; a response curve is evaluated pixel by pixel.

mod convolution;
mod gradient;
mod plan;
mod rows;
mod similarity;
mod strips;
mod sweep;
mod values;

use std::sync::{Mutex, MutexGuard, PoisonError};

use luxel_core::{Knots, LossWeights, RESPONSE_KNOTS, VIGNETTING_TERMS, View};
use luxel_lanes::Level;
use rayon::prelude::*;

use self::plan::{LossInputs, LossPlan, Planes};
use self::rows::BAND_PX;
use self::sweep::{BandSums, Sweep, differentiate_band};
use super::rasterize::TilePixels;
use super::rasterize_backward::BlockGradient;
use super::vignetting::{vignette, vignette_backward};
use crate::view::{BLOCK_PX, ScreenCamera, TILE_BLOCKS};

/// Buffers of the pass, kept between steps.
#[derive(Default)]
pub(crate) struct LossBuffers {
    /// Sums of each band.
    sums: Vec<BandSums>,
    /// A sweep for each thread, so that its data stays in the core's cache. No thread waits for
    /// another's.
    sweeps: Vec<Mutex<Sweep>>,
    /// The pixels times the gain of the view's vignetting, if it has one.
    vignetted: Vec<TilePixels>,
    /// Gradient by the pixels' radiance, row by row of blocks, whole tiles across and down.
    pub(crate) gradient: Vec<BlockGradient>,
}

/// The results of the pass, besides the gradient by the pixels.
pub(crate) struct LossSums {
    pub(crate) l1: f32,
    pub(crate) l2: f32,
    pub(crate) ssim: f32,
    pub(crate) by_knots: Option<Knots>,
    pub(crate) by_vignetting: Option<[f32; VIGNETTING_TERMS]>,
}

impl LossBuffers {
    /// Evaluates the loss, and its gradient by the pixels' radiance.
    pub(crate) fn loss(
        &mut self,
        level: Level,
        camera: &ScreenCamera,
        pixels: &[TilePixels],
        view: &View,
        weights: &LossWeights,
    ) -> LossSums {
        let Some(vignetting) = &view.target.vignetting else { return self.loss_of(level, camera, pixels, view, weights) };
        let mut vignetted = std::mem::take(&mut self.vignetted);
        vignette(level, camera, vignetting, pixels, &mut vignetted);
        let sums = self.loss_of(level, camera, &vignetted, view, weights);
        let by_vignetting = vignette_backward(level, camera, vignetting, &vignetted, &mut self.gradient);
        self.vignetted = vignetted;
        LossSums { by_vignetting: Some(by_vignetting), ..sums }
    }

    /// Evaluates the loss of pixels as the view shows them.
    fn loss_of(&mut self, level: Level, camera: &ScreenCamera, pixels: &[TilePixels], view: &View, weights: &LossWeights) -> LossSums {
        let [width, height] = camera.size_px;
        let [across, down] = camera.tiles();
        let all = (width * height) as f64;
        let total = view.mask.as_ref().map_or(all, |mask| mask.weights.iter().map(|weight| f64::from(*weight)).sum());
        // The mean over no pixels is 0.
        let total = 3.0 * if total > 0.0 { total } else { 1.0 };
        let plan = LossPlan::new(camera, view, weights, total);
        let bands = height.div_ceil(BAND_PX);
        self.sums.resize(bands, BandSums::ZERO);
        let (blocks_across, band_blocks) = (across * TILE_BLOCKS, BAND_PX / BLOCK_PX);
        self.gradient.resize(blocks_across * (down * TILE_BLOCKS).max(bands * band_blocks), BlockGradient::default());
        self.sweeps.resize_with(rayon::current_num_threads(), Mutex::default);
        self.sweeps.iter().for_each(|sweep| lock_sweep(sweep).begin());

        let sweeps = &self.sweeps;
        let inputs = LossInputs { pixels, view };
        let bands = self.gradient.par_chunks_exact_mut(blocks_across * band_blocks).zip(&mut self.sums).enumerate();
        bands.with_max_len(1).for_each(|(band, (blocks, sums))| {
            let sweep = &mut *lock_sweep(&sweeps[rayon::current_thread_index().unwrap_or(0)]);
            *sums = differentiate_band(level, &plan, inputs, band, sweep, blocks);
        });
        let by_knots = (plan.planes == Planes::Response).then(|| self.by_knots());
        let sum = |field: fn(&BandSums) -> f64| self.sums.iter().map(field).sum::<f64>();
        let [absolute, squared] = [sum(|band| band.differences.absolute), sum(|band| band.differences.squared)];
        let ssim = sum(|band| band.ssim);
        LossSums {
            l1: (absolute / total) as f32,
            l2: (squared / total) as f32,
            ssim: (ssim / (3.0 * all)) as f32,
            by_knots,
            by_vignetting: None,
        }
    }

    /// Adds up the gradient by the knots over the bands.
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

/// Locks a sweep, which no two threads use at once.
fn lock_sweep(sweep: &Mutex<Sweep>) -> MutexGuard<'_, Sweep> {
    sweep.lock().unwrap_or_else(PoisonError::into_inner)
}
