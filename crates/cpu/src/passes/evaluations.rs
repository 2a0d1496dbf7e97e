//! How often blending looks at a splat from a pixel: what the cost of a step is measured in.
//!
//! In: the tiles' sorted lists. Out: [`Evaluations`], counted in whole numbers, so that no order matters.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd};
use luxel_core::engine::Evaluations;
use rayon::prelude::*;

use super::sort::{Entry, TileList};
use super::walk::{Met, Visitor, walk_block};
use crate::lanes::{LANES, with_simd};
use crate::view::{BLOCKS, ScreenCamera};

/// Counts over all tiles.
pub(crate) fn evaluations(level: Level, camera: &ScreenCamera, lists: &[TileList]) -> Evaluations {
    let of_tile = |(tile, list): (usize, &TileList)| {
        let origin = camera.tile_origin_px(tile);
        let mut counter = Counter(Evaluations::default());
        with_simd!(level, simd => {
            for block in 0..BLOCKS {
                walk_block(simd, camera, origin, (list, block), &mut counter);
            }
        });
        counter.0
    };
    let add = |a: Evaluations, b: Evaluations| Evaluations { touched: a.touched + b.touched, alive: a.alive + b.alive };
    lists.par_iter().enumerate().map(of_tile).reduce(Evaluations::default, add)
}

struct Counter(Evaluations);

impl<S: Simd> Visitor<S> for Counter {
    #[inline(always)]
    fn meet(&mut self, _: &Entry, met: &Met<S>) {
        self.0.touched += LANES as u64;
        self.0.alive += u64::from(met.hit.to_bitmask().count_ones());
    }
}
