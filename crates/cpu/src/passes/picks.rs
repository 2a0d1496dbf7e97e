//! The entries of a tile that touch a block, extracted from words of bits.
//!
//! In: words of 64 bits, one bit per entry. Out: [`Picked`], numbers of entries in ascending order.
//!
//! `rasterize` processes picks in stages: each loop does one thing for all picks.
//! `rasterize_backward` does the same over changes. Within a stage the splats do not depend on each
//! other, so the processor overlaps them; one loop over everything would be longer than its
//! out-of-order window.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, mask8x64, u8x64};

use super::sort::WORD;
use crate::lanes::{LANES, is_one_register};

/// Number of picks from which on they are worth processing.
const ENOUGH: usize = 16;
/// Bits that [`Picks::push_bitwise`] extracts between two checks whether any are left: a check for
/// each bit is mispredicted too often. Few words have more bits.
const STRIDE: usize = 8;
/// Capacity for picks, in whole vectors. There are at most one less than [`ENOUGH`], and a word.
pub(crate) const MOST_PICKS: usize = (ENOUGH - 1 + WORD).next_multiple_of(LANES);

/// Picks that were taken from [`Picks`].
#[derive(Clone, Copy)]
pub(crate) struct Picked<'a> {
    /// Numbers of entries; those beyond the last are arbitrary.
    room: &'a [u32; MOST_PICKS],
    len: usize,
}

impl<'a> Picked<'a> {
    #[cfg(test)]
    pub(crate) fn new(room: &'a [u32; MOST_PICKS], len: usize) -> Self {
        Self { room, len }
    }

    /// Returns the numbers of the entries, in ascending order.
    #[inline(always)]
    pub(crate) fn entries(self) -> &'a [u32] {
        &self.room[..self.len]
    }

    /// Returns the numbers of the entries, with arbitrary ones behind them up to whole vectors.
    #[inline(always)]
    pub(crate) fn whole_vectors(self) -> &'a [u32] {
        &self.room[..self.len.next_multiple_of(LANES)]
    }
}

/// A buffer of numbers of entries, in ascending order.
pub(crate) struct Picks {
    entries: [u32; MOST_PICKS],
    len: usize,
}

impl Picks {
    pub(crate) const NONE: Self = Self { entries: [0; MOST_PICKS], len: 0 };

    /// Reports whether there are enough picks to process.
    #[inline(always)]
    pub(crate) fn is_enough(&self) -> bool {
        self.len >= ENOUGH
    }

    /// Appends the bits of a word, which stand for the entries from `start` on. There must not be
    /// enough picks yet.
    #[inline(always)]
    pub(crate) fn push_word<S: Simd>(&mut self, simd: S, start: u32, bits: u64) {
        if is_one_register::<S>() {
            self.push_compressed(simd, start, bits);
        } else {
            self.push_bitwise(start, bits);
        }
    }

    /// Takes the picks; none are left.
    #[inline(always)]
    pub(crate) fn take(&mut self) -> Picked<'_> {
        Picked { room: &self.entries, len: std::mem::take(&mut self.len) }
    }

    /// Appends the set bits one by one.
    #[inline(always)]
    fn push_bitwise(&mut self, start: u32, mut bits: u64) {
        let mut next = self.len;
        self.len += bits.count_ones() as usize;
        while next < self.len {
            for slot in &mut self.entries[next..][..STRIDE] {
                // Slots beyond the last bit hold an arbitrary number, which is not kept.
                *slot = start + bits.trailing_zeros();
                bits &= bits.wrapping_sub(1);
            }
            next += STRIDE;
        }
    }

    /// Appends the set bits by compressing the numbers of all bits: one instruction, where a
    /// register holds them.
    #[inline(always)]
    fn push_compressed<S: Simd>(&mut self, simd: S, start: u32, bits: u64) {
        const NUMBERS: [u8; WORD] = {
            let mut numbers = [0; WORD];
            let mut n = 0;
            while n < WORD {
                numbers[n] = n as u8;
                n += 1;
            }
            numbers
        };
        let next = self.len;
        self.len += bits.count_ones() as usize;
        let set = u8x64::load_array(simd, NUMBERS).compress(mask8x64::from_bitmask(simd, bits));
        let (low, high) = set.widen();
        let ((first, second), (third, fourth)) = (low.widen(), high.widen());
        let slots = &mut self.entries[next..][..WORD];
        (first + start).store_slice(&mut slots[..LANES]);
        if self.len > next + LANES {
            (second + start).store_slice(&mut slots[LANES..2 * LANES]);
            (third + start).store_slice(&mut slots[2 * LANES..3 * LANES]);
            (fourth + start).store_slice(&mut slots[3 * LANES..]);
        }
    }
}

#[cfg(test)]
mod tests {
    use luxel_lanes::Level;

    use super::*;
    use crate::lanes::with_simd;

    fn taken(picks: &mut Picks) -> &[u32] {
        picks.take().entries()
    }

    /// Returns the picks after appending `bits` to `before` others.
    fn picked<S: Simd>(simd: S, before: u32, bits: u64, compressed: bool) -> Vec<u32> {
        let mut picks = Picks::NONE;
        picks.push_bitwise(0, (1 << before) - 1);
        assert!(!picks.is_enough());
        if compressed {
            picks.push_compressed(simd, 640, bits);
        } else {
            picks.push_bitwise(640, bits);
        }
        assert_eq!(picks.is_enough(), before + bits.count_ones() >= ENOUGH as u32);
        taken(&mut picks).to_vec()
    }

    #[test]
    fn both_ways_pick_the_bits_in_order() {
        for bits in [0, 1, 1 << 63, 0b1011_0100, 0xffff, u64::MAX, 0x8421_0842_1084_2108] {
            for before in [0, 3, ENOUGH as u32 - 1] {
                let expected: Vec<u32> = (0..before).chain((0..64).filter(|bit| bits >> bit & 1 == 1).map(|bit| 640 + bit)).collect();
                for level in [Level::best(), Level::baseline()] {
                    with_simd!(level, simd => {
                        assert_eq!(picked(simd, before, bits, true), expected);
                        assert_eq!(picked(simd, before, bits, false), expected);
                    });
                }
            }
        }
    }

    #[test]
    fn picks_are_taken_once() {
        let mut picks = Picks::NONE;
        picks.push_bitwise(0, 0b101);
        assert_eq!(taken(&mut picks), [0, 2]);
        assert!(taken(&mut picks).is_empty());
        picks.push_bitwise(64, 0b10);
        assert_eq!(taken(&mut picks), [65]);
    }
}
