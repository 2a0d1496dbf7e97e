//! Elementary functions of sixteen numbers, for the images and networks of methods.
//!
//! In and out: vectors, or numbers in place. Accuracy is given with each function; tests hold it.
//! The same operations on every instruction set.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, i32x16};
use luxel_lanes::Level;

/// Numbers of a vector.
pub(crate) const LANES: usize = 16;

/// Coefficients of r^7 to r^2 of the exponential's series.
const EXPONENTIAL: [f32; 6] = [1.0 / 5040.0, 1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5];

/// Returns e^x, where x is cut to -87 to 88; relative error below 3e-7.
#[inline(always)]
pub(crate) fn exp<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    let c = |value: f32| f32x16::splat(simd, value);
    let x = x.max(c(-87.0)).min(c(88.0));
    let whole = (x * c(std::f32::consts::LOG2_E)).round_ties_even();
    // x - whole ln 2 in two parts (Cody and Waite): the rest is within ln 2 / 2.
    let r = whole.mul_add(c(2.121_944_4e-4), whole.mul_add(c(-0.693_359_4), x));
    let mut p = c(EXPONENTIAL[0]);
    for coefficient in &EXPONENTIAL[1..] {
        p = p.mul_add(r, c(*coefficient));
    }
    let p = (p * r).mul_add(r, r) + c(1.0);
    let exponent: i32x16<S> = whole.to_int();
    let bits: i32x16<S> = p.bitcast();
    (bits + (exponent << 23)).bitcast()
}

/// Returns ln x of positive normal numbers; relative error below 2e-7 away from 1, absolute below
/// 1e-7 near it.
#[inline(always)]
pub(crate) fn ln<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    let c = |value: f32| f32x16::splat(simd, value);
    let bits: i32x16<S> = x.bitcast();
    // Mantissa in sqrt(1/2) to sqrt(2), where the series of both sides of 1 converge alike.
    let exponent = (bits - i32x16::splat(simd, 0x3f35_04f3)) >> 23;
    let mantissa: f32x16<S> = (bits - (exponent << 23)).bitcast();
    let e: f32x16<S> = exponent.to_float();
    // ln m = 2 artanh s, s = (m - 1) / (m + 1).
    let s = (mantissa - c(1.0)) / (mantissa + c(1.0));
    let z = s * s;
    let p = c(2.0 / 9.0).mul_add(z, c(2.0 / 7.0)).mul_add(z, c(2.0 / 5.0)).mul_add(z, c(2.0 / 3.0));
    e.mul_add(c(std::f32::consts::LN_2), (p * z).mul_add(s, s + s))
}

/// Returns ln(1 + x) of x >= 0; relative error below 4e-7.
#[inline(always)]
pub(crate) fn ln_1p<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    let one = f32x16::splat(simd, 1.0);
    let sum = one + x;
    // What rounding took from the sum, the ratio of x to the rest of the sum gives back.
    let rest = sum - one;
    rest.simd_eq(f32x16::splat(simd, 0.0)).select(x, ln(simd, sum) * (x / rest))
}

/// Returns 1 / (1 + e^-x); absolute error below 1e-7.
#[inline(always)]
pub(crate) fn sigmoid<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    let one = f32x16::splat(simd, 1.0);
    one / (one + exp(simd, -x))
}

/// Returns tanh x; absolute error below 2e-7.
#[inline(always)]
pub(crate) fn tanh<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    let one = f32x16::splat(simd, 1.0);
    one - f32x16::splat(simd, 2.0) / (one + exp(simd, x + x))
}

/// Returns ln(1 + e^x); relative error below 1e-6 above -80.
#[inline(always)]
pub(crate) fn softplus<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    x.max(f32x16::splat(simd, 0.0)) + ln_1p(simd, exp(simd, -x.abs()))
}

/// A function of single numbers.
pub(crate) trait Elementwise: Sync {
    /// Returns the function's values.
    fn apply<S: Simd>(&self, simd: S, x: f32x16<S>) -> f32x16<S>;
}

/// Applies a function to numbers in place.
#[inline(always)]
pub(crate) fn map<S: Simd>(simd: S, function: &impl Elementwise, numbers: &mut [f32]) {
    let (whole, rest) = numbers.as_chunks_mut::<LANES>();
    for block in whole {
        function.apply(simd, f32x16::load_array_ref(simd, block)).store_array(block);
    }
    if !rest.is_empty() {
        let mut block = [1.0; LANES];
        block[..rest.len()].copy_from_slice(rest);
        function.apply(simd, f32x16::load_array_ref(simd, &block)).store_array(&mut block);
        rest.copy_from_slice(&block[..rest.len()]);
    }
}

/// Applies a function to numbers in place, by the best instructions of the processor.
pub(crate) fn map_all(function: &impl Elementwise, numbers: &mut [f32]) {
    luxel_lanes::dispatch!(Level::best(), simd => map(simd, function, numbers));
}

/// [`sigmoid`].
pub(crate) struct Sigmoid;

impl Elementwise for Sigmoid {
    #[inline(always)]
    fn apply<S: Simd>(&self, simd: S, x: f32x16<S>) -> f32x16<S> {
        sigmoid(simd, x)
    }
}

/// [`softplus`].
pub(crate) struct Softplus;

impl Elementwise for Softplus {
    #[inline(always)]
    fn apply<S: Simd>(&self, simd: S, x: f32x16<S>) -> f32x16<S> {
        softplus(simd, x)
    }
}

/// ln max(x, floor).
pub(crate) struct LnAbove {
    pub(crate) floor: f32,
}

impl Elementwise for LnAbove {
    #[inline(always)]
    fn apply<S: Simd>(&self, simd: S, x: f32x16<S>) -> f32x16<S> {
        ln(simd, x.max(f32x16::splat(simd, self.floor)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    macro_rules! elementwise {
        ($name:ident) => {{
            struct Function;
            impl Elementwise for Function {
                #[inline(always)]
                fn apply<S: Simd>(&self, simd: S, x: f32x16<S>) -> f32x16<S> {
                    $name(simd, x)
                }
            }
            Function
        }};
    }

    fn check(function: &impl Elementwise, inputs: impl Iterator<Item = f32>, exact: impl Fn(f64) -> f64, bound: impl Fn(f64) -> f64) {
        let inputs: Vec<f32> = inputs.collect();
        let mut found = inputs.clone();
        map_all(function, &mut found);
        for (x, found) in inputs.into_iter().zip(found) {
            let expected = exact(x.into());
            assert!((f64::from(found) - expected).abs() <= bound(expected), "{x}: {found:e} {expected:e}");
        }
    }

    #[test]
    fn functions_are_as_exact_as_they_say() {
        let line = |from: f32, to: f32| (0..4001).map(move |i| from + (to - from) * i as f32 / 4000.0);
        let powers = || (-120..=120).flat_map(|e| [1.0f32, 1.3, 1.99].map(|m| m * (e as f32).exp2()));
        check(&elementwise!(exp), line(-86.0, 87.0), f64::exp, |y| 3e-7 * y);
        check(&elementwise!(ln), powers().chain(line(0.5, 2.0)), f64::ln, |y| 2e-7 * y.abs() + 1e-7);
        check(&elementwise!(ln_1p), powers().chain(line(0.0, 2.0)), f64::ln_1p, |y| 4e-7 * y);
        check(&Sigmoid, line(-30.0, 30.0), |x| 1.0 / (1.0 + (-x).exp()), |_| 1e-7);
        check(&elementwise!(tanh), line(-30.0, 30.0), f64::tanh, |_| 2e-7);
        check(&Softplus, line(-80.0, 80.0), |x| x.max(0.0) + (-x.abs()).exp().ln_1p(), |y| 1e-6 * y);
    }
}
