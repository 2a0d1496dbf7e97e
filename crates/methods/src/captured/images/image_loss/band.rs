//! A band of rows of a channel: its differences, its SSIM, and the gradient by its values.
//!
//! In: a channel of prediction and target. Out: sums over the band's pixels, the gradient by them,
//! and 1 - SSIM of their windows. The gradient of a pixel needs the derivatives of all windows that
//! see it, and those need what their windows see: a band computes both for as many rows above and
//! below, which fit into a core's cache.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use luxel_core::{SQUARED_KNEE, SSIM_RADIUS, each};
use luxel_lanes::{LANES, sums};

use super::similarity::{DERIVATIVES, MEANS, similarity};
use super::window::{Derivatives, GROUP, MarginedRow, Taps, ValuePair, derivatives_down, means_down, taps};

/// Rows of a band: whole groups. A constant, on which sums depend.
pub(super) const BAND: usize = 40;
/// Rows whose windows see the band, in whole groups.
const WINDOW_ROWS: usize = (BAND + 2 * SSIM_RADIUS).next_multiple_of(GROUP);
/// Rows that those windows see.
const VALUE_ROWS: usize = WINDOW_ROWS + 2 * SSIM_RADIUS;

const _: () = assert!(BAND.is_multiple_of(GROUP));

/// A channel to be compared.
pub(super) struct Channel<'a> {
    /// Width and height.
    pub(super) size: [usize; 2],
    /// Prediction and target, `[H, W]`.
    pub(super) x: &'a [f32],
    pub(super) y: &'a [f32],
    /// Weights of pixels and of values, `[H, W]`.
    pub(super) pixels: Option<&'a [f32]>,
    pub(super) values: Option<&'a [f32]>,
    /// Gradient by an absolute difference of weight 1, and by an SSIM.
    pub(super) by_difference: f32,
    pub(super) by_ssim: f32,
    pub(super) squared_share: f32,
}

/// Receives what is found for the pixels of a band.
pub(super) struct BandOut<'a> {
    pub(super) by_value: &'a mut [f32],
    pub(super) dissimilarity: Option<&'a mut [f32]>,
}

/// Sums over a band.
#[derive(Clone, Copy, Default)]
pub(super) struct Sums {
    pub(super) absolute: f64,
    pub(super) squared: f64,
    /// Sum of SSIM times the weight of its value, and sum of these weights.
    pub(super) ssim: f64,
    pub(super) weight: f64,
}

/// Buffers of a band, for the next one.
#[derive(Default)]
pub(super) struct Scratch {
    /// Values, `[VALUE_ROWS, stride]`.
    values: Vec<ValuePair>,
    /// Derivatives of SSIM, `[WINDOW_ROWS, stride]`.
    by: Vec<Derivatives>,
    /// Means or derivatives of the rows of a group.
    rows: [[MarginedRow; MEANS]; GROUP],
}

impl Scratch {
    fn resize(&mut self, stride: usize) {
        if self.by.len() != WINDOW_ROWS * stride {
            self.values.resize(VALUE_ROWS * stride, [[0.0; LANES]; 2]);
            self.by.resize(WINDOW_ROWS * stride, [[0.0; LANES]; DERIVATIVES]);
            self.rows.as_flattened_mut().iter_mut().for_each(|row| row.resize(stride));
        }
    }
}

/// Returns the sum of sixteen numbers.
fn sum_of<S: Simd>(lanes: f32x16<S>) -> f64 {
    f64::from(sums::sum_in_order(lanes.to_array()))
}

impl Channel<'_> {
    /// Returns the number of an image's row that lies `before` rows before row `row` of a band.
    fn row(&self, first_row: usize, row: usize, before: usize) -> Option<usize> {
        (first_row + row).checked_sub(before).filter(|row| *row < self.size[1])
    }

    /// Compares the band that begins with a row.
    #[inline(always)]
    pub(super) fn compare<S: Simd>(&self, simd: S, first_row: usize, scratch: &mut Scratch, out: &mut BandOut<'_>) -> Sums {
        let (stride, taps) = (self.size[0].div_ceil(LANES), taps());
        scratch.resize(stride);
        for (row, values) in scratch.values.chunks_exact_mut(stride).enumerate() {
            self.collect(self.row(first_row, row, 2 * SSIM_RADIUS), values);
        }
        let mut sums = Sums::default();
        for group in (0..WINDOW_ROWS).step_by(GROUP) {
            self.differentiate_windows(simd, &taps, [first_row, group], scratch, out, &mut sums);
        }
        let band_rows = (self.size[1] - first_row).min(BAND);
        for group in (0..band_rows).step_by(GROUP) {
            self.differentiate_values(simd, &taps, [first_row, group], scratch, out, &mut sums);
        }
        sums
    }

    /// Writes a row of the prediction, mixed with the target by the weights of pixels, and of the
    /// target; zeros for a row that the image lacks.
    #[inline(always)]
    fn collect(&self, row: Option<usize>, out: &mut [ValuePair]) {
        let Some(row) = row else { return out.fill([[0.0; LANES]; 2]) };
        let width = self.size[0];
        let at = row * width..(row + 1) * width;
        let (x, y) = (&self.x[at.clone()], &self.y[at.clone()]);
        let weights = self.pixels.map(|weights| &weights[at]);
        for (vector, out) in out.iter_mut().enumerate() {
            let first = vector * LANES;
            let end = width.min(first + LANES);
            if let (Some(x), Some(y)) = (x[first..].first_chunk(), y[first..].first_chunk()) {
                *out = [*x, *y];
            } else {
                *out = [[0.0; LANES]; 2];
                out[0][..end - first].copy_from_slice(&x[first..end]);
                out[1][..end - first].copy_from_slice(&y[first..end]);
            }
            if let Some(weights) = weights {
                let [x, y] = out;
                x.iter_mut().zip(y).zip(&weights[first..end]).for_each(|((x, y), w)| *x = w * *x + (1.0 - w) * *y);
            }
        }
    }

    /// Returns the weights of the values of a vector, zeros behind the last one.
    #[inline(always)]
    fn weights_of_values<S: Simd>(&self, simd: S, row: usize, vector: usize) -> f32x16<S> {
        let (width, first) = (self.size[0], vector * LANES);
        let len = LANES.min(width - first);
        match self.values {
            None if len == LANES => f32x16::splat(simd, 1.0),
            None => {
                let mut weights = [0.0; LANES];
                weights[..len].fill(1.0);
                f32x16::load_array_ref(simd, &weights)
            }
            Some(values) if len == LANES => f32x16::from_slice(simd, &values[row * width + first..][..LANES]),
            Some(values) => {
                let mut weights = [0.0; LANES];
                weights[..len].copy_from_slice(&values[row * width + first..][..len]);
                f32x16::load_array_ref(simd, &weights)
            }
        }
    }

    /// Writes the derivatives of SSIM of a group of rows of windows, and adds up the SSIM of those
    /// within the band.
    #[inline(always)]
    fn differentiate_windows<S: Simd>(
        &self,
        simd: S,
        taps: &Taps,
        [first_row, group]: [usize; 2],
        scratch: &mut Scratch,
        out: &mut BandOut<'_>,
        sums: &mut Sums,
    ) {
        let (width, stride) = (self.size[0], self.size[0].div_ceil(LANES));
        let Scratch { values, by, rows } = scratch;
        for vector in 0..stride {
            let means = means_down(simd, taps, &values[group * stride + vector..], stride);
            each!([0, 1, 2, 3] row => each!([0, 1, 2, 3] mean => rows[row][mean].store(vector, means[row][mean])));
        }
        for (j, rows) in rows.iter().enumerate() {
            let by = &mut by[(group + j) * stride..][..stride];
            let Some(row) = self.row(first_row, group + j, SSIM_RADIUS) else {
                by.fill([[0.0; LANES]; DERIVATIVES]);
                continue;
            };
            let inside = (SSIM_RADIUS..SSIM_RADIUS + BAND).contains(&(group + j));
            let (mut ssim, mut weights) = (f32x16::splat(simd, 0.0), f32x16::splat(simd, 0.0));
            for (vector, by) in by.iter_mut().enumerate() {
                let [a, b, c, d] = rows;
                let means = [
                    a.window(simd, taps, vector),
                    b.window(simd, taps, vector),
                    c.window(simd, taps, vector),
                    d.window(simd, taps, vector),
                ];
                let found = similarity(simd, means);
                let weight = self.weights_of_values(simd, row, vector);
                (weight * found.by[0]).store_array(&mut by[0]);
                (weight * found.by[1]).store_array(&mut by[1]);
                (weight * found.by[2]).store_array(&mut by[2]);
                ssim = weight.mul_add(found.ssim, ssim);
                weights += weight;
                if let Some(dissimilarity) = out.dissimilarity.as_mut().filter(|_| inside) {
                    let values = (f32x16::splat(simd, 1.0) - found.ssim).to_array();
                    let end = width.min((vector + 1) * LANES);
                    let out = &mut dissimilarity[(row - first_row) * width..][vector * LANES..end];
                    out.copy_from_slice(&values[..out.len()]);
                }
            }
            if inside {
                sums.ssim += sum_of(ssim);
                sums.weight += sum_of(weights);
            }
        }
    }

    /// Writes the gradient by a group of rows of values, and adds up their differences.
    #[inline(always)]
    fn differentiate_values<S: Simd>(
        &self,
        simd: S,
        taps: &Taps,
        [first_row, group]: [usize; 2],
        scratch: &mut Scratch,
        out: &mut BandOut<'_>,
        sums: &mut Sums,
    ) {
        let (width, stride) = (self.size[0], self.size[0].div_ceil(LANES));
        let Scratch { values, by, rows } = scratch;
        for vector in 0..stride {
            let found = derivatives_down(simd, taps, &by[group * stride + vector..], stride);
            each!([0, 1, 2, 3] row => each!([0, 1, 2] by => rows[row][by].store(vector, found[row][by])));
        }
        let c = |value: f32| f32x16::splat(simd, value);
        let (zero, by_ssim) = (c(0.0), c(self.by_ssim));
        let (l1, l2) = (self.by_difference * (1.0 - self.squared_share), self.by_difference * self.squared_share / SQUARED_KNEE);
        for (j, rows) in rows.iter().enumerate() {
            let Some(row) = self.row(first_row, group + j, 0) else { break };
            let values = &values[(group + j + 2 * SSIM_RADIUS) * stride..][..stride];
            let out = &mut out.by_value[(group + j) * width..][..width];
            let (mut absolute, mut squared) = (zero, zero);
            for (vector, [x, y]) in values.iter().enumerate() {
                let (x, y) = (f32x16::load_array_ref(simd, x), f32x16::load_array_ref(simd, y));
                let weight = self.weights_of_values(simd, row, vector);
                let d = x - y;
                absolute = weight.mul_add(d.abs(), absolute);
                squared = (weight * d).mul_add(d, squared);
                let sign = d.simd_gt(zero).select(c(l1), d.simd_lt(zero).select(c(-l1), zero));
                let [a, b, product, _] = rows;
                let windows = [a.window(simd, taps, vector), b.window(simd, taps, vector), product.window(simd, taps, vector)];
                let by_window = y.mul_add(windows[2], (x + x).mul_add(windows[1], windows[0]));
                let gradient = weight.mul_add(d.mul_add(c(l2), sign), by_ssim * by_window);
                let end = width.min((vector + 1) * LANES);
                self.store_gradient(gradient, row * width + vector * LANES, &mut out[vector * LANES..end]);
            }
            sums.absolute += sum_of(absolute);
            sums.squared += sum_of(squared);
        }
    }

    /// Writes the gradient by the pixels from `first` on, times their weights.
    #[inline(always)]
    fn store_gradient<S: Simd>(&self, gradient: f32x16<S>, first: usize, out: &mut [f32]) {
        match self.pixels {
            None if out.len() == LANES => gradient.store_slice(out),
            None => out.copy_from_slice(&gradient.to_array()[..out.len()]),
            Some(weights) => {
                let gradient = gradient.to_array();
                out.iter_mut().zip(gradient).zip(&weights[first..]).for_each(|((out, gradient), weight)| *out = gradient * weight);
            }
        }
    }
}
