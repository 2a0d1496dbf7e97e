//! The part of a trainer that is about methods with steps of their own.
//!
//! In: the view of the step. Out: the engine's scene and the method's numbers, updated, and the
//! step's report; scenes of such methods from checkpoints.

use luxel_core::engine::StepConfig;
use luxel_core::{Engine, Scene, Snapshot, StepReport};

use super::Trainer;
use super::batch::{SlotView, view_of};
use crate::TrainError;
use crate::state::State;
use crate::step_method::{MethodStep, StepImages, StepMethod, StepMethods, ToneMapperRecord, resumed};

impl Trainer {
    /// Lets the method make a step.
    pub(super) fn train_by_method(&mut self, of: SlotView, step: &StepConfig) -> Result<StepReport, TrainError> {
        self.ask_ahead(of);
        let Self { engine, views, state, lenses, method, .. } = self;
        let Some(method) = method else { return Err(TrainError::State("the method is missing".to_owned())) };
        let captured = views.recording_at(of.step, of.index, state.crop(of.step, of.slot))?;
        let view = view_of(views, state, lenses.as_ref(), of)?;
        let (radiance_scale, planned_iterations) = (state.radiance_scale, state.planned_iterations);
        let step = MethodStep { train: &state.config, engine: step, radiance_scale, planned_iterations };
        method.step(&mut **engine, StepImages { view, captured: captured.as_ref() }, step)
    }

    /// Returns the tone mappers of the method, or `None` if it has none.
    pub fn tone_mappers(&self) -> Option<ToneMapperRecord> {
        self.method.as_ref()?.tone_mappers(self.state.radiance_scale.get())
    }

    /// Returns the state as text.
    pub(super) fn state_json(&self) -> Result<String, TrainError> {
        self.state.to_json(self.method.as_ref().map(|method| method.saved()).transpose()?)
    }
}

/// Returns the method of the run that a snapshot was taken of, if it has one with steps of its own.
fn method_of(snapshot: &Snapshot, methods: &dyn StepMethods) -> Result<Option<Box<dyn StepMethod>>, TrainError> {
    let State { networks, config, .. } = State::parse(&snapshot.state_json)?;
    resumed(methods, networks.as_ref(), &config, snapshot.scene.splats.len())
}

/// Returns the scene of a snapshot, without the lift of a method that lifts colours to radiance:
/// close to the lifted colours over the whole sphere.
///
/// # Errors
/// [`TrainError::State`] if the state cannot be read, or is of a method that is not there.
pub fn snapshot_scene(snapshot: Snapshot, methods: &dyn StepMethods) -> Result<Scene, TrainError> {
    let method = method_of(&snapshot, methods)?;
    let scene = snapshot.scene;
    Ok(match method {
        None => scene,
        Some(method) => Scene { splats: method.plain_splats(scene.splats, &[]), ..scene },
    })
}

/// Loads the scene of a snapshot into an engine that renders the radiance to which its method lifts
/// colours; `None` for a method that does not lift them. The engine must blend channels.
///
/// # Errors
/// [`TrainError::State`] if the state cannot be read; the engine's refusal of the splats.
pub fn lifted_engine(
    snapshot: &Snapshot,
    mut engine: Box<dyn Engine>,
    methods: &dyn StepMethods,
) -> Result<Option<Box<dyn Engine>>, TrainError> {
    let lifts_colors = State::parse(&snapshot.state_json)?.config.method.lifts_colors();
    let Some(method) = method_of(snapshot, methods)?.filter(|_| lifts_colors) else { return Ok(None) };
    engine.load(&snapshot.scene.splats, None)?;
    Ok(Some(method.rendering(engine)))
}
