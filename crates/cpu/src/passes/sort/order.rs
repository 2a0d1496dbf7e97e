//! The order of a tile's splats: sorts places of a bin by ascending depth, equal depths by
//! ascending place.
//!
//! In: the depths' bits, which for positive numbers are ordered as the numbers are. Out: keys that
//! hold the places. The method is a radix sort of the bits that differ within the tile, in at most
//! three rounds, each of which counts the digits of the next. Short lists are sorted by the
//! standard library, as clearing counters would cost more. Degenerate: equal depths need no round.

/// Greatest number of bits in a digit: its counters stay in the nearest cache.
const MAX_DIGIT: u32 = 11;
/// Length below which the standard library is as fast.
const MIN_RADIX: usize = 512;

/// Buffers of a sort, kept between steps.
#[derive(Default)]
pub(super) struct Order {
    /// Bits of the depth, then the place.
    keys: Vec<u64>,
    swap: Vec<u64>,
    /// For each digit the number of keys that have it; then the position of the next one.
    starts: Vec<u32>,
    next_starts: Vec<u32>,
}

/// Returns the place of a key.
#[inline(always)]
pub(super) fn place(key: u64) -> usize {
    key as u32 as usize
}

impl Order {
    /// Returns the keys of the places, in ascending order of `depths`.
    pub(super) fn ascending(&mut self, depths: &[u32]) -> &[u64] {
        self.keys.clear();
        self.keys.extend(depths.iter().zip(0u64..).map(|(depth, place)| u64::from(*depth) << 32 | place));
        if depths.len() < MIN_RADIX {
            self.keys.sort_unstable();
        } else {
            self.radix_sort(depths);
        }
        &self.keys
    }

    fn radix_sort(&mut self, depths: &[u32]) {
        let (least, most) = depths.iter().fold((u32::MAX, 0), |(least, most), depth| (least.min(*depth), most.max(*depth)));
        let bits = u32::BITS - (most - least).leading_zeros();
        let rounds = bits.div_ceil(MAX_DIGIT);
        if rounds == 0 {
            return;
        }
        let digit_bits = bits.div_ceil(rounds);
        let digit = |key: u64, round: u32| (((key >> 32) as u32 - least) >> (round * digit_bits)) as usize & ((1 << digit_bits) - 1);
        self.swap.resize(self.keys.len(), 0);
        for counts in [&mut self.starts, &mut self.next_starts] {
            counts.clear();
            counts.resize(1 << digit_bits, 0);
        }
        for key in &self.keys {
            self.starts[digit(*key, 0)] += 1;
        }
        for round in 0..rounds {
            let mut start = 0;
            for count in &mut self.starts {
                start += std::mem::replace(count, start);
            }
            // The last round counts the first digit again; that count is not used.
            let next = (round + 1) % rounds;
            for key in &self.keys {
                let start = &mut self.starts[digit(*key, round)];
                self.swap[*start as usize] = *key;
                *start += 1;
                self.next_starts[digit(*key, next)] += 1;
            }
            std::mem::swap(&mut self.keys, &mut self.swap);
            std::mem::swap(&mut self.starts, &mut self.next_starts);
            self.next_starts.fill(0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(depths: &[f32]) {
        let bits: Vec<u32> = depths.iter().map(|depth| depth.to_bits()).collect();
        let mut expected: Vec<u32> = (0..depths.len() as u32).collect();
        expected.sort_by(|a, b| depths[*a as usize].total_cmp(&depths[*b as usize]));
        let mut order = Order::default();
        for _ in 0..2 {
            assert_eq!(order.ascending(&bits).iter().map(|key| *key as u32).collect::<Vec<u32>>(), expected);
        }
    }

    #[test]
    fn places_are_sorted_by_depth_then_place() {
        check(&[3.0, 1.0, 2.5e-3, 1.0, 7e9, 2.0, 1.0]);
        check(&[]);
        let noise = |i: u32| f32::from((i.wrapping_mul(2_654_435_761) >> 16) as u16) / 65536.0;
        for count in [MIN_RADIX as u32 - 1, MIN_RADIX as u32, 5000] {
            let of = |depth: fn(f32) -> f32| (0..count).map(|i| depth(noise(i))).collect::<Vec<f32>>();
            check(&of(|_| 2.0));
            check(&of(|x| 2.0 + 1e-4 * x));
            check(&of(|x| 0.3 + 9.0 * x));
            check(&of(|x| (f32::MAX.ln() * (2.0 * x - 1.0)).exp()));
            check(&of(|x| (8.0 * x).floor() + 1.0));
        }
    }
}
