//! The limit on needles: splats much longer than wide are shortened at regular steps, whatever the
//! strategy, and at the end.
//!
//! In: the engine's scene. Out: the same with limited log scales; moments and statistics stay.
//! Degenerate: a limit of 0 changes nothing.

use super::Trainer;
use crate::TrainError;

/// Steps between two limitations: needles grow over hundreds of steps.
const INTERVAL: u32 = 100;

impl Trainer {
    /// Shortens needles where that is due after `step`.
    pub(super) fn limit_aspect(&mut self, step: u32) -> Result<(), TrainError> {
        let most = self.state.config.max_aspect;
        if most <= 0.0 || self.state.config.freezes_geometry() || !(step.is_multiple_of(INTERVAL) || step >= self.state.config.iterations) {
            return Ok(());
        }
        let mut splats = self.engine.splats()?;
        let count = splats.limit_aspect(most);
        if count > 0 {
            self.engine.replace_parameters(&splats)?;
        }
        tracing::debug!(step, count, "needles shortened");
        Ok(())
    }
}
