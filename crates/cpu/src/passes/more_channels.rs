//! Channels beyond the three that an entry of a tile carries, for `rasterize`.
//!
//! In: for each entry of a tile the numbers of its other channels, `[entries, E]`. Out: their sums
//! over splats at each pixel. A splat's geometry is evaluated once, however many channels there
//! are. Training has no other channels: [`NoMore`] compiles to nothing. Degenerate: E may be 0.

use fearless_simd::Simd;
use luxel_core::Real;

use crate::lanes::{Lanes, V};

/// The work of `rasterize` on other channels.
pub(crate) trait BlendMore {
    /// Begins a block of the tile.
    fn begin_block(&mut self, block: usize);
    /// Blends the tile's entry with these weights.
    fn blend<S: Simd>(&mut self, simd: S, weight: V<S>, entry: usize);
    /// Adds the background.
    fn end_block<S: Simd>(&mut self, simd: S, transmittance: V<S>);
}

/// No other channels.
pub(crate) struct NoMore;

impl BlendMore for NoMore {
    #[inline(always)]
    fn begin_block(&mut self, _: usize) {}

    #[inline(always)]
    fn blend<S: Simd>(&mut self, _: S, _: V<S>, _: usize) {}

    #[inline(always)]
    fn end_block<S: Simd>(&mut self, _: S, _: V<S>) {}
}

/// Other channels to blend.
pub(crate) struct BlendChannels<'a> {
    /// `[entries, E]`.
    pub(crate) colors: &'a [f32],
    /// `[E]`.
    pub(crate) background: &'a [f32],
    /// Receives the pixels of the tile, `[blocks, E]`.
    pub(crate) pixels: &'a mut [Lanes],
    /// First of the block's rows in `pixels`.
    pub(crate) first: usize,
}

impl BlendMore for BlendChannels<'_> {
    #[inline(always)]
    fn begin_block(&mut self, block: usize) {
        let count = self.background.len();
        self.first = block * count;
        self.pixels[self.first..][..count].fill(Lanes::ZERO);
    }

    #[inline(always)]
    fn blend<S: Simd>(&mut self, simd: S, weight: V<S>, entry: usize) {
        let count = self.background.len();
        let colors = &self.colors[entry * count..][..count];
        for (sum, color) in self.pixels[self.first..][..count].iter_mut().zip(colors) {
            weight.mul_add(V::splat(simd, *color), V::load(simd, sum)).store(sum);
        }
    }

    #[inline(always)]
    fn end_block<S: Simd>(&mut self, simd: S, transmittance: V<S>) {
        for (sum, background) in self.pixels[self.first..].iter_mut().zip(self.background) {
            transmittance.mul_add(V::splat(simd, *background), V::load(simd, sum)).store(sum);
        }
    }
}
