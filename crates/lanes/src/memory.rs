//! Sixteen numbers in memory.
//!
//! Vectors always have sixteen lanes, whatever the machine's registers hold, so that sums have one
//! order everywhere.

use bytemuck::{Pod, Zeroable};
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};

/// Lanes of a vector.
pub const LANES: usize = 16;

/// Sixteen numbers in memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C, align(64))]
pub struct Lanes(
    /// The numbers.
    pub [f32; LANES],
);

impl Lanes {
    /// Sixteen zeros.
    pub const ZERO: Self = Self([0.0; LANES]);

    /// Loads the numbers into registers.
    #[inline(always)]
    pub fn load<S: Simd>(&self, simd: S) -> f32x16<S> {
        f32x16::load_array_ref(simd, &self.0)
    }

    /// Stores a vector.
    #[inline(always)]
    pub fn store<S: Simd>(&mut self, vector: f32x16<S>) {
        vector.store_array(&mut self.0);
    }
}
