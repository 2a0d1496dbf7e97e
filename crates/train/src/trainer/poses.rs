//! Poses that are optimised with the scene: the part of a step that corrects its view's pose.
//!
//! In: the gradient by the step's camera. Out: corrected cameras for the next steps. Degenerate:
//! without gradient the poses stay.

use luxel_core::engine::CameraGradientChoice;
use luxel_core::{Camera, StepReport};

use super::Trainer;
use crate::TrainError;
use crate::poses::{PoseReport, decay, default_rate_px};

impl Trainer {
    /// Returns whether `step` computes the gradient by its camera.
    pub(super) fn camera_gradient_of(&self, step: u32) -> CameraGradientChoice {
        match self.schedule.pose_progress(step) {
            Some(_) => CameraGradientChoice::Compute,
            None => CameraGradientChoice::Skip,
        }
    }

    /// Refuses a run whose poses are to be optimised but in no step.
    pub(super) fn check_pose_steps(&self) -> Result<(), TrainError> {
        match self.schedule.poses {
            Some([from, until]) if until <= from || from >= self.schedule.end => {
                let reason = format!(
                    "poses are optimised after step {from} and up to step {until}, which is none of the run's {} steps",
                    self.schedule.end
                );
                Err(TrainError::config("refine_poses", reason))
            }
            _ => Ok(()),
        }
    }

    /// Moves the camera of view `index` by the gradient that `step` reports.
    pub(super) fn correct_pose(&mut self, step: u32, index: usize, report: &StepReport) {
        let (Some(poses), Some(corrections)) = (&self.poses, &mut self.state.poses) else { return };
        let (Some(progress), Some(gradient)) = (self.schedule.pose_progress(step), &report.camera) else { return };
        let steps = self.schedule.poses.map_or(1, |[from, until]| until.saturating_sub(from));
        let rate_px = self.state.config.pose_lr.map_or_else(|| default_rate_px(steps, self.views.len()), f64::from);
        corrections.update(poses, index, gradient, rate_px * decay(progress));
        self.views.move_to(corrections.cameras(poses));
    }

    /// Sees the training views through the cameras of the state, when a run begins or resumes.
    pub(super) fn restore_poses(&mut self) {
        if let (Some(poses), Some(corrections)) = (&self.poses, &self.state.poses) {
            self.views.move_to(corrections.cameras(poses));
        }
    }

    /// Returns the cameras of the training views at full resolution, in the order of the views: the
    /// optimised ones, or those of the data set.
    pub fn cameras(&self) -> Vec<Camera> {
        self.views.cameras().into_iter().cloned().collect()
    }

    /// Returns the corrections of the poses in numbers, or `None` if poses are not optimised.
    pub fn pose_report(&self) -> Option<PoseReport> {
        Some(self.state.poses.as_ref()?.report(self.poses.as_ref()?))
    }
}
