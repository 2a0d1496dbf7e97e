//! Adam for numbers that all splats share.
//!
//! In: numbers, gradient, rate. Out: the numbers after a step, with the constants of the splats'
//! own updates. Arithmetic is in f64, number by number.

use luxel_core::engine::{ADAM_BETA1, ADAM_BETA2, ADAM_EPSILON, NumberAdam};
use luxel_lanes::Level;
use serde::{Deserialize, Serialize};

use luxel_train::TrainError;

/// The moments of some numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Adam {
    first: Vec<f32>,
    second: Vec<f32>,
    /// Number of updates made.
    updates: u32,
}

impl Adam {
    /// Returns moments of zero.
    pub(crate) fn new(count: usize) -> Self {
        Self { first: vec![0.0; count], second: vec![0.0; count], updates: 0 }
    }

    /// Returns moments read from a file, after so many updates.
    pub(crate) fn from_moments(first: Vec<f32>, second: Vec<f32>, updates: u32) -> Self {
        Self { first, second, updates }
    }

    /// Returns the first and the second moments.
    pub(crate) fn moments(&self) -> [&[f32]; 2] {
        [&self.first, &self.second]
    }

    /// Updates the numbers.
    pub(crate) fn step<G: Copy + Into<f64>>(&mut self, numbers: &mut [f32], gradient: &[G], rate: f64) {
        self.updates = self.updates.saturating_add(1);
        let betas = [ADAM_BETA1, ADAM_BETA2].map(f64::from);
        let adam = NumberAdam::new(betas, [self.updates; 2], ADAM_EPSILON.into());
        let step = Step { rate, adam };
        // Arithmetic is by elements: the same on every instruction set.
        luxel_lanes::dispatch!(Level::best(), _simd => step.apply(numbers, gradient, &mut self.first, &mut self.second));
    }

    /// Takes moments to new places: those of the given old ones, 0 where there is none.
    pub(crate) fn rearrange(&mut self, from: impl Iterator<Item = Option<usize>>) {
        let moments = from.map(|at| at.map_or((0.0, 0.0), |at| (self.first[at], self.second[at])));
        (self.first, self.second) = moments.unzip();
    }

    /// Checks moments read from a file.
    pub(crate) fn validate(&self, count: usize) -> Result<(), TrainError> {
        let is_finite = self.first.iter().chain(&self.second).all(|v| v.is_finite());
        if is_finite && [self.first.len(), self.second.len()] == [count; 2] {
            return Ok(());
        }
        Err(TrainError::State(format!("moments of {count} shared numbers are missing or not finite")))
    }
}

/// The constants of a step.
struct Step {
    rate: f64,
    adam: NumberAdam,
}

impl Step {
    #[inline(always)]
    fn apply<G: Copy + Into<f64>>(&self, numbers: &mut [f32], gradient: &[G], first: &mut [f32], second: &mut [f32]) {
        for (((number, gradient), first), second) in numbers.iter_mut().zip(gradient).zip(first).zip(second) {
            let moved = self.adam.update_f32(first, second, (*gradient).into());
            *number = (f64::from(*number) - self.rate * moved.mean / moved.deviation) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_is_the_rate_against_the_gradient() {
        let (mut adam, mut numbers) = (Adam::new(2), [1.0, 2.0]);
        adam.step(&mut numbers, &[3.0, -1e-4], 0.1);
        assert!((numbers[0] - 0.9).abs() < 1e-6 && (numbers[1] - 2.1).abs() < 1e-6, "{numbers:?}");
        adam.validate(2).unwrap();
        assert!(adam.validate(3).is_err());
    }
}
