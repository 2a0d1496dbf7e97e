//! Entries of a tile that touch a block, picked from words of bits.
//!
//! The rasterisers go over picks in stages, a loop each that does one thing for all of them. Splats do not hang on each other there, and the processor
//! overlaps them; a loop that did everything for one splat would be longer than what it looks ahead.

use super::sort::WORD;

/// From this many on picks are worth going over.
const ENOUGH: usize = 16;
/// Picked in one go, wanted or not: how many there are is guessed wrong too often to ask before each.
const STRIDE: usize = 4;
/// Most picks there are: one less than enough, and a word.
pub(crate) const MOST_PICKS: usize = ENOUGH - 1 + WORD;

/// Numbers of entries, in the order they were picked.
pub(crate) struct Picks {
    len: usize,
    entries: [u32; MOST_PICKS + STRIDE],
}

impl Picks {
    pub(crate) const NONE: Self = Self { len: 0, entries: [0; MOST_PICKS + STRIDE] };

    #[inline(always)]
    pub(crate) fn is_enough(&self) -> bool {
        self.len >= ENOUGH
    }

    /// Picks the bits of a word, which are entries from `start` on, the lowest first. There must not be enough picks yet.
    #[inline(always)]
    pub(crate) fn pick_ascending(&mut self, start: usize, bits: u64) {
        self.pick(bits, |bit| (start + bit) as u32);
    }

    /// Picks the bits of a word, which are entries from `start` on, the highest first. There must not be enough picks yet.
    #[inline(always)]
    pub(crate) fn pick_descending(&mut self, start: usize, bits: u64) {
        // What stands for no bit at all is not kept, whatever it is.
        self.pick(bits.reverse_bits(), |bit| (start + WORD - 1).wrapping_sub(bit) as u32);
    }

    #[inline(always)]
    fn pick(&mut self, mut bits: u64, entry: impl Fn(usize) -> u32) {
        let end = self.len + bits.count_ones() as usize;
        while self.len < end {
            for slot in &mut self.entries[self.len..][..STRIDE] {
                *slot = entry(bits.trailing_zeros() as usize);
                bits &= bits.wrapping_sub(1);
            }
            self.len += STRIDE;
        }
        self.len = end;
    }

    /// Hands the picks over, and has none afterwards.
    #[inline(always)]
    pub(crate) fn take(&mut self) -> &[u32] {
        let len = std::mem::take(&mut self.len);
        &self.entries[..len.min(MOST_PICKS)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_picked_in_order_either_way() {
        for bits in [0, 1, 1 << 63, 0b1011_0100, u64::MAX, 0x8421_0842_1084_2108] {
            let mut expected: Vec<u32> = (0..WORD as u32).filter(|bit| bits >> bit & 1 == 1).map(|bit| 640 + bit).collect();
            let mut picks = Picks::NONE;
            picks.pick_ascending(640, bits);
            assert_eq!(picks.take(), expected);
            picks.pick_descending(640, bits);
            expected.reverse();
            assert_eq!(picks.take(), expected);
            assert!(picks.take().is_empty());
        }
    }

    #[test]
    fn there_is_room_for_a_word_until_there_are_enough() {
        let mut picks = Picks::NONE;
        picks.pick_descending(0, (1 << (ENOUGH - 1)) - 1);
        assert!(!picks.is_enough());
        picks.pick_ascending(64, u64::MAX);
        assert!(picks.is_enough());
        let all: Vec<u32> = (0..ENOUGH as u32 - 1).rev().chain(64..128).collect();
        assert_eq!(picks.take(), all);
    }
}
