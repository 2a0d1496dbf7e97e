//! A step of a method that trains on radiance and a captured image of the same pose.
//!
//! In: the view of the step. Out: the engine's scene and the method's networks, updated, and the
//! step's report. Degenerate: a loss that is not finite is an error before the update.

use luxel_core::StepReport;
use luxel_core::engine::StepConfig;

use super::Trainer;
use super::batch::{SlotView, view_of};
use crate::peers::{HdrGsStep, SharedNetworks, ToneMapperRecord};
use crate::{NamedChoice, TrainError};

impl Trainer {
    /// Trains on a pair.
    pub(super) fn train_on_pair(&mut self, of: SlotView, step: &StepConfig) -> Result<StepReport, TrainError> {
        self.ask_ahead(of);
        let Self { engine, views, state, lenses, .. } = self;
        let crop = state.crop(of.step, of.slot);
        let method = state.config.method.name();
        let no_pair = |view: String| TrainError::NeedsPairs { method, view, reason: "has no captured image beside its radiance" };
        let recording = views.recording_at(of.step, of.index, crop)?.ok_or_else(|| no_pair(views.name(of.index).to_owned()))?;
        let view = view_of(views, state, lenses.as_ref(), of)?;
        let splats = engine.splats()?;
        let Some(raster) = engine.differentiable() else {
            return Err(luxel_core::EngineError::invalid("this engine has no rasteriser with gradients").into());
        };
        let Some(SharedNetworks::HdrGs(mappers)) = &mut state.networks else { return Err(no_pair(view.name.clone())) };
        let found = HdrGsStep { raster, splats: &splats, view, recording: &recording, config: &state.config, step }.gradients(mappers)?;
        if !found.report.loss.is_finite() {
            return Err(TrainError::NotFinite { step: of.step, view: view.name.clone() });
        }
        if let Some((tables, gradient)) = &found.tone {
            mappers.update(tables, gradient, state.config.tone_lr.into());
        }
        engine.apply_gradients(&found.splats, step)?;
        Ok(found.report)
    }

    /// Returns the tone mappers of the method, or `None` if it has none.
    pub fn tone_mappers(&self) -> Option<ToneMapperRecord> {
        self.state.networks.as_ref()?.tone_mappers(self.state.radiance_scale.get())
    }
}
