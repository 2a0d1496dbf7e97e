//! The vector type of all passes: sixteen numbers at a time, the splats of a block or the pixels of
//! a 4x4 block.
//!
//! [`V`] wraps `fearless_simd`'s `f32x16`, which is one AVX-512 register, two of AVX2, four of SSE
//! or NEON. Every pass is written once over the instruction set `S` and dispatched at run time.
//! Vectors are always sixteen lanes, so reductions have one order on every machine.

mod functions;
mod moments;

use std::ops::{Add, Div, Mul, Neg, Sub};

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, f32x16, i32x16, mask32x16};
use luxel_core::Real;
pub(crate) use luxel_lanes::functions::LOG2_OF_ZERO;
use luxel_lanes::sums;
pub(crate) use luxel_lanes::{LANES, Lanes, dispatch as with_simd};

/// Sixteen numbers in registers.
#[derive(Clone, Copy)]
pub(crate) struct V<S: Simd>(pub(crate) f32x16<S>);

/// Eight numbers in registers: one half of a vector, for loops that would run out of registers
/// where a vector takes two.
#[derive(Clone, Copy)]
pub(crate) struct Half<S: Simd>(f32x8<S>);

/// A mask of sixteen lanes.
pub(crate) type M<S> = mask32x16<S>;

impl<S: Simd> V<S> {
    #[inline(always)]
    pub(crate) fn splat(simd: S, value: f32) -> Self {
        Self(f32x16::splat(simd, value))
    }

    /// Returns the lane numbers, 0 to 15.
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

    /// Returns the sum in single precision ([`sums::sum_in_order`]).
    #[inline(always)]
    pub(crate) fn sum_in_order(self) -> f32 {
        sums::sum_in_order(self.lanes())
    }

    /// Returns the sum in double precision ([`sums::sum_f64`]).
    #[inline(always)]
    pub(crate) fn sum_f64(self) -> f64 {
        sums::sum_f64(self.lanes())
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

    /// Joins the first and the last eight numbers.
    #[inline(always)]
    pub(crate) fn from_halves(low: Half<S>, high: Half<S>) -> Self {
        Self(low.0.combine(high.0))
    }

    /// Packs two whole numbers below 2^16 into the bits of each lane, as two `u16` in memory.
    #[inline(always)]
    pub(crate) fn pack(first: Self, second: Self) -> Self {
        let (first, second): (i32x16<S>, i32x16<S>) = (first.0.to_int(), second.0.to_int());
        let (low, high) = if cfg!(target_endian = "little") { (first, second) } else { (second, first) };
        Self((low | (high << 16)).bitcast())
    }

    /// Moves every number to the next lane, with 0 in the first.
    #[inline(always)]
    pub(crate) fn lanes_up(self) -> Self {
        let zero = f32x16::splat(self.0.token(), 0.0);
        Self(zero.slide::<{ LANES - 1 }>(self.0))
    }

    /// Moves every number to the previous lane, with 0 in the last.
    #[inline(always)]
    pub(crate) fn lanes_down(self) -> Self {
        let zero = f32x16::splat(self.0.token(), 0.0);
        Self(self.0.slide::<1>(zero))
    }

    /// Transposes rows and columns: four rounds of [`Self::interleaved`] swap the row and the lane
    /// of each number.
    #[inline(always)]
    pub(crate) fn transpose(mut rows: [Self; LANES]) -> [Self; LANES] {
        for _ in 0..LANES.ilog2() {
            rows = Self::interleaved(rows);
        }
        rows
    }

    /// Interleaves the upper half of the rows with the lower, which rotates the bits of a number's
    /// position (row, then lane) by one. `ROWS` is a power of two.
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

    /// Loads half number `half`, 0 or 1.
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

/// Reports whether sixteen numbers fit in one register.
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

/// The dot product of two vectors of three.
#[inline(always)]
pub(crate) fn dot<S: Simd>(a: [V<S>; 3], b: [V<S>; 3]) -> V<S> {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

/// Transposes the numbers of at most sixteen splats to the first rows.
#[inline(always)]
pub(crate) fn fill_rows<const N: usize>(rows: &mut [Lanes], numbers: &[[f32; N]]) {
    if let Ok(numbers) = <&[[f32; N]; LANES]>::try_from(numbers) {
        // Of fixed length: the compiler makes exchanges of vectors of it.
        for (c, row) in rows.iter_mut().enumerate().take(N) {
            row.0 = std::array::from_fn(|lane| numbers[lane][c]);
        }
        return;
    }
    for (c, row) in rows.iter_mut().enumerate().take(N) {
        for (out, numbers) in row.0.iter_mut().zip(numbers) {
            *out = numbers[c];
        }
    }
}

/// Runs `$body` as a function of its own, compiled for the instruction set of `$simd`: once,
/// however many passes call the function around it. For work on a block of splats, beside which a
/// call costs nothing.
macro_rules! outlined {
    ($simd:expr => $body:expr) => {
        $crate::lanes::run_outlined(
            $simd,
            #[inline(always)]
            || $body,
        )
    };
}
pub(crate) use outlined;

/// The function of [`outlined!`].
#[inline(never)]
pub(crate) fn run_outlined<S: Simd, R>(simd: S, body: impl FnOnce() -> R) -> R {
    simd.vectorize(body)
}

#[cfg(test)]
mod tests;
