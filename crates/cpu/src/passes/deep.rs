//! Pass `deep`: lists what each pixel is blended from. It is not part of training.
//!
//! In: the tiles' sorted lists, the most samples of a pixel. Out: [`DeepImage`], in normalised
//! units. Splats, thresholds and order are those of `rasterize`; a splat is a sample at the depth
//! of its centre, and neighbours are merged. Degenerate: pixels beyond the image are left out.

use fearless_simd::Simd;
use fearless_simd::prelude::*;
use luxel_core::each;
use luxel_core::engine::{DeepImage, DeepSample, merge_samples};
use rayon::prelude::*;

use super::bin::ScreenSplats;
use super::sort::Entry;
use super::tile_records::{TileInputs, TileRecords};
use super::visit_block::{Hit, Visitor, visit_block};
use crate::lanes::{LANES, with_simd};
use crate::view::{BLOCK_PX, BLOCKS, ScreenBlock, TILE_BLOCKS, TILE_PX};

/// The samples of a pixel, front to back.
type Samples = Vec<DeepSample>;

/// Lists the samples of all pixels.
pub(crate) fn deep(inputs: &TileInputs<'_>, records: &TileRecords, most_samples: usize) -> DeepImage {
    let TileInputs { level, camera, splats, .. } = *inputs;
    let [width, height] = camera.size_px;
    let [across, _] = camera.tiles();
    let mut image = DeepImage { width, height, pixels: vec![Samples::new(); width * height] };
    let tile_row = |(row, band): (usize, &mut [Samples])| {
        for column in 0..across {
            let tile = row * across + column;
            records.read(inputs, tile, |record| {
                for index in 0..BLOCKS {
                    let block = ScreenBlock { origin_px: camera.tile_origin_px(tile), index };
                    let mut lister = Lister { splats, start: splats.bins.range(tile).start, samples: Default::default() };
                    with_simd!(level, simd => visit_block(simd, camera, &record.list, block, &mut lister));
                    let left = column * TILE_PX + index % TILE_BLOCKS * BLOCK_PX;
                    let top = index / TILE_BLOCKS * BLOCK_PX;
                    for (lane, mut samples) in lister.samples.into_iter().enumerate() {
                        let (x, y) = (left + lane % BLOCK_PX, top + lane / BLOCK_PX);
                        if x < width && (y + 1) * width <= band.len() {
                            merge_samples(&mut samples, most_samples);
                            band[y * width + x] = samples;
                        }
                    }
                }
            });
        }
    };
    image.pixels.par_chunks_mut(TILE_PX * width).enumerate().with_max_len(1).for_each(tile_row);
    image
}

/// A visitor that lists the splats of each pixel of a block.
struct Lister<'a> {
    splats: ScreenSplats<'a>,
    /// First entry of the tile.
    start: usize,
    samples: [Samples; LANES],
}

impl<S: Simd> Visitor<S> for Lister<'_> {
    #[inline(always)]
    fn visit(&mut self, entry: &Entry, hit: &Hit<S>) {
        let mut bits = hit.changed.to_bitmask();
        if bits == 0 {
            return;
        }
        let depth = self.splats.footprints[self.splats.bins.splat(self.start + entry.place as usize)].depth;
        let alpha = hit.alpha.lanes();
        while bits != 0 {
            let lane = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            let alpha = alpha[lane];
            self.samples[lane].push(DeepSample { radiance: each!([0, 1, 2] c => alpha * entry.radiance[c]), alpha, depth: [depth; 2] });
        }
    }
}
