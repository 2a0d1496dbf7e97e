//! mu-law values of prediction and target in strips, and the sum of their absolute differences.

use fearless_simd::Simd;
use luxel_core::{Real, View};

use super::Plan;
use super::band::{Band, MOMENT_ROWS};
use super::convolution::RADIUS;
use super::strips::{linear_len, read_blocks, to_strips};
use crate::lanes::{Lanes, V};
use crate::passes::rasterize::TilePixels;
use crate::view::{BLOCK_PX, TILE_BLOCKS};

/// Planes of values of a channel: prediction, target.
pub(super) const PLANES: usize = 2;

/// Rows on their way into strips, kept between steps.
#[derive(Default)]
pub(super) struct ValueScratch {
    /// Linear rows of the prediction: `[3, BLOCK_PX, linear]`.
    prediction: Vec<f32>,
    prediction_strips: Vec<Lanes>,
    /// One linear row of the target's channels in turn.
    target: Vec<f32>,
    target_strips: Vec<Lanes>,
    /// mu-law prediction and target in strips: `[MOMENT_ROWS, 3, 2, strip]`.
    pub(super) values: Vec<Lanes>,
}

/// mu-law values of the rows within the image whose moments `band` needs, into `scratch.values`; the sum of absolute differences over the
/// band's own rows.
#[inline(always)]
pub(super) fn load_band<S: Simd>(
    simd: S,
    plan: &Plan,
    (pixels, view): (&[TilePixels], &View),
    band: Band,
    scratch: &mut ValueScratch,
) -> f64 {
    let (width, strip) = (plan.width, plan.strip);
    scratch.resize(strip);
    let linear = linear_len(strip);
    let mut difference = 0.0;
    let mut block_row = usize::MAX;
    for row in band.inside(plan, 2 * RADIUS, MOMENT_ROWS) {
        let y = band.start + row - 2 * RADIUS;
        if block_row != y / BLOCK_PX {
            block_row = y / BLOCK_PX;
            let tiles = &pixels[block_row / TILE_BLOCKS * plan.across..][..plan.across];
            read_blocks(tiles, block_row % TILE_BLOCKS, &mut scratch.prediction, linear);
        }
        let pixels = y * width..(y + 1) * width;
        // The image's pixels are interleaved: as one row of three times the width, its strips hold the channels in turn.
        scratch.target[..3 * width].copy_from_slice(view.image.pixels[pixels.clone()].as_flattened());
        scratch.target[3 * width..].fill(0.0);
        to_strips(simd, &scratch.target, 3 * strip, &mut scratch.target_strips);
        let valid = view.mask.as_ref().map(|mask| &mask.valid[pixels]);
        let mut row_difference = V::splat(simd, 0.0);
        let out = &mut scratch.values[row * 3 * PLANES * strip..][..3 * PLANES * strip];
        for (channel, out) in out.chunks_exact_mut(PLANES * strip).enumerate() {
            let (x_out, y_out) = out.split_at_mut(strip);
            let prediction = &mut scratch.prediction[(channel * BLOCK_PX + y % BLOCK_PX) * linear..][..linear];
            prediction[width..].fill(0.0);
            if let Some(valid) = valid {
                for (i, _) in valid.iter().enumerate().filter(|(_, valid)| !**valid) {
                    prediction[i] = scratch.target[3 * i + channel];
                }
            }
            to_strips(simd, prediction, strip, &mut scratch.prediction_strips);
            let targets = scratch.target_strips.chunks_exact(3);
            for (((x_out, y_out), x), y) in x_out.iter_mut().zip(y_out).zip(&scratch.prediction_strips).zip(targets) {
                let x = mu_law(V::load(simd, x), plan);
                let y = mu_law(V::load(simd, &y[channel]), plan);
                x.store(x_out);
                y.store(y_out);
                row_difference = row_difference + (x - y).abs();
            }
        }
        if (2 * RADIUS..2 * RADIUS + band.rows).contains(&row) {
            difference += row_difference.lanes().iter().map(|v| f64::from(*v)).sum::<f64>();
        }
    }
    difference
}

impl ValueScratch {
    fn resize(&mut self, strip: usize) {
        self.prediction.resize(3 * BLOCK_PX * linear_len(strip), 0.0);
        self.prediction_strips.resize(strip, Lanes::ZERO);
        self.target.resize(linear_len(3 * strip), 0.0);
        self.target_strips.resize(3 * strip, Lanes::ZERO);
        self.values.resize(MOMENT_ROWS * 3 * PLANES * strip, Lanes::ZERO);
    }
}

/// ln(1 + mu max(p, 0)) / ln(1 + mu).
#[inline(always)]
fn mu_law<S: Simd>(radiance: V<S>, plan: &Plan) -> V<S> {
    (radiance.max(radiance.lift(0.0)) * plan.mu).ln_1p() * plan.mu_law_scale
}
