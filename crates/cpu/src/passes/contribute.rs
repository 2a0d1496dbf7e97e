//! What each splat gives to an image: a sibling of `rasterize`, outside of training.
//!
//! In: the tiles' sorted lists, a mask `[H*W]`. Out, per splat (see [`luxel_core::edit::Contributions`]): sums over the image's pixels of its
//! blending weight times the mask, of its blending weight, and of its alpha. Weights are those that `rasterize` blends with, under the
//! same thresholds; alphas are summed behind finished pixels, too. Tiles are summed each by itself and then in order: the result does not
//! depend on threads.

use fearless_simd::{Level, Simd};
use luxel_core::edit::Contributions;
use luxel_core::{Real, each};
use rayon::prelude::*;

use super::bin::Bins;
use super::rasterize::{Seen, pixel_centers};
use super::sort::{TileList, WORD};
use crate::lanes::{Lanes, V, with_simd};
use crate::view::{BLOCKS, ScreenCamera, TILE_PX, block_of};

/// Sums of one entry of a tile: masked, blended, unoccluded.
type EntrySums = [f32; 3];

/// Sums over all tiles for `count` splats.
pub(crate) fn contribute(
    level: Level,
    camera: &ScreenCamera,
    (bins, lists): (&Bins, &[TileList]),
    mask: &[f32],
    count: usize,
) -> Contributions {
    let of_tile = |(tile, list): (usize, &TileList)| -> Vec<EntrySums> {
        let mut sums = vec![EntrySums::default(); list.entries.len()];
        let painted = tile_mask(camera, tile, mask);
        let origin = camera.tile_origin_px(tile);
        with_simd!(level, simd => {
            for (block, painted) in painted.iter().enumerate() {
                contribute_block(simd, camera, origin, (list, block), painted, &mut sums);
            }
        });
        sums
    };
    let tiles: Vec<Vec<EntrySums>> = lists.par_iter().enumerate().map(of_tile).collect();
    let zeros = || vec![0.0; count];
    let mut total = Contributions { masked: zeros(), blended: zeros(), unoccluded: zeros() };
    for (tile, sums) in tiles.iter().enumerate() {
        for (splat, [masked, blended, unoccluded]) in bins.tile(tile).map(|splat| splat as usize).zip(sums) {
            total.masked[splat] += masked;
            total.blended[splat] += blended;
            total.unoccluded[splat] += unoccluded;
        }
    }
    total
}

/// The mask in the order of a tile's blocks; 0 beyond the image.
fn tile_mask(camera: &ScreenCamera, tile: usize, mask: &[f32]) -> [Lanes; BLOCKS] {
    let ([left, top], [width, height]) = (camera.tile_origin_px(tile), camera.size_px);
    let mut painted = [Lanes::ZERO; BLOCKS];
    for y in 0..TILE_PX.min(height - top) {
        for x in 0..TILE_PX.min(width - left) {
            let (block, lane) = block_of(x, y);
            painted[block].0[lane] = mask[(top + y) * width + left + x];
        }
    }
    painted
}

#[inline(always)]
fn contribute_block<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    origin: [usize; 2],
    (list, block): (&TileList, usize),
    painted: &Lanes,
    sums: &mut [EntrySums],
) {
    let c = |value: f32| V::splat(simd, value);
    let (zero, one) = (c(0.0), c(1.0));
    let (max_alpha, min_transmittance) = (c(camera.cutoffs.max_alpha), c(camera.cutoffs.min_transmittance));
    let (centers, painted) = (pixel_centers(simd, block), V::load(simd, painted));
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
            let sums = &mut sums[entry.place as usize];
            for (sum, value) in sums.iter_mut().zip([weight * painted, weight, V::select(touched, alpha, zero)]) {
                *sum += value.lanes().iter().sum::<f32>();
            }
        }
    }
}
