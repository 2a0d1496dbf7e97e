//! Random numbers from (seed, index) alone: the same whatever the order of evaluation, so that a
//! training needs no generator in its checkpoint.

/// Returns 64 well-mixed bits of (seed, index): the finaliser of SplitMix64 (Steele et al. 2014),
/// twice.
#[inline]
pub(crate) fn bits(seed: u64, index: u64) -> u64 {
    mix(seed ^ mix(index))
}

/// Returns a uniform number in [0, 1).
#[inline]
pub(crate) fn uniform(seed: u64, index: u64) -> f32 {
    (bits(seed, index) >> 40) as f32 / 16_777_216.0
}

#[inline]
fn mix(mut z: u64) -> u64 {
    z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_uniform_and_differ_by_seed() {
        let mut tenths = [0u32; 10];
        for index in 0..100_000 {
            tenths[(uniform(7, index) * 10.0) as usize] += 1;
        }
        assert!(tenths.iter().all(|count| (9_600..10_400).contains(count)), "{tenths:?}");
        let both = (0..100_000).filter(|i| uniform(7, *i) < 0.1 && uniform(8, *i) < 0.1).count();
        assert!((900..1_100).contains(&both), "{both}");
    }
}
