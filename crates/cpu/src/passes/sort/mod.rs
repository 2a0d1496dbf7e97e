//! Pass `sort`: orders a tile's splats front to back, and finds which of its blocks they cover.
//!
//! In: bins, footprints. Out: the tile's [`TileList`]: its [`Entry`]s by ascending depth, equal
//! depths by ascending index of the splat, and for each of its 64 blocks a bit per entry that tells
//! whether the entry's ellipse touches the block (exact for the continuous band of a block's rows,
//! with a margin for rounding). The rasteriser iterates over the bits of a block.
//!
//! Splats are first read in the order of the bin, where neighbours in a vector are neighbours in
//! memory and on the screen, and [`cover`] finds the blocks of each. Then [`order`] sorts, and
//! entries and bits are put into that order.

mod cover;
mod order;

use bytemuck::{Pod, Zeroable};
use fearless_simd::Simd;
use luxel_core::each;
use luxel_lanes::Level;

use self::cover::{Cover, GROUP, Outlines, SplatBits, touched_blocks};
use self::order::{Order, place};
use super::bin::ScreenSplats;
use super::project::{Footprint, MARGIN_PX};
use crate::lanes::{LANES, Lanes, V, with_simd};
use crate::prefetch::{AHEAD, prefetch};
use crate::rays::RayTable;
use crate::view::ScreenCamera;

pub(crate) use self::cover::WORD;

/// A splat in a tile's list: the fields of its footprint that blending needs, in the footprint's
/// order.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C, align(16))]
pub(crate) struct Entry {
    /// Centre relative to the tile's top left corner.
    pub(crate) mean_px: [f32; 2],
    /// See [`Footprint::root`].
    pub(crate) root: [f32; 3],
    pub(crate) log2_opacity: f32,
    pub(crate) radiance: [f32; 3],
    pub(crate) log2_threshold: f32,
    /// Place in the tile's bin, where its gradient is stored.
    pub(crate) place: u32,
    /// See [`Footprint::last`].
    last: f32,
}

/// The splats of a tile.
#[derive(Default)]
pub(crate) struct TileList {
    /// Front to back.
    pub(crate) entries: Vec<Entry>,
    cover: Vec<Cover>,
}

/// The buffers of a thread that sorts tiles.
#[derive(Default)]
pub(crate) struct SortBuffers {
    /// Splat of each place.
    splats: Vec<u32>,
    /// Depth of each place, in blocks of 16.
    depths: Vec<Lanes>,
    /// Touched blocks of each place, in blocks of 16.
    blocks: Vec<SplatBits>,
    order: Order,
}

/// A tile: its number and its sorted splats.
#[derive(Clone, Copy)]
pub(crate) struct Tile<'a> {
    pub(crate) index: usize,
    pub(crate) list: &'a TileList,
}

impl TileList {
    /// Makes the list of a tile from its bin.
    pub(crate) fn sort(&mut self, level: Level, camera: &ScreenCamera, splats: ScreenSplats<'_>, tile: usize, buffers: &mut SortBuffers) {
        let ScreenSplats { bins, footprints } = splats;
        let origin_px = camera.tile_origin_px(tile).map(|v| v as f32);
        buffers.splats.clear();
        buffers.splats.extend(bins.tile(tile));
        match &camera.rays {
            None => with_simd!(level, simd => buffers.find_blocks(simd, footprints, origin_px)),
            Some(rays) => with_simd!(level, simd => buffers.find_blocks_of_rays(simd, footprints, rays, tile)),
        }
        // Rays are the same for all tiles.
        let origin_px = if camera.rays.is_some() { [0.0; 2] } else { origin_px };
        let SortBuffers { splats, depths, blocks, order } = buffers;
        let depths: &[u32] = &bytemuck::cast_slice(depths)[..splats.len()];
        let order = order.ascending(depths);
        self.entries.clear();
        self.cover.clear();
        self.entries.reserve(order.len());
        for keys in order.chunks(GROUP) {
            let mut cover = Cover::zeroed();
            for (i, key) in keys.iter().enumerate() {
                let place = place(*key);
                self.entries.push(Entry::new(&footprints[splats[place] as usize], origin_px, place));
                cover.set(i, blocks[place / LANES].halves(place % LANES));
            }
            with_simd!(level, simd => cover.transpose(simd));
            self.cover.push(cover);
        }
    }

    /// Returns the number of words of 64 entries that hold a block's bits.
    #[inline(always)]
    pub(crate) fn words(&self) -> usize {
        self.entries.len().div_ceil(WORD)
    }

    /// Returns which of the entries from 64 `word` on touch a block of the tile.
    #[inline(always)]
    pub(crate) fn word(&self, word: usize, block: usize) -> u64 {
        self.cover[word / (GROUP / WORD)].word(word % (GROUP / WORD), block)
    }

    /// Returns the memory that the list holds, bytes.
    pub(crate) fn capacity_bytes(&self) -> usize {
        self.entries.capacity() * size_of::<Entry>() + self.cover.capacity() * size_of::<Cover>()
    }

    /// Returns the memory that a copy takes, bytes.
    pub(crate) fn used_bytes(&self) -> usize {
        size_of_val(&*self.entries) + size_of_val(&*self.cover)
    }

    /// Returns a copy with no more memory than it needs.
    pub(crate) fn exact_copy(&self) -> Self {
        Self { entries: self.entries.to_vec(), cover: self.cover.to_vec() }
    }
}

impl SortBuffers {
    /// Finds the depths and the touched blocks of a tile whose pixels are rays, in the order of the
    /// bin.
    #[inline(always)]
    fn find_blocks_of_rays<S: Simd>(&mut self, simd: S, footprints: &[Footprint], rays: &RayTable, tile: usize) {
        self.depths.clear();
        self.blocks.clear();
        for splats in self.splats.chunks(LANES) {
            let (mut words, mut depths) = ([0; LANES], Lanes::ZERO);
            for ((splat, word), depth) in splats.iter().zip(&mut words).zip(&mut depths.0) {
                let footprint = &footprints[*splat as usize];
                *depth = footprint.depth;
                *word = footprint.touch().map_or(0, |splat| rays.touched_blocks(simd, &splat, tile));
            }
            self.blocks.push(SplatBits::from_words(&words));
            self.depths.push(depths);
        }
    }

    /// Finds the depths and the touched blocks, in the order of the bin.
    #[inline(always)]
    fn find_blocks<S: Simd>(&mut self, simd: S, footprints: &[Footprint], origin_px: [f32; 2]) {
        self.depths.clear();
        self.blocks.clear();
        for (n, splats) in self.splats.chunks(LANES).enumerate() {
            for splat in self.splats.iter().skip((n + AHEAD) * LANES).take(LANES) {
                prefetch(&footprints[*splat as usize]);
            }
            // Places beyond the last splat are copies of it, which are never read.
            let [mean_x, mean_y, root_0, root_1, root_2, log2_opacity, _, _, _, log2_threshold, extent_y, depth, right_dy, ..] =
                V::transpose(each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15] lane => {
                    V::load(simd, bytemuck::cast_ref(&footprints[splats[splats.len().min(lane + 1) - 1] as usize]))
                }));
            let outlines = Outlines {
                mean_px: [mean_x - origin_px[0], mean_y - origin_px[1]],
                root: [root_0, root_1, root_2],
                radius2: log2_opacity - log2_threshold,
                extent_y_px: extent_y + MARGIN_PX,
                right_dy_px: right_dy,
            };
            self.blocks.push(touched_blocks(simd, &outlines));
            let mut depths = Lanes::ZERO;
            depth.store(&mut depths);
            self.depths.push(depths);
        }
    }
}

impl Entry {
    #[inline(always)]
    fn new(f: &Footprint, origin_px: [f32; 2], place: usize) -> Self {
        Self {
            mean_px: [f.mean_px[0] - origin_px[0], f.mean_px[1] - origin_px[1]],
            root: f.root,
            log2_opacity: f.log2_opacity,
            radiance: f.radiance,
            log2_threshold: f.log2_threshold,
            place: place as u32,
            last: f.last,
        }
    }

    /// Returns the second and third number of the triangular root on the plane, of which the rows
    /// of the matrix are made.
    #[inline(always)]
    pub(crate) fn root_of_rows(&self) -> [f32; 2] {
        let [a, b] = self.rows();
        let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let last = dot(b, b).sqrt().max(f32::MIN_POSITIVE);
        [dot(a, b) / last, last]
    }

    /// Returns the rows of the matrix: see [`Footprint::rows`].
    #[inline(always)]
    pub(crate) fn rows(&self) -> [[f32; 3]; 2] {
        let ([a, b], [c, d, e]) = (self.mean_px, self.root);
        [[a, b, c], [d, e, self.last]]
    }
}
