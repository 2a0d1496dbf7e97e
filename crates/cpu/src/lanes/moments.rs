//! Two moments of Adam in the bits of one number, sixteen parameters at a time.
//!
//! Layout: see [`crate::moments`]. Rounding is random, up with the probability of what is cut off.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, i32x16};

use super::V;

/// Mask of the first moment's bits, and of the second's.
const FIRST: i32 = 0xffff_0000_u32.cast_signed();
const SECOND: i32 = 0xffff;
/// Bits of the second moment that are cut off.
const SECOND_SHIFT: u32 = 15;

/// Numbers that tell the lanes apart: multiples of a large odd number.
const LANE_NUMBERS: [i32; 16] = {
    let mut numbers = [0; 16];
    let mut lane = 0;
    while lane < 16 {
        numbers[lane] = (lane as i32 + 1).wrapping_mul(0x2c1b_3c6d);
        lane += 1;
    }
    numbers
};

impl<S: Simd> V<S> {
    /// Returns the first and the second moments of packed numbers.
    #[inline(always)]
    pub(crate) fn unpack_moments(self) -> (Self, Self) {
        let simd = self.0.token();
        let bits: i32x16<S> = self.0.bitcast();
        let first = bits & i32x16::splat(simd, FIRST);
        let second = (bits & i32x16::splat(simd, SECOND)) << SECOND_SHIFT;
        (Self(first.bitcast()), Self(second.bitcast()))
    }

    /// Packs moments. The rounding depends on `seed`, the lane and nothing else; second moments are
    /// not negative.
    #[inline(always)]
    pub(crate) fn pack_moments(first: Self, second: Self, seed: u32) -> Self {
        let simd = first.0.token();
        let c = |value: i32| i32x16::splat(simd, value);
        // Two rounds of multiplication and shift mix the bits well enough for a dither.
        let random = i32x16::load_array_ref(simd, &LANE_NUMBERS) + c(seed.cast_signed());
        let random = (random ^ (random >> 16)) * c(0x7feb_352d);
        let random = (random ^ (random >> 15)) * c(0x846c_a68b_u32.cast_signed());
        let first: i32x16<S> = first.0.bitcast();
        let second: i32x16<S> = second.0.bitcast();
        let first = first + ((random >> 16) & c(SECOND));
        let second = second + (random & c((1 << SECOND_SHIFT) - 1));
        Self(((first & c(FIRST)) | ((second >> SECOND_SHIFT) & c(SECOND))).bitcast())
    }
}

#[cfg(test)]
mod tests {
    use luxel_lanes::Level;

    use super::*;
    use crate::lanes::with_simd;

    fn round_trip(first: f32, second: f32, seed: u32) -> [[f32; 16]; 2] {
        with_simd!(Level::best(), simd => {
            let (m, v) = V::pack_moments(V::splat(simd, first), V::splat(simd, second), seed).unpack_moments();
            [m.lanes(), v.lanes()]
        })
    }

    #[test]
    fn zeros_and_what_was_packed_stay_as_they_are() {
        let kept = [(0.0, 0.0), (1.0, 1.0), (-1.5, 0.0), (3.0e-30, 0.0)].map(|(m, v): (f32, f32)| {
            let m = f32::from_bits(m.to_bits() & 0xffff_0000);
            (m, v)
        });
        for (m, v) in kept {
            for seed in 0..50 {
                assert_eq!(round_trip(m, v, seed), [[m; 16], [v; 16]], "{m} {v}");
            }
        }
    }

    #[test]
    fn rounding_is_right_on_average_and_within_a_step() {
        for (m, v) in [(1.234_567_f32, 7.654_321e-9_f32), (-3.3e-7, 2.2e-20), (-9.99e-3, 1.001)] {
            let (mut sums, count) = ([0.0f64; 2], 4000);
            for seed in 0..count {
                let [first, second] = round_trip(m, v, (seed as u32).wrapping_mul(0x9e37_79b9));
                for lane in 0..16 {
                    assert!((first[lane] / m - 1.0).abs() < 1.0 / 128.0 && (second[lane] / v - 1.0).abs() < 1.0 / 256.0);
                    sums[0] += f64::from(first[lane]);
                    sums[1] += f64::from(second[lane]);
                }
            }
            let means = sums.map(|sum| sum / f64::from(16 * count));
            assert!((means[0] / f64::from(m) - 1.0).abs() < 1e-4, "{m}: {means:?}");
            assert!((means[1] / f64::from(v) - 1.0).abs() < 1e-4, "{v}: {means:?}");
        }
    }
}
