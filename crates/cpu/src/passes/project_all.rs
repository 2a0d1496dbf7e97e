//! Pass `project` over all splats, for any projection.
//!
//! In: the store, camera. Out: one [`Footprint`] per splat.

use fearless_simd::Simd;
use luxel_lanes::Level;
use rayon::prelude::*;

use super::project::{self, Footprint, resize_for};
use super::project_rays;
use crate::lanes::{LANES, Lanes, outlined, with_simd};
use crate::prefetch::{AHEAD, prefetch_rows};
use crate::store::{Block, Store, StoreShape};
use crate::view::ScreenCamera;

/// Projects all splats.
pub(crate) fn project(level: Level, camera: &ScreenCamera, store: &Store, smoothing: &[Lanes], out: &mut Vec<Footprint>) {
    let rows = store.layout.count();
    let shape = store.shape();
    resize_for(store, out);
    out.par_chunks_mut(LANES).zip(store.lanes.par_chunks(rows)).enumerate().with_min_len(64).for_each(|(index, (out, rows))| {
        prefetch_rows(&store.lanes, (index + AHEAD) * rows.len(), rows.len());
        with_simd!(level, simd => project_block(simd, camera, shape, Block { index, rows }, smoothing, out));
    });
}

/// Projects a block of a store of the given shape, as the camera's projection needs it.
#[inline(always)]
pub(crate) fn project_block<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    shape: StoreShape,
    block: Block<'_>,
    smoothing: &[Lanes],
    out: &mut [Footprint],
) {
    outlined!(simd => match &camera.rays {
            None => project::project_block(simd, camera, shape, block, smoothing, out),
            Some(rays) => project_rays::project_block(simd, camera, rays, shape, block, smoothing, out),
    });
}
