//! Pass `sort`: a tile's splats from front to back, and which of its blocks they cover.
//!
//! In: bins, footprints. Out: the tile's [`TileList`]: its [`Entry`]s by ascending depth, equal depths by ascending index of the splat,
//! and for each of its 64 blocks a bit per entry that says whether the entry's ellipse touches the block (exact for the
//! continuous band of a block's rows, with a margin for rounding). The rasteriser walks the bits of a block.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd};
use luxel_core::{Real, each};

use super::bin::Bins;
use super::project::{Footprint, MARGIN_PX};
use crate::lanes::{LANES, Lanes, V, with_simd};
use crate::view::{BLOCK_PX, BLOCKS, ScreenCamera, TILE_BLOCKS};

/// Entries whose bits share a word.
pub(crate) const WORD: usize = 64;

/// A splat in a tile's list: what blending needs of its footprint.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(16))]
pub(crate) struct Entry {
    /// Centre relative to the tile's top left corner.
    pub(crate) mean_px: [f32; 2],
    /// As [`Footprint::root`].
    pub(crate) root: [f32; 3],
    pub(crate) log2_opacity: f32,
    pub(crate) log2_threshold: f32,
    pub(crate) radiance: [f32; 3],
    /// Place in the tile's bin, where its gradient goes.
    pub(crate) place: u32,
}

/// A tile's splats.
#[derive(Default)]
pub(crate) struct TileList {
    /// Front to back.
    pub(crate) entries: Vec<Entry>,
    /// Words of 64 entries: `[words, 64 blocks]`.
    pub(crate) cover: Vec<[u64; BLOCKS]>,
    /// Depth's bits and place.
    keys: Vec<u64>,
    /// Splat of each place.
    splats: Vec<u32>,
    outlines: Vec<Outline>,
}

/// Outlines of 16 entries, in what [`cover_group`] needs.
#[derive(Clone, Copy, Default)]
struct Outline {
    mean: [Lanes; 2],
    extent_y: Lanes,
    right_dy: Lanes,
    radius2: Lanes,
    root: [Lanes; 3],
}

impl TileList {
    /// Makes the list of a tile from its bin.
    pub(crate) fn sort(&mut self, level: Level, camera: &ScreenCamera, (bins, tile): (&Bins, usize), footprints: &[Footprint]) {
        let origin_px = camera.tile_origin_px(tile).map(|v| v as f32);
        self.collect(bins.tile(tile), footprints, origin_px);
        with_simd!(level, simd => self.find_cover(simd));
    }

    /// Reads the entries once in a row, at the pace of memory, so that they are in the core's cache for who picks from them.
    pub(crate) fn fetch(&self) {
        std::hint::black_box(self.entries.iter().fold(0, |sum, entry| sum ^ entry.place));
    }

    fn collect(&mut self, splats: impl Iterator<Item = u32>, footprints: &[Footprint], origin_px: [f32; 2]) {
        self.splats.clear();
        self.keys.clear();
        for (place, splat) in splats.enumerate() {
            self.splats.push(splat);
            // Bits of positive floats are in the order of the numbers; places are in the order of the splats.
            self.keys.push(u64::from(footprints[splat as usize].depth.to_bits()) << 32 | place as u64);
        }
        self.keys.sort_unstable();
        self.entries.clear();
        self.outlines.clear();
        self.outlines.resize(self.keys.len().div_ceil(LANES), Outline::default());
        for (i, key) in self.keys.iter().enumerate() {
            let place = *key as u32;
            let f = &footprints[self.splats[place as usize] as usize];
            let entry = Entry {
                mean_px: [f.mean_px[0] - origin_px[0], f.mean_px[1] - origin_px[1]],
                root: f.root,
                log2_opacity: f.log2_opacity,
                log2_threshold: f.log2_threshold,
                radiance: f.radiance,
                place,
            };
            self.outlines[i / LANES].set(i % LANES, &entry, f);
            self.entries.push(entry);
        }
    }

    #[inline(always)]
    fn find_cover<S: Simd>(&mut self, simd: S) {
        self.cover.clear();
        for outlines in self.outlines.chunks(WORD / LANES) {
            let mut word = [0u64; BLOCKS];
            for (n, outline) in outlines.iter().enumerate() {
                cover_group(simd, outline, n * LANES, &mut word);
            }
            self.cover.push(word);
        }
        // Lanes beyond the last entry are empty outlines, and cover nothing.
    }
}

impl Outline {
    fn set(&mut self, lane: usize, entry: &Entry, f: &Footprint) {
        for i in 0..2 {
            self.mean[i].0[lane] = entry.mean_px[i];
        }
        for i in 0..3 {
            self.root[i].0[lane] = entry.root[i];
        }
        // Of an empty outline this is 0, of a splat it is more.
        self.extent_y.0[lane] = f.extent_y_px + MARGIN_PX;
        self.right_dy.0[lane] = f.right_dy_px;
        self.radius2.0[lane] = entry.log2_opacity - entry.log2_threshold;
    }
}

/// Sets the bits of 16 entries, from `shift` on, in the words of the blocks that they touch.
#[inline(always)]
fn cover_group<S: Simd>(simd: S, outline: &Outline, shift: usize, words: &mut [u64; BLOCKS]) {
    let c = |value: f32| V::splat(simd, value);
    let [mean_x, mean_y] = each!([0, 1] i => V::load(simd, &outline.mean[i]));
    let root = each!([0, 1, 2] i => V::load(simd, &outline.root[i]));
    let (extent_y, right_dy) = (V::load(simd, &outline.extent_y), V::load(simd, &outline.right_dy));
    let radius2 = V::load(simd, &outline.radius2);
    let inverse_root = c(1.0) / root[0].max(c(f32::MIN_POSITIVE));
    let slope = -(root[1] * inverse_root);
    let half = |dy: V<S>| {
        let v = root[2] * dy;
        (-v).mul_add(v, radius2).max(c(0.0)).sqrt() * inverse_root
    };
    let (first_column, last_column) = (BLOCK_CENTERS_PX[0], BLOCK_CENTERS_PX[1]);
    for row in 0..TILE_BLOCKS {
        let y = (row * BLOCK_PX) as f32;
        // The band of the row's pixel centres, relative to the splat's, cut to its ellipse.
        let top = (c(y + first_column - MARGIN_PX) - mean_y).max(-extent_y);
        let bottom = (c(y + last_column + MARGIN_PX) - mean_y).min(extent_y);
        let touches = extent_y.gt(c(0.0)) & bottom.ge(top);
        if !touches.any_true() {
            continue;
        }
        let (left_dy, right_dy) = ((-right_dy).max(top).min(bottom), right_dy.max(top).min(bottom));
        let left = slope.mul_add(left_dy, mean_x) - half(left_dy) - MARGIN_PX;
        let right = slope.mul_add(right_dy, mean_x) + half(right_dy) + MARGIN_PX;
        for column in 0..TILE_BLOCKS {
            let x = (column * BLOCK_PX) as f32;
            let hit = touches & right.ge(c(x + first_column)) & c(x + last_column).ge(left);
            words[row * TILE_BLOCKS + column] |= hit.to_bitmask() << shift;
        }
    }
}

/// First and last pixel centre of a block.
const BLOCK_CENTERS_PX: [f32; 2] = [0.5, BLOCK_PX as f32 - 0.5];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_are_sorted_by_depth_then_index() {
        let depths = [3.0, 1.0, 2.5e-3, 1.0, 7e9, 2.0, 1.0];
        let footprints: Vec<Footprint> = depths.iter().map(|d| Footprint { depth: *d, ..Footprint::default() }).collect();
        let mut list = TileList::default();
        list.collect(0..7, &footprints, [0.0; 2]);
        let places: Vec<u32> = list.entries.iter().map(|entry| entry.place).collect();
        assert_eq!(places, [2, 1, 3, 6, 5, 0, 4]);
    }
}
