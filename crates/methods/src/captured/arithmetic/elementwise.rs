//! Functions of single numbers over arrays of them, for the images and networks of methods.
//!
//! In and out: numbers in place, sixteen at a time.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use luxel_lanes::{LANES, Level, functions};

/// A function of single numbers.
pub(crate) trait Elementwise: Sync {
    /// Returns the function's values.
    fn apply<S: Simd>(&self, simd: S, x: f32x16<S>) -> f32x16<S>;
}

/// Applies a function to numbers in place.
#[inline(always)]
fn map<S: Simd>(simd: S, function: &impl Elementwise, numbers: &mut [f32]) {
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

/// [`functions::sigmoid`].
pub(crate) struct Sigmoid;

impl Elementwise for Sigmoid {
    #[inline(always)]
    fn apply<S: Simd>(&self, _simd: S, x: f32x16<S>) -> f32x16<S> {
        functions::sigmoid(x)
    }
}

/// [`functions::softplus`].
pub(crate) struct Softplus;

impl Elementwise for Softplus {
    #[inline(always)]
    fn apply<S: Simd>(&self, _simd: S, x: f32x16<S>) -> f32x16<S> {
        functions::softplus(x)
    }
}

/// ln max(x, floor).
pub(crate) struct LnAbove {
    pub(crate) floor: f32,
}

impl Elementwise for LnAbove {
    #[inline(always)]
    fn apply<S: Simd>(&self, simd: S, x: f32x16<S>) -> f32x16<S> {
        functions::ln(x.max(f32x16::splat(simd, self.floor)))
    }
}
