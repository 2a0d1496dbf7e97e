//! A step of a method that trains on captured images alone, with networks of its own.
//!
//! In: the view of the step. Out: the engine's scene, the method's networks and features, updated,
//! and the step's report. Degenerate: a loss that is not finite is an error before the update.

use luxel_core::StepReport;
use luxel_core::engine::StepConfig;

use super::Trainer;
use super::batch::{SlotView, view_of};
use crate::camera_response::exposure_of;
use crate::peers::{GaussRates, GaussStep, GaussTarget, SharedNetworks, tone_rate};
use crate::{NamedChoice, TrainError};

impl Trainer {
    /// Trains on a captured image.
    pub(super) fn train_on_captured(&mut self, of: SlotView, step: &StepConfig) -> Result<StepReport, TrainError> {
        self.ask_ahead(of);
        let Self { engine, views, state, lenses, .. } = self;
        let method = state.config.method.name();
        let view = view_of(views, state, lenses.as_ref(), of)?;
        let no_image = |reason| TrainError::NeedsCaptured { method, view: view.name.clone(), reason };
        let exposure_s = exposure_of(view).ok_or_else(|| no_image("is radiance, expected a captured image"))?;
        let Some(SharedNetworks::GaussHdr(networks)) = &mut state.networks else { return Err(no_image("has no tone networks")) };
        let exposure = state.radiance_scale.restored_value(exposure_s);
        let target = GaussTarget { view, exposure, unit_value: state.config.unit_exposure, loss: step.loss };
        let mut channels = GaussStep::new(target, networks.tone(), networks.features());
        let report = engine.train_channels(&view.camera, &mut channels, step)?;
        if !report.loss.is_finite() {
            return Err(TrainError::NotFinite { step: of.step, view: view.name.clone() });
        }
        let found = channels.gradients();
        let tone = tone_rate(&state.config, of.step, state.planned_iterations);
        let rates = GaussRates { tone, features: state.config.feature_lr.into() };
        networks.update(&found.by_numbers, &found.by_features, rates);
        Ok(report)
    }
}
