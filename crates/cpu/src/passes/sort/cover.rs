//! The blocks of a tile that ellipses touch: bits by splat, then bits by block.
//!
//! In: [`Outlines`] of 16 splats relative to the tile. Out: [`SplatBits`], 64 bits of each splat;
//! of 256 entries in their order, [`Cover`], the same bits as words of 64 entries for each block. A
//! block is touched if the band of its rows' pixel centres cuts the ellipse in its columns' range,
//! with a margin of `MARGIN_PX` for rounding.

use bytemuck::{Pod, Zeroable};
use fearless_simd::prelude::*;
use fearless_simd::{Simd, i32x16, u32x16};
use luxel_core::{Real, each};

use super::super::project::MARGIN_PX;
use crate::lanes::{LANES, V};
use crate::view::{BLOCK_PX, TILE_BLOCKS};

/// Entries whose bits share a word.
pub(crate) const WORD: usize = 64;
/// Entries that are transposed together: 16 matrices of 32 x 32 bits, one in each lane.
pub(super) const GROUP: usize = 256;

/// Rows of blocks that share a number: a row has eight bits, and half of a tile's rows fill 32.
const HALF_ROWS: usize = TILE_BLOCKS / 2;
/// Rows and columns of a lane's matrix: the number of bits of a number.
const SIDE: usize = u32::BITS as usize;
/// Matrices for each half of the blocks.
const MATRICES: usize = GROUP / SIDE;

/// The ellipses of 16 splats.
pub(super) struct Outlines<S: Simd> {
    /// Centre relative to the tile's top left corner.
    pub(super) mean_px: [V<S>; 2],
    /// See [`Footprint::root`](super::super::project::Footprint::root).
    pub(super) root: [V<S>; 3],
    /// u^2 + v^2 at the outline.
    pub(super) radius2: V<S>,
    /// Half the extent along y, with the margin.
    pub(super) extent_y_px: V<S>,
    /// dy at the rightmost point.
    pub(super) right_dy_px: V<S>,
}

/// The blocks that each of 16 splats touches: bit n of half h for block 32 h + n.
#[derive(Clone, Copy)]
pub(super) struct SplatBits([[i32; LANES]; 2]);

impl SplatBits {
    /// Converts a word of bits for each splat.
    pub(super) fn from_words(words: &[u64; LANES]) -> Self {
        let half = |shift: u32| words.map(|word| ((word >> shift) as u32).cast_signed());
        Self([half(0), half(u32::BITS)])
    }

    /// Returns both halves of a splat's bits.
    #[inline(always)]
    pub(super) fn halves(&self, lane: usize) -> [u32; 2] {
        each!([0, 1] half => self.0[half][lane].cast_unsigned())
    }
}

/// Finds the blocks that 16 splats touch.
#[inline(always)]
pub(super) fn touched_blocks<S: Simd>(simd: S, outlines: &Outlines<S>) -> SplatBits {
    let Outlines { mean_px: [mean_x, mean_y], root, radius2, extent_y_px, right_dy_px } = *outlines;
    let c = |value: f32| V::splat(simd, value);
    let (zero, one) = (i32x16::splat(simd, 0), i32x16::splat(simd, 1));
    let inverse_root = c(1.0) / root[0].max(c(f32::MIN_POSITIVE));
    let slope = -(root[1] * inverse_root);
    // First and last pixel centre of a block.
    let (first_px, last_px) = (0.5, BLOCK_PX as f32 - 0.5);
    let mut halves = [zero; 2];
    for row in 0..TILE_BLOCKS {
        let y = (row * BLOCK_PX) as f32;
        // The band of the row's pixel centres, relative to the splat's, cut to its ellipse.
        let top = (c(y + first_px - MARGIN_PX) - mean_y).max(-extent_y_px);
        let bottom = (c(y + last_px + MARGIN_PX) - mean_y).min(extent_y_px);
        let cuts = bottom.ge(top);
        if !cuts.any_true() {
            continue;
        }
        let (left_dy, right_dy) = ((-right_dy_px).max(top).min(bottom), right_dy_px.max(top).min(bottom));
        let [half_left, half_right] = each!([0, 1] side => {
            let v = root[2] * [left_dy, right_dy][side];
            (-v).mul_add(v, radius2).max(c(0.0)).sqrt() * inverse_root
        });
        let left = slope.mul_add(left_dy, mean_x) - half_left - MARGIN_PX;
        let right = slope.mul_add(right_dy, mean_x) + half_right + MARGIN_PX;
        // From the first block whose last column is not left of it to the last whose first column
        // is not right of it.
        let [first, end] = each!([0, 1] side => {
            let px = [left + (BLOCK_PX as f32 - last_px), right + (BLOCK_PX as f32 - first_px)][side];
            (px * (1.0 / BLOCK_PX as f32)).floor().max(c(0.0)).min(c(TILE_BLOCKS as f32))
        });
        let (first_bit, end_bit): (i32x16<S>, i32x16<S>) = (first.0.to_int(), end.0.to_int());
        let bits = (cuts & end.gt(first)).select((one << end_bit) - (one << first_bit), zero);
        let half = &mut halves[row / HALF_ROWS];
        *half |= bits << (row % HALF_ROWS * TILE_BLOCKS) as u32;
    }
    let mut bits = SplatBits([[0; LANES]; 2]);
    for (half, bits) in halves.iter().zip(&mut bits.0) {
        half.store_array(bits);
    }
    bits
}

/// The bits of 256 entries. Before the transposition, number n of half h of row r holds the blocks
/// 32 h.. that entry 32 n + r touches; after it, the entries 32 n.. that touch block 32 h + r: two
/// numbers in a row are a word.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(64))]
pub(super) struct Cover([[[u32; MATRICES]; 2]; SIDE]);

impl Cover {
    /// Sets the blocks of an entry of the group.
    #[inline(always)]
    pub(super) fn set(&mut self, entry: usize, halves: [u32; 2]) {
        for (half, bits) in self.0[entry % SIDE].iter_mut().zip(halves) {
            half[entry / SIDE] = bits;
        }
    }

    /// Returns the entries of the group, from 64 `word` on, that touch a block.
    #[inline(always)]
    pub(super) fn word(&self, word: usize, block: usize) -> u64 {
        let numbers = &self.0[block % SIDE][block / SIDE];
        u64::from(numbers[2 * word]) | u64::from(numbers[2 * word + 1]) << SIDE
    }

    /// Transposes bits by entry to bits by block: 16 matrices at once, by swapping quarters of
    /// halving size (Warren, Hacker's Delight, 7-3).
    #[inline(always)]
    pub(super) fn transpose<S: Simd>(&mut self, simd: S) {
        let rows: &mut [[u32; LANES]; SIDE] = bytemuck::cast_mut(&mut self.0);
        let mut size = SIDE / 2;
        let mut low = u32::MAX >> size;
        while size > 0 {
            for row in (0..SIDE).filter(|row| row & size == 0) {
                let (upper, lower) = (u32x16::load_array(simd, rows[row]), u32x16::load_array(simd, rows[row + size]));
                let swap = ((upper >> size as u32) ^ lower) & low;
                (upper ^ (swap << size as u32)).store_array(&mut rows[row]);
                (lower ^ swap).store_array(&mut rows[row + size]);
            }
            size /= 2;
            low ^= low << size;
        }
    }
}

#[cfg(test)]
mod tests {
    use luxel_lanes::Level;

    use super::*;
    use crate::lanes::{Lanes, with_simd};
    use crate::view::BLOCKS;

    /// Returns a generator of numbers in [0, 1).
    fn noise() -> impl FnMut() -> f32 {
        let mut state = 1u32;
        move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        }
    }

    #[test]
    fn bits_by_entry_become_bits_by_block() {
        let mut noise = noise();
        let entries: [[u32; 2]; GROUP] = std::array::from_fn(|_| [(); 2].map(|()| noise().to_bits().wrapping_mul(2_654_435_761)));
        for level in [Level::best(), Level::baseline()] {
            let mut cover = Cover::zeroed();
            entries.iter().enumerate().for_each(|(i, halves)| cover.set(i, *halves));
            with_simd!(level, simd => cover.transpose(simd));
            for (i, halves) in entries.iter().enumerate() {
                for block in 0..BLOCKS {
                    let expected = halves[block / SIDE] >> (block % SIDE) & 1;
                    assert_eq!(cover.word(i / WORD, block) >> (i % WORD) & 1, u64::from(expected), "entry {i}, block {block}");
                }
            }
        }
    }

    /// Centre, root and radius of 16 ellipses, round and thin, on the tile and beside it.
    struct Ellipses {
        mean_px: [Lanes; 2],
        root: [Lanes; 3],
        radius: Lanes,
    }

    impl Ellipses {
        fn new(noise: &mut impl FnMut() -> f32) -> Self {
            let mut lanes = |low: f32, high: f32| Lanes(std::array::from_fn(|_| low + (high - low) * noise()));
            let mean_px = [lanes(-8.0, 40.0), lanes(-8.0, 40.0)];
            Self { mean_px, root: [lanes(0.05, 2.0), lanes(-2.0, 2.0), lanes(0.05, 2.0)], radius: lanes(0.3, 3.0) }
        }

        fn touched(&self, level: Level) -> SplatBits {
            let [m0, m1, m2] = &self.root;
            let of = |f: &dyn Fn(usize) -> f32| Lanes(std::array::from_fn(f));
            let extent_y = of(&|i| self.radius.0[i] / m2.0[i] + MARGIN_PX);
            // Where dx = (u - m1 dy) / m0 is largest on the circle of u and v = m2 dy.
            let right_dy = of(&|i| {
                let shear = m1.0[i] / m2.0[i];
                -self.radius.0[i] * shear / (1.0 + shear * shear).sqrt() / m2.0[i]
            });
            let radius2 = of(&|i| self.radius.0[i] * self.radius.0[i]);
            with_simd!(level, simd => {
                let load = |lanes: &Lanes| V::load(simd, lanes);
                touched_blocks(simd, &Outlines {
                    mean_px: [load(&self.mean_px[0]), load(&self.mean_px[1])],
                    root: [load(m0), load(m1), load(m2)],
                    radius2: load(&radius2),
                    extent_y_px: load(&extent_y),
                    right_dy_px: load(&right_dy),
                })
            })
        }

        /// Reports whether a point of a grid over the block's pixel centres, `step` apart, is
        /// within the ellipse, which is enlarged by what may lie between points.
        fn overlaps(&self, i: usize, block: usize, step: f32) -> bool {
            let [m0, m1, m2] = [0, 1, 2].map(|k| self.root[k].0[i]);
            let corner = [block % TILE_BLOCKS, block / TILE_BLOCKS].map(|n| (n * BLOCK_PX) as f32 + 0.5);
            let slack = if step < 1.0 { 1.2 * step * (m0 + m1.abs() + m2) } else { 0.0 };
            let points = ((BLOCK_PX - 1) as f32 / step) as usize;
            (0..=points).any(|y| {
                (0..=points).any(|x| {
                    let dx = corner[0] + x as f32 * step - self.mean_px[0].0[i];
                    let dy = corner[1] + y as f32 * step - self.mean_px[1].0[i];
                    (m0 * dx + m1 * dy).hypot(m2 * dy) <= self.radius.0[i] + slack
                })
            })
        }
    }

    #[test]
    fn touched_blocks_are_those_that_the_ellipse_overlaps() {
        let mut noise = noise();
        for round in 0..60 {
            let ellipses = Ellipses::new(&mut noise);
            for level in [Level::best(), Level::baseline()] {
                let bits = ellipses.touched(level);
                for (i, block) in (0..LANES).flat_map(|i| (0..BLOCKS).map(move |block| (i, block))) {
                    let touched = bits.halves(i)[block / SIDE] >> (block % SIDE) & 1 == 1;
                    assert!(touched || !ellipses.overlaps(i, block, 1.0), "round {round}, ellipse {i}: block {block} has a pixel of it");
                    assert!(!touched || ellipses.overlaps(i, block, 0.25), "round {round}, ellipse {i}: block {block} is off it");
                }
            }
        }
    }
}
