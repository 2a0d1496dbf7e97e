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
    /// Whether there is any.
    const IS_SOME: bool;
    /// Begins a block of the tile.
    fn begin_block(&mut self, block: usize);
    /// Blends some of the tile's entries, front to back, with these weights.
    fn blend<S: Simd>(&mut self, simd: S, weights: &[Lanes], entries: &[u32]);
    /// Adds the background.
    fn end_block<S: Simd>(&mut self, simd: S, transmittance: V<S>);
}

/// No other channels.
pub(crate) struct NoMore;

impl BlendMore for NoMore {
    const IS_SOME: bool = false;

    #[inline(always)]
    fn begin_block(&mut self, _: usize) {}

    #[inline(always)]
    fn blend<S: Simd>(&mut self, _: S, _: &[Lanes], _: &[u32]) {}

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

/// Channels whose sums are in registers together.
const TOGETHER: usize = 4;

impl BlendChannels<'_> {
    /// Blends `N` channels from `channel` on.
    #[inline(always)]
    fn blend_some<S: Simd, const N: usize>(&mut self, simd: S, channel: usize, weights: &[Lanes], entries: &[u32]) {
        let count = self.background.len();
        let Some(pixels) = self.pixels[self.first + channel..].first_chunk_mut::<N>() else { return };
        let mut sums = [V::splat(simd, 0.0); N];
        for (sum, pixels) in sums.iter_mut().zip(&*pixels) {
            *sum = V::load(simd, pixels);
        }
        for (weight, entry) in weights.iter().zip(entries) {
            let Some(colors) = self.colors[*entry as usize * count + channel..].first_chunk::<N>() else { return };
            let weight = V::load(simd, weight);
            for (sum, color) in sums.iter_mut().zip(colors) {
                *sum = weight.mul_add(V::splat(simd, *color), *sum);
            }
        }
        for (sum, pixels) in sums.into_iter().zip(pixels) {
            sum.store(pixels);
        }
    }
}

impl BlendMore for BlendChannels<'_> {
    const IS_SOME: bool = true;

    #[inline(always)]
    fn begin_block(&mut self, block: usize) {
        let count = self.background.len();
        self.first = block * count;
        self.pixels[self.first..][..count].fill(Lanes::ZERO);
    }

    #[inline(always)]
    fn blend<S: Simd>(&mut self, simd: S, weights: &[Lanes], entries: &[u32]) {
        let count = self.background.len();
        for channel in (0..count).step_by(TOGETHER) {
            match count - channel {
                1 => self.blend_some::<_, 1>(simd, channel, weights, entries),
                2 => self.blend_some::<_, 2>(simd, channel, weights, entries),
                3 => self.blend_some::<_, 3>(simd, channel, weights, entries),
                _ => self.blend_some::<_, TOGETHER>(simd, channel, weights, entries),
            }
        }
    }

    #[inline(always)]
    fn end_block<S: Simd>(&mut self, simd: S, transmittance: V<S>) {
        for (sum, background) in self.pixels[self.first..].iter_mut().zip(self.background) {
            transmittance.mul_add(V::splat(simd, *background), V::load(simd, sum)).store(sum);
        }
    }
}
