//! A record of which of a tile's entries changed which pixels, written by `rasterize` and read by
//! `rasterize_backward`.
//!
//! In: picks of a block with a bit per changed pixel. Out: [`BlockChanges`], without the picks that
//! changed nothing.
//!
//! With it `rasterize_backward` needs neither the blocks' bits nor thresholds, and skips splats
//! between pixel centres or behind finished pixels.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, u16x16, u32x16};

use super::picks::{MOST_PICKS, Picked};
use crate::lanes::{LANES, M, is_one_register};
use crate::prefetch::fetch;

/// The changes of a tile's pixels.
#[derive(Default)]
pub(crate) struct Changes {
    /// Numbers of entries, block after block, front to back within each, and room for more.
    entries: Vec<u32>,
    /// Pixels that each entry changed: bit n for lane n.
    pixels: Vec<u16>,
    /// Number of changes.
    len: usize,
    /// Number of changes up to the end of each block.
    ends: Vec<usize>,
}

/// The entries that changed a pixel of a block, front to back, and which pixels.
#[derive(Clone, Copy)]
pub(crate) struct BlockChanges<'a> {
    pub(crate) entries: &'a [u32],
    /// Bit n for lane n.
    pub(crate) pixels: &'a [u16],
}

/// Room for recorded changes.
struct ChangeRoom<'a> {
    entries: &'a mut [u32],
    pixels: &'a mut [u16],
}

impl Changes {
    /// Removes all blocks.
    pub(crate) fn clear(&mut self) {
        self.ends.clear();
        self.len = 0;
    }

    /// Returns the memory that the changes hold, bytes.
    pub(crate) fn capacity_bytes(&self) -> usize {
        self.entries.capacity() * size_of::<u32>() + self.pixels.capacity() * size_of::<u16>() + self.ends.capacity() * size_of::<usize>()
    }

    /// Returns the memory that a copy takes, bytes.
    pub(crate) fn used_bytes(&self) -> usize {
        self.len * (size_of::<u32>() + size_of::<u16>()) + size_of_val(&*self.ends)
    }

    /// Returns a copy with no more memory than it needs.
    pub(crate) fn exact_copy(&self) -> Self {
        let Self { entries, pixels, len, ends } = self;
        Self { entries: entries[..*len].to_vec(), pixels: pixels[..*len].to_vec(), len: *len, ends: ends.to_vec() }
    }

    /// Ends a block; the next begins.
    pub(crate) fn end_block(&mut self) {
        self.ends.push(self.len);
    }

    /// Returns the changes of a block that has ended.
    pub(crate) fn block(&self, block: usize) -> BlockChanges<'_> {
        let start = if block == 0 { 0 } else { self.ends[block - 1] };
        let range = start..self.ends[block];
        BlockChanges { entries: &self.entries[range.clone()], pixels: &self.pixels[range] }
    }

    /// Reads all changes ahead of their use, so that they are in the cache.
    pub(crate) fn fetch(&self) {
        fetch(&self.entries[..self.len]);
        fetch(&self.pixels[..self.len]);
    }

    /// Records the picks that changed pixels of the block, in their order. `pixels` holds the
    /// pixels that each pick changed, and 0 behind the last pick.
    #[inline(always)]
    pub(crate) fn record<S: Simd>(&mut self, simd: S, picked: Picked<'_>, pixels: &[u16; MOST_PICKS]) {
        if self.entries.len() < self.len + MOST_PICKS {
            let room = (self.len + MOST_PICKS).max(2 * self.entries.len());
            self.entries.resize(room, 0);
            self.pixels.resize(room, 0);
        }
        let room = ChangeRoom { entries: &mut self.entries[self.len..][..MOST_PICKS], pixels: &mut self.pixels[self.len..][..MOST_PICKS] };
        self.len += if is_one_register::<S>() {
            keep_compressed(simd, picked.whole_vectors(), pixels, room)
        } else {
            keep_one_by_one(picked.entries(), pixels, room)
        };
    }
}

/// Keeps the picks that changed a pixel. Returns their number.
#[inline(always)]
fn keep_one_by_one(picks: &[u32], pixels: &[u16], room: ChangeRoom<'_>) -> usize {
    let mut kept = 0;
    for (pick, pixels) in picks.iter().zip(pixels) {
        room.entries[kept] = *pick;
        room.pixels[kept] = *pixels;
        kept += usize::from(*pixels != 0);
    }
    kept
}

/// Keeps the picks that changed a pixel, sixteen at a time, where a register holds them. Returns
/// their number.
#[inline(always)]
fn keep_compressed<S: Simd>(simd: S, picks: &[u32], pixels: &[u16], room: ChangeRoom<'_>) -> usize {
    let mut kept = 0;
    for (picks, pixels) in picks.chunks_exact(LANES).zip(pixels.chunks_exact(LANES)) {
        let (picks, pixels) = (u32x16::from_slice(simd, picks), u16x16::from_slice(simd, pixels));
        let changed = pixels.simd_gt(u16x16::splat(simd, 0));
        let bits = changed.to_bitmask();
        picks.compress(M::from_bitmask(simd, bits)).store_slice(&mut room.entries[kept..][..LANES]);
        pixels.compress(changed).store_slice(&mut room.pixels[kept..][..LANES]);
        kept += bits.count_ones() as usize;
    }
    kept
}

impl<'a> BlockChanges<'a> {
    /// Returns chunks of `count` changes from back to front; within each chunk they are front to
    /// back.
    #[inline(always)]
    pub(crate) fn chunks_from_back(self, count: usize) -> impl Iterator<Item = BlockChanges<'a>> {
        self.entries.rchunks(count).zip(self.pixels.rchunks(count)).map(|(entries, pixels)| BlockChanges { entries, pixels })
    }
}

#[cfg(test)]
mod tests {
    use std::ops::Range;

    use luxel_lanes::Level;

    use super::*;
    use crate::lanes::with_simd;

    /// Records the picks of the range, of which pick n (counted from the first) changed the pixels
    /// `pixels(n)`.
    fn record(level: Level, changes: &mut Changes, range: Range<u32>, pixels: impl Fn(u32) -> u16) {
        let (first, count) = (range.start, range.len());
        // Numbers behind the last pick must not be kept.
        let picks = std::array::from_fn(|i| if i < count { first + i as u32 } else { u32::MAX });
        let pixels = std::array::from_fn(|i| if i < count { pixels(i as u32) } else { 0 });
        with_simd!(level, simd => changes.record(simd, Picked::new(&picks, count), &pixels));
    }

    #[test]
    fn changes_are_kept_by_block_without_picks_that_changed_nothing() {
        for level in [Level::best(), Level::baseline()] {
            let mut changes = Changes::default();
            for count in [MOST_PICKS, MOST_PICKS - 1, 33, 16, 5, 1] {
                changes.clear();
                for block in 0..3 {
                    (0..4 * block).for_each(|n| record(level, &mut changes, 100 * n..100 * n + count as u32, |pick| (pick % 3) as u16));
                    changes.end_block();
                }
                assert!(changes.block(0).entries.is_empty());
                for block in 1..3 {
                    let BlockChanges { entries, pixels } = changes.block(block as usize);
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
    fn chunks_from_the_back_are_full_except_the_first() {
        let mut changes = Changes::default();
        record(Level::best(), &mut changes, 0..5, |pick| 1 << pick);
        changes.end_block();
        let lots: Vec<_> = changes.block(0).chunks_from_back(2).map(|lot| (lot.entries.to_vec(), lot.pixels.to_vec())).collect();
        assert_eq!(lots, [(vec![3, 4], vec![8, 16]), (vec![1, 2], vec![2, 4]), (vec![0], vec![1])]);
    }
}
