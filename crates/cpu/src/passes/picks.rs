//! Entries of a tile that touch a block, picked from words of bits.
//!
//! `rasterize` goes over picks in stages, a loop each that does one thing for all of them, and so does `rasterize_backward` over what they changed.
//! Splats do not hang on each other there, and the processor overlaps them; a loop that did everything for one splat would be longer than what it
//! looks ahead.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, mask8x64, u8x64};

use super::sort::WORD;
use crate::lanes::{LANES, is_one_register};

/// From this many on picks are worth going over.
const ENOUGH: usize = 16;
/// Picked in one go by [`Picks::count_off`], wanted or not: how many there are is guessed wrong too often to ask before each. Few words have more bits.
const STRIDE: usize = 8;
/// Room for picks, in whole vectors. Most that there are: one less than enough, and a word.
pub(crate) const MOST_PICKS: usize = (ENOUGH - 1 + WORD).next_multiple_of(LANES);

/// Numbers of entries, in ascending order.
pub(crate) struct Picks {
    entries: [u32; MOST_PICKS],
    len: usize,
}

impl Picks {
    pub(crate) const NONE: Self = Self { entries: [0; MOST_PICKS], len: 0 };

    #[inline(always)]
    pub(crate) fn is_enough(&self) -> bool {
        self.len >= ENOUGH
    }

    /// Picks the bits of a word, which are entries from `start` on. There must not be enough picks yet.
    #[inline(always)]
    pub(crate) fn pick<S: Simd>(&mut self, simd: S, start: u32, bits: u64) {
        if is_one_register::<S>() {
            self.squeeze(simd, start, bits);
        } else {
            self.count_off(start, bits);
        }
    }

    /// Hands the picks over, with how many there are; there are none then. What follows the last does not matter.
    #[inline(always)]
    pub(crate) fn take(&mut self) -> (&[u32; MOST_PICKS], usize) {
        (&self.entries, std::mem::take(&mut self.len))
    }

    /// Bit by bit.
    #[inline(always)]
    fn count_off(&mut self, start: u32, mut bits: u64) {
        let mut next = self.len;
        self.len += bits.count_ones() as usize;
        while next < self.len {
            for slot in &mut self.entries[next..][..STRIDE] {
                // What stands for no bit at all is not kept, whatever it is.
                *slot = start + bits.trailing_zeros();
                bits &= bits.wrapping_sub(1);
            }
            next += STRIDE;
        }
    }

    /// The numbers of all bits, without those that are not set: an instruction, where a register holds all.
    #[inline(always)]
    fn squeeze<S: Simd>(&mut self, simd: S, start: u32, bits: u64) {
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
    use fearless_simd::Level;

    use super::*;
    use crate::lanes::with_simd;

    fn taken(picks: &mut Picks) -> &[u32] {
        let (entries, len) = picks.take();
        &entries[..len]
    }

    /// Picks `bits` after `before` others.
    fn picked<S: Simd>(simd: S, before: u32, bits: u64, squeeze: bool) -> Vec<u32> {
        let mut picks = Picks::NONE;
        picks.count_off(0, (1 << before) - 1);
        assert!(!picks.is_enough());
        if squeeze {
            picks.squeeze(simd, 640, bits);
        } else {
            picks.count_off(640, bits);
        }
        assert_eq!(picks.is_enough(), before + bits.count_ones() >= ENOUGH as u32);
        taken(&mut picks).to_vec()
    }

    #[test]
    fn either_way_picks_the_bits_in_order() {
        for bits in [0, 1, 1 << 63, 0b1011_0100, 0xffff, u64::MAX, 0x8421_0842_1084_2108] {
            for before in [0, 3, ENOUGH as u32 - 1] {
                let expected: Vec<u32> = (0..before).chain((0..64).filter(|bit| bits >> bit & 1 == 1).map(|bit| 640 + bit)).collect();
                for level in [Level::new(), Level::baseline()] {
                    with_simd!(level, simd => {
                        assert_eq!(picked(simd, before, bits, true), expected);
                        assert_eq!(picked(simd, before, bits, false), expected);
                    });
                }
            }
        }
    }

    #[test]
    fn picks_are_handed_over_once() {
        let mut picks = Picks::NONE;
        picks.count_off(0, 0b101);
        assert_eq!(taken(&mut picks), [0, 2]);
        assert!(taken(&mut picks).is_empty());
        picks.count_off(64, 0b10);
        assert_eq!(taken(&mut picks), [65]);
    }
}
