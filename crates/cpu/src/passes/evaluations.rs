//! Counts how often blending evaluates a splat at a pixel: the measure of a step's cost.
//!
//! In: the tiles' sorted lists. Out: [`Evaluations`], as whole numbers, so that the order of
//! additions does not matter.

use fearless_simd::Simd;
use fearless_simd::prelude::*;
use luxel_core::engine::Evaluations;
use rayon::prelude::*;

use super::sort::Entry;
use super::tile_records::{TileInputs, TileRecord, TileRecords};
use super::visit_block::{Hit, Visitor, visit_block};
use crate::lanes::{LANES, with_simd};
use crate::view::{BLOCKS, ScreenBlock};

/// Counts evaluations over all tiles.
pub(crate) fn evaluations(inputs: &TileInputs<'_>, records: &TileRecords) -> Evaluations {
    let TileInputs { level, camera, .. } = *inputs;
    let count_tile = |tile: usize, TileRecord { list, .. }: &TileRecord| {
        let origin_px = camera.tile_origin_px(tile);
        let mut counter = Counter(Evaluations::default());
        with_simd!(level, simd => {
            for index in 0..BLOCKS {
                visit_block(simd, camera, list, ScreenBlock { origin_px, index }, &mut counter);
            }
        });
        counter.0
    };
    let add = |a: Evaluations, b: Evaluations| Evaluations { touched: a.touched + b.touched, alive: a.alive + b.alive };
    let [across, down] = camera.tiles();
    let tiles = (0..across * down).into_par_iter().map(|tile| records.read(inputs, tile, |record| count_tile(tile, record)));
    tiles.reduce(Evaluations::default, add)
}

/// A visitor that counts.
struct Counter(Evaluations);

impl<S: Simd> Visitor<S> for Counter {
    #[inline(always)]
    fn visit(&mut self, _: &Entry, hit: &Hit<S>) {
        self.0.touched += LANES as u64;
        self.0.alive += u64::from(hit.changed.to_bitmask().count_ones());
    }
}
