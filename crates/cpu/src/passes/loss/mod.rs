//! Pass `loss`: mu-law L1 + SSIM against the view's image, and its gradient by the pixels' radiance.
//!
//! In: the tiles' radiance, target image and mask, [`LossConfig`]. Out: L1 and SSIM means, [`BlockGradient`]s row by row.
//! Source: LCD-GS eq. 5; SSIM as in 3DGS: 11x11 Gaussian window of sigma 1.5, zero padding, mean over pixels and channels.
//! The window is symmetric and the padding zero, so the convolution is its own adjoint. Masked pixels take the target's value for the
//! prediction in the windows, and add nothing to L1.
//!
//! One sweep over bands of rows, each within a core's cache: [`values`], then [`band`] per channel. Rows are laid out in [`strips`], so that
//! windows along rows and down columns are the same code, [`convolution`], on whole vectors.

mod band;
mod convolution;
mod strips;
mod values;

use std::sync::{Mutex, MutexGuard, PoisonError};

use fearless_simd::Level;
use luxel_core::{LossConfig, View};
use rayon::prelude::*;

use self::band::{BAND_PX, Band, BandScratch, differentiate_band, store_band};
use self::convolution::{Weights, weights};
use self::strips::strip_px;
use self::values::{ValueScratch, load_band};
use super::rasterize::TilePixels;
use super::rasterize_backward::BlockGradient;
use crate::lanes::with_simd;
use crate::view::{BLOCK_PX, ScreenCamera, TILE_BLOCKS};

/// Buffers of the pass, kept between steps.
#[derive(Default)]
pub(crate) struct LossBuffers {
    /// Per band: sums of absolute differences and of SSIM.
    sums: Vec<[f64; 2]>,
    /// Per thread: what it works on stays in its core's cache. Nobody else locks it.
    scratch: Vec<Mutex<Scratch>>,
    /// Gradient by the pixels' radiance, row by row of blocks, whole tiles across and down.
    pub(crate) gradient: Vec<BlockGradient>,
}

/// Buffers of a thread.
#[derive(Default)]
struct Scratch {
    values: ValueScratch,
    band: BandScratch,
}

/// What the pass found.
pub(crate) struct LossSums {
    pub(crate) l1: f32,
    pub(crate) ssim: f32,
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
    mu: f32,
    /// 1 / ln(1 + mu).
    mu_law_scale: f32,
    log2_1p_mu: f32,
    /// Gradient of the loss by radiance 0: by L1's sign, and by half the derivative of the sum of SSIM.
    l1_factor: f32,
    ssim_factor: f32,
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
        let valid = view.mask.as_ref().map_or(width * height, |mask| mask.valid.iter().filter(|v| **v).count());
        let plan = Plan::new(camera, config, valid);
        let bands = height.div_ceil(BAND_PX);
        self.sums.resize(bands, [0.0; 2]);
        let (blocks_across, band_blocks) = (across * TILE_BLOCKS, BAND_PX / BLOCK_PX);
        self.gradient.resize(blocks_across * (down * TILE_BLOCKS).max(bands * band_blocks), BlockGradient::default());
        self.scratch.resize_with(rayon::current_num_threads(), Mutex::default);

        let (scratch, mask) = (&self.scratch, view.mask.as_ref().map(|mask| mask.valid.as_slice()));
        let bands = self.gradient.par_chunks_exact_mut(blocks_across * band_blocks).zip(&mut self.sums).enumerate();
        bands.with_max_len(1).for_each(|(band, (blocks, sums))| {
            let Scratch { values, band: scratch } = &mut *own(scratch);
            let start = band * BAND_PX;
            let rows = (height - start).min(BAND_PX);
            let band = Band { start, rows, channel: 0 };
            sums[0] = with_simd!(level, simd => load_band(simd, &plan, (pixels, view), band, values));
            sums[1] = 0.0;
            for channel in 0..3 {
                let band = Band { channel, ..band };
                sums[1] += with_simd!(level, simd => differentiate_band(simd, &plan, (&values.values, mask), band, scratch));
            }
            store_band(&plan, rows, scratch, blocks);
        });
        let totals = self.sums.iter().fold([0.0; 2], |t, s| [t[0] + s[0], t[1] + s[1]]);
        LossSums { l1: (totals[0] / (3 * valid.max(1)) as f64) as f32, ssim: (totals[1] / (3 * width * height) as f64) as f32 }
    }
}

/// The calling thread's scratch.
fn own(scratch: &[Mutex<Scratch>]) -> MutexGuard<'_, Scratch> {
    scratch[rayon::current_thread_index().unwrap_or(0)].lock().unwrap_or_else(PoisonError::into_inner)
}

impl Plan {
    /// Means are over `valid` pixels for L1, over all for SSIM.
    fn new(camera: &ScreenCamera, config: &LossConfig, valid: usize) -> Self {
        let [width, height] = camera.size_px;
        let log = config.mu.ln_1p();
        // The derivative of the mu-law at radiance 0.
        let slope = config.mu / log;
        Self {
            width,
            height,
            strip: strip_px(width),
            across: camera.tiles()[0],
            window: weights(),
            mu: config.mu,
            mu_law_scale: 1.0 / log,
            log2_1p_mu: log * std::f32::consts::LOG2_E,
            l1_factor: slope * (1.0 - config.ssim_weight) / (3 * valid.max(1)) as f32,
            ssim_factor: slope * -2.0 * config.ssim_weight / (3 * width * height) as f32,
        }
    }
}
