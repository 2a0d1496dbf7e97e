//! Sums of the sixteen numbers of a vector, each in a fixed order.
//!
//! The three differ in their last bits. Results of trainings depend on them, so a kernel keeps the
//! one that it has.

use crate::LANES;

/// Returns the sum in single precision, half onto half: a tree of four levels.
#[inline(always)]
pub fn sum(mut numbers: [f32; LANES]) -> f32 {
    let mut half = LANES / 2;
    while half > 0 {
        for i in 0..half {
            numbers[i] += numbers[i + half];
        }
        half /= 2;
    }
    numbers[0]
}

/// Returns the sum in single precision, from the first number to the last.
#[inline(always)]
pub fn sum_in_order(numbers: [f32; LANES]) -> f32 {
    numbers.iter().sum()
}

/// Returns the sum in double precision, from the first number to the last.
#[inline(always)]
pub fn sum_f64(numbers: [f32; LANES]) -> f64 {
    numbers.iter().map(|v| f64::from(*v)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_sum_has_its_order() {
        let whole: [f32; LANES] = std::array::from_fn(|lane| lane as f32);
        assert_eq!((sum(whole), sum_in_order(whole), sum_f64(whole)), (120.0, 120.0, 120.0));
        // The ulp of 2^24 is 2: in order, each 1 is lost; half onto half, they meet first.
        let mut numbers = [1.0; LANES];
        numbers[0] = 16_777_216.0;
        numbers[8] = 0.0;
        numbers[4] = 0.0;
        numbers[12] = 0.0;
        assert_eq!(sum_in_order(numbers), 16_777_216.0);
        assert_eq!(sum(numbers), 16_777_228.0);
        assert_eq!(sum_f64(numbers), 16_777_228.0);
    }
}
