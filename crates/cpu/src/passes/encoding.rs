//! The meaning of a block's rows of scale and opacity: parameters of training, or the values
//! themselves.

use fearless_simd::Simd;
use luxel_core::Real;

use crate::lanes::V;

/// The meaning of the rows of scale and opacity.
pub(crate) trait Encoding {
    /// Returns the standard deviation.
    fn sigma<S: Simd>(row: V<S>) -> V<S>;
    /// Returns the opacity.
    fn opacity<S: Simd>(row: V<S>) -> V<S>;
}

/// Logarithms of scales, and logits of opacities: what training optimises.
pub(crate) struct Logarithmic;

impl Encoding for Logarithmic {
    #[inline(always)]
    fn sigma<S: Simd>(row: V<S>) -> V<S> {
        row.exp()
    }

    #[inline(always)]
    fn opacity<S: Simd>(row: V<S>) -> V<S> {
        let one = row.lift(1.0);
        one / (one + (-row).exp())
    }
}

/// Scales and opacities themselves.
pub(crate) struct Linear;

impl Encoding for Linear {
    #[inline(always)]
    fn sigma<S: Simd>(row: V<S>) -> V<S> {
        row
    }

    #[inline(always)]
    fn opacity<S: Simd>(row: V<S>) -> V<S> {
        row
    }
}
