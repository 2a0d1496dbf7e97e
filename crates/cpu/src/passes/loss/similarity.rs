//! SSIM of a channel's group of rows, and its derivatives convolved along the rows.
//!
//! In: values under the curve. Out: the sum of SSIM, and derivatives that [`super::gradient`]
//! convolves down the columns.
//!
//! Moments of the window are convolved down the columns, then along the rows.

use fearless_simd::Simd;
use luxel_core::{Real, each};
use luxel_core::{SSIM_C1, SSIM_C2};

use super::convolution::{Column, GROUP, Products, RADIUS, Row, RowStack, Squares, Window};
use super::plan::LossPlan;
use super::rows::RowGroup;
use super::strips::pad;
use crate::lanes::{Lanes, M, V};

/// Moments that SSIM needs: x, y, x^2 + y^2, xy. Only the sum of the variances occurs in it.
const MOMENTS: usize = 4;
/// Derivatives of SSIM: by the means of x, x^2, xy.
pub(super) const DERIVATIVES: usize = 3;

/// The buffers of a thread.
#[derive(Default)]
pub(super) struct SimilarityScratch {
    /// Moments convolved down the columns, [`padded`]: `[GROUP, MOMENTS, padded]`.
    moments: Vec<Lanes>,
    /// Derivatives of one row, [`padded`]: `[DERIVATIVES, padded]`.
    derivatives: Vec<Lanes>,
}

impl SimilarityScratch {
    /// Resizes the buffers for a plan.
    pub(super) fn resize(&mut self, plan: &LossPlan) {
        self.moments.resize(GROUP * MOMENTS * padded(plan), Lanes::ZERO);
        self.derivatives.resize(DERIVATIVES * padded(plan), Lanes::ZERO);
    }
}

/// Returns the number of vectors of a padded row, with whole groups of results.
fn padded(plan: &LossPlan) -> usize {
    plan.strip.next_multiple_of(GROUP) + 2 * RADIUS
}

/// Computes the derivatives of a channel's group of rows, `[strip, DERIVATIVES]`, from the values
/// of the group above, of the group and of the group below, `[strip, planes]`. Returns the sum of
/// SSIM.
#[inline(always)]
pub(super) fn differentiate_similarity<S: Simd>(
    simd: S,
    plan: &LossPlan,
    values: [&[RowStack]; 3],
    group: RowGroup,
    scratch: &mut SimilarityScratch,
    out: &mut [RowStack],
) -> f64 {
    let window = &Window::new(simd, &plan.window);
    vertical_moments(simd, plan, values, window, &mut scratch.moments);
    let mut total = 0.0;
    for (j, moments) in scratch.moments.chunks_exact_mut(MOMENTS * padded(plan)).enumerate() {
        if group.row(plan, j).is_none() {
            out.iter_mut().for_each(|derivative| derivative[j] = Lanes::ZERO);
            continue;
        }
        for moment in moments.chunks_exact_mut(padded(plan)) {
            pad(simd, moment, plan.strip);
        }
        total += differentiate_row(simd, plan, moments, window, &mut scratch.derivatives);
        horizontal_derivatives(simd, plan, &mut scratch.derivatives, window, out, j);
    }
    total
}

/// Convolves the moments down the columns.
#[inline(always)]
fn vertical_moments<S: Simd>(simd: S, plan: &LossPlan, values: [&[RowStack]; 3], window: &Window<S>, out: &mut [Lanes]) {
    let (planes, padded) = (plan.planes.count(), padded(plan));
    for i in 0..plan.strip {
        let [x, y] = each!([0, 1] plane => Column(each!([0, 1, 2] n => &values[n][i * planes + plane])));
        let moments = [
            window.convolve(simd, x),
            window.convolve(simd, y),
            window.convolve(simd, Squares(x, y)),
            window.convolve(simd, Products(x, y)),
        ];
        for (k, moment) in moments.iter().enumerate() {
            for j in 0..GROUP {
                moment[j].store(&mut out[(j * MOMENTS + k) * padded + RADIUS + i]);
            }
        }
    }
}

/// Convolves a row's moments along it and differentiates SSIM. Returns its sum.
#[inline(always)]
fn differentiate_row<S: Simd>(simd: S, plan: &LossPlan, moments: &[Lanes], window: &Window<S>, out: &mut [Lanes]) -> f64 {
    let (strip, padded) = (plan.strip, padded(plan));
    let mut total = V::splat(simd, 0.0);
    for first in (0..strip).step_by(GROUP) {
        let mut group = [[Lanes::ZERO; MOMENTS]; GROUP];
        for k in 0..MOMENTS {
            let moment = window.convolve(simd, Row::at(&moments[k * padded + first..]));
            for j in 0..GROUP {
                moment[j].store(&mut group[j][k]);
            }
        }
        for (i, moments) in (first..strip).zip(&group) {
            let moments = each!([0, 1, 2, 3] k => V::load(simd, &moments[k]));
            let (ssim, by) = similarity(simd, moments, inside_mask(simd, plan, i));
            total = total + ssim;
            for k in 0..DERIVATIVES {
                by[k].store(&mut out[k * padded + RADIUS + i]);
            }
        }
    }
    total.sum_f64()
}

/// Convolves a row's derivatives along it, and writes them to row `j` of their stacks.
#[inline(always)]
fn horizontal_derivatives<S: Simd>(simd: S, plan: &LossPlan, rows: &mut [Lanes], window: &Window<S>, out: &mut [RowStack], j: usize) {
    for (k, row) in rows.chunks_exact_mut(padded(plan)).enumerate() {
        pad(simd, row, plan.strip);
        for first in (0..plan.strip).step_by(GROUP) {
            let group = window.convolve(simd, Row::at(&row[first..]));
            let out = out[first * DERIVATIVES + k..].iter_mut().step_by(DERIVATIVES);
            for (v, out) in group.iter().zip(out) {
                v.store(&mut out[j]);
            }
        }
    }
}

/// Returns SSIM, and half of its derivatives by the means of x (at a constant sum of variances),
/// x^2 and xy; zero outside the image.
#[inline(always)]
fn similarity<S: Simd>(simd: S, [mx, my, squares, exy]: [V<S>; MOMENTS], inside: M<S>) -> (V<S>, [V<S>; DERIVATIVES]) {
    let c = |value: f32| V::splat(simd, value);
    let mean_squares = mx.mul_add(mx, my * my);
    let mean_product = mx * my;
    let a = mean_product.mul_add(c(2.0), c(SSIM_C1 as f32));
    let b = (exy - mean_product).mul_add(c(2.0), c(SSIM_C2 as f32));
    let d = mean_squares + SSIM_C1 as f32;
    let e = squares - mean_squares + SSIM_C2 as f32;
    let inverse = V::select(inside, (d * e).reciprocal(), c(0.0));
    let ssim = a * b * inverse;
    let by_exx = -(ssim * (d * inverse));
    let by_exy = a * inverse;
    let by_mx = my.mul_add(b - a, mx * ssim * (d - e)) * inverse;
    (ssim, [by_mx, by_exx, by_exy])
}

/// Returns the lanes of vector `i` of a row that are within the image.
#[inline(always)]
fn inside_mask<S: Simd>(simd: S, plan: &LossPlan, i: usize) -> M<S> {
    (V::lane_numbers(simd) * plan.strip as f32 + i as f32).lt(V::splat(simd, plan.width as f32))
}
