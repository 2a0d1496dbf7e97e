//! SSIM of windows.
//!
//! In: means of x, y, x^2 + y^2 and x y over windows. Out: SSIM, and its derivatives by the means
//! of x, x^2 and x y.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use luxel_core::{SSIM_C1, SSIM_C2};

/// Means of a window that SSIM needs; only the sum of the variances occurs in it.
pub(super) const MEANS: usize = 4;
/// Means by which SSIM is differentiated.
pub(super) const DERIVATIVES: usize = 3;

/// SSIM of windows, with its derivatives.
pub(super) struct Similarity<S: Simd> {
    pub(super) ssim: f32x16<S>,
    pub(super) by: [f32x16<S>; DERIVATIVES],
}

/// Compares windows.
#[inline(always)]
pub(super) fn similarity<S: Simd>(simd: S, [mx, my, squares, product]: [f32x16<S>; MEANS]) -> Similarity<S> {
    let (c1, c2) = (f32x16::splat(simd, SSIM_C1 as f32), f32x16::splat(simd, SSIM_C2 as f32));
    let two = f32x16::splat(simd, 2.0);
    let (both, mean_squares) = (mx * my, mx.mul_add(mx, my * my));
    let (a, b) = (two * both + c1, two * (product - both) + c2);
    let (c, d) = (mean_squares + c1, squares - mean_squares + c2);
    let inverse = f32x16::splat(simd, 1.0) / (c * d);
    let (by_c, by_d) = (inverse * d, inverse * c);
    let ssim = a * b * inverse;
    let by_mean = two * (my * (b - a) * inverse + mx * ssim * (by_d - by_c));
    Similarity { ssim, by: [by_mean, -ssim * by_d, two * a * inverse] }
}
