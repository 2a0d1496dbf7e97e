//! Positions and directions as sines and cosines of doubling frequencies (Mildenhall et al. 2020).
//!
//! In: three numbers of about -1 to 1. Out: the numbers, then for k = 0, 1, ... the sines of 2^k
//! times them and the cosines.

/// Frequencies of a position.
const OF_POSITION: usize = 10;
/// Frequencies of a direction.
const OF_DIRECTION: usize = 4;
/// Numbers that describe a position.
pub(crate) const POSITION: usize = 3 + 6 * OF_POSITION;
/// Numbers that describe a direction.
pub(crate) const DIRECTION: usize = 3 + 6 * OF_DIRECTION;

/// Returns the numbers that describe a position in the unit cube.
pub(crate) fn position(at: [f32; 3]) -> [f32; POSITION] {
    encoded(at.map(|p| 2.0 * p - 1.0))
}

/// Returns the numbers that describe a direction.
pub(crate) fn direction(toward: [f32; 3]) -> [f32; DIRECTION] {
    encoded(toward)
}

fn encoded<const N: usize>(values: [f32; 3]) -> [f32; N] {
    let mut found = [0.0; N];
    found[..3].copy_from_slice(&values);
    for (k, parts) in found[3..].chunks_exact_mut(6).enumerate() {
        for (axis, value) in values.into_iter().enumerate() {
            (parts[axis], parts[3 + axis]) = ((1u32 << k) as f32 * value).sin_cos();
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frequencies_double() {
        let found = direction([0.3, -0.5, 0.1]);
        assert_eq!((found[0], found[3], found[6]), (0.3, 0.3f32.sin(), 0.3f32.cos()));
        assert_eq!((found[9 + 1], found[12 + 1]), ((-1.0f32).sin(), (-1.0f32).cos()));
        assert_eq!(position([0.5, 1.0, 0.0])[..6], [0.0, 1.0, -1.0, 0.0, 1.0f32.sin(), (-1.0f32).sin()]);
    }
}
