//! Pass `bin`: which splats touch which tile, front to back.
//!
//! In: visible splats in depth order, footprints. Out, in [`Bins`]: for each tile the range of its entries, each entry a splat; for each
//! visible splat the places of its entries, so that its gradients can be gathered in a fixed order.
//!
//! A tile is touched if the splat's ellipse at its alpha threshold contains a pixel centre's column range in one of the tile's
//! rows: exact for the continuous band of the tile's rows, and with a margin of [`MARGIN_PX`] for rounding, as the rasteriser
//! decides each pixel itself.

use std::ops::Range;
use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;

use super::project::Footprint;
use crate::view::{ScreenCamera, TILE_PX};

/// Enlarges footprints against rounding, pixels.
const MARGIN_PX: f32 = 0.01;

/// Splats a chunk of the work holds. A constant, and not a share of the threads, though the result does not depend on it.
const CHUNK: usize = 8192;

/// Entries of all tiles.
#[derive(Default)]
pub(crate) struct Bins {
    /// Tile t has entries `tile_start[t]..tile_start[t + 1]`.
    pub(crate) tile_start: Vec<u32>,
    /// Splat of each entry, by tile, front to back.
    pub(crate) splat: Vec<AtomicU32>,
    /// Entries by splat: the n-th visible splat (in depth order) has places `place_start[n]..place_start[n + 1]` of `place`.
    pub(crate) place_start: Vec<u32>,
    /// Index of the entry.
    pub(crate) place: Vec<u32>,
    chunks: Vec<Chunk>,
}

/// Tiles of a run of splats.
#[derive(Default)]
struct Chunk {
    /// Tile of each entry, by splat.
    tiles: Vec<u32>,
    /// Entries of each splat.
    counts: Vec<u32>,
    /// Entries of each tile; then where the chunk's next entry of the tile goes.
    cursor: Vec<u32>,
}

impl Bins {
    /// Number of entries.
    pub(crate) fn len(&self) -> usize {
        self.place.len()
    }

    /// Entries of a tile.
    pub(crate) fn tile(&self, tile: usize) -> Range<usize> {
        self.tile_start[tile] as usize..self.tile_start[tile + 1] as usize
    }

    /// Distributes the splats in `order` over the tiles.
    pub(crate) fn fill(&mut self, camera: &ScreenCamera, footprints: &[Footprint], order: &[u32]) {
        let tiles = camera.tiles();
        let tile_count = tiles[0] * tiles[1];
        let chunk_count = order.len().div_ceil(CHUNK);
        self.chunks.resize_with(self.chunks.len().max(chunk_count), Chunk::default);
        let chunks = &mut self.chunks[..chunk_count];
        chunks.par_iter_mut().zip(order.par_chunks(CHUNK)).for_each(|(chunk, order)| {
            chunk.collect(tiles, footprints, order);
        });

        // Where each tile starts, and within it each chunk.
        self.tile_start.clear();
        self.tile_start.resize(tile_count + 1, 0);
        let mut next = 0u32;
        for tile in 0..tile_count {
            self.tile_start[tile] = next;
            for chunk in chunks.iter_mut() {
                next += std::mem::replace(&mut chunk.cursor[tile], next);
            }
        }
        self.tile_start[tile_count] = next;

        self.place_start.clear();
        let mut start = 0u32;
        for chunk in chunks.iter() {
            for count in &chunk.counts {
                self.place_start.push(start);
                start += count;
            }
        }
        self.place_start.push(start);

        let total = next as usize;
        self.place.resize(total, 0);
        self.splat.resize_with(total, AtomicU32::default);
        // Each chunk writes its own run of `place`, and entries of `splat` that are its alone; atomics only say so to the compiler.
        let mut rest = self.place.as_mut_slice();
        let mut work = Vec::with_capacity(chunk_count);
        for (chunk, order) in chunks.iter_mut().zip(order.chunks(CHUNK)) {
            let (own, others) = rest.split_at_mut(chunk.tiles.len());
            work.push((chunk, order, own));
            rest = others;
        }
        let splat = &self.splat;
        work.into_par_iter().for_each(|(chunk, order, places)| chunk.scatter(order, places, splat));
    }
}

impl Chunk {
    fn collect(&mut self, tiles: [usize; 2], footprints: &[Footprint], order: &[u32]) {
        self.tiles.clear();
        self.counts.clear();
        self.cursor.clear();
        self.cursor.resize(tiles[0] * tiles[1], 0);
        for splat in order {
            let before = self.tiles.len();
            touched_tiles(&footprints[*splat as usize], tiles, |tile| {
                self.tiles.push(tile as u32);
                self.cursor[tile] += 1;
            });
            self.counts.push((self.tiles.len() - before) as u32);
        }
    }

    fn scatter(&mut self, order: &[u32], places: &mut [u32], splat: &[AtomicU32]) {
        let mut entries = self.tiles.iter().zip(places);
        for (index, count) in order.iter().zip(&self.counts) {
            for (tile, place) in entries.by_ref().take(*count as usize) {
                let cursor = &mut self.cursor[*tile as usize];
                *place = *cursor;
                splat[*cursor as usize].store(*index, Ordering::Relaxed);
                *cursor += 1;
            }
        }
    }
}

/// Calls `touch` with each tile that the footprint touches, row by row.
#[inline(always)]
fn touched_tiles(f: &Footprint, tiles: [usize; 2], mut touch: impl FnMut(usize)) {
    let tile_px = TILE_PX as f32;
    let tile_range = |low_px: f32, high_px: f32, count: usize| -> Range<usize> {
        // Pixel centres between low and high: from floor(low + 1/2) to floor(high - 1/2); casts floor what is not negative, and
        // saturate. A centre at low itself is left out, which the margin makes up for.
        let first = (low_px + 0.5).max(0.0);
        let last = high_px - 0.5;
        if last < 0.0 || (last as usize) < first as usize {
            0..0
        } else {
            first as usize / TILE_PX..(last as usize / TILE_PX + 1).min(count)
        }
    };
    let [mean_x, mean_y] = f.mean_px;
    let extent_y = f.extent_px[1] + MARGIN_PX;
    let rows = tile_range(mean_y - extent_y, mean_y + extent_y, tiles[1]);
    let columns = tile_range(mean_x - f.extent_px[0] - MARGIN_PX, mean_x + f.extent_px[0] + MARGIN_PX, tiles[0]);
    if rows.len() <= 1 || columns.len() <= 1 {
        for row in rows {
            for column in columns.clone() {
                touch(row * tiles[0] + column);
            }
        }
        return;
    }
    // The ellipse xx dx^2 + 2 xy dx dy + yy dy^2 = radius2, solved for dx: centre -xy dy / xx, half width sqrt((radius2 - dy^2
    // det/xx) / xx).
    let [xx, xy, yy] = f.conic;
    let radius2 = 2.0 * (f.log2_opacity - f.log2_threshold);
    let inverse_xx = 1.0 / xx;
    let slope = -xy * inverse_xx;
    let det_xx = (yy - xy * xy * inverse_xx).max(0.0);
    let right = |dy: f32| slope * dy + ((radius2 - dy * dy * det_xx).max(0.0) * inverse_xx).sqrt();
    let left = |dy: f32| slope * dy - ((radius2 - dy * dy * det_xx).max(0.0) * inverse_xx).sqrt();
    for row in rows {
        // The band of the row's pixel centres, relative to the centre, cut to the ellipse.
        let top = (row as f32 * tile_px + 0.5 - mean_y - MARGIN_PX).max(-f.extent_px[1]);
        let bottom = (row as f32 * tile_px + tile_px - 0.5 - mean_y + MARGIN_PX).min(f.extent_px[1]);
        if top > bottom {
            continue;
        }
        // The ellipse is convex: its rightmost point within the band is its rightmost point, or on the nearer edge of the band.
        let max_dx = right(f.right_dy_px.clamp(top, bottom));
        let min_dx = left((-f.right_dy_px).clamp(top, bottom));
        for column in tile_range(mean_x + min_dx - MARGIN_PX, mean_x + max_dx + MARGIN_PX, tiles[0]) {
            touch(row * tiles[0] + column);
        }
    }
}
