//! A check of numbers that a file holds.

use luxel_train::TrainError;

/// Checks the length and finiteness of an array that a file holds.
pub(super) fn check_numbers(name: &str, values: &[f32], expected: usize) -> Result<(), TrainError> {
    if values.len() != expected {
        return Err(TrainError::State(format!("{name} has {} numbers, expected {expected}", values.len())));
    }
    match values.iter().position(|v| !v.is_finite()) {
        Some(at) => Err(TrainError::State(format!("number {at} of {name} is not finite"))),
        None => Ok(()),
    }
}
