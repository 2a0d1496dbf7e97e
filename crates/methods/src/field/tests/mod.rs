//! Gradients of every part, against central differences of an oracle in f64; and learning.

mod gradients;
mod learning;
mod oracle;
mod step;

use luxel_core::random;

use crate::field::GridShape;

/// Dense and hashed levels, small enough for an oracle.
const SMALL: GridShape = GridShape { levels: 4, log2_entries: 10, coarsest: 4, finest: 64 };

fn numbers(seed: u64, count: usize, scale: f32) -> Vec<f32> {
    (0..count as u64).map(|i| scale * (2.0 * random::uniform(seed, i) - 1.0)).collect()
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|value| f64::from(*value)).collect()
}

/// Asserts that two gradients agree to a part of the largest number of the second.
#[track_caller]
fn assert_close(found: &[f64], expected: &[f64], tolerance: f64) {
    let largest = expected.iter().fold(0f64, |largest, value| largest.max(value.abs()));
    assert!(largest > 0.0, "no gradient to compare with");
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((found - expected).abs() <= tolerance * largest, "number {i}: {found}, expected {expected} (largest {largest})");
    }
}
