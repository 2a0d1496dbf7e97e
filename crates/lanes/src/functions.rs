//! Elementary functions of sixteen numbers, which the CPU engine and published methods share.
//!
//! In and out: vectors. Accuracy and range are given with each function; tests hold them. The same
//! operations on every instruction set.
//!
//! There are two exponentials and two of ln(1 + x), because trained results depend on the last
//! bits: the engine's are [`exp_by_exp2`] and [`ln_1p`], those of the methods' networks and losses
//! [`exp`] and [`ln_1p_by_ratio`].

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, i32x16};

/// Newton steps of a reciprocal: x86 estimates it to 12 bits or better, other machines to 8, where
/// one step would give only 16.
const NEWTON_STEPS: usize = if cfg!(any(target_arch = "x86", target_arch = "x86_64")) { 1 } else { 2 };

/// The argument for which [`exp2`] is exactly zero.
pub const LOG2_OF_ZERO: f32 = -127.0;

/// Limits of the arguments of exponentials: beyond them the results are no normal numbers.
const EXP_RANGE: [f32; 2] = [-87.0, 88.0];

/// ln 2 in two parts (Cody and Waite): a whole number times the first is exact.
const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];

/// Coefficients of r^7 to r^2 of the exponential's series.
const EXPONENTIAL: [f32; 6] = [1.0 / 5040.0, 1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5];

/// Returns 1 / x to a few units in the last place, for normal numbers: the hardware's estimate,
/// refined by steps of Newton's method, each of which doubles its bits. Division is several times
/// slower.
#[inline(always)]
pub fn reciprocal<S: Simd>(x: f32x16<S>) -> f32x16<S> {
    let two = f32x16::splat(x.token(), 2.0);
    let mut estimate = x.approximate_recip();
    for _ in 0..NEWTON_STEPS {
        estimate = estimate * (-x).mul_add(estimate, two);
    }
    estimate
}

/// Returns 2^x, for x in [-126, 127]; relative error below 3e-7. Zero for [`LOG2_OF_ZERO`].
///
/// The nearest integer is added to the exponent's bits, and a polynomial is evaluated on the rest
/// (minimax of the relative error with p(0) = 1 and p'(0) = ln 2).
#[inline(always)]
pub fn exp2<S: Simd>(x: f32x16<S>) -> f32x16<S> {
    let whole = x.round_ties_even();
    let f = x - whole;
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
    (bits + (exponent << 23)).bitcast()
}

/// Returns e^x by way of [`exp2`], where x is clamped to [-87, 88]; relative error below 1e-6. The
/// engine's; it differs from [`exp`] in the last bits.
#[inline(always)]
pub fn exp_by_exp2<S: Simd>(x: f32x16<S>) -> f32x16<S> {
    let simd = x.token();
    let c = |value: f32| f32x16::splat(simd, value);
    let x = x.max(c(EXP_RANGE[0])).min(c(EXP_RANGE[1]));
    let high = x * std::f32::consts::LOG2_E;
    let whole = high.round_ties_even();
    // x - whole ln 2, which keeps the error small for arguments of tens, then back to base 2.
    let rest = whole.mul_add(c(-LN_2[0]), x);
    let rest = whole.mul_add(c(-LN_2[1]), rest);
    let fraction = exp2(rest * std::f32::consts::LOG2_E);
    let exponent: i32x16<S> = whole.to_int();
    let scale: f32x16<S> = ((exponent + i32x16::splat(simd, 127)) << 23).bitcast();
    fraction * scale
}

/// Returns e^x by its series, where x is clamped to [-87, 88]; relative error below 3e-7. That of
/// the published methods; it differs from [`exp_by_exp2`] in the last bits.
#[inline(always)]
pub fn exp<S: Simd>(x: f32x16<S>) -> f32x16<S> {
    let simd = x.token();
    let c = |value: f32| f32x16::splat(simd, value);
    let x = x.max(c(EXP_RANGE[0])).min(c(EXP_RANGE[1]));
    let whole = (x * c(std::f32::consts::LOG2_E)).round_ties_even();
    // x - whole ln 2: the rest is within ln 2 / 2.
    let r = whole.mul_add(c(-LN_2[1]), whole.mul_add(c(-LN_2[0]), x));
    let mut p = c(EXPONENTIAL[0]);
    for coefficient in &EXPONENTIAL[1..] {
        p = p.mul_add(r, c(*coefficient));
    }
    let p = (p * r).mul_add(r, r) + c(1.0);
    let exponent: i32x16<S> = whole.to_int();
    let bits: i32x16<S> = p.bitcast();
    (bits + (exponent << 23)).bitcast()
}

/// Returns ln x of positive normal numbers; relative error of the result below 2e-7 away from 1,
/// absolute below 1e-7 near it.
#[inline(always)]
pub fn ln<S: Simd>(x: f32x16<S>) -> f32x16<S> {
    let simd = x.token();
    let c = |value: f32| f32x16::splat(simd, value);
    let bits: i32x16<S> = x.bitcast();
    // Mantissa in [sqrt(1/2), sqrt(2)), so that the series converges evenly on both sides of 1.
    let shifted = bits - i32x16::splat(simd, 0x3f35_04f3);
    let exponent = shifted >> 23;
    let mantissa: f32x16<S> = (bits - (exponent << 23)).bitcast();
    let e: f32x16<S> = exponent.to_float();
    // ln(m) = 2 artanh(s), s = (m - 1) / (m + 1), |s| <= 0.1716.
    let s = (mantissa - c(1.0)) / (mantissa + c(1.0));
    let z = s * s;
    let p = c(2.0 / 9.0);
    let p = p.mul_add(z, c(2.0 / 7.0));
    let p = p.mul_add(z, c(2.0 / 5.0));
    let p = p.mul_add(z, c(2.0 / 3.0));
    let p = (p * z).mul_add(s, s + s);
    e.mul_add(c(std::f32::consts::LN_2), p)
}

/// Returns ln(1 + x), for x in [0, 2^126]; relative error below 2e-7. The engine's; it differs from
/// [`ln_1p_by_ratio`] in the last bits.
///
/// With the power of two 2^e nearest to 1 + x in ratio, ln(1 + x) = e ln 2 + ln(1 + f) where f = (1
/// + x) 2^-e - 1 comes from x itself in one rounding, so small arguments keep all of their digits.
#[inline(always)]
pub fn ln_1p<S: Simd>(x: f32x16<S>) -> f32x16<S> {
    let simd = x.token();
    let c = |value: f32| f32x16::splat(simd, value);
    let bits: i32x16<S> = (x + c(1.0)).bitcast();
    // e in the exponent's place: (1 + x) 2^-e is in [sqrt(1/2), sqrt(2)).
    let exponent = (bits - i32x16::splat(simd, 0x3f35_04f3)) & i32x16::splat(simd, !0x007f_ffff);
    let scale: f32x16<S> = (i32x16::splat(simd, 1f32.to_bits().cast_signed()) - exponent).bitcast();
    let f = x.mul_add(scale, scale - c(1.0));
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
    e.mul_add(c(std::f32::consts::LN_2 / (1 << 23) as f32), p)
}

/// Returns ln(1 + x) of x >= 0; relative error below 4e-7. That of the published methods; it
/// differs from [`ln_1p`] in the last bits.
#[inline(always)]
pub fn ln_1p_by_ratio<S: Simd>(x: f32x16<S>) -> f32x16<S> {
    let simd = x.token();
    let one = f32x16::splat(simd, 1.0);
    let sum = one + x;
    // What rounding took from the sum, the ratio of x to the rest of the sum gives back.
    let rest = sum - one;
    rest.simd_eq(f32x16::splat(simd, 0.0)).select(x, ln(sum) * (x / rest))
}

/// Returns 1 / (1 + e^-x), by [`exp`]; absolute error below 1e-7.
#[inline(always)]
pub fn sigmoid<S: Simd>(x: f32x16<S>) -> f32x16<S> {
    let one = f32x16::splat(x.token(), 1.0);
    one / (one + exp(-x))
}

/// Returns tanh x, by [`exp`]; absolute error below 2e-7.
#[inline(always)]
pub fn tanh<S: Simd>(x: f32x16<S>) -> f32x16<S> {
    let one = f32x16::splat(x.token(), 1.0);
    one - f32x16::splat(x.token(), 2.0) / (one + exp(x + x))
}

/// Returns ln(1 + e^x), by [`exp`] and [`ln_1p_by_ratio`]; relative error below 1e-6 above -80.
#[inline(always)]
pub fn softplus<S: Simd>(x: f32x16<S>) -> f32x16<S> {
    x.max(f32x16::splat(x.token(), 0.0)) + ln_1p_by_ratio(exp(-x.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LANES, Lanes, Level};

    /// Checks a function against its exact values, on the best instruction set and on the baseline.
    macro_rules! check {
        ($function:ident, $inputs:expr, $exact:expr, $bound:expr) => {
            let inputs: Vec<f32> = $inputs.collect();
            for level in [Level::best(), Level::baseline()] {
                for inputs in inputs.chunks(LANES) {
                    let mut block = Lanes([1.0; LANES]);
                    block.0[..inputs.len()].copy_from_slice(inputs);
                    let found = crate::dispatch!(level, simd => $function(block.load(simd)).to_array());
                    for (x, found) in inputs.iter().zip(found) {
                        let expected: f64 = $exact(f64::from(*x));
                        let bound: f64 = $bound(expected);
                        assert!((f64::from(found) - expected).abs() <= bound, "{} {level:?} {x}: {found:e} {expected:e}", stringify!($function));
                    }
                }
            }
        };
    }

    fn linear(from: f32, to: f32) -> impl Iterator<Item = f32> {
        (0..16_000).map(move |i| from + (to - from) * i as f32 / 16_000.0)
    }

    fn logarithmic(from: f32, to: f32) -> impl Iterator<Item = f32> {
        (0..16_000).map(move |i| from * (to / from).powf(i as f32 / 16_000.0))
    }

    fn powers() -> impl Iterator<Item = f32> {
        (-120..=120).flat_map(|e| [1.0f32, 1.3, 1.99].map(|m| m * (e as f32).exp2()))
    }

    #[test]
    fn functions_of_the_engine_are_as_exact_as_they_say() {
        check!(reciprocal, logarithmic(1e-4, 1e4), f64::recip, |y: f64| 3e-7 * y);
        check!(exp2, linear(-100.0, 100.0), f64::exp2, |y: f64| 4e-7 * y);
        check!(exp_by_exp2, linear(-80.0, 80.0), f64::exp, |y: f64| 1e-6 * y);
        check!(ln_1p, logarithmic(1e-30, 8e37), f64::ln_1p, |y: f64| 2e-7 * y);
        check!(ln, logarithmic(1e-30, 0.9), f64::ln, |y: f64| 1e-6 * y.abs());
    }

    #[test]
    fn functions_of_methods_are_as_exact_as_they_say() {
        check!(exp, linear(-86.0, 87.0), f64::exp, |y: f64| 3e-7 * y);
        check!(ln, powers().chain(linear(0.5, 2.0)), f64::ln, |y: f64| 2e-7 * y.abs() + 1e-7);
        check!(ln_1p_by_ratio, powers().chain(linear(0.0, 2.0)), f64::ln_1p, |y: f64| 4e-7 * y);
        check!(sigmoid, linear(-30.0, 30.0), |x: f64| 1.0 / (1.0 + (-x).exp()), |_| 1e-7);
        check!(tanh, linear(-30.0, 30.0), f64::tanh, |_| 2e-7);
        check!(softplus, linear(-80.0, 80.0), |x: f64| x.max(0.0) + (-x.abs()).exp().ln_1p(), |y: f64| 1e-6 * y);
    }

    #[test]
    fn nothing_is_blended_where_the_logarithm_is_that_of_zero() {
        let zero = crate::dispatch!(Level::best(), simd => exp2(f32x16::splat(simd, LOG2_OF_ZERO)).to_array());
        assert_eq!(zero.map(f32::to_bits), [0; LANES]);
    }
}
