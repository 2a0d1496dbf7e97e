//! Channels beyond the three that an entry of a tile carries, for `rasterize_backward`.
//!
//! In: see [`super::more_channels`], and the gradient by the pixels. Out: sums over pixels for each
//! entry. The gradient by alpha of all channels together is summed, as absolute gradients need.

use fearless_simd::Simd;
use luxel_core::Real;

use super::more_channels::NoMore;
use super::sums::{EntryGradient, Staged, SummedSplats, add_first_moments, add_weighted};
use crate::lanes::{LANES, Lanes, M, V};

/// The work of `rasterize_backward` on other channels.
pub(crate) trait DifferentiateMore {
    /// Begins a block of the tile.
    fn begin_block(&mut self, block: usize);
    /// Returns the gradient-weighted background behind all splats, given the gradient by the
    /// remaining transmittance of the first three channels.
    fn behind<S: Simd>(&mut self, simd: S, transmittance: V<S>, sum: V<S>) -> V<S>;
    /// Returns the entry's channels, dotted with the pixels' gradient, given the sum of its
    /// first three.
    fn shade<S: Simd>(&self, simd: S, sum: V<S>, entry: usize) -> V<S>;
    /// Takes note of splat number `i` of a chunk, from back to front.
    fn unwind<S: Simd>(&mut self, simd: S, i: usize, splat: Unwound<S>);
    /// Adds the gradients by the channels of staged splats.
    fn add_sums<S: Simd>(&mut self, simd: S, splats: &SummedSplats<'_>, staged: &Staged, out: &mut [EntryGradient]);
}

/// A splat at a block's pixels as the backward pass meets it.
#[derive(Clone, Copy)]
pub(crate) struct Unwound<S: Simd> {
    /// alpha / (1 - alpha).
    pub(crate) odds: V<S>,
    /// alpha times transmittance.
    pub(crate) blended: V<S>,
    /// The first three channels, dotted with the pixels' gradient.
    pub(crate) shading: V<S>,
    /// The pixels at which alpha is not capped.
    pub(crate) is_free: M<S>,
}

impl DifferentiateMore for NoMore {
    #[inline(always)]
    fn begin_block(&mut self, _: usize) {}

    #[inline(always)]
    fn behind<S: Simd>(&mut self, _: S, transmittance: V<S>, sum: V<S>) -> V<S> {
        transmittance * sum
    }

    #[inline(always)]
    fn shade<S: Simd>(&self, _: S, sum: V<S>, _: usize) -> V<S> {
        sum
    }

    #[inline(always)]
    fn unwind<S: Simd>(&mut self, _: S, _: usize, _: Unwound<S>) {}

    #[inline(always)]
    fn add_sums<S: Simd>(&mut self, _: S, _: &SummedSplats<'_>, _: &Staged, _: &mut [EntryGradient]) {}
}

/// The gradient by alpha of the first three channels alone, for statistics.
pub(crate) struct FirstThree {
    /// Gradient-weighted radiance from behind the splat.
    behind: Lanes,
    /// g of a chunk's splats.
    shares: [Lanes; LANES],
}

impl FirstThree {
    pub(crate) const ZERO: Self = Self { behind: Lanes::ZERO, shares: [Lanes::ZERO; LANES] };
}

/// Other channels to differentiate. If `MEASURES_FIRST`, the moments of the first three channels'
/// gradient by alpha take the place of absolute sums.
pub(crate) struct DifferentiateChannels<'a, const MEASURES_FIRST: bool> {
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
    /// How many of the channels have a gradient by alpha.
    pub(crate) shaping: usize,
    pub(crate) first: FirstThree,
    /// Sums over the tile's pixels, `[places, E]` with E rounded up by [`padded`].
    pub(crate) sums: &'a mut [f32],
}

/// Returns the length of rows that sums of `count` channels are kept in.
pub(crate) fn padded(count: usize) -> usize {
    count.next_multiple_of(4)
}

impl<const MEASURES_FIRST: bool> DifferentiateChannels<'_, MEASURES_FIRST> {
    /// Returns the gradients by the block's channels that have one by alpha.
    #[inline(always)]
    fn gradients(&self) -> &[Lanes] {
        &self.gradient[self.block * self.background.len()..][..self.shaping]
    }
}

impl<const MEASURES_FIRST: bool> DifferentiateMore for DifferentiateChannels<'_, MEASURES_FIRST> {
    #[inline(always)]
    fn begin_block(&mut self, block: usize) {
        self.block = self.blocks[block];
    }

    #[inline(always)]
    fn behind<S: Simd>(&mut self, simd: S, transmittance: V<S>, mut sum: V<S>) -> V<S> {
        if MEASURES_FIRST {
            (transmittance * sum).store(&mut self.first.behind);
        }
        for (gradient, background) in self.gradients().iter().zip(self.background) {
            sum = V::load(simd, gradient).mul_add(V::splat(simd, *background), sum);
        }
        // Alpha is one minus the transmittance.
        if let Some(alpha) = self.alpha.get(self.block) {
            sum = sum - V::load(simd, alpha);
        }
        transmittance * sum
    }

    #[inline(always)]
    fn shade<S: Simd>(&self, simd: S, mut sum: V<S>, entry: usize) -> V<S> {
        let count = self.background.len();
        for (gradient, color) in self.gradients().iter().zip(&self.colors[entry * count..]) {
            sum = V::load(simd, gradient).mul_add(V::splat(simd, *color), sum);
        }
        sum
    }

    #[inline(always)]
    fn unwind<S: Simd>(&mut self, simd: S, i: usize, Unwound { odds, blended, shading, is_free }: Unwound<S>) {
        if MEASURES_FIRST {
            let FirstThree { behind, shares } = &mut self.first;
            let (radiance, after) = (blended * shading, V::load(simd, behind));
            V::select(is_free, (-odds).mul_add(after, radiance), V::splat(simd, 0.0)).store(&mut shares[i]);
            (after + radiance).store(behind);
        }
    }

    #[inline(always)]
    fn add_sums<S: Simd>(&mut self, simd: S, splats: &SummedSplats<'_>, staged: &Staged, out: &mut [EntryGradient]) {
        let count = self.background.len();
        if count > 0 {
            let gradient = &self.gradient[self.block * count..][..count];
            add_weighted(simd, splats, &staged.weight, gradient, self.sums);
        }
        if MEASURES_FIRST {
            add_first_moments(simd, splats, staged, &self.first.shares, out);
        }
    }
}
