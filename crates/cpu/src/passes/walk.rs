//! The way through a block's splats that `rasterize` takes, front to back, for who wants to know something else than the image.
//!
//! In: a tile's sorted list. Thresholds and the order of splats are the rasteriser's; splats behind finished pixels are shown, too.

use fearless_simd::Simd;
use luxel_core::{Real, each};

use super::rasterize::{Seen, pixel_centers};
use super::sort::{Entry, TileList, WORD};
use crate::lanes::{M, V};
use crate::view::ScreenCamera;

/// A splat at a block's pixels.
pub(crate) struct Met<S: Simd> {
    /// Where the splat is above its threshold, on the image.
    pub(crate) touched: M<S>,
    /// Where it changes the pixel: touched, and the pixel not finished.
    pub(crate) hit: M<S>,
    pub(crate) alpha: V<S>,
    /// Weight it is blended with, 0 where it is not.
    pub(crate) weight: V<S>,
}

/// Who is shown a block's splats.
pub(crate) trait Visitor<S: Simd> {
    /// Called with each splat whose ellipse touches the block.
    fn meet(&mut self, entry: &Entry, met: &Met<S>);
}

/// Shows the splats of a block of a tile, whose top left pixel is `origin`.
#[inline(always)]
pub(crate) fn walk_block<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    origin: [usize; 2],
    (list, block): (&TileList, usize),
    visitor: &mut impl Visitor<S>,
) {
    let c = |value: f32| V::splat(simd, value);
    let (zero, one) = (c(0.0), c(1.0));
    let (max_alpha, min_transmittance) = (c(camera.cutoffs.max_alpha), c(camera.cutoffs.min_transmittance));
    let centers = pixel_centers(simd, block);
    let limit = each!([0, 1] i => c(camera.size_px[i] as f32 - origin[i] as f32));
    let inside = centers[0].lt(limit[0]) & centers[1].lt(limit[1]);
    let (mut live, mut transmittance) = (inside, one);
    for n in 0..list.words() {
        let mut bits = list.word(n, block);
        while bits != 0 {
            let entry = &list.entries[n * WORD + bits.trailing_zeros() as usize];
            bits &= bits - 1;
            let seen = Seen::new(simd, entry, centers);
            let touched = seen.log2_alpha.ge(c(entry.log2_threshold)) & inside;
            let alpha = seen.log2_alpha.exp2().min(max_alpha);
            let left = (-alpha).mul_add(transmittance, transmittance);
            let stays = left.ge(min_transmittance);
            let hit = touched & live & stays;
            live &= !touched | stays;
            let weight = V::select(hit, alpha * transmittance, zero);
            transmittance = V::select(hit, left, transmittance);
            visitor.meet(entry, &Met { touched, hit, alpha, weight });
        }
    }
}
