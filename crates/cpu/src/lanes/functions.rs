//! Elementary functions of [`V`], and [`Real`], through which core's formulas run on vectors.
//!
//! In and out: [`V`]. Accuracy and range are given with [`luxel_lanes::functions`].

use fearless_simd::Simd;
use fearless_simd::prelude::*;
use luxel_core::Real;
use luxel_lanes::functions;

use super::V;

impl<S: Simd> V<S> {
    /// Returns 1 / `self` ([`functions::reciprocal`]).
    #[inline(always)]
    pub(crate) fn reciprocal(self) -> Self {
        Self(functions::reciprocal(self.0))
    }

    /// Returns 2 to the power of `self` ([`functions::exp2`]).
    #[inline(always)]
    pub(crate) fn exp2(self) -> Self {
        Self(functions::exp2(self.0))
    }

    /// Returns the natural logarithm ([`functions::ln`]).
    #[inline(always)]
    pub(crate) fn ln(self) -> Self {
        Self(functions::ln(self.0))
    }
}

impl<S: Simd> Real for V<S> {
    #[inline(always)]
    fn lift(self, value: f32) -> Self {
        Self::splat(self.0.token(), value)
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        Self(self.0.mul_add(factor.0, term.0))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(self.0.max(other.0))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(self.0.min(other.0))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.sqrt())
    }
    #[inline(always)]
    fn exp(self) -> Self {
        Self(functions::exp_by_exp2(self.0))
    }
    #[inline(always)]
    fn ln_1p(self) -> Self {
        Self(functions::ln_1p(self.0))
    }
    #[inline(always)]
    fn if_positive(self, then: Self, otherwise: Self) -> Self {
        Self::select(self.gt(self.lift(0.0)), then, otherwise)
    }
}
