//! The methods on splats with steps of their own that this program has.

use luxel_core::Engine;
use luxel_train::{CapturedMethods, StepMethods, TrainingMeans};

/// Returns the methods.
pub(crate) fn step_methods() -> &'static dyn StepMethods {
    &CapturedMethods
}

/// Returns the means of a training of splats on an engine.
pub(crate) fn means_of(engine: Box<dyn Engine>) -> TrainingMeans<'static> {
    TrainingMeans { engine, methods: step_methods() }
}
