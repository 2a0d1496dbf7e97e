//! Mean of the parameters over the last steps of a run.
//!
//! Adam's steps are of nearly constant length and see one view each, so the parameters keep moving
//! around the optimum. Their mean is closer to it than the last state (Polyak and Juditsky 1992;
//! Izmailov et al. 2018). Every parameter is averaged as it is stored: logarithms, logits and
//! quaternions. The quaternions neither flip nor turn far within these steps.

use luxel_core::engine::{SavedPart, SplatArray};
use luxel_core::{Engine, EngineError, Splats};

/// Splats whose values are asked for at a time.
const PIECE_SPLATS: usize = 1 << 14;

/// A running mean.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Average {
    mean: Splats,
    /// Number of states in the mean.
    count: u32,
}

impl Average {
    /// Returns a mean that `count` states have made so far.
    pub(crate) fn new(mean: Splats, count: u32) -> Self {
        Self { mean, count: count.max(1) }
    }

    /// Adds the state of an engine, of the same splats, to the mean. The smoothing filter is not a
    /// parameter; the newest state's is kept.
    ///
    /// # Errors
    /// Those of the engine.
    pub(crate) fn add(&mut self, engine: &mut dyn Engine) -> Result<(), EngineError> {
        self.count = self.count.saturating_add(1);
        let weight = 1.0 / self.count as f32;
        let (count, color_model) = (self.mean.len(), self.mean.color_model);
        for array in SplatArray::ALL.into_iter().filter(|array| *array != SplatArray::Smoothing) {
            for first in (0..count).step_by(PIECE_SPLATS) {
                let splats = first..count.min(first + PIECE_SPLATS);
                let at = first * array.width(color_model);
                let values = engine.save_array(SavedPart::Parameters, array, splats)?;
                for (mean, value) in self.mean.array_mut(array).iter_mut().skip(at).zip(values) {
                    *mean += (value - *mean) * weight;
                }
            }
        }
        self.mean.smoothing = engine.save_array(SavedPart::Parameters, SplatArray::Smoothing, 0..count)?;
        Ok(())
    }

    /// Returns the mean so far.
    pub(crate) fn mean(&self) -> &Splats {
        &self.mean
    }

    /// Returns the number of states in the mean.
    pub(crate) fn count(&self) -> u32 {
        self.count
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::{ColorModel, Moments};
    use luxel_cpu::CpuEngine;

    use super::*;

    fn state(value: f32) -> Splats {
        let mut splats = Moments::zeros(ColorModel::Sh { degree: 0 }, 2).first;
        splats.position[1] = [value; 3];
        splats.rotation[1] = [1.0, value, 0.0, 0.0];
        splats.opacity_logit[0] = -value;
        splats.sh[3] = 2.0 * value;
        splats
    }

    fn add(average: &mut Average, value: f32) {
        let mut engine = CpuEngine::new(1).unwrap();
        engine.load(&state(value), None).unwrap();
        average.add(&mut engine).unwrap();
    }

    #[test]
    fn the_mean_is_that_of_all_states() {
        let mut average = Average::new(state(1.0), 1);
        for value in [2.0, 6.0, 3.0] {
            add(&mut average, value);
        }
        assert_eq!(average.count(), 4);
        let mean = average.mean();
        assert_eq!((mean.position[1], mean.opacity_logit[0], mean.sh[3]), ([3.0; 3], -3.0, 6.0));
        assert_eq!((mean.rotation[1], mean.position[0]), ([1.0, 3.0, 0.0, 0.0], [0.0; 3]));
    }

    #[test]
    fn a_saved_mean_continues() {
        let mut whole = Average::new(state(1.0), 1);
        add(&mut whole, 2.0);
        let mut resumed = Average::new(whole.mean().clone(), whole.count());
        for average in [&mut whole, &mut resumed] {
            add(average, 0.25);
        }
        assert_eq!(whole, resumed);
    }
}
