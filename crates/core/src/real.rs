//! The number type of formulas: `f32`, `f64`, or an engine's vector of them.
//!
//! The colour model and its gradient are written once, generic over [`Real`]. An engine that
//! processes several splats at a time implements the trait for its vector type and evaluates the
//! same formulas.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// A real number or a vector of independent ones.
pub trait Real: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self> {
    /// Returns the constant `value` in the type of `self`.
    fn lift(self, value: f32) -> Self;
    /// Returns `self * factor + term`.
    fn mul_add(self, factor: Self, term: Self) -> Self;
    /// Returns the larger of the two.
    fn max(self, other: Self) -> Self;
    /// Returns the smaller of the two.
    fn min(self, other: Self) -> Self;
    /// Returns the square root.
    fn sqrt(self) -> Self;
    /// Returns e to the power of `self`.
    fn exp(self) -> Self;
    /// Returns ln(1 + `self`) for `self >= 0`, accurate for small arguments.
    fn ln_1p(self) -> Self;
    /// Returns `then` where `self > 0`, else `otherwise`.
    fn if_positive(self, then: Self, otherwise: Self) -> Self;
}

/// Evaluates an expression at each listed index and returns the array:
/// `each!([0, 1, 2] i => 2 * i)`.
///
/// The macro expands in place. `array::map` would do the same in a function of its own, but code
/// for an instruction set chosen at run time is compiled for that set only within functions marked
/// for it.
#[macro_export]
macro_rules! each {
    ([$($index:literal),+] $i:ident => $value:expr) => {
        [$({ let $i: usize = $index; $value }),+]
    };
}

macro_rules! impl_real {
    ($t:ty) => {
        impl Real for $t {
            #[inline(always)]
            fn lift(self, value: f32) -> Self {
                <$t>::from(value)
            }
            #[inline(always)]
            fn mul_add(self, factor: Self, term: Self) -> Self {
                // Without hardware support a fused operation is a library call, which these scalar
                // paths do not need.
                self * factor + term
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                <$t>::max(self, other)
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                <$t>::min(self, other)
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                <$t>::sqrt(self)
            }
            #[inline(always)]
            fn exp(self) -> Self {
                <$t>::exp(self)
            }
            #[inline(always)]
            fn ln_1p(self) -> Self {
                <$t>::ln_1p(self)
            }
            #[inline(always)]
            fn if_positive(self, then: Self, otherwise: Self) -> Self {
                if self > 0.0 { then } else { otherwise }
            }
        }
    };
}
impl_real!(f32);
impl_real!(f64);
