//! Counts how often blending evaluates a splat at a pixel: the measure of a step's cost.
//!
//! In: the tiles' sorted lists. Out: [`Evaluations`], as whole numbers, so that the order of
//! additions does not matter.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd};
use luxel_core::engine::Evaluations;
use rayon::prelude::*;

use super::sort::{Entry, TileList};
use super::visit_block::{Hit, Visitor, visit_block};
use crate::lanes::{LANES, with_simd};
use crate::view::{BLOCKS, ScreenBlock, ScreenCamera};

/// Counts evaluations over all tiles.
pub(crate) fn evaluations(level: Level, camera: &ScreenCamera, lists: &[TileList]) -> Evaluations {
    let count_tile = |(tile, list)| {
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
    lists.par_iter().enumerate().map(count_tile).reduce(Evaluations::default, add)
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
