//! A step of a method that trains on radiance and a captured image of the same pose.
//!
//! In: the view of the step. Out: the engine's scene and the method's networks, updated, and the
//! step's report. Degenerate: a loss that is not finite is an error before the update.

use luxel_core::engine::StepConfig;
use luxel_core::{Engine, Scene, Snapshot, StepReport};

use super::Trainer;
use super::batch::{SlotView, view_of};
use crate::peers::{LiftedEngine, PairTargets, SharedNetworks, ToneMapperRecord, folded};
use crate::state::State;
use crate::{NamedChoice, TrainError};

impl Trainer {
    /// Trains on a pair.
    pub(super) fn train_on_pair(&mut self, of: SlotView, step: &StepConfig) -> Result<StepReport, TrainError> {
        self.ask_ahead(of);
        let Self { engine, views, state, lenses, lift, .. } = self;
        let crop = state.crop(of.step, of.slot);
        let method = state.config.method.name();
        let no_pair = |view: String| TrainError::NeedsPairs { method, view, reason: "has no captured image beside its radiance" };
        let recording = views.recording_at(of.step, of.index, crop)?.ok_or_else(|| no_pair(views.name(of.index).to_owned()))?;
        let view = view_of(views, state, lenses.as_ref(), of)?;
        let pair = PairTargets { view, recording: &recording, config: &state.config, loss: step.loss };
        let check = |report: StepReport| match report.loss.is_finite() {
            true => Ok(report),
            false => Err(TrainError::NotFinite { step: of.step, view: view.name.clone() }),
        };
        match &mut state.networks {
            Some(SharedNetworks::HdrGs(mappers)) => {
                let mut channels = pair.hdr_gs(mappers);
                let report = check(engine.train_channels(&view.camera, &mut channels, step)?)?;
                mappers.learn(&channels.gradients(), state.config.tone_lr.into());
                Ok(report)
            }
            Some(SharedNetworks::MonoHdrGs(networks)) => {
                let mut channels = pair.mono_hdr_gs(networks);
                let report = check(engine.train_channels(&view.camera, &mut channels, step)?)?;
                let found = channels.gradients();
                networks.update(&found, &state.config);
                lift.iter().for_each(|lift| lift.set(networks.lift.tables()));
                Ok(report)
            }
            Some(SharedNetworks::GaussHdr(_) | SharedNetworks::GaussHdrAnchors(_)) | None => Err(no_pair(view.name.clone())),
        }
    }

    /// Returns the tone mappers of the method, or `None` if it has none.
    pub fn tone_mappers(&self) -> Option<ToneMapperRecord> {
        self.state.networks.as_ref()?.tone_mappers(self.state.radiance_scale.get())
    }
}

/// Returns the scene of a snapshot, without the lift of a method that lifts colours to radiance:
/// close to the lifted colours over the whole sphere.
///
/// # Errors
/// [`TrainError::State`] if the state cannot be read.
pub fn snapshot_scene(snapshot: Snapshot) -> Result<Scene, TrainError> {
    let state = State::parse(&snapshot.state_json)?;
    SharedNetworks::validate(state.networks.as_ref(), &state.config, snapshot.scene.splats.len())?;
    let scene = snapshot.scene;
    Ok(match state.networks.as_ref().and_then(SharedNetworks::shared_lift) {
        None => scene,
        Some(lift) => Scene { splats: folded(&scene.splats, &lift.get(), &[]), ..scene },
    })
}

/// Loads the scene of a snapshot into an engine that renders the radiance to which its method lifts
/// colours; `None` for a method that does not lift them. The engine must blend channels.
///
/// # Errors
/// [`TrainError::State`] if the state cannot be read; the engine's refusal of the splats.
pub fn lifted_engine(snapshot: &Snapshot, mut engine: Box<dyn Engine>) -> Result<Option<Box<dyn Engine>>, TrainError> {
    let state = State::parse(&snapshot.state_json)?;
    SharedNetworks::validate(state.networks.as_ref(), &state.config, snapshot.scene.splats.len())?;
    let Some(lift) = state.networks.as_ref().and_then(SharedNetworks::shared_lift) else { return Ok(None) };
    engine.load(&snapshot.scene.splats, None)?;
    Ok(Some(Box::new(LiftedEngine::new(engine, lift))))
}
