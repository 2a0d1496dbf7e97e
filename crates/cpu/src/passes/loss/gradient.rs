//! The gradient of the loss by the radiance of a channel's group of rows.
//!
//! In: values and derivatives of SSIM. Out: linear rows of the gradient, and the gradient by a
//! response's knots.
//!
//! The derivatives of SSIM are convolved down the columns: the window is symmetric and the padding
//! is zero, so the convolution is its own adjoint.

use fearless_simd::Simd;
use luxel_core::response::piece;
use luxel_core::{RESPONSE_KNOTS, Real, each};

use super::convolution::{Column, GROUP, RowStack, Window};
use super::plan::{Curve, LossPlan, Planes};
use super::rows::{BAND_PX, RowGroup};
use super::similarity::DERIVATIVES;
use super::strips::{from_strips, linear_len};
use crate::lanes::{Lanes, V};

/// The buffers of a thread.
#[derive(Default)]
pub(super) struct GradientScratch {
    /// Rows of a group in strips: `[GROUP, strip]`.
    strips: Vec<Lanes>,
    /// A row of a plane in strips.
    plane: Vec<Lanes>,
    /// One row of the gradient by the values, of the weights and of the positions on the response,
    /// linear: `[3, linear]`.
    recorded: Vec<f32>,
    /// A band's linear rows: `[3, BAND_PX, linear]`.
    linear: Vec<f32>,
}

impl GradientScratch {
    /// Resizes the buffers for a plan.
    pub(super) fn resize(&mut self, plan: &LossPlan) {
        self.strips.resize(GROUP * plan.strip, Lanes::ZERO);
        self.plane.resize(plan.strip, Lanes::ZERO);
        self.recorded.resize(3 * linear_len(plan.strip), 0.0);
        self.linear.resize(3 * BAND_PX * linear_len(plan.strip), 0.0);
    }

    /// Returns the rows of the band's channels, one channel after the other.
    pub(super) fn linear(&self) -> &[f32] {
        &self.linear
    }
}

/// The rows of a channel that are differentiated.
pub(super) struct ChannelRows<'a> {
    pub(super) group: RowGroup,
    /// Values of the group, `[strip, planes]`.
    pub(super) values: &'a [RowStack],
    /// Derivatives of the group above, of the group and of the group below, `[strip, DERIVATIVES]`.
    pub(super) derivatives: [&'a [RowStack]; 3],
}

/// Writes the gradient of a channel's group to the scratch's linear rows, from `first_row` on, and
/// adds the gradient by a response's knots to `by_knots`.
#[inline(always)]
pub(super) fn differentiate_values<S: Simd>(
    simd: S,
    plan: &LossPlan,
    ChannelRows { group, values, derivatives }: ChannelRows<'_>,
    scratch: &mut GradientScratch,
    first_row: usize,
    by_knots: &mut [f64; RESPONSE_KNOTS],
) {
    let (strip, window) = (plan.strip, Window::new(simd, &plan.window));
    for (i, values) in values.chunks_exact(plan.planes.count()).enumerate() {
        let [by_mx, by_exx, by_exy] =
            each!([0, 1, 2] k => window.convolve(simd, Column(each!([0, 1, 2] n => &derivatives[n][i * DERIVATIVES + k]))));
        for j in 0..GROUP {
            let (x, y) = (&values[0][j], &values[1][j]);
            let by_ssim = by_exy[j].mul_add(V::load(simd, y), by_exx[j].mul_add(V::load(simd, x), by_mx[j]));
            let by_value = by_value(simd, plan, x, y, by_ssim);
            by_radiance(simd, plan, x, values.get(2).map(|slopes| &slopes[j]), by_value).store(&mut scratch.strips[j * strip + i]);
        }
    }
    let linear = linear_len(strip);
    for j in 0..GROUP {
        let inside = if group.row(plan, j).is_some() { plan.width } else { 0 };
        if plan.planes == Planes::Response && inside > 0 {
            add_by_knots(simd, plan, values, j, scratch, by_knots);
        }
        let out = &mut scratch.linear[(first_row + j) * linear..][..linear];
        from_strips(simd, &scratch.strips[j * strip..][..strip], strip, out);
        // Beyond the image the gradient is zero.
        out[inside..].fill(0.0);
    }
}

/// Returns the gradient of the loss by the value under the curve, divided by [`Curve::slope`].
/// `by_ssim` is half the gradient of the sum of SSIM by the value.
#[inline(always)]
fn by_value<S: Simd>(simd: S, plan: &LossPlan, x: &Lanes, y: &Lanes, by_ssim: V<S>) -> V<S> {
    let c = |value: f32| V::splat(simd, value);
    let difference = V::load(simd, x) - V::load(simd, y);
    let by_l1 = difference.if_positive(c(plan.l1_factor), (-difference).if_positive(c(-plan.l1_factor), c(0.0)));
    by_ssim.mul_add(c(plan.ssim_factor), difference.mul_add(c(plan.l2_factor), by_l1))
}

/// Returns the gradient of the loss by radiance. For a response it remains the gradient by value,
/// which the knots need first; [`add_by_knots`] multiplies it by the slope.
#[inline(always)]
fn by_radiance<S: Simd>(simd: S, plan: &LossPlan, x: &Lanes, slope: Option<&Lanes>, by_value: V<S>) -> V<S> {
    match (&plan.curve, slope) {
        // T'(p) = mu / ((1 + mu p) ln(1 + mu)) and 1 / (1 + mu p) = 2^(-T log2(1 + mu)); the
        // factors hold the rest.
        (Curve::MuLaw { log2_1p_mu, .. }, None) => by_value * (V::load(simd, x) * -*log2_1p_mu).exp2(),
        (Curve::MuLaw { .. }, Some(slope)) => by_value * V::load(simd, slope),
        (Curve::Response(_), _) => by_value,
    }
}

/// Adds the gradient by the knots of row `j`, given its gradient by value in the scratch, and
/// converts that to the gradient by radiance.
#[inline(always)]
fn add_by_knots<S: Simd>(
    simd: S,
    plan: &LossPlan,
    values: &[RowStack],
    j: usize,
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
