//! Counter-based random numbers: the same on every engine, whatever the order of evaluation.

/// Returns a well-mixed 64-bit hash (finaliser of SplitMix64, Steele et al. 2014).
#[inline]
fn mix(mut z: u64) -> u64 {
    z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Returns 64 random bits that depend on `(seed, index)` alone.
#[inline]
pub fn bits(seed: u64, index: u64) -> u64 {
    mix(seed ^ mix(index))
}

/// Returns a uniform number in [0, 1) that depends on `(seed, index)` alone.
#[inline]
pub fn uniform(seed: u64, index: u64) -> f32 {
    (bits(seed, index) >> 40) as f32 / 16_777_216.0
}

/// Returns a well-mixed 32-bit hash (finaliser of MurmurHash3, Appleby 2011).
#[inline]
fn mix_32(mut h: u32) -> u32 {
    h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    h ^ (h >> 16)
}

/// Returns a uniform number in [0, 1) that depends on `(seed, index)` alone, from 32-bit operations
/// that shaders have.
#[inline]
pub fn uniform_32(seed: u32, index: u32) -> f32 {
    (mix_32(mix_32(index.wrapping_add(0x9e37_79b9)) ^ seed) >> 8) as f32 / 16_777_216.0
}

/// Returns three standard normal numbers that depend on `(seed, index)` alone (Box and Muller
/// 1958).
pub fn standard_normal(seed: u64, index: u64) -> [f32; 3] {
    let h = bits(seed, index);
    let g = mix(h);
    // 24 bits each: uniform in (0, 1].
    let unit = |bits: u64| ((bits & 0xff_ffff) as f32 + 1.0) / 16_777_216.0;
    let radius = |u: f32| (-2.0 * u.ln()).sqrt();
    let angle = |u: f32| std::f32::consts::TAU * u;
    let (r0, a0) = (radius(unit(h)), angle(unit(h >> 24)));
    let (r1, a1) = (radius(unit(g)), angle(unit(g >> 24)));
    [r0 * a0.cos(), r0 * a0.sin(), r1 * a1.cos()]
}

/// A sequential generator of random numbers, for data that is made in one place.
pub(crate) struct Stream {
    seed: u64,
    index: u64,
}

impl Stream {
    /// Returns the generator of `seed`; equal seeds give equal numbers.
    pub(crate) fn new(seed: u64) -> Self {
        Self { seed, index: 0 }
    }

    fn next_index(&mut self) -> u64 {
        self.index = self.index.wrapping_add(1);
        self.index
    }

    /// Returns a uniform number in (0, 1].
    pub(crate) fn uniform(&mut self) -> f32 {
        let index = self.next_index();
        ((mix(self.seed ^ mix(index)) >> 40) as f32 + 1.0) / 16_777_216.0
    }

    /// Returns standard normal numbers.
    pub(crate) fn normals<const K: usize>(&mut self) -> [f32; K] {
        let mut out = [0.0; K];
        for chunk in out.chunks_mut(3) {
            let index = self.next_index();
            chunk.copy_from_slice(&standard_normal(self.seed, index)[..chunk.len()]);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_32_bits_are_uniform_for_every_seed_and_index() {
        for seed in [0, 1, u32::MAX] {
            let mut tenths = [0u32; 10];
            for index in 0..100_000 {
                tenths[(uniform_32(seed, index) * 10.0) as usize] += 1;
            }
            assert!(tenths.iter().all(|n| (9_600..10_400).contains(n)), "seed {seed}: {tenths:?}");
            // The same splats are not left out again and again.
            let both = (0..100_000).filter(|i| uniform_32(seed, *i) < 0.1 && uniform_32(seed.wrapping_add(1), *i) < 0.1).count();
            assert!((900..1_100).contains(&both), "seed {seed}: {both}");
        }
    }

    #[test]
    fn noise_is_standard_normal_and_uncorrelated() {
        let n = 100_000;
        let samples: Vec<[f32; 3]> = (0..n).map(|i| standard_normal(7, i)).collect();
        for a in 0..3 {
            let mean = samples.iter().map(|s| f64::from(s[a])).sum::<f64>() / n as f64;
            assert!(mean.abs() < 0.015, "mean of axis {a}: {mean}");
            for b in 0..3 {
                let covariance = samples.iter().map(|s| f64::from(s[a]) * f64::from(s[b])).sum::<f64>() / n as f64;
                let expected = f64::from(u8::from(a == b));
                assert!((covariance - expected).abs() < 0.02, "covariance {a} {b}: {covariance}");
            }
        }
    }

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
