//! The memory that training a field takes, for checks before it starts.

use crate::field::frequencies;
use crate::field::task::TASKS;
use crate::field::trunk::{FieldNetwork, Trunk};

/// Samples that a thread evaluates at a time, at most about.
const MOST_SAMPLES: usize = 4096;

impl FieldNetwork {
    /// Returns the memory that training takes on so many threads, bytes, beyond that on a grid.
    pub fn training_bytes(self, threads: usize) -> u64 {
        let Self::Layers { layers, units } = self else { return 0 };
        let trunk = Trunk::new(self, &self.grid());
        let color = trunk.color_sizes();
        let weights = trunk.len() + color.windows(2).map(|pair| (pair[0] + 1) * pair[1]).sum::<usize>();
        let units_per_sample = (layers as usize + 2) * units as usize + 2 * frequencies::POSITION;
        // Values and gradients of a thread's samples; gradients of the tasks, parameters, moments.
        let numbers = 2 * threads.max(1) * MOST_SAMPLES * units_per_sample + (TASKS + 4) * weights;
        (numbers * size_of::<f32>()) as u64
    }
}
