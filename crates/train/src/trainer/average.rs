//! The mean of the last states of a run, which becomes the scene.
//!
//! In: the engine's parameters after each of the last steps. Out: the engine's scene, replaced by
//! their mean. Degenerate: without such steps the scene stays as it is.

use super::Trainer;
use crate::TrainError;
use crate::average::Average;

impl Trainer {
    /// Warns if an average is requested but densification leaves no steps for it.
    pub(super) fn warn_of_average(&self) {
        let (config, schedule) = (&self.state.config, &self.schedule);
        if config.average_share > 0.0 && schedule.densifies_to_the_end() {
            tracing::warn!(
                densify_until = schedule.densify_until,
                iterations = schedule.end,
                average_share = config.average_share,
                "nothing is averaged: splats are added and removed up to the last step; lower densify_until, or set average_share to 0"
            );
        }
    }

    /// Adds the parameters after `step` to their mean where that is due. After the last such step,
    /// the mean becomes the scene.
    pub(super) fn average(&mut self, step: u32) -> Result<(), TrainError> {
        if !self.schedule.is_averaging(step) {
            // These steps are no longer among the last ones, because the end was moved.
            self.average = None;
        }
        if self.schedule.averages_after(step) {
            match &mut self.average {
                Some(average) => average.add(&mut *self.engine)?,
                None => self.average = Some(Average::new(self.engine.splats()?, 1)),
            }
            if step == self.schedule.end {
                self.load_average()?;
            }
        }
        self.state.averaged = self.average.as_ref().map_or(0, Average::count);
        Ok(())
    }

    /// Replaces the scene by the mean, if there is one. Adam's moments stay, so that a longer run
    /// can continue from there.
    fn load_average(&mut self) -> Result<(), TrainError> {
        if let Some(average) = self.average.take() {
            self.engine.replace_parameters(average.mean())?;
        }
        self.state.averaged = 0;
        Ok(())
    }

    /// Replaces the scene by the mean taken so far, if the run ends at the current step, as it can
    /// after [`Self::set_iterations`]. Returns whether there was such a mean.
    ///
    /// # Errors
    /// Returns [`TrainError::Engine`] if the engine fails.
    pub fn finish_average(&mut self) -> Result<bool, TrainError> {
        let is_due = self.average.is_some() && self.schedule.is_averaging(self.state.iteration) && self.is_finished();
        if is_due {
            self.load_average()?;
        }
        Ok(is_due)
    }
}
