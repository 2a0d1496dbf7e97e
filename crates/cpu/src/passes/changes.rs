//! Which of a tile's entries changed which pixels: what `rasterize` knows at its end, and `rasterize_backward` would have to find out again.
//!
//! The second so needs neither the blocks' bits nor thresholds, and never meets the splats that lie between pixel centres or behind finished
//! pixels.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, u16x16, u32x16};

use super::picks::MOST_PICKS;
use crate::lanes::{LANES, M, is_one_register};
use crate::prefetch::fetch;

/// Changes of a tile's pixels.
#[derive(Default)]
pub(crate) struct Changes {
    /// Numbers of entries, of all blocks in a row and each front to back, and room for more.
    entries: Vec<u32>,
    /// Of each, the pixels that it changed: bit n for lane n.
    pixels: Vec<u16>,
    /// How many there are.
    len: usize,
    /// How many there were at the end of each block.
    ends: Vec<usize>,
}

/// Entries that changed a pixel of a block, front to back, and which pixels.
#[derive(Clone, Copy)]
pub(crate) struct BlockChanges<'a> {
    pub(crate) entries: &'a [u32],
    /// Bit n for lane n.
    pub(crate) pixels: &'a [u16],
}

impl Changes {
    /// Forgets all blocks.
    pub(crate) fn clear(&mut self) {
        self.ends.clear();
        self.len = 0;
    }

    /// Ends a block; the next begins.
    pub(crate) fn end_block(&mut self) {
        self.ends.push(self.len);
    }

    /// Those of a block that was ended.
    pub(crate) fn of(&self, block: usize) -> BlockChanges<'_> {
        let start = if block == 0 { 0 } else { self.ends[block - 1] };
        let range = start..self.ends[block];
        BlockChanges { entries: &self.entries[range.clone()], pixels: &self.pixels[range] }
    }

    /// Fetches all of them from memory.
    pub(crate) fn fetch(&self) {
        fetch(&self.entries[..self.len]);
        fetch(&self.pixels[..self.len]);
    }

    /// Notes the picks of the block that changed pixels, in their order. `pixels` are those that each changed, none behind the last pick.
    #[inline(always)]
    pub(crate) fn note<S: Simd>(&mut self, simd: S, (picks, count): (&[u32; MOST_PICKS], usize), pixels: &[u16; MOST_PICKS]) {
        if self.entries.len() < self.len + MOST_PICKS {
            let room = (self.len + MOST_PICKS).max(2 * self.entries.len());
            self.entries.resize(room, 0);
            self.pixels.resize(room, 0);
        }
        let room = (&mut self.entries[self.len..][..MOST_PICKS], &mut self.pixels[self.len..][..MOST_PICKS]);
        self.len += if is_one_register::<S>() {
            squeeze(simd, (&picks[..count.next_multiple_of(LANES)], pixels), room)
        } else {
            one_by_one((&picks[..count], pixels), room)
        };
    }
}

/// Keeps the picks that changed a pixel, with those. Returns how many.
#[inline(always)]
fn one_by_one((picks, pixels): (&[u32], &[u16]), (kept_picks, kept_pixels): (&mut [u32], &mut [u16])) -> usize {
    let mut kept = 0;
    for (pick, pixels) in picks.iter().zip(pixels) {
        kept_picks[kept] = *pick;
        kept_pixels[kept] = *pixels;
        kept += usize::from(*pixels != 0);
    }
    kept
}

/// The same of sixteen at a time, where a register holds them.
#[inline(always)]
fn squeeze<S: Simd>(simd: S, (picks, pixels): (&[u32], &[u16]), (kept_picks, kept_pixels): (&mut [u32], &mut [u16])) -> usize {
    let mut kept = 0;
    for (picks, pixels) in picks.chunks_exact(LANES).zip(pixels.chunks_exact(LANES)) {
        let (picks, pixels) = (u32x16::from_slice(simd, picks), u16x16::from_slice(simd, pixels));
        let changed = pixels.simd_gt(u16x16::splat(simd, 0));
        let bits = changed.to_bitmask();
        picks.compress(M::from_bitmask(simd, bits)).store_slice(&mut kept_picks[kept..][..LANES]);
        pixels.compress(changed).store_slice(&mut kept_pixels[kept..][..LANES]);
        kept += bits.count_ones() as usize;
    }
    kept
}

impl<'a> BlockChanges<'a> {
    /// `count` at a time from the back, each lot front to back.
    #[inline(always)]
    pub(crate) fn lots_from_the_back(self, count: usize) -> impl Iterator<Item = BlockChanges<'a>> {
        self.entries.rchunks(count).zip(self.pixels.rchunks(count)).map(|(entries, pixels)| BlockChanges { entries, pixels })
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::Level;

    use super::*;
    use crate::lanes::with_simd;

    /// Notes `count` picks from `first` on, of which pick n changed the pixels `pixels(n)`.
    fn note(level: Level, changes: &mut Changes, (first, count): (u32, usize), pixels: impl Fn(u32) -> u16) {
        // What lies behind the last pick is not to be kept.
        let picks = std::array::from_fn(|i| if i < count { first + i as u32 } else { u32::MAX });
        let pixels = std::array::from_fn(|i| if i < count { pixels(i as u32) } else { 0 });
        with_simd!(level, simd => changes.note(simd, (&picks, count), &pixels));
    }

    #[test]
    fn changes_are_kept_by_block_and_what_changed_nothing_is_not() {
        for level in [Level::new(), Level::baseline()] {
            let mut changes = Changes::default();
            for count in [MOST_PICKS, MOST_PICKS - 1, 33, 16, 5, 1] {
                changes.clear();
                for block in 0..3 {
                    (0..4 * block).for_each(|n| note(level, &mut changes, (100 * n, count), |pick| (pick % 3) as u16));
                    changes.end_block();
                }
                assert!(changes.of(0).entries.is_empty());
                for block in 1..3 {
                    let BlockChanges { entries, pixels } = changes.of(block as usize);
                    let expected: Vec<u32> = (0..4 * block)
                        .flat_map(|n| (0..count as u32).filter(|pick| pick % 3 != 0).map(move |pick| 100 * n + pick))
                        .collect();
                    assert_eq!(entries, expected);
                    assert!(entries.iter().zip(pixels).all(|(entry, pixels)| u32::from(*pixels) == entry % 100 % 3));
                }
            }
        }
    }

    #[test]
    fn lots_from_the_back_are_full_but_for_the_first() {
        let mut changes = Changes::default();
        note(Level::new(), &mut changes, (0, 5), |pick| 1 << pick);
        changes.end_block();
        let lots: Vec<_> = changes.of(0).lots_from_the_back(2).map(|lot| (lot.entries.to_vec(), lot.pixels.to_vec())).collect();
        assert_eq!(lots, [(vec![3, 4], vec![8, 16]), (vec![1, 2], vec![2, 4]), (vec![0], vec![1])]);
    }
}
