//! Pass `rasterize_backward`: gradients of each tile's splats, back to front.
//!
//! In: the tiles' sorted lists, pixels and [`Changes`], gradient of the loss by the pixels' radiance ([`BlockGradient`]s row by row).
//! Out: one [`EntryGradient`] per entry of a tile, in the order of its bin: sums over the tile's pixels. They are gathered by splat later,
//! in a fixed order, so no two threads ever add to one number.
//!
//! With w_i = T_i alpha_i and S_i = sum over j > i of w_j c_j (background last), d alpha_i = T_i c_i - S_i / (1 - alpha_i), dotted
//! with the pixel's gradient. By the odds o_i = alpha_i / (1 - alpha_i) and the transmittance behind the splat, w_i = o_i T_(i+1), T_i = T_(i+1) + w_i
//! and g = alpha_i d alpha_i = w_i c_i - o_i S_i: where a pixel is not changed the odds are zero, and it stays what it is to the bit. Gradients by
//! centre and covariance follow from the moments of g over the pixels' whitened offsets (u, v), which are summed here and turned into them per
//! splat. Where alpha is capped it has no gradient.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd};
use luxel_core::Real;
use luxel_core::each;
use rayon::prelude::*;

use super::changes::{BlockChanges, Changes};
use super::rasterize::{BlockPixels, Seen, TilePixels, pixel_centers};
use super::sort::{Entry, TileList};
use super::sums::{EntryGradient, Staged, add_sums};
use crate::lanes::{LANES, LOG2_OF_ZERO, Lanes, M, V, with_simd};
use crate::prefetch::fetch;
use crate::view::{ScreenCamera, TILE_BLOCKS};

/// Gradient by the radiance of a block's pixels.
pub(crate) type BlockGradient = [Lanes; 3];

/// Whether AbsGS's sums are wanted.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum AbsoluteSums {
    /// Leave them zero.
    Skip,
    /// Sum them.
    Collect,
}

/// Differentiates all tiles.
pub(crate) fn rasterize_backward(
    level: Level,
    camera: &ScreenCamera,
    (lists, changes): (&[TileList], &[Changes]),
    (pixels, gradients): (&[TilePixels], &[BlockGradient]),
    absolute: AbsoluteSums,
    out: &mut Vec<Vec<EntryGradient>>,
) {
    out.resize_with(lists.len(), Vec::new);
    let across = camera.tiles()[0];
    // Tile by tile, as they are blended.
    let tiles = out.par_iter_mut().zip(lists).zip(changes).zip(pixels).enumerate().with_max_len(1);
    tiles.for_each(|(tile, (((out, list), changes), pixels))| {
        out.clear();
        out.resize(list.entries.len(), EntryGradient::default());
        fetch(&list.entries);
        changes.fetch();
        let gradient = |block: usize| {
            let row = tile / across * TILE_BLOCKS + block / TILE_BLOCKS;
            &gradients[(row * across + tile % across) * TILE_BLOCKS + block % TILE_BLOCKS]
        };
        let mut staged = Staged::ZERO;
        with_simd!(level, simd => {
            for (block, pixels) in pixels.0.iter().enumerate() {
                let (changes, seen) = (changes.of(block), (pixels, gradient(block)));
                let (entries, out) = (list.entries.as_slice(), (&mut staged, out.as_mut_slice()));
                match absolute {
                    AbsoluteSums::Skip => block_backward::<_, false>(simd, camera, block, (entries, changes), seen, out),
                    AbsoluteSums::Collect => block_backward::<_, true>(simd, camera, block, (entries, changes), seen, out),
                }
            }
        });
    });
}

/// What differentiating a block's splats goes on with from one to the next in front.
struct Unwinding<S: Simd> {
    centers: [V<S>; 2],
    gradient: [V<S>; 3],
    transmittance: V<S>,
    /// Gradient-weighted radiance from behind.
    behind: V<S>,
    max_alpha: V<S>,
    max_odds: V<S>,
}

#[inline(always)]
fn block_backward<S: Simd, const ABSOLUTE: bool>(
    simd: S,
    camera: &ScreenCamera,
    block: usize,
    (entries, changes): (&[Entry], BlockChanges<'_>),
    (pixels, gradient): (&BlockPixels, &BlockGradient),
    (staged, out): (&mut Staged, &mut [EntryGradient]),
) {
    let max_alpha = V::splat(simd, camera.cutoffs.max_alpha);
    let colors = each!([0, 1, 2] channel => V::load(simd, &gradient[channel]));
    let transmittance = V::load(simd, &pixels.transmittance);
    let background = each!([0, 1, 2] i => colors[i] * camera.background[i]);
    let mut unwinding = Unwinding {
        centers: pixel_centers(simd, block),
        gradient: colors,
        transmittance,
        behind: transmittance * (background[0] + background[1] + background[2]),
        max_alpha,
        max_odds: odds(max_alpha),
    };
    for lot in changes.lots_from_the_back(LANES) {
        unwind(simd, &mut unwinding, entries, lot, staged);
        add_sums::<_, ABSOLUTE>(simd, (entries, lot.entries), (block, staged, gradient), out);
    }
}

/// alpha / (1 - alpha).
#[inline(always)]
fn odds<S: Simd>(alpha: V<S>) -> V<S> {
    alpha * (alpha.lift(1.0) - alpha).reciprocal()
}

/// Differentiates a lot of changes in front of what has been differentiated.
#[inline(always)]
fn unwind<S: Simd>(simd: S, state: &mut Unwinding<S>, entries: &[Entry], lot: BlockChanges<'_>, staged: &mut Staged) {
    let c = |value: f32| V::splat(simd, value);
    for (i, (index, pixels)) in lot.entries.iter().zip(lot.pixels).enumerate().take(LANES) {
        let entry = &entries[*index as usize];
        let seen = Seen::new(simd, entry, state.centers);
        V::select(M::from_bitmask(simd, (*pixels).into()), seen.log2_alpha, c(LOG2_OF_ZERO)).store(&mut staged.share[i]);
        staged.see(i, entry, &seen);
    }
    let Staged { share, weight, .. } = staged;
    let (share, weight) = (&mut share[..lot.entries.len()], &mut weight[..lot.entries.len()]);
    for share in share.iter_mut() {
        odds(V::load(simd, share).exp2().min(state.max_alpha)).store(share);
    }
    let gradient = state.gradient;
    for ((index, share), weight) in lot.entries.iter().zip(share).zip(weight).rev() {
        let entry = &entries[*index as usize];
        let odds = V::load(simd, share);
        let blended = odds * state.transmittance;
        let color = each!([0, 1, 2] i => c(entry.radiance[i]));
        let shine = color[0].mul_add(gradient[0], color[1].mul_add(gradient[1], color[2] * gradient[2]));
        let given = blended * shine;
        let g = (-odds).mul_add(state.behind, given);
        let g = V::select(odds.lt(state.max_odds), g, c(0.0));
        state.transmittance = state.transmittance + blended;
        state.behind = state.behind + given;
        g.store(share);
        blended.store(weight);
    }
}
