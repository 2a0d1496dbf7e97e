//! Means over the window of SSIM: down the columns of a group of rows, then along each row.
//!
//! In: rows of whole vectors, with the rows that the window reaches above and below. Out: sums over
//! the window. Rows beyond an image, and numbers beyond a row, are zeros. The window is symmetric:
//! along a row, the two numbers of equal weight are added first.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use luxel_core::{SSIM_RADIUS, SSIM_TAPS, each, ssim_window};
use luxel_lanes::LANES;

use super::similarity::{DERIVATIVES, MEANS};

/// Rows whose windows are summed together: they share what is loaded.
pub(super) const GROUP: usize = 4;
/// Rows that the windows of a group reach.
const GROUP_ROWS: usize = GROUP + 2 * SSIM_RADIUS;
/// Numbers that the window reads for a vector along a row.
const REACH: usize = LANES + 2 * SSIM_RADIUS;

// The loops below name their rows and taps one by one.
const _: () = assert!(GROUP == 4 && SSIM_RADIUS == 5 && MEANS == 4 && DERIVATIVES == 3);

/// Weights of the window.
pub(super) type Taps = [f32; SSIM_TAPS];

/// Returns the weights.
pub(super) fn taps() -> Taps {
    ssim_window().map(|weight| weight as f32)
}

/// A row with room for the window on both sides.
#[derive(Clone, Default)]
pub(super) struct MarginedRow(Vec<f32>);

impl MarginedRow {
    /// Makes room for a row of `stride` vectors.
    pub(super) fn resize(&mut self, stride: usize) {
        self.0.clear();
        self.0.resize(stride * LANES + 2 * SSIM_RADIUS, 0.0);
    }

    #[inline(always)]
    pub(super) fn store<S: Simd>(&mut self, vector: usize, values: f32x16<S>) {
        values.store_slice(&mut self.0[SSIM_RADIUS + vector * LANES..][..LANES]);
    }

    /// Returns the sums of the window around the numbers of a vector.
    #[inline(always)]
    pub(super) fn window<S: Simd>(&self, simd: S, taps: &Taps, vector: usize) -> f32x16<S> {
        let reach: &[f32; REACH] = self.0[vector * LANES..].first_chunk().unwrap_or(&[0.0; REACH]);
        let at = |tap: usize| f32x16::from_slice(simd, &reach[tap..tap + LANES]);
        let weight = |tap: usize| f32x16::splat(simd, taps[tap]);
        let mut sum = at(SSIM_RADIUS) * weight(SSIM_RADIUS);
        each!([0, 1, 2, 3, 4] tap => sum = (at(tap) + at(2 * SSIM_RADIUS - tap)).mul_add(weight(tap), sum));
        sum
    }
}

/// Vectors of a prediction and its target.
pub(super) type ValuePair = [[f32; LANES]; 2];
/// Vectors of the derivatives of SSIM.
pub(super) type Derivatives = [[f32; LANES]; DERIVATIVES];

/// Returns the means down the columns of a group of rows; `column` starts at the first vector that
/// the first row's window reaches, and has a row every `stride` vectors.
#[inline(always)]
pub(super) fn means_down<S: Simd>(simd: S, taps: &Taps, column: &[ValuePair], stride: usize) -> [[f32x16<S>; MEANS]; GROUP] {
    let mut sums = [[f32x16::splat(simd, 0.0); MEANS]; GROUP];
    let column = &column[..(GROUP_ROWS - 1) * stride + 1];
    each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13] row => {
        let [x, y] = &column[row * stride];
        let (x, y) = (f32x16::load_array_ref(simd, x), f32x16::load_array_ref(simd, y));
        let (squares, product) = (x.mul_add(x, y * y), x * y);
        each!([0, 1, 2, 3] of => {
            if (of..of + SSIM_TAPS).contains(&row) {
                let weight = f32x16::splat(simd, taps[row - of]);
                sums[of][0] = x.mul_add(weight, sums[of][0]);
                sums[of][1] = y.mul_add(weight, sums[of][1]);
                sums[of][2] = squares.mul_add(weight, sums[of][2]);
                sums[of][3] = product.mul_add(weight, sums[of][3]);
            }
        });
    });
    sums
}

/// Returns the sums of derivatives down the columns of a group of rows, as [`means_down`].
#[inline(always)]
pub(super) fn derivatives_down<S: Simd>(simd: S, taps: &Taps, column: &[Derivatives], stride: usize) -> [[f32x16<S>; DERIVATIVES]; GROUP] {
    let mut sums = [[f32x16::splat(simd, 0.0); DERIVATIVES]; GROUP];
    let column = &column[..(GROUP_ROWS - 1) * stride + 1];
    each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13] row => {
        let [a, b, c] = &column[row * stride];
        let [a, b, c] = [f32x16::load_array_ref(simd, a), f32x16::load_array_ref(simd, b), f32x16::load_array_ref(simd, c)];
        each!([0, 1, 2, 3] of => {
            if (of..of + SSIM_TAPS).contains(&row) {
                let weight = f32x16::splat(simd, taps[row - of]);
                sums[of][0] = a.mul_add(weight, sums[of][0]);
                sums[of][1] = b.mul_add(weight, sums[of][1]);
                sums[of][2] = c.mul_add(weight, sums[of][2]);
            }
        });
    });
    sums
}
