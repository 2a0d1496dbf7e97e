//! Pass `contribute`: computes what each splat contributes to an image. It is not part of training.
//!
//! In: the tiles' sorted lists, a mask `[H*W]`. Out, per splat (see
//! [`luxel_core::edit::Contributions`]): sums over the image's pixels of its blending weight times
//! the mask, of its blending weight, of its alpha, and of the masked weight times its brightest
//! channel. The weights are those of `rasterize`, with the same thresholds; alphas are summed
//! behind finished pixels, too. Each tile is summed by itself, and the tiles are then added in
//! order: the result does not depend on threads.

use fearless_simd::Simd;
use luxel_core::Real;
use luxel_core::edit::Contributions;
use rayon::prelude::*;

use super::sort::Entry;
use super::tile_records::{TileInputs, TileRecord, TileRecords};
use super::visit_block::{Hit, Visitor, visit_block};
use crate::lanes::{Lanes, V, with_simd};
use crate::view::{BLOCKS, ScreenBlock, ScreenCamera, TILE_PX, block_of};

/// The sums of one entry of a tile: masked, blended, unoccluded, light.
type EntrySums = [f32; 4];

/// Computes the contributions of `count` splats, over all tiles.
pub(crate) fn contribute(inputs: &TileInputs<'_>, records: &TileRecords, mask: &[f32], count: usize) -> Contributions {
    let TileInputs { level, camera, splats, .. } = *inputs;
    let sum_tile = |tile: usize, TileRecord { list, .. }: &TileRecord| -> Vec<EntrySums> {
        let mut sums = vec![EntrySums::default(); list.entries.len()];
        let painted = tile_mask(camera, tile, mask);
        let origin_px = camera.tile_origin_px(tile);
        with_simd!(level, simd => {
            for (index, painted) in painted.iter().enumerate() {
                let mut adder = Adder { painted: V::load(simd, painted), sums: &mut sums };
                visit_block(simd, camera, list, ScreenBlock { origin_px, index }, &mut adder);
            }
        });
        sums
    };
    let [across, down] = camera.tiles();
    let tiles = (0..across * down).into_par_iter().map(|tile| records.read(inputs, tile, |record| sum_tile(tile, record)));
    let tiles: Vec<Vec<EntrySums>> = tiles.collect();
    let zeros = || vec![0.0; count];
    let share = 1.0 / (camera.samples * camera.samples) as f32;
    let mut total = Contributions { masked: zeros(), blended: zeros(), unoccluded: zeros(), light: zeros() };
    for (tile, sums) in tiles.iter().enumerate() {
        for (splat, [masked, blended, unoccluded, light]) in splats.bins.tile(tile).map(|splat| splat as usize).zip(sums) {
            total.masked[splat] += masked * share;
            total.blended[splat] += blended * share;
            total.unoccluded[splat] += unoccluded * share;
            total.light[splat] += light * share;
        }
    }
    total
}

/// Returns the mask in the order of a tile's blocks; 0 beyond the image.
fn tile_mask(camera: &ScreenCamera, tile: usize, mask: &[f32]) -> [Lanes; BLOCKS] {
    let ([left, top], [width, height]) = (camera.tile_origin_px(tile), camera.size_px);
    let samples = camera.samples;
    let mut painted = [Lanes::ZERO; BLOCKS];
    for y in 0..TILE_PX.min(height - top) {
        for x in 0..TILE_PX.min(width - left) {
            let (block, lane) = block_of(x, y);
            painted[block].0[lane] = mask[(top + y) / samples * (width / samples) + (left + x) / samples];
        }
    }
    painted
}

/// A visitor that adds up the contributions of a block's splats.
struct Adder<'a, S: Simd> {
    painted: V<S>,
    sums: &'a mut [EntrySums],
}

impl<S: Simd> Visitor<S> for Adder<'_, S> {
    #[inline(always)]
    fn visit(&mut self, entry: &Entry, hit: &Hit<S>) {
        let unoccluded = V::select(hit.touched, hit.alpha, hit.alpha.lift(0.0));
        let [masked, blended, unoccluded] = [hit.weight * self.painted, hit.weight, unoccluded].map(V::sum_in_order);
        let brightest = entry.radiance.into_iter().fold(0.0, f32::max);
        let sums = &mut self.sums[entry.place as usize];
        for (sum, value) in sums.iter_mut().zip([masked, blended, unoccluded, masked * brightest]) {
            *sum += value;
        }
    }
}
