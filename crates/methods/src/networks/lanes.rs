//! Sixteen numbers at a time, in memory and in registers.
//!
//! Samples are stored in blocks of sixteen: row r of a block holds quantity r of its
//! sixteen samples. Kernels are written once over the instruction set `S` and dispatched at run
//! time. Vectors always have sixteen lanes, so that sums have one order on every machine.

use bytemuck::{Pod, Zeroable};
use fearless_simd::Simd;
use fearless_simd::f32x16;
use fearless_simd::prelude::*;

/// Samples of a block.
pub(crate) const LANES: usize = 16;

/// Sixteen numbers in memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C, align(64))]
pub(crate) struct Lanes(
    /// The numbers.
    pub [f32; LANES],
);

impl Lanes {
    /// Sixteen zeros.
    pub(crate) const ZERO: Self = Self([0.0; LANES]);

    /// Loads the numbers into registers.
    #[inline(always)]
    pub(crate) fn load<S: Simd>(&self, simd: S) -> f32x16<S> {
        f32x16::load_array_ref(simd, &self.0)
    }

    /// Stores a vector.
    #[inline(always)]
    pub(crate) fn store<S: Simd>(&mut self, vector: f32x16<S>) {
        vector.store_array(&mut self.0);
    }
}

/// Returns the sum of the sixteen numbers, in a fixed order.
#[inline(always)]
pub(crate) fn sum<S: Simd>(vector: f32x16<S>) -> f32 {
    let mut parts = vector.to_array();
    let mut half = LANES / 2;
    while half > 0 {
        for i in 0..half {
            parts[i] += parts[i + half];
        }
        half /= 2;
    }
    parts[0]
}

/// Makes room for exactly `count` blocks of numbers. Their content is arbitrary.
pub(crate) fn resize(rows: &mut Vec<Lanes>, count: usize) {
    rows.resize(count, Lanes::ZERO);
}
