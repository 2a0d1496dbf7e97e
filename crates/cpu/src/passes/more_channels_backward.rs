//! Channels beyond the three that an entry of a tile carries, for `rasterize_backward`.
//!
//! In: see [`super::more_channels`], and the gradient by the pixels. Out: sums over pixels for each
//! entry. The gradient by alpha of all channels together is summed, as absolute gradients need.

use fearless_simd::Simd;
use luxel_core::Real;

use super::more_channels::NoMore;
use super::sums::{Staged, SummedSplats, add_weighted};
use crate::lanes::{Lanes, V};

/// The work of `rasterize_backward` on other channels.
pub(crate) trait DifferentiateMore {
    /// Begins a block of the tile.
    fn begin_block(&mut self, block: usize);
    /// Returns the gradient by the remaining transmittance, given that of the first three
    /// channels.
    fn by_transmittance<S: Simd>(&self, simd: S, sum: V<S>) -> V<S>;
    /// Returns the entry's channels, dotted with the pixels' gradient, given the sum of its
    /// first three.
    fn shade<S: Simd>(&self, simd: S, sum: V<S>, entry: usize) -> V<S>;
    /// Adds the gradients by the channels of staged splats.
    fn add_sums<S: Simd>(&mut self, simd: S, splats: &SummedSplats<'_>, staged: &Staged);
}

impl DifferentiateMore for NoMore {
    #[inline(always)]
    fn begin_block(&mut self, _: usize) {}

    #[inline(always)]
    fn by_transmittance<S: Simd>(&self, _: S, sum: V<S>) -> V<S> {
        sum
    }

    #[inline(always)]
    fn shade<S: Simd>(&self, _: S, sum: V<S>, _: usize) -> V<S> {
        sum
    }

    #[inline(always)]
    fn add_sums<S: Simd>(&mut self, _: S, _: &SummedSplats<'_>, _: &Staged) {}
}

/// Other channels to differentiate.
pub(crate) struct DifferentiateChannels<'a> {
    /// `[entries, E]`.
    pub(crate) colors: &'a [f32],
    /// `[E]`.
    pub(crate) background: &'a [f32],
    /// Gradients by the channels of the image's blocks, `[blocks of the image, E]`.
    pub(crate) gradient: &'a [Lanes],
    /// Gradients by alpha of the image's blocks; empty if there are none.
    pub(crate) alpha: &'a [Lanes],
    /// Number of each block of the tile among all of the image.
    pub(crate) blocks: &'a [usize],
    /// Number of the block among all of the image.
    pub(crate) block: usize,
    /// Sums over the tile's pixels, `[places, E]`.
    pub(crate) sums: &'a mut [f32],
}

impl DifferentiateChannels<'_> {
    /// Returns the gradients by the block's channels.
    #[inline(always)]
    fn gradients(&self) -> &[Lanes] {
        let count = self.background.len();
        &self.gradient[self.block * count..][..count]
    }
}

impl DifferentiateMore for DifferentiateChannels<'_> {
    #[inline(always)]
    fn begin_block(&mut self, block: usize) {
        self.block = self.blocks[block];
    }

    #[inline(always)]
    fn by_transmittance<S: Simd>(&self, simd: S, mut sum: V<S>) -> V<S> {
        for (gradient, background) in self.gradients().iter().zip(self.background) {
            sum = V::load(simd, gradient).mul_add(V::splat(simd, *background), sum);
        }
        // Alpha is one minus the transmittance.
        match self.alpha.get(self.block) {
            Some(alpha) => sum - V::load(simd, alpha),
            None => sum,
        }
    }

    #[inline(always)]
    fn shade<S: Simd>(&self, simd: S, mut sum: V<S>, entry: usize) -> V<S> {
        let count = self.background.len();
        for (gradient, color) in self.gradients().iter().zip(&self.colors[entry * count..][..count]) {
            sum = V::load(simd, gradient).mul_add(V::splat(simd, *color), sum);
        }
        sum
    }

    #[inline(always)]
    fn add_sums<S: Simd>(&mut self, simd: S, splats: &SummedSplats<'_>, staged: &Staged) {
        let count = self.background.len();
        if count > 0 {
            let gradient = &self.gradient[self.block * count..][..count];
            add_weighted(simd, splats, &staged.weight, gradient, self.sums);
        }
    }
}
