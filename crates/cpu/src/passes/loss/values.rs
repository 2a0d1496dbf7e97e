//! Values of the loss: prediction and target under the tone curve, in strips, with what their
//! gradient needs besides.
//!
//! In: [`LossInputs`]. Out: planes of a group of rows, and the sums of absolute and squared
//! differences. Degenerate: rows and pixels beyond the image are zero.

use fearless_simd::Simd;
use luxel_core::{Real, Response, each};

use super::convolution::{GROUP, RowStack};
use super::plan::{Curve, LossInputs, LossPlan, Planes};
use super::rows::RowGroup;
use super::strips::{linear_len, read_blocks, to_strips};
use crate::lanes::{Lanes, V};
use crate::view::{BLOCK_PX, TILE_BLOCKS, TILE_PX};

/// Buffers for converting rows to strips, kept between steps.
#[derive(Default)]
pub(super) struct ValueScratch {
    /// Linear rows of the prediction: `[3, BLOCK_PX, linear]`.
    prediction: Vec<f32>,
    /// One row of a channel's prediction in strips, or of a plane under a response.
    prediction_strips: Vec<Lanes>,
    /// One linear row of the target, channels interleaved.
    target: Vec<f32>,
    target_strips: Vec<Lanes>,
    /// One linear row of the weights.
    weights: Vec<f32>,
    weight_strips: Vec<Lanes>,
    /// One linear row of the planes of a channel under a response: `[5, linear]`.
    recorded: Vec<f32>,
    /// Row of blocks in `prediction`.
    block_row: Option<usize>,
}

/// The sums over pixels and channels of absolute and squared differences.
#[derive(Clone, Copy, Default)]
pub(super) struct Differences {
    pub(super) absolute: f64,
    pub(super) squared: f64,
}

/// Loads the values of a group of rows, `[3, strip, planes]`, zero beyond the image. Returns the
/// sums of their differences.
#[inline(always)]
pub(super) fn load_values<S: Simd>(
    simd: S,
    plan: &LossPlan,
    LossInputs { pixels, view }: LossInputs<'_>,
    group: RowGroup,
    scratch: &mut ValueScratch,
    out: &mut [RowStack],
) -> Differences {
    let (width, strip) = (plan.width, plan.strip);
    let linear = linear_len(strip);
    let mut total = Differences::default();
    for j in 0..GROUP {
        let Some(y) = group.row(plan, j) else {
            out.iter_mut().for_each(|stack| stack[j] = Lanes::ZERO);
            continue;
        };
        if scratch.block_row != Some(y / BLOCK_PX) {
            scratch.block_row = Some(y / BLOCK_PX);
            let (tile_row, block_row) = (y / TILE_PX, y / BLOCK_PX % TILE_BLOCKS);
            read_blocks(&pixels[tile_row * plan.across..][..plan.across], block_row, &mut scratch.prediction, linear);
        }
        let pixels = y * width..(y + 1) * width;
        // The image's channels are interleaved: treated as one row of three times the width, its
        // strips hold them in turn.
        scratch.target[..3 * width].copy_from_slice(view.image.pixels[pixels.clone()].as_flattened());
        scratch.target[3 * width..].fill(0.0);
        to_strips(simd, &scratch.target, 3 * strip, &mut scratch.target_strips);
        match (&view.mask, plan.planes) {
            (_, Planes::Values) => {}
            (Some(mask), _) => scratch.weights[..width].copy_from_slice(&mask.weights[pixels]),
            (None, _) => scratch.weights[..width].fill(1.0),
        }
        if plan.planes == Planes::Weighted {
            to_strips(simd, &scratch.weights, strip, &mut scratch.weight_strips);
        }
        let mut sums = [V::splat(simd, 0.0); 2];
        for (channel, out) in out.chunks_exact_mut(plan.planes.count() * strip).enumerate() {
            let prediction = &mut scratch.prediction[(channel * BLOCK_PX + y % BLOCK_PX) * linear..][..linear];
            prediction[width..].fill(0.0);
            match &plan.curve {
                Curve::MuLaw { mu, scale, log2_1p_mu } => {
                    to_strips(simd, prediction, strip, &mut scratch.prediction_strips);
                    let (prediction, target) = (&scratch.prediction_strips, &scratch.target_strips);
                    let row = StripRow { prediction, target, channel, target_scale: plan.target_scale[channel] };
                    let weights = (plan.planes == Planes::Weighted)
                        .then_some(RowWeights { weights: &scratch.weight_strips, log2_1p_mu: *log2_1p_mu });
                    mu_law_row(simd, [*mu, *scale], &row, weights, out, j, &mut sums);
                }
                Curve::Response(response) => {
                    let row = LinearRow {
                        channel,
                        target_scale: plan.target_scale[channel],
                        radiance: &prediction[..width],
                        target: &scratch.target[channel..],
                        weights: &scratch.weights,
                    };
                    response_row(response, &row, &mut scratch.recorded);
                    for (plane, linear) in scratch.recorded.chunks_exact(linear).enumerate() {
                        to_strips(simd, linear, strip, &mut scratch.prediction_strips);
                        let out = out[plane..].iter_mut().step_by(plan.planes.count());
                        out.zip(&scratch.prediction_strips).for_each(|(out, v)| out[j] = *v);
                    }
                    add_differences(simd, out, j, &mut sums);
                }
            }
        }
        let [absolute, squared] = each!([0, 1] k => sums[k].sum_f64());
        total.absolute += absolute;
        total.squared += squared;
    }
    total
}

impl ValueScratch {
    /// Begins a band that does not follow the last one: no row has been read.
    pub(super) fn begin(&mut self) {
        self.block_row = None;
    }

    /// Resizes the buffers for a plan.
    pub(super) fn resize(&mut self, plan: &LossPlan) {
        let (strip, planes) = (plan.strip, plan.planes);
        self.prediction.resize(3 * BLOCK_PX * linear_len(strip), 0.0);
        self.prediction_strips.resize(strip, Lanes::ZERO);
        self.target.resize(linear_len(3 * strip), 0.0);
        self.target_strips.resize(3 * strip, Lanes::ZERO);
        if planes != Planes::Values {
            self.weight_strips.resize(strip, Lanes::ZERO);
            // Zero beyond the image: a view of another width may have left values there.
            for (linear, rows) in [(&mut self.weights, 1), (&mut self.recorded, planes.count())] {
                linear.clear();
                linear.resize(rows * linear_len(strip), 0.0);
            }
        }
    }
}

/// The radiance of one row, in strips.
struct StripRow<'a> {
    prediction: &'a [Lanes],
    /// Channels interleaved.
    target: &'a [Lanes],
    channel: usize,
    target_scale: f32,
}

/// The weights of one row.
#[derive(Clone, Copy)]
struct RowWeights<'a> {
    /// Weights in strips.
    weights: &'a [Lanes],
    log2_1p_mu: f32,
}

/// One channel of a linear row.
struct LinearRow<'a> {
    channel: usize,
    target_scale: f32,
    radiance: &'a [f32],
    /// Every third number is the channel's.
    target: &'a [f32],
    weights: &'a [f32],
}

/// Evaluates a channel of a row under the mu-law of `[mu, 1 / ln(1 + mu)]`, writes it to row `j` of
/// its stacks, and adds its differences to `sums`. With weights, the prediction is mixed with the
/// target, and the slope (relative to that at 0) times the weight is written, too.
#[inline(always)]
fn mu_law_row<S: Simd>(
    simd: S,
    curve: [f32; 2],
    row: &StripRow<'_>,
    weights: Option<RowWeights<'_>>,
    out: &mut [RowStack],
    j: usize,
    sums: &mut [V<S>; 2],
) {
    let planes = out.len() / row.prediction.len();
    let pixels = row.prediction.iter().zip(row.target.chunks_exact(3));
    for (i, (out, (x, y))) in out.chunks_exact_mut(planes).zip(pixels).enumerate() {
        let mut x = mu_law(V::load(simd, x), curve);
        let y = mu_law(V::load(simd, &y[row.channel]) * row.target_scale, curve);
        if let Some(RowWeights { weights, log2_1p_mu }) = weights {
            let (zero, w) = (V::splat(simd, 0.0), V::load(simd, &weights[i]));
            // Exact for weights of 0 and 1. A prediction of weight 0 has no effect, even if it is
            // NaN.
            w.if_positive((x * -log2_1p_mu).exp2() * w, zero).store(&mut out[2][j]);
            x = w.if_positive(w.mul_add(x, (V::splat(simd, 1.0) - w) * y), y);
        }
        x.store(&mut out[0][j]);
        y.store(&mut out[1][j]);
        add_difference(x - y, sums);
    }
}

/// Adds the absolute and the squared difference.
#[inline(always)]
fn add_difference<S: Simd>(difference: V<S>, [absolute, squared]: &mut [V<S>; 2]) {
    *absolute = *absolute + difference.abs();
    *squared = difference.mul_add(difference, *squared);
}

/// Returns ln(1 + mu max(p, 0)) / ln(1 + mu).
#[inline(always)]
fn mu_law<S: Simd>(radiance: V<S>, [mu, scale]: [f32; 2]) -> V<S> {
    (radiance.max(radiance.lift(0.0)) * mu).ln_1p() * scale
}

/// Evaluates a channel of a row under a response: its five planes, linear.
fn response_row(response: &Response, row: &LinearRow<'_>, out: &mut [f32]) {
    let LinearRow { channel, target_scale, radiance, target, weights } = *row;
    let length = out.len() / Planes::Response.count();
    let (x_out, rest) = out.split_at_mut(length);
    let (y_out, rest) = rest.split_at_mut(length);
    let (slope_out, rest) = rest.split_at_mut(length);
    let (weight_out, position_out) = rest.split_at_mut(length);
    for (i, ((p, y), w)) in radiance.iter().zip(target.iter().step_by(3)).zip(weights).enumerate() {
        let y = y * target_scale;
        let found = response.against(channel, *p, y);
        let weight = w * found.weight;
        y_out[i] = y;
        x_out[i] = if *w > 0.0 { w.mul_add(found.value, (1.0 - w) * y) } else { y };
        slope_out[i] = if *w > 0.0 { w * found.by_radiance } else { 0.0 };
        weight_out[i] = weight;
        position_out[i] = found.position;
    }
}

/// Adds the differences of row `j` of the first two planes.
#[inline(always)]
fn add_differences<S: Simd>(simd: S, planes: &[RowStack], j: usize, sums: &mut [V<S>; 2]) {
    for planes in planes.chunks_exact(Planes::Response.count()) {
        add_difference(V::load(simd, &planes[0][j]) - V::load(simd, &planes[1][j]), sums);
    }
}
