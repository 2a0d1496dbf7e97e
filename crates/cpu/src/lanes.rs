//! Sixteen numbers at a time: the vector type of all passes.
//!
//! [`V`] wraps `fearless_simd`'s `f32x16`, which is one AVX-512 register, two of AVX2, four of SSE or NEON. Every pass is written
//! once over the instruction set `S` and dispatched at run time. Vectors are always sixteen lanes, so reductions have one order on
//! every machine.

use std::ops::{Add, Div, Mul, Neg, Sub};

use bytemuck::{Pod, Zeroable};
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, f32x16, i32x16, mask32x16};
use luxel_core::Real;

/// Lanes of a vector: splats of a block, pixels of a 4x4 block.
pub(crate) const LANES: usize = 16;

/// x86 estimates a reciprocal to 12 bits or better; other machines to 8, where one step would leave 16.
const NEWTON_STEPS: usize = if cfg!(any(target_arch = "x86", target_arch = "x86_64")) { 1 } else { 2 };

/// Has an [`V::exp2`] of exactly zero.
pub(crate) const LOG2_OF_ZERO: f32 = -127.0;

/// Sixteen numbers in memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C, align(64))]
pub(crate) struct Lanes(pub(crate) [f32; LANES]);

impl Lanes {
    pub(crate) const ZERO: Self = Self([0.0; LANES]);
}

/// Sixteen numbers in registers.
#[derive(Clone, Copy)]
pub(crate) struct V<S: Simd>(pub(crate) f32x16<S>);

/// Eight numbers in registers: one half of a vector, for loops that would need more registers than there are where a vector is two.
#[derive(Clone, Copy)]
pub(crate) struct Half<S: Simd>(f32x8<S>);

/// Sixteen truths.
pub(crate) type M<S> = mask32x16<S>;

impl<S: Simd> V<S> {
    #[inline(always)]
    pub(crate) fn splat(simd: S, value: f32) -> Self {
        Self(f32x16::splat(simd, value))
    }

    /// 0 to 15.
    #[inline(always)]
    pub(crate) fn lane_numbers(simd: S) -> Self {
        Self::load(simd, &Lanes([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0]))
    }

    #[inline(always)]
    pub(crate) fn load(simd: S, lanes: &Lanes) -> Self {
        Self(f32x16::load_array_ref(simd, &lanes.0))
    }

    /// Loads 16 numbers from the start of `slice`.
    #[inline(always)]
    pub(crate) fn load_slice(simd: S, slice: &[f32]) -> Self {
        Self(f32x16::from_slice(simd, &slice[..LANES]))
    }

    #[inline(always)]
    pub(crate) fn store(self, lanes: &mut Lanes) {
        self.0.store_array(&mut lanes.0);
    }

    #[inline(always)]
    pub(crate) fn store_slice(self, slice: &mut [f32]) {
        self.0.store_slice(&mut slice[..LANES]);
    }

    #[inline(always)]
    pub(crate) fn lanes(self) -> [f32; LANES] {
        self.0.to_array()
    }

    #[inline(always)]
    pub(crate) fn lt(self, other: Self) -> M<S> {
        self.0.simd_lt(other.0)
    }

    #[inline(always)]
    pub(crate) fn ge(self, other: Self) -> M<S> {
        self.0.simd_ge(other.0)
    }

    #[inline(always)]
    pub(crate) fn gt(self, other: Self) -> M<S> {
        self.0.simd_gt(other.0)
    }

    #[inline(always)]
    pub(crate) fn select(mask: M<S>, then: Self, otherwise: Self) -> Self {
        Self(mask.select(then.0, otherwise.0))
    }

    #[inline(always)]
    pub(crate) fn abs(self) -> Self {
        Self(self.0.abs())
    }

    #[inline(always)]
    pub(crate) fn floor(self) -> Self {
        Self(self.0.floor())
    }

    /// 1 / `self` to a few units in the last place, for normal numbers: the hardware's estimate and steps of Newton's method, each of
    /// which doubles its bits. Division takes several times as long.
    #[inline(always)]
    pub(crate) fn reciprocal(self) -> Self {
        let two = f32x16::splat(self.0.token(), 2.0);
        let mut estimate = self.0.approximate_recip();
        for _ in 0..NEWTON_STEPS {
            estimate = estimate * (-self.0).mul_add(estimate, two);
        }
        Self(estimate)
    }

    /// 2 to the power of `self`, for arguments in [-126, 127]; relative error below 3e-7. Zero for [`LOG2_OF_ZERO`].
    ///
    /// Splits off the nearest integer, which goes into the exponent's bits, and evaluates a polynomial on the rest (minimax of the relative
    /// error with p(0) = 1 and p'(0) = ln 2, which is 1.05e-7).
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

    /// Natural logarithm of positive normal numbers; relative error of the result below 2e-7 away from 1, absolute below 1e-7 near it.
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

    /// The first and the last eight numbers.
    #[inline(always)]
    pub(crate) fn from_halves(low: Half<S>, high: Half<S>) -> Self {
        Self(low.0.combine(high.0))
    }

    /// Two whole numbers below 2^16 in the bits of each lane, as two `u16` in memory.
    #[inline(always)]
    pub(crate) fn pack(first: Self, second: Self) -> Self {
        let (first, second): (i32x16<S>, i32x16<S>) = (first.0.to_int(), second.0.to_int());
        let (low, high) = if cfg!(target_endian = "little") { (first, second) } else { (second, first) };
        Self((low | (high << 16)).bitcast())
    }

    /// Every number one lane on, 0 in the first.
    #[inline(always)]
    pub(crate) fn lanes_up(self) -> Self {
        let zero = f32x16::splat(self.0.token(), 0.0);
        Self(zero.slide::<{ LANES - 1 }>(self.0))
    }

    /// Every number one lane back, 0 in the last.
    #[inline(always)]
    pub(crate) fn lanes_down(self) -> Self {
        let zero = f32x16::splat(self.0.token(), 0.0);
        Self(self.0.slide::<1>(zero))
    }

    /// Rows for columns: four rounds of [`Self::interleaved`] swap the halves of a number's place.
    #[inline(always)]
    pub(crate) fn transpose(mut rows: [Self; LANES]) -> [Self; LANES] {
        for _ in 0..LANES.ilog2() {
            rows = Self::interleaved(rows);
        }
        rows
    }

    /// Interleaves the upper half of the rows with the lower, which rotates the bits of a number's place, row and lane, by one. `ROWS` is a power
    /// of two.
    #[inline(always)]
    pub(crate) fn interleaved<const ROWS: usize>(before: [Self; ROWS]) -> [Self; ROWS] {
        let mut rows = before;
        for i in 0..ROWS / 2 {
            let (low, high) = before[i].0.interleave(before[i + ROWS / 2].0);
            rows[2 * i] = Self(low);
            rows[2 * i + 1] = Self(high);
        }
        rows
    }
}

impl<S: Simd> Half<S> {
    #[inline(always)]
    pub(crate) fn splat(simd: S, value: f32) -> Self {
        Self(f32x8::splat(simd, value))
    }

    /// Half number `half`, 0 or 1.
    #[inline(always)]
    pub(crate) fn load(simd: S, lanes: &Lanes, half: usize) -> Self {
        Self(f32x8::from_slice(simd, &lanes.0[half * (LANES / 2)..][..LANES / 2]))
    }

    #[inline(always)]
    pub(crate) fn mul_add(self, factor: Self, term: Self) -> Self {
        Self(self.0.mul_add(factor.0, term.0))
    }
}

impl<S: Simd> Mul for Half<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(self.0 * other.0)
    }
}

/// Whether sixteen numbers are one register.
#[inline(always)]
pub(crate) const fn is_one_register<S: Simd>() -> bool {
    size_of::<S::f32s>() == size_of::<Lanes>()
}

macro_rules! impl_op {
    ($trait:ident, $method:ident) => {
        impl<S: Simd> $trait for V<S> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self($trait::$method(self.0, other.0))
            }
        }
        impl<S: Simd> $trait<f32> for V<S> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: f32) -> Self {
                Self($trait::$method(self.0, other))
            }
        }
    };
}
impl_op!(Add, add);
impl_op!(Sub, sub);
impl_op!(Mul, mul);
impl_op!(Div, div);

impl<S: Simd> Neg for V<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(-self.0)
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
    /// Saturates outside of [-87, 88].
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
    /// For arguments in [0, 2^126]; relative error below 2e-7.
    ///
    /// With the power of two 2^e nearest to 1 + x in ratio, ln(1 + x) = e ln 2 + ln(1 + f) where f = (1 + x) 2^-e - 1 comes from x itself
    /// in one rounding, so that small arguments keep all of their digits.
    #[inline(always)]
    fn ln_1p(self) -> Self {
        let simd = self.0.token();
        let c = |value: f32| f32x16::splat(simd, value);
        let bits: i32x16<S> = (self.0 + c(1.0)).bitcast();
        // e in the exponent's place: (1 + x) 2^-e is in [sqrt(1/2), sqrt(2)).
        let exponent = (bits - i32x16::splat(simd, 0x3f35_04f3)) & i32x16::splat(simd, !0x007f_ffff);
        let scale: f32x16<S> = (i32x16::splat(simd, 1f32.to_bits().cast_signed()) - exponent).bitcast();
        let f = self.0.mul_add(scale, scale - c(1.0));
        // Minimax polynomial of (ln(1 + f) - f) / f^2; 3.5e-8 of ln(1 + f).
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

/// Runs `$body` compiled for the instruction set `$level`, with its token as `$simd`.
macro_rules! with_simd {
    ($level:expr, $simd:ident => $body:expr) => {
        fearless_simd::dispatch!($level, $simd => $body)
    };
}
pub(crate) use with_simd;

#[cfg(test)]
mod tests {
    use fearless_simd::Level;

    use super::*;

    /// Largest relative error of `f` against `exact` over `arguments`.
    fn worst(arguments: impl Iterator<Item = f32>, f: impl Fn(Lanes) -> [f32; LANES], exact: impl Fn(f64) -> f64) -> f64 {
        let all: Vec<f32> = arguments.collect();
        let mut worst = 0f64;
        for chunk in all.chunks_exact(LANES) {
            let mut lanes = Lanes::ZERO;
            lanes.0.copy_from_slice(chunk);
            for (x, y) in chunk.iter().zip(f(lanes)) {
                let expected = exact(f64::from(*x));
                worst = worst.max((f64::from(y) - expected).abs() / expected.abs().max(1e-30));
            }
        }
        worst
    }

    #[test]
    fn elementary_functions_are_accurate_to_a_few_ulp() {
        let level = Level::new();
        let linear = |a: f32, b: f32| (0..16_000).map(move |i| a + (b - a) * i as f32 / 16_000.0);
        let logarithmic = |a: f32, b: f32| (0..16_000).map(move |i| a * (b / a).powf(i as f32 / 16_000.0));
        let reciprocal = worst(logarithmic(1e-4, 1e4), |x| with_simd!(level, s => V::load(s, &x).reciprocal().lanes()), f64::recip);
        assert!(reciprocal < 3e-7, "reciprocal {reciprocal}");
        let exp2 = worst(linear(-100.0, 100.0), |x| with_simd!(level, s => V::load(s, &x).exp2().lanes()), f64::exp2);
        assert!(exp2 < 4e-7, "exp2 {exp2}");
        let zero = with_simd!(level, s => V::splat(s, LOG2_OF_ZERO).exp2().lanes());
        assert_eq!(zero.map(f32::to_bits), [0; LANES]);
        let exp = worst(linear(-80.0, 80.0), |x| with_simd!(level, s => V::load(s, &x).exp().lanes()), f64::exp);
        assert!(exp < 1e-6, "exp {exp}");
        let ln = worst(logarithmic(1e-30, 0.9), |x| with_simd!(level, s => V::load(s, &x).ln().lanes()), f64::ln);
        assert!(ln < 1e-6, "ln {ln}");
        let ln_1p = worst(logarithmic(1e-30, 8e37), |x| with_simd!(level, s => V::load(s, &x).ln_1p().lanes()), f64::ln_1p);
        assert!(ln_1p < 2e-7, "ln_1p {ln_1p}");
    }

    #[test]
    fn lanes_move_across_the_whole_vector() {
        let row = |start: usize| Lanes(std::array::from_fn(|lane| (start + lane) as f32));
        for level in [Level::new(), Level::baseline()] {
            let up = with_simd!(level, s => V::load(s, &row(1)).lanes_up().lanes());
            assert_eq!(up, row(0).0);
            let mut down = row(1).0;
            down[LANES - 1] = 0.0;
            assert_eq!(with_simd!(level, s => V::load(s, &row(0)).lanes_down().lanes()), down);
            let columns = with_simd!(level, s => {
                V::transpose(std::array::from_fn(|i| V::load(s, &row(LANES * i)))).map(V::lanes)
            });
            for (i, column) in columns.iter().enumerate() {
                assert_eq!(*column, std::array::from_fn(|lane| (LANES * lane + i) as f32), "column {i}");
            }
        }
    }
}
