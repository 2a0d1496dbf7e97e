//! Pass `bin`: finds which splats touch which tile.
//!
//! In: footprints `[N]`. Out, in [`Bins`]: for each tile a list of splats by ascending index, the
//! lists one after another; for each splat the numbers of its list entries, so that its gradients
//! can be gathered in a fixed order. Splats are stored along a curve through space, so the splats
//! of a tile lie near each other in memory, and so do the entries of neighbouring splats.
//!
//! A tile is touched if the splat's ellipse at its alpha threshold contains a pixel centre's column
//! range in one of the tile's rows: exact for the continuous band of the tile's rows, and with a
//! margin of `MARGIN_PX` for rounding, because the rasteriser tests each pixel again. Where pixels
//! are rays, cones around the tiles decide: see [`crate::rays`]. Degenerate: culled footprints
//! touch no tile.

use std::ops::Range;
use std::sync::atomic::{AtomicU32, Ordering};

use fearless_simd::Simd;
use luxel_lanes::Level;
use rayon::prelude::*;

use super::project::{Footprint, MARGIN_PX};
use crate::lanes::with_simd;
use crate::rays::RayTable;
use crate::view::{ScreenCamera, TILE_PX};

/// Least number of splats in a chunk of work: a power of two, so that no block is in two chunks.
/// Chunks follow from the number of splats, never from the number of threads, on which no result
/// depends.
const MIN_CHUNK: usize = 2048;
/// Greatest number of chunks: each keeps a number for every tile.
const MAX_CHUNKS: usize = 256;
/// Chunks that a thread takes at once. Few, so that no thread waits long for another at the end.
const CHUNKS_AT_A_TIME: usize = 4;

/// The lists of all tiles.
#[derive(Default)]
pub(crate) struct Bins {
    /// Tile t has entries `tile_start[t]..tile_start[t + 1]`.
    tile_start: Vec<u32>,
    /// Splat of each entry, by tile. Atomic because chunks write at the same time; each writes its
    /// own entries.
    splat: Vec<AtomicU32>,
    chunk_len: usize,
    chunks: Vec<Chunk>,
}

/// Splats on the screen, binned by tile.
#[derive(Clone, Copy)]
pub(crate) struct ScreenSplats<'a> {
    pub(crate) bins: &'a Bins,
    pub(crate) footprints: &'a [Footprint],
}

/// The tiles of a run of splats.
#[derive(Default)]
struct Chunk {
    /// Entries of the run, by splat; splat n of the run has `start[n]..start[n + 1]`. At first the
    /// tile of each entry, then its number.
    entries: Vec<u32>,
    start: Vec<u32>,
    /// Entries of each tile; then where the chunk's next entry of the tile goes.
    cursor: Vec<u32>,
    visible: u32,
}

impl Bins {
    /// Returns the splats of a tile's list, in ascending order.
    pub(crate) fn tile(&self, tile: usize) -> impl Iterator<Item = u32> {
        self.splat[self.range(tile)].iter().map(|splat| splat.load(Ordering::Relaxed))
    }

    /// Returns the splat of an entry.
    pub(crate) fn splat(&self, entry: usize) -> usize {
        self.splat[entry].load(Ordering::Relaxed) as usize
    }

    /// Returns the numbers of the entries of a tile's list.
    pub(crate) fn range(&self, tile: usize) -> Range<usize> {
        self.tile_start[tile] as usize..self.tile_start[tile + 1] as usize
    }

    /// Returns the number of entries of all lists.
    pub(crate) fn len(&self) -> usize {
        self.splat.len()
    }

    /// Returns the number of splats that touch a tile.
    pub(crate) fn visible(&self) -> u32 {
        self.chunks.iter().map(|chunk| chunk.visible).sum()
    }

    /// Returns the numbers of the entries of each of `count` splats, from splat `first` on; they
    /// must lie within one block.
    #[inline(always)]
    pub(crate) fn entries(&self, first: usize, count: usize) -> impl Iterator<Item = &[u32]> {
        let chunk = &self.chunks[first / self.chunk_len];
        let n = first % self.chunk_len;
        chunk.start[n..=n + count].windows(2).map(|range| &chunk.entries[range[0] as usize..range[1] as usize])
    }

    /// Distributes the footprints over the tiles.
    pub(crate) fn fill(&mut self, level: Level, camera: &ScreenCamera, footprints: &[Footprint]) {
        let tiles = camera.tiles();
        let tile_count = tiles[0] * tiles[1];
        self.chunk_len = footprints.len().div_ceil(MAX_CHUNKS).next_power_of_two().max(MIN_CHUNK);
        self.chunks.resize_with(footprints.len().div_ceil(self.chunk_len), Chunk::default);
        let chunks = self.chunks.par_iter_mut().zip(footprints.par_chunks(self.chunk_len)).with_max_len(CHUNKS_AT_A_TIME);
        chunks.for_each(|(chunk, footprints)| match &camera.rays {
            None => chunk.collect(tiles, footprints, &OnImagePlane { across: tiles[0] }),
            Some(rays) => with_simd!(level, simd => chunk.collect(tiles, footprints, &OnRays { simd, rays })),
        });

        // The start of each tile's list, and within it of each chunk.
        self.tile_start.clear();
        let mut next = 0u32;
        for tile in 0..tile_count {
            self.tile_start.push(next);
            let start = next;
            for chunk in &mut self.chunks {
                next += std::mem::replace(&mut chunk.cursor[tile], next - start);
            }
        }
        self.tile_start.push(next);

        self.splat.resize_with(next as usize, AtomicU32::default);
        let (starts, splat, chunk_len) = (&self.tile_start, &self.splat, self.chunk_len);
        let chunks = self.chunks.par_iter_mut().enumerate().with_max_len(CHUNKS_AT_A_TIME);
        chunks.for_each(|(n, chunk)| chunk.scatter(n * chunk_len, starts, splat));
    }
}

/// The tiles of a splat on their way into a chunk.
struct Touched<'a> {
    tiles: &'a mut Vec<u32>,
    counts: &'a mut [u32],
}

impl Touched<'_> {
    #[inline(always)]
    fn add(&mut self, tile: usize) {
        self.tiles.push(tile as u32);
        self.counts[tile] += 1;
    }
}

/// Finds the tiles of a footprint, by what pixels are. A trait instead of a closure, which
/// might stay a call around each vector operation.
trait FindTiles {
    /// Adds the tiles that the footprint touches.
    fn find_tiles(&self, footprint: &Footprint, touched: &mut Touched<'_>);
}

/// Pixels are places on the image plane, of so many tiles `across`.
struct OnImagePlane {
    across: usize,
}

impl FindTiles for OnImagePlane {
    #[inline(always)]
    fn find_tiles(&self, footprint: &Footprint, touched: &mut Touched<'_>) {
        touched_tiles(footprint, self.across, |tile| touched.add(tile));
    }
}

/// Pixels are rays.
struct OnRays<'a, S> {
    simd: S,
    rays: &'a RayTable,
}

impl<S: Simd> FindTiles for OnRays<'_, S> {
    #[inline(always)]
    fn find_tiles(&self, footprint: &Footprint, touched: &mut Touched<'_>) {
        if let Some(splat) = footprint.touch() {
            self.rays.touched_tiles(self.simd, &splat, |tile| touched.add(tile));
        }
    }
}

impl Chunk {
    /// Collects the tiles that the chunk's footprints touch.
    #[inline(always)]
    fn collect(&mut self, tiles: [usize; 2], footprints: &[Footprint], pixels: &impl FindTiles) {
        self.entries.clear();
        self.start.clear();
        self.cursor.clear();
        self.cursor.resize(tiles[0] * tiles[1], 0);
        self.visible = 0;
        for footprint in footprints {
            let before = self.entries.len();
            self.start.push(before as u32);
            pixels.find_tiles(footprint, &mut Touched { tiles: &mut self.entries, counts: &mut self.cursor });
            self.visible += u32::from(self.entries.len() > before);
        }
        self.start.push(self.entries.len() as u32);
    }

    /// Writes the chunk's splats to the lists of their tiles.
    fn scatter(&mut self, first_splat: usize, tile_start: &[u32], splat: &[AtomicU32]) {
        for (n, range) in self.start.windows(2).enumerate() {
            for entry in &mut self.entries[range[0] as usize..range[1] as usize] {
                let tile = *entry as usize;
                *entry = tile_start[tile] + self.cursor[tile];
                self.cursor[tile] += 1;
                splat[*entry as usize].store((first_splat + n) as u32, Ordering::Relaxed);
            }
        }
    }
}

/// Calls `touch` with each tile that the footprint touches, row by row.
#[inline(always)]
fn touched_tiles(f: &Footprint, across: usize, mut touch: impl FnMut(usize)) {
    let [columns, rows] = f.tiles.map(|[first, end]| first.into()..end.into());
    if rows.len() <= 1 || columns.len() <= 1 {
        for row in rows {
            for column in columns.clone() {
                touch(row * across + column);
            }
        }
        return;
    }
    let [mean_x, mean_y] = f.mean_px;
    let tile_px = TILE_PX as f32;
    let ellipse = Ellipse::new(f);
    for row in rows {
        // The band of the row's pixel centres, relative to the centre, cut to the ellipse.
        let top = (row as f32 * tile_px + 0.5 - mean_y - MARGIN_PX).max(-f.extent_y_px);
        let bottom = (row as f32 * tile_px + tile_px - 0.5 - mean_y + MARGIN_PX).min(f.extent_y_px);
        if top > bottom {
            continue;
        }
        let [left, right] = ellipse.columns(top, bottom);
        // Pixel centres from left to right, as `project` counts them; casts floor what is not
        // negative, and saturate.
        let (first, last) = ((mean_x + left - MARGIN_PX + 0.5).max(0.0), mean_x + right + MARGIN_PX - 0.5);
        if last >= 0.0 && last as usize >= first as usize {
            for column in (first as usize / TILE_PX).max(columns.start)..(last as usize / TILE_PX + 1).min(columns.end) {
                touch(row * across + column);
            }
        }
    }
}

/// A footprint's outline u^2 + v^2 = radius2, solved for dx: centre `slope` dy, half width
/// sqrt(radius2 - v^2) / root[0].
struct Ellipse {
    radius2: f32,
    slope: f32,
    inverse_root: f32,
    root_y: f32,
    right_dy_px: f32,
}

impl Ellipse {
    /// Solves a footprint's outline.
    fn new(f: &Footprint) -> Self {
        let inverse_root = 1.0 / f.root[0];
        Self {
            radius2: f.log2_opacity - f.log2_threshold,
            slope: -f.root[1] * inverse_root,
            inverse_root,
            root_y: f.root[2],
            right_dy_px: f.right_dy_px,
        }
    }

    /// Returns the range of dx within the band of dy from `top` to `bottom`. The ellipse is convex:
    /// its rightmost point within the band is its rightmost point, or on the nearer edge of the
    /// band.
    fn columns(&self, top: f32, bottom: f32) -> [f32; 2] {
        let half = |dy: f32| {
            let v = self.root_y * dy;
            (self.radius2 - v * v).max(0.0).sqrt() * self.inverse_root
        };
        let (left_dy, right_dy) = ((-self.right_dy_px).clamp(top, bottom), self.right_dy_px.clamp(top, bottom));
        [self.slope * left_dy - half(left_dy), self.slope * right_dy + half(right_dy)]
    }
}
