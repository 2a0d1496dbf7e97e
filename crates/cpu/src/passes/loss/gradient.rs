//! Gradient of the loss by the radiance of a channel's group of rows.
//!
//! The derivatives of SSIM are convolved down the columns: the window is symmetric and the padding zero, so the convolution is its own adjoint.

use fearless_simd::Simd;
use luxel_core::response::piece;
use luxel_core::{RESPONSE_KNOTS, Real, each};

use super::convolution::{Column, GROUP, Stack, Window};
use super::similarity::DERIVATIVES;
use super::strips::{from_strips, linear_len};
use super::sweep::{BAND_PX, Group};
use super::{Curve, Plan, Planes};
use crate::lanes::{Lanes, V};

/// Buffers of a thread.
#[derive(Default)]
pub(super) struct GradientScratch {
    /// Rows of a group in strips: `[GROUP, strip]`.
    strips: Vec<Lanes>,
    /// A row of a plane in strips.
    plane: Vec<Lanes>,
    /// One row of the gradient by the recorded values, of the weights and of the places on the response, linear: `[3, linear]`.
    recorded: Vec<f32>,
    /// A band's linear rows: `[3, BAND_PX, linear]`.
    linear: Vec<f32>,
}

impl GradientScratch {
    pub(super) fn resize(&mut self, plan: &Plan) {
        self.strips.resize(GROUP * plan.strip, Lanes::ZERO);
        self.plane.resize(plan.strip, Lanes::ZERO);
        self.recorded.resize(3 * linear_len(plan.strip), 0.0);
        self.linear.resize(3 * BAND_PX * linear_len(plan.strip), 0.0);
    }

    /// Rows of the band's channels, one after the other.
    pub(super) fn linear(&self) -> &[f32] {
        &self.linear
    }
}

/// Gradient of a channel's `group` of rows, into the scratch's linear rows from number `first_row` on, and that by a response's knots, added to `by_knots`.
///
/// Values are the group's, `[strip, planes]`, derivatives those of the group above, its own and those of the one below, `[strip, DERIVATIVES]`.
#[inline(always)]
pub(super) fn differentiate_values<S: Simd>(
    simd: S,
    plan: &Plan,
    (group, values, derivatives): (Group, &[Stack], [&[Stack]; 3]),
    (scratch, first_row): (&mut GradientScratch, usize),
    by_knots: &mut [f64; RESPONSE_KNOTS],
) {
    let (strip, window) = (plan.strip, Window::new(simd, &plan.window));
    for (i, values) in values.chunks_exact(plan.planes.count()).enumerate() {
        let [by_mx, by_exx, by_exy] =
            each!([0, 1, 2] k => window.convolve(simd, Column(each!([0, 1, 2] n => &derivatives[n][i * DERIVATIVES + k]))));
        for j in 0..GROUP {
            let (x, y) = (&values[0][j], &values[1][j]);
            let by_ssim = by_exy[j].mul_add(V::load(simd, y), by_exx[j].mul_add(V::load(simd, x), by_mx[j]));
            let by_value = by_value(simd, plan, (x, y), by_ssim);
            by_radiance(simd, plan, (x, values.get(2).map(|slopes| &slopes[j])), by_value).store(&mut scratch.strips[j * strip + i]);
        }
    }
    let linear = linear_len(strip);
    for j in 0..GROUP {
        let inside = if group.row(plan, j).is_some() { plan.width } else { 0 };
        if plan.planes == Planes::Response && inside > 0 {
            add_by_knots(simd, plan, (values, j), scratch, by_knots);
        }
        let out = &mut scratch.linear[(first_row + j) * linear..][..linear];
        from_strips(simd, &scratch.strips[j * strip..][..strip], strip, out);
        // Beyond the image the gradient is zero.
        out[inside..].fill(0.0);
    }
}

/// Gradient of the loss by the value under the curve, over the curve's own slope, of half the gradient of the sum of SSIM by it.
#[inline(always)]
fn by_value<S: Simd>(simd: S, plan: &Plan, (x, y): (&Lanes, &Lanes), by_ssim: V<S>) -> V<S> {
    let c = |value: f32| V::splat(simd, value);
    let difference = V::load(simd, x) - V::load(simd, y);
    let by_l1 = difference.if_positive(c(plan.l1_factor), (-difference).if_positive(c(-plan.l1_factor), c(0.0)));
    by_ssim.mul_add(c(plan.ssim_factor), difference.mul_add(c(plan.l2_factor), by_l1))
}

/// Gradient of the loss by radiance: through a response it stays by value, for the knots, and is multiplied by the slope behind them.
#[inline(always)]
fn by_radiance<S: Simd>(simd: S, plan: &Plan, (x, slope): (&Lanes, Option<&Lanes>), by_value: V<S>) -> V<S> {
    match (&plan.curve, slope) {
        // T'(p) = mu / ((1 + mu p) ln(1 + mu)) and 1 / (1 + mu p) = 2^(-T log2(1 + mu)); the factors hold the rest.
        (Curve::MuLaw { log2_1p_mu, .. }, None) => by_value * (V::load(simd, x) * -*log2_1p_mu).exp2(),
        (Curve::MuLaw { .. }, Some(slope)) => by_value * V::load(simd, slope),
        (Curve::Response(_), _) => by_value,
    }
}

/// Adds the gradient by the knots of row `j`, whose gradient by value is in the scratch, and makes that the gradient by radiance.
#[inline(always)]
fn add_by_knots<S: Simd>(
    simd: S,
    plan: &Plan,
    (values, j): (&[Stack], usize),
    scratch: &mut GradientScratch,
    by_knots: &mut [f64; RESPONSE_KNOTS],
) {
    let (strip, linear) = (plan.strip, linear_len(plan.strip));
    let gradient = &mut scratch.strips[j * strip..][..strip];
    let planes = || values.chunks_exact(plan.planes.count());
    from_strips(simd, gradient, strip, &mut scratch.recorded[..linear]);
    for (plane, out) in [3, 4].into_iter().zip(scratch.recorded[linear..].chunks_exact_mut(linear)) {
        scratch.plane.iter_mut().zip(planes()).for_each(|(out, planes)| *out = planes[plane][j]);
        from_strips(simd, &scratch.plane, strip, out);
    }
    let (by_value, rest) = scratch.recorded.split_at(linear);
    let (weights, positions) = rest.split_at(linear);
    for ((by_value, weight), position) in by_value.iter().zip(weights).zip(positions).take(plan.width) {
        let (k, along) = piece(*position);
        let gradient = f64::from(by_value * weight);
        by_knots[k] += gradient * f64::from(1.0 - along);
        by_knots[k + 1] += gradient * f64::from(along);
    }
    for (gradient, planes) in gradient.iter_mut().zip(planes()) {
        (V::load(simd, gradient) * V::load(simd, &planes[2][j])).store(gradient);
    }
}
