//! Spatial order of splats: neighbours in space become neighbours in memory.
//!
//! In: positions `[N,3]`. Out: a permutation. Passes fetch splats by tile and gradients by splat.
//! On a scene in random order nearly every fetch misses the caches; along a Z-order curve (Morton
//! 1966) most fetches hit.

/// Bits per axis in a key.
const AXIS_BITS: u32 = 16;

/// Returns the permutation that sorts positions `[N,3]` along a Z-order curve through their
/// bounding box: `result[new] = old`.
///
/// Ties keep their order.
pub fn spatial_order(position: &[[f32; 3]]) -> Vec<u32> {
    let mut low = [f32::INFINITY; 3];
    let mut high = [f32::NEG_INFINITY; 3];
    for p in position {
        for axis in 0..3 {
            low[axis] = low[axis].min(p[axis]);
            high[axis] = high[axis].max(p[axis]);
        }
    }
    let cells = ((1u32 << AXIS_BITS) - 1) as f32;
    let key = |p: &[f32; 3]| {
        (0..3).fold(0u64, |key, axis| {
            let unit = (p[axis] - low[axis]) / (high[axis] - low[axis]).max(f32::MIN_POSITIVE);
            key | spread((unit * cells) as u64) << axis
        })
    };
    let mut keyed: Vec<(u64, u32)> = position.iter().zip(0u32..).map(|(p, i)| (key(p), i)).collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(_, i)| i).collect()
}

/// Spreads 16 bits so that two zeros separate neighbours.
fn spread(bits: u64) -> u64 {
    let mut b = bits & 0xffff;
    b = (b | b << 16) & 0x00_ff00_00ff;
    b = (b | b << 8) & 0x00f0_0f00_f00f;
    b = (b | b << 4) & 0x0c30_c30c_30c3;
    (b | b << 2) & 0x2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spread_leaves_two_zeros_between_bits() {
        for bit in 0..16 {
            assert_eq!(spread(1 << bit), 1 << (3 * bit), "bit {bit}");
        }
        assert_eq!(spread(0xffff).count_ones(), 16);
    }

    #[test]
    fn order_is_a_permutation_that_keeps_neighbours_together() {
        let position: Vec<[f32; 3]> =
            (0..4096u32).map(|i| i.wrapping_mul(2_654_435_761)).map(|h| [0, 8, 16].map(|s| ((h >> s) & 255) as f32)).collect();
        let order = spatial_order(&position);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert!(sorted.iter().enumerate().all(|(i, o)| i as u32 == *o));
        let step = |a: u32, b: u32| (0..3).map(|c| (position[a as usize][c] - position[b as usize][c]).abs()).sum::<f32>();
        let before: f32 = (1..4096).map(|i| step(i - 1, i)).sum();
        let after: f32 = order.windows(2).map(|w| step(w[0], w[1])).sum();
        assert!(after < before / 4.0, "{after} {before}");
    }

    #[test]
    fn order_of_coincident_or_absent_points_is_kept() {
        assert_eq!(spatial_order(&[[1.0; 3]; 3]), [0, 1, 2]);
        assert!(spatial_order(&[]).is_empty());
    }
}
