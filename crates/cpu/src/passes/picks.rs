//! Entries of a tile that touch a block, picked from words of bits.
//!
//! The rasterisers go over picks in stages, a loop each that does one thing for all of them. Splats do not hang on each other there, and the processor
//! overlaps them; a loop that did everything for one splat would be longer than what it looks ahead.

use super::sort::WORD;

/// From this many on picks are worth going over.
const ENOUGH: usize = 16;
/// Picked in one go, wanted or not: how many there are is guessed wrong too often to ask before each. Few words have more bits.
const STRIDE: usize = 8;
/// Most picks there are: one less than enough, and a word.
pub(crate) const MOST_PICKS: usize = ENOUGH - 1 + WORD;
/// Memory for picks: so much that what is left has to be moved to the front only now and then, as reading together what was just written in parts
/// takes long.
pub(crate) type Room = [u32; 4 * WORD];
/// Memory that nobody has written to.
pub(crate) const EMPTY_ROOM: Room = [0; 4 * WORD];

/// Numbers of entries, in the order they were picked. Those before `start` have been handed over.
pub(crate) struct Picks<'a> {
    start: usize,
    end: usize,
    entries: &'a mut Room,
}

impl<'a> Picks<'a> {
    /// None yet; what is in `room` does not matter.
    #[inline(always)]
    pub(crate) fn new(room: &'a mut Room) -> Self {
        Self { start: 0, end: 0, entries: room }
    }

    #[inline(always)]
    pub(crate) fn is_enough(&self) -> bool {
        self.end - self.start >= ENOUGH
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
        if self.end > EMPTY_ROOM.len() - WORD - STRIDE {
            self.entries.copy_within(self.start..self.end, 0);
            (self.start, self.end) = (0, self.end - self.start);
        }
        let mut next = self.end;
        self.end += bits.count_ones() as usize;
        loop {
            for slot in &mut self.entries[next..][..STRIDE] {
                *slot = entry(bits.trailing_zeros() as usize);
                bits &= bits.wrapping_sub(1);
            }
            next += STRIDE;
            if next >= self.end {
                break;
            }
        }
    }

    /// Hands the first picks over, at most `most`.
    #[inline(always)]
    pub(crate) fn take(&mut self, most: usize) -> &[u32] {
        let (start, len) = (self.start, (self.end - self.start).min(most));
        self.start += len;
        &self.entries[start..][..len]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_picked_in_order_either_way() {
        for bits in [0, 1, 1 << 63, 0b1011_0100, u64::MAX, 0x8421_0842_1084_2108] {
            let mut expected: Vec<u32> = (0..WORD as u32).filter(|bit| bits >> bit & 1 == 1).map(|bit| 640 + bit).collect();
            let mut room = EMPTY_ROOM;
            let mut picks = Picks::new(&mut room);
            picks.pick_ascending(640, bits);
            assert_eq!(picks.take(MOST_PICKS), expected);
            picks.pick_descending(640, bits);
            expected.reverse();
            assert_eq!(picks.take(MOST_PICKS), expected);
            assert!(picks.take(MOST_PICKS).is_empty());
        }
    }

    #[test]
    fn there_is_room_for_a_word_until_there_are_enough() {
        let mut room = EMPTY_ROOM;
        let mut picks = Picks::new(&mut room);
        picks.pick_descending(0, (1 << (ENOUGH - 1)) - 1);
        assert!(!picks.is_enough());
        picks.pick_ascending(64, u64::MAX);
        assert!(picks.is_enough());
        let all: Vec<u32> = (0..ENOUGH as u32 - 1).rev().chain(64..128).collect();
        assert_eq!(picks.take(ENOUGH), &all[..ENOUGH]);
        assert_eq!(picks.take(MOST_PICKS), &all[ENOUGH..]);
    }

    #[test]
    fn what_is_not_taken_stays() {
        let mut room = EMPTY_ROOM;
        let mut picks = Picks::new(&mut room);
        picks.pick_ascending(0, u64::MAX);
        for start in [0, 16, 32] {
            assert_eq!(picks.take(ENOUGH), (start..start + 16).collect::<Vec<u32>>());
        }
        assert_eq!(picks.take(ENOUGH - 1), (48..63).collect::<Vec<u32>>());
        picks.pick_ascending(64, 0b101);
        assert_eq!(picks.take(MOST_PICKS), [63, 64, 66]);
    }
}
