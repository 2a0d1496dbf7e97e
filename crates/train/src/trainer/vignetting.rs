//! Vignetting that is optimised with the scene: the part of a step that sees its view through it
//! and changes it.
//!
//! In: the gradient by the step's vignetting. Out: the vignetting of the next steps. Degenerate:
//! without gradient it stays.

use luxel_core::{Camera, StepReport, Vignetting};

use super::Trainer;
use crate::state::State;
use crate::vignetting::{LensVignetting, Lenses};

/// A view as a step sees it.
pub(super) struct VignettedView<'a> {
    pub(super) step: u32,
    /// Number of the view.
    pub(super) index: usize,
    /// Factor by which its sides are reduced.
    pub(super) reduction: u32,
    /// Camera of what the step sees of it.
    pub(super) camera: &'a Camera,
}

impl State {
    /// Returns the vignetting of a view, if it is optimised and there is any yet.
    pub(super) fn vignetting_of(
        &self,
        lenses: &Lenses,
        VignettedView { step, index, reduction, camera }: VignettedView<'_>,
    ) -> Option<Vignetting> {
        self.vignetting.as_ref()?.of_view(lenses, index, camera, reduction, self.progress(step))
    }

    /// Returns the fraction of the planned steps that are done after `step`.
    fn progress(&self, step: u32) -> f64 {
        f64::from(step) / f64::from(self.planned_iterations.max(1))
    }
}

impl Trainer {
    /// Changes the vignetting of view `index` by the gradient that `step` reports, unless opacities
    /// are recovering from a reset, which makes renders faint.
    pub(super) fn learn_vignetting(&mut self, step: u32, index: usize, report: &StepReport) {
        if self.schedule.is_recovering(step) {
            return;
        }
        let progress = self.state.progress(step);
        if let (Some(lenses), Some(vignetting), Some(by)) = (&self.lenses, &mut self.state.vignetting, &report.by_vignetting) {
            vignetting.update(lenses, index, by, progress);
        }
    }

    /// Returns the vignetting of each lens of the training views, or `None` if it is not optimised.
    pub fn vignetting(&self) -> Option<Vec<LensVignetting>> {
        Some(self.state.vignetting.as_ref()?.report(self.lenses.as_ref()?))
    }
}
