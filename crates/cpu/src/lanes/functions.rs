//! Elementary functions on sixteen numbers, and [`Real`], through which core's formulas run on
//! vectors.
//!
//! In and out: [`V`]. Accuracy and range are given with each function; tests hold them.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, i32x16};
use luxel_core::Real;

use super::V;

/// Newton steps of a reciprocal: x86 estimates it to 12 bits or better, other machines to 8, where
/// one step would give only 16.
const NEWTON_STEPS: usize = if cfg!(any(target_arch = "x86", target_arch = "x86_64")) { 1 } else { 2 };

/// The argument for which [`V::exp2`] is exactly zero.
pub(crate) const LOG2_OF_ZERO: f32 = -127.0;

impl<S: Simd> V<S> {
    /// Returns 1 / `self` to a few units in the last place, for normal numbers: the hardware's
    /// estimate, refined by steps of Newton's method, each of which doubles its bits. Division is
    /// several times slower.
    #[inline(always)]
    pub(crate) fn reciprocal(self) -> Self {
        let two = f32x16::splat(self.0.token(), 2.0);
        let mut estimate = self.0.approximate_recip();
        for _ in 0..NEWTON_STEPS {
            estimate = estimate * (-self.0).mul_add(estimate, two);
        }
        Self(estimate)
    }

    /// Returns 2 to the power of `self`, for arguments in [-126, 127]; relative error below 3e-7.
    /// Zero for [`LOG2_OF_ZERO`].
    ///
    /// The nearest integer is added to the exponent's bits, and a polynomial is evaluated on the
    /// rest (minimax of the relative error with p(0) = 1 and p'(0) = ln 2).
    #[inline(always)]
    pub(crate) fn exp2(self) -> Self {
        let whole = self.0.round_ties_even();
        let f = self.0 - whole;
        let simd = f.token();
        let c = |value: f32| f32x16::splat(simd, value);
        let p = c(1.330_060_5e-3);
        let p = p.mul_add(f, c(9.669_691e-3));
        let p = p.mul_add(f, c(5.550_558_5e-2));
        let p = p.mul_add(f, c(0.240_222_83));
        let p = p.mul_add(f, c(std::f32::consts::LN_2));
        let p = p.mul_add(f, c(1.0));
        let exponent: i32x16<S> = whole.to_int();
        let bits: i32x16<S> = p.bitcast();
        Self((bits + (exponent << 23)).bitcast())
    }

    /// Returns the natural logarithm of positive normal numbers; relative error of the result below
    /// 2e-7 away from 1, absolute below 1e-7 near it.
    #[inline(always)]
    pub(crate) fn ln(self) -> Self {
        let simd = self.0.token();
        let c = |value: f32| f32x16::splat(simd, value);
        let bits: i32x16<S> = self.0.bitcast();
        // Mantissa in [sqrt(1/2), sqrt(2)), so that the series converges evenly on both sides of 1.
        let shifted = bits - i32x16::splat(simd, 0x3f35_04f3);
        let exponent = shifted >> 23;
        let mantissa: f32x16<S> = (bits - (exponent << 23)).bitcast();
        let e: f32x16<S> = exponent.to_float();
        // ln(m) = 2 atanh(s), s = (m - 1) / (m + 1), |s| <= 0.1716.
        let s = (mantissa - c(1.0)) / (mantissa + c(1.0));
        let z = s * s;
        let p = c(2.0 / 9.0);
        let p = p.mul_add(z, c(2.0 / 7.0));
        let p = p.mul_add(z, c(2.0 / 5.0));
        let p = p.mul_add(z, c(2.0 / 3.0));
        let p = (p * z).mul_add(s, s + s);
        Self(e.mul_add(c(std::f32::consts::LN_2), p))
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
    /// Returns e to the power of `self`, which is clamped to [-87, 88].
    #[inline(always)]
    fn exp(self) -> Self {
        // The low part of log2(e) keeps the relative error at 1e-6 for arguments of tens.
        let x = self.max(self.lift(-87.0)).min(self.lift(88.0));
        let high = x * std::f32::consts::LOG2_E;
        let whole = Self(high.0.round_ties_even());
        // x - whole ln 2 in two parts (Cody and Waite), then back to base 2.
        let rest = whole.mul_add(x.lift(-0.693_359_4), x);
        let rest = whole.mul_add(x.lift(2.121_944_4e-4), rest);
        let fraction = (rest * std::f32::consts::LOG2_E).exp2();
        let simd = x.0.token();
        let exponent: i32x16<S> = whole.0.to_int();
        let scale: f32x16<S> = ((exponent + i32x16::splat(simd, 127)) << 23).bitcast();
        Self(fraction.0 * scale)
    }
    /// Returns ln(1 + `self`), for arguments in [0, 2^126]; relative error below 2e-7.
    ///
    /// With the power of two 2^e nearest to 1 + x in ratio, ln(1 + x) = e ln 2 + ln(1 + f) where f
    /// = (1 + x) 2^-e - 1 comes from x itself in one rounding, so small arguments keep all of their
    /// digits.
    #[inline(always)]
    fn ln_1p(self) -> Self {
        let simd = self.0.token();
        let c = |value: f32| f32x16::splat(simd, value);
        let bits: i32x16<S> = (self.0 + c(1.0)).bitcast();
        // e in the exponent's place: (1 + x) 2^-e is in [sqrt(1/2), sqrt(2)).
        let exponent = (bits - i32x16::splat(simd, 0x3f35_04f3)) & i32x16::splat(simd, !0x007f_ffff);
        let scale: f32x16<S> = (i32x16::splat(simd, 1f32.to_bits().cast_signed()) - exponent).bitcast();
        let f = self.0.mul_add(scale, scale - c(1.0));
        // Minimax polynomial of (ln(1 + f) - f) / f^2; its error is 3.5e-8 of ln(1 + f).
        let p = c(0.087_348_43);
        let p = p.mul_add(f, c(-0.143_075_21));
        let p = p.mul_add(f, c(0.149_179_74));
        let p = p.mul_add(f, c(-0.165_705_08));
        let p = p.mul_add(f, c(0.199_620_72));
        let p = p.mul_add(f, c(-0.250_017_55));
        let p = p.mul_add(f, c(0.333_339_5));
        let p = p.mul_add(f, c(-0.499_999_9));
        let p = p.mul_add(f * f, f);
        let e: f32x16<S> = exponent.to_float();
        Self(e.mul_add(c(std::f32::consts::LN_2 / (1 << 23) as f32), p))
    }
    #[inline(always)]
    fn if_positive(self, then: Self, otherwise: Self) -> Self {
        Self::select(self.gt(self.lift(0.0)), then, otherwise)
    }
}
