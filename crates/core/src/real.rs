//! The number a formula is evaluated on: `f32`, `f64`, or a vector of them in an engine.
//!
//! The colour model and its gradient are written once, over [`Real`]; an engine that works on several splats at a time
//! implements the trait for its vector type and evaluates the same formula on all of them.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// A real number or a vector of independent ones.
pub trait Real: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self> {
    /// The constant `value` in the same space as `self`.
    fn lift(self, value: f32) -> Self;
    /// `self * factor + term`.
    fn mul_add(self, factor: Self, term: Self) -> Self;
    /// The larger of the two.
    fn max(self, other: Self) -> Self;
    /// The smaller of the two.
    fn min(self, other: Self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// e to the power of `self`.
    fn exp(self) -> Self;
    /// ln(1 + `self`), accurate for small arguments, for `self >= 0`.
    fn ln_1p(self) -> Self;
    /// `then` where `self > 0`, else `otherwise`.
    fn if_positive(self, then: Self, otherwise: Self) -> Self;
}

/// The array of an expression's values at the listed indices: `each!([0, 1, 2] i => 2 * i)`.
///
/// Written out in place. `array::map` would do the same, but it is a function of its own, and code for an instruction set chosen at
/// run time is only compiled for that set within the functions marked for it.
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
                // A fused operation where the machine has none is a library call; these scalar paths do not need it.
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
