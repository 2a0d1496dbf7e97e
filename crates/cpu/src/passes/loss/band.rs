//! SSIM and the gradient of one band of rows and one channel.
//!
//! Moments convolved along the rows; per column, moments convolved down the column, SSIM, its derivatives and their convolution down the
//! column; per row, the derivatives convolved along the row and the gradient. A band needs the moments of `2 RADIUS` rows beyond itself and
//! the derivatives of `RADIUS`, which its neighbours evaluate again: cheaper than a trip through memory.
//!
//! Between rows and columns, vectors lie in stacks of [`GROUP`] rows, `[rows / GROUP, columns, planes, GROUP]`: a group's inputs are three
//! stacks, and both the sweep along rows and the one down columns stay on few pages.

use std::ops::Range;

use fearless_simd::Simd;
use luxel_core::metrics::{SSIM_C1, SSIM_C2};
use luxel_core::response::piece;
use luxel_core::{RESPONSE_KNOTS, Real, each};

use super::convolution::{GROUP, RADIUS, Stack, Window};
use super::strips::{from_strips, linear_len, pad, write_blocks};
use super::{Curve, Plan, Planes};
use crate::lanes::{Lanes, M, V};
use crate::passes::rasterize_backward::BlockGradient;
use crate::view::{BLOCK_PX, TILE_BLOCKS};

/// Rows of a band: whole blocks. Fewer are more halo, more exceed the cache.
pub(super) const BAND_PX: usize = 40;
/// Rows whose derivatives a band needs.
const DERIVATIVE_ROWS: usize = BAND_PX + 2 * RADIUS;
/// Rows whose moments a band needs.
pub(super) const MOMENT_ROWS: usize = DERIVATIVE_ROWS + 2 * RADIUS;
/// Moments that SSIM needs: x, y, x^2 + y^2, xy. It takes the variances only as their sum.
const MOMENTS: usize = 4;
/// Derivatives of SSIM: by the means of x, x^2, xy.
const DERIVATIVES: usize = 3;
/// Vectors of the derivatives' stacks at one place.
const DERIVATIVE_STACKS: usize = DERIVATIVES * GROUP;

const _: () = assert!(BAND_PX.is_multiple_of(BLOCK_PX) && BAND_PX.is_multiple_of(GROUP) && RADIUS.is_multiple_of(GROUP));

/// Buffers of a thread, kept between steps.
pub(super) struct BandScratch {
    /// One row of the moments, padded: `[4, RADIUS + strip + RADIUS]`.
    row: Vec<Lanes>,
    /// Moments convolved along the rows: `[MOMENT_ROWS / GROUP, strip]`.
    moments: Vec<[Stack; MOMENTS]>,
    /// Derivatives of one column.
    column: [[Stack; DERIVATIVES]; DERIVATIVE_ROWS / GROUP],
    /// Derivatives convolved down the columns, padded: `[BAND_PX / GROUP, RADIUS + strip + RADIUS]`.
    derivatives: Vec<[Stack; DERIVATIVES]>,
    /// One row of the gradient, in strips.
    gradient: Vec<Lanes>,
    /// One row of the gradient by the recorded values, of the weights and of the places on the response, linear: `[3, linear]`.
    recorded: Vec<f32>,
    /// Linear rows of the gradient: `[3, BAND_PX, linear]`.
    linear: Vec<f32>,
}

/// A band of a channel.
#[derive(Clone, Copy)]
pub(super) struct Band {
    /// First row.
    pub(super) start: usize,
    /// Rows, at most [`BAND_PX`].
    pub(super) rows: usize,
    pub(super) channel: usize,
}

impl Band {
    /// Of `count` rows that start `halo` before the band, those within the image.
    pub(super) fn inside(&self, plan: &Plan, halo: usize, count: usize) -> Range<usize> {
        let first = halo.saturating_sub(self.start).min(count);
        first..(plan.height + halo - self.start).clamp(first, count)
    }
}

impl Default for BandScratch {
    fn default() -> Self {
        Self {
            row: Vec::new(),
            moments: Vec::new(),
            column: [[[Lanes::ZERO; GROUP]; DERIVATIVES]; DERIVATIVE_ROWS / GROUP],
            derivatives: Vec::new(),
            gradient: Vec::new(),
            recorded: Vec::new(),
            linear: Vec::new(),
        }
    }
}

impl BandScratch {
    fn resize(&mut self, strip: usize) {
        let padded = strip + 2 * RADIUS;
        self.row.resize(MOMENTS * padded, Lanes::ZERO);
        self.moments.resize(MOMENT_ROWS / GROUP * strip, [[Lanes::ZERO; GROUP]; MOMENTS]);
        self.derivatives.resize(BAND_PX / GROUP * padded, [[Lanes::ZERO; GROUP]; DERIVATIVES]);
        self.gradient.resize(strip, Lanes::ZERO);
        self.recorded.resize(3 * linear_len(strip), 0.0);
        self.linear.resize(3 * BAND_PX * linear_len(strip), 0.0);
    }
}

/// Gradient of a channel's band, left in the scratch, the gradient by a response's knots, added to `by_knots`, and the sum of SSIM.
#[inline(always)]
pub(super) fn differentiate_band<S: Simd>(
    simd: S,
    plan: &Plan,
    values: &[Lanes],
    band: Band,
    (scratch, by_knots): (&mut BandScratch, &mut [f64; RESPONSE_KNOTS]),
) -> f64 {
    scratch.resize(plan.strip);
    let window = Window::new(simd, &plan.window);
    horizontal_moments(simd, plan, values, band, &window, scratch);
    let mut total = 0.0;
    for i in 0..plan.strip {
        total += differentiate_column(simd, plan, (band, i), &window, scratch);
    }
    for derivatives in scratch.derivatives.chunks_exact_mut(plan.strip + 2 * RADIUS) {
        pad(simd, derivatives.as_flattened_mut().as_flattened_mut(), plan.strip, DERIVATIVE_STACKS);
    }
    let linear = linear_len(plan.strip);
    for row in 0..band.rows {
        gradient_row(simd, plan, values, (band, row), &window, scratch);
        if plan.planes == Planes::Response {
            add_by_knots(simd, plan, row_of(plan, values, 2 * RADIUS + row, band.channel), scratch, by_knots);
        }
        let out = &mut scratch.linear[(band.channel * BAND_PX + row) * linear..][..linear];
        from_strips(simd, &scratch.gradient, plan.strip, out);
        // Beyond the image the gradient is zero.
        out[plan.width..].fill(0.0);
    }
    total
}

/// Writes the gradient of a band's three channels to its blocks.
#[inline(always)]
pub(super) fn store_band(plan: &Plan, rows: usize, scratch: &mut BandScratch, blocks: &mut [BlockGradient]) {
    let linear = linear_len(plan.strip);
    for channel in scratch.linear.chunks_exact_mut(BAND_PX * linear) {
        // Beyond the image the gradient is zero.
        channel[rows * linear..].fill(0.0);
    }
    for (row, blocks) in blocks.chunks_exact_mut(plan.across * TILE_BLOCKS).enumerate() {
        write_blocks(blocks, &scratch.linear[row * BLOCK_PX * linear..], linear, BAND_PX);
    }
}

/// Values of a channel's row, counted as the moments' rows are: the planes, prediction and target first.
#[inline(always)]
fn row_of<'a>(plan: &Plan, values: &'a [Lanes], row: usize, channel: usize) -> &'a [Lanes] {
    let length = plan.planes.count() * plan.strip;
    &values[(row * 3 + channel) * length..][..length]
}

/// Convolves the moments along the rows.
#[inline(always)]
fn horizontal_moments<S: Simd>(simd: S, plan: &Plan, values: &[Lanes], band: Band, window: &Window<S>, scratch: &mut BandScratch) {
    let strip = plan.strip;
    let padded = strip + 2 * RADIUS;
    let inside = band.inside(plan, 2 * RADIUS, MOMENT_ROWS);
    for row in 0..MOMENT_ROWS {
        let out = &mut scratch.moments[row / GROUP * strip..][..strip];
        let place = row % GROUP;
        if !inside.contains(&row) {
            for moment in out.as_flattened_mut() {
                moment[place] = Lanes::ZERO;
            }
            continue;
        }
        let (x, rest) = row_of(plan, values, row, band.channel).split_at(strip);
        moments_of_row(simd, (x, &rest[..strip]), &mut scratch.row);
        for (k, moment) in scratch.row.chunks_exact(padded).enumerate() {
            let mut i = 0;
            while i + GROUP <= strip {
                let group = window.row_group(simd, &moment[i..], 1);
                let out = &mut out[i..i + GROUP];
                for j in 0..GROUP {
                    group[j].store(&mut out[j][k][place]);
                }
                i += GROUP;
            }
            for i in i..strip {
                window.row_single(simd, &moment[i..], 1).store(&mut out[i][k][place]);
            }
        }
    }
}

/// Moments of one row, padded.
#[inline(always)]
fn moments_of_row<S: Simd>(simd: S, (x, y): (&[Lanes], &[Lanes]), out: &mut [Lanes]) {
    let strip = x.len();
    let padded = strip + 2 * RADIUS;
    let (x_out, rest) = out.split_at_mut(padded);
    let (y_out, rest) = rest.split_at_mut(padded);
    let (squares, products) = rest.split_at_mut(padded);
    let inner = RADIUS..RADIUS + strip;
    let firsts = x_out[inner.clone()].iter_mut().zip(&mut y_out[inner.clone()]);
    let seconds = squares[inner.clone()].iter_mut().zip(&mut products[inner]);
    for (((x, y), (x_out, y_out)), (square, product)) in x.iter().zip(y).zip(firsts).zip(seconds) {
        let (x, y) = (V::load(simd, x), V::load(simd, y));
        x.store(x_out);
        y.store(y_out);
        x.mul_add(x, y * y).store(square);
        (x * y).store(product);
    }
    for row in [x_out, y_out, squares, products] {
        pad(simd, row, strip, 1);
    }
}

/// SSIM of column `i` of vectors (returned as the sum over the band's own rows), and its derivatives convolved down the column.
#[inline(always)]
fn differentiate_column<S: Simd>(simd: S, plan: &Plan, (band, i): (Band, usize), window: &Window<S>, scratch: &mut BandScratch) -> f64 {
    let inside = inside_mask(simd, plan, i);
    let rows_inside = band.inside(plan, RADIUS, DERIVATIVE_ROWS);
    let mut total = V::splat(simd, 0.0);
    let groups = band.rows.div_ceil(GROUP);
    for g in 0..groups + 2 {
        let [above, at, below] = each!([0, 1, 2] s => &scratch.moments[(g + s) * plan.strip + i]);
        let mut moments = [[Lanes::ZERO; GROUP]; MOMENTS];
        for (k, moments) in moments.iter_mut().enumerate() {
            let group = window.column_group(simd, [&above[k], &at[k], &below[k]]);
            for j in 0..GROUP {
                group[j].store(&mut moments[j]);
            }
        }
        let out = &mut scratch.column[g];
        for j in 0..GROUP {
            let row = g * GROUP + j;
            let (ssim, by) = similarity(simd, each!([0, 1, 2, 3] k => V::load(simd, &moments[k][j])), inside);
            if (RADIUS..RADIUS + band.rows).contains(&row) {
                total = total + ssim;
            }
            if rows_inside.contains(&row) {
                for k in 0..DERIVATIVES {
                    by[k].store(&mut out[k][j]);
                }
            } else {
                for derivative in out.iter_mut() {
                    derivative[j] = Lanes::ZERO;
                }
            }
        }
    }
    for g in 0..groups {
        let out = &mut scratch.derivatives[g * (plan.strip + 2 * RADIUS) + RADIUS + i];
        let [above, at, below] = each!([0, 1, 2] s => &scratch.column[g + s]);
        for (k, out) in out.iter_mut().enumerate() {
            let group = window.column_group(simd, [&above[k], &at[k], &below[k]]);
            for j in 0..GROUP {
                group[j].store(&mut out[j]);
            }
        }
    }
    total.lanes().iter().map(|v| f64::from(*v)).sum()
}

/// SSIM and half of its derivatives by the means of x (at constant variances' sum), x^2 and xy; zero outside of the image.
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

/// Lanes of vector `i` of a row that are within the image.
#[inline(always)]
fn inside_mask<S: Simd>(simd: S, plan: &Plan, i: usize) -> M<S> {
    (V::lane_numbers(simd) * plan.strip as f32 + i as f32).lt(V::splat(simd, plan.width as f32))
}

/// Gradient of a row of the band, in strips.
#[inline(always)]
fn gradient_row<S: Simd>(
    simd: S,
    plan: &Plan,
    values: &[Lanes],
    (band, row): (Band, usize),
    window: &Window<S>,
    scratch: &mut BandScratch,
) {
    let strip = plan.strip;
    let padded = strip + 2 * RADIUS;
    let (x, rest) = row_of(plan, values, 2 * RADIUS + row, band.channel).split_at(strip);
    let (y, slopes) = rest.split_at(strip);
    let derivatives = scratch.derivatives[row / GROUP * padded..][..padded].as_flattened().as_flattened();
    let [by_mx, by_exx, by_exy] = each!([0, 1, 2] k => &derivatives[k * GROUP + row % GROUP..]);
    let mut i = 0;
    while i + GROUP <= strip {
        let (x, y, out) = (&x[i..i + GROUP], &y[i..i + GROUP], &mut scratch.gradient[i..i + GROUP]);
        let first = i * DERIVATIVE_STACKS;
        let mut sums = window.row_group(simd, &by_mx[first..], DERIVATIVE_STACKS);
        let group = window.row_group(simd, &by_exx[first..], DERIVATIVE_STACKS);
        for j in 0..GROUP {
            sums[j] = group[j].mul_add(V::load(simd, &x[j]), sums[j]);
        }
        let group = window.row_group(simd, &by_exy[first..], DERIVATIVE_STACKS);
        for j in 0..GROUP {
            let by_ssim = group[j].mul_add(V::load(simd, &y[j]), sums[j]);
            let by_value = by_value(simd, plan, (&x[j], &y[j]), by_ssim);
            by_radiance(simd, plan, (&x[j], slopes.get(i + j)), by_value).store(&mut out[j]);
        }
        i += GROUP;
    }
    for i in i..strip {
        let [by_mx, by_exx, by_exy] = each!([0, 1, 2] k => window.row_single(simd, &derivatives[i * DERIVATIVE_STACKS + k * GROUP + row % GROUP..], DERIVATIVE_STACKS));
        let by_ssim = by_exy.mul_add(V::load(simd, &y[i]), by_exx.mul_add(V::load(simd, &x[i]), by_mx));
        let by_value = by_value(simd, plan, (&x[i], &y[i]), by_ssim);
        by_radiance(simd, plan, (&x[i], slopes.get(i)), by_value).store(&mut scratch.gradient[i]);
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

/// Adds the gradient by the knots of a row, whose gradient by value is in the scratch, and makes that the gradient by radiance.
#[inline(always)]
fn add_by_knots<S: Simd>(simd: S, plan: &Plan, row: &[Lanes], scratch: &mut BandScratch, by_knots: &mut [f64; RESPONSE_KNOTS]) {
    let strip = plan.strip;
    let (slopes, rest) = row[2 * strip..].split_at(strip);
    let (weights, positions) = rest.split_at(strip);
    for (strips, out) in
        [scratch.gradient.as_slice(), weights, positions].into_iter().zip(scratch.recorded.chunks_exact_mut(linear_len(strip)))
    {
        from_strips(simd, strips, strip, out);
    }
    let (by_value, rest) = scratch.recorded.split_at(linear_len(strip));
    let (weights, positions) = rest.split_at(linear_len(strip));
    for ((by_value, weight), position) in by_value.iter().zip(weights).zip(positions).take(plan.width) {
        let (k, along) = piece(*position);
        let gradient = f64::from(by_value * weight);
        by_knots[k] += gradient * f64::from(1.0 - along);
        by_knots[k + 1] += gradient * f64::from(along);
    }
    for (gradient, slope) in scratch.gradient.iter_mut().zip(slopes) {
        (V::load(simd, gradient) * V::load(simd, slope)).store(gradient);
    }
}
