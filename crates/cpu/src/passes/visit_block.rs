//! Visits the splats of a block front to back, as `rasterize` blends them, for passes that measure
//! something other than the image.
//!
//! In: a tile's sorted list. Out: a [`Hit`] for each splat, passed to a [`Visitor`]. Thresholds and
//! order are those of the rasteriser. Splats behind finished pixels are visited, too.

use fearless_simd::Simd;
use luxel_core::{Real, each};

use super::rasterize::{Centers, Pixels, Rays, pixel_centers};
use super::sort::{Entry, TileList, WORD};
use crate::lanes::{M, V};
use crate::view::{ScreenBlock, ScreenCamera};

/// A splat at the pixels of a block.
pub(crate) struct Hit<S: Simd> {
    /// Pixels of the image at which the splat is above its threshold.
    pub(crate) touched: M<S>,
    /// Pixels that the splat changes: touched, and not finished.
    pub(crate) changed: M<S>,
    pub(crate) alpha: V<S>,
    /// Weight with which the splat is blended; 0 where it is not blended.
    pub(crate) weight: V<S>,
}

/// A receiver of the splats of a block.
pub(crate) trait Visitor<S: Simd> {
    /// Called with each splat whose ellipse touches the block.
    fn visit(&mut self, entry: &Entry, hit: &Hit<S>);
}

/// Visits the splats of a block of a tile.
#[inline(always)]
pub(crate) fn visit_block<S: Simd>(simd: S, camera: &ScreenCamera, list: &TileList, block: ScreenBlock, visitor: &mut impl Visitor<S>) {
    match &camera.rays {
        None => visit_pixels::<_, Centers<_>>(simd, camera, list, block, visitor),
        Some(_) => visit_pixels::<_, Rays<_>>(simd, camera, list, block, visitor),
    }
}

#[inline(always)]
fn visit_pixels<S: Simd, P: Pixels<S>>(simd: S, camera: &ScreenCamera, list: &TileList, block: ScreenBlock, visitor: &mut impl Visitor<S>) {
    let c = |value: f32| V::splat(simd, value);
    let (zero, one) = (c(0.0), c(1.0));
    let (max_alpha, min_transmittance) = (c(camera.cutoffs.max_alpha), c(camera.cutoffs.min_transmittance));
    let centers = pixel_centers(simd, block.index);
    let limit = each!([0, 1] i => c(camera.size_px[i] as f32 - block.origin_px[i] as f32));
    let inside = centers[0].lt(limit[0]) & centers[1].lt(limit[1]);
    let pixels = P::load(simd, camera, block);
    let (mut live, mut transmittance) = (inside, one);
    for n in 0..list.words() {
        let mut bits = list.word(n, block.index);
        while bits != 0 {
            let entry = &list.entries[n * WORD + bits.trailing_zeros() as usize];
            bits &= bits - 1;
            let splat = pixels.evaluate(simd, entry);
            let touched = splat.log2_alpha.ge(c(entry.log2_threshold)) & inside;
            let alpha = splat.log2_alpha.exp2().min(max_alpha);
            let left = (-alpha).mul_add(transmittance, transmittance);
            let stays = left.ge(min_transmittance);
            let changed = touched & live & stays;
            live &= !touched | stays;
            let weight = V::select(changed, alpha * transmittance, zero);
            transmittance = V::select(changed, left, transmittance);
            visitor.visit(entry, &Hit { touched, changed, alpha, weight });
        }
    }
}
