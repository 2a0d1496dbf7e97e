//! Which of a tile's entries changed which pixels: what `rasterize` knows at its end, and `rasterize_backward` would have to find out again.
//!
//! The second so needs neither the blocks' bits nor thresholds, and never meets the splats that lie between pixel centres or behind finished
//! pixels.

use super::picks::MOST_PICKS;
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

    /// To note up to [`MOST_PICKS`] of the block with.
    #[inline(always)]
    pub(crate) fn pen(&mut self) -> Pen<'_> {
        if self.entries.len() < self.len + MOST_PICKS {
            let room = (self.len + MOST_PICKS).max(2 * self.entries.len());
            self.entries.resize(room, 0);
            self.pixels.resize(room, 0);
        }
        let (entries, pixels) = (&mut self.entries[self.len..][..MOST_PICKS], &mut self.pixels[self.len..][..MOST_PICKS]);
        Pen { entries, pixels, noted: 0, len: &mut self.len }
    }
}

impl<'a> BlockChanges<'a> {
    /// `count` at a time from the back, each lot front to back.
    #[inline(always)]
    pub(crate) fn lots_from_the_back(self, count: usize) -> impl Iterator<Item = BlockChanges<'a>> {
        self.entries.rchunks(count).zip(self.pixels.rchunks(count)).map(|(entries, pixels)| BlockChanges { entries, pixels })
    }
}

/// Notes changes; they count once it is dropped.
pub(crate) struct Pen<'a> {
    entries: &'a mut [u32],
    pixels: &'a mut [u16],
    noted: usize,
    len: &'a mut usize,
}

impl Pen<'_> {
    /// Notes an entry, unless it changed no pixel.
    #[inline(always)]
    pub(crate) fn note(&mut self, entry: u32, pixels: u16) {
        self.entries[self.noted] = entry;
        self.pixels[self.noted] = pixels;
        self.noted += usize::from(pixels != 0);
    }
}

impl Drop for Pen<'_> {
    #[inline(always)]
    fn drop(&mut self) {
        *self.len += self.noted;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_kept_by_block_and_what_changed_nothing_is_not() {
        let mut changes = Changes::default();
        for _ in 0..2 {
            changes.clear();
            for block in 0..3 {
                for n in 0..4 * block {
                    let mut pen = changes.pen();
                    (0..MOST_PICKS as u32).for_each(|entry| pen.note(100 * n + entry, (entry % 3) as u16));
                }
                changes.end_block();
            }
            assert!(changes.of(0).entries.is_empty());
            for block in 1..3 {
                let BlockChanges { entries, pixels } = changes.of(block as usize);
                let expected: Vec<u32> = (0..4 * block)
                    .flat_map(|n| (0..MOST_PICKS as u32).filter(|entry| entry % 3 != 0).map(move |entry| 100 * n + entry))
                    .collect();
                assert_eq!(entries, expected);
                assert!(entries.iter().zip(pixels).all(|(entry, pixels)| u32::from(*pixels) == entry % 100 % 3));
            }
        }
    }

    #[test]
    fn lots_from_the_back_are_full_but_for_the_first() {
        let mut changes = Changes::default();
        let mut pen = changes.pen();
        (0..5).for_each(|entry| pen.note(entry, 1 << entry));
        drop(pen);
        changes.end_block();
        let lots: Vec<_> = changes.of(0).lots_from_the_back(2).map(|lot| (lot.entries.to_vec(), lot.pixels.to_vec())).collect();
        assert_eq!(lots, [(vec![3, 4], vec![8, 16]), (vec![1, 2], vec![2, 4]), (vec![0], vec![1])]);
    }
}
