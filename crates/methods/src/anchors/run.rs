//! The training of anchors as a run drives it.
//!
//! In: a data set, options or a checkpoint, an engine of splats. Out: a [`Reconstruction`].
//! Degenerate: a checkpoint of another data set is an error.

use luxel_core::{Dataset, Engine, Knots, RadianceScale, RenderOptions, Scene, StepReport};
use luxel_train::{Reconstruction, SavedRun, SceneContent, SceneSize, TrainConfig, TrainError};

use super::AnchorTrainer;
use super::files::{AnchorCheckpoint, of_run, of_scene};
use crate::place::{check_fingerprint, place_in};

/// A training of anchors.
pub struct AnchorRun {
    trainer: AnchorTrainer,
    fingerprint: String,
    /// Units and place of the scene.
    place: Scene,
}

impl AnchorRun {
    /// Starts a run on the engine that was opened for it.
    ///
    /// # Errors
    /// Options or data that cannot be used.
    pub fn new(dataset: &Dataset, config: &TrainConfig, engine: Box<dyn Engine>) -> Result<Self, TrainError> {
        Ok(Self::assemble(dataset, AnchorTrainer::new(dataset, config.clone(), engine)?))
    }

    /// Continues a run.
    ///
    /// # Errors
    /// A checkpoint of another data set, or that is damaged.
    pub fn resume(dataset: &Dataset, checkpoint: AnchorCheckpoint, engine: Box<dyn Engine>) -> Result<Self, TrainError> {
        check_fingerprint(&checkpoint.fingerprint, dataset)?;
        Ok(Self::assemble(dataset, AnchorTrainer::resume(dataset, checkpoint.snapshot, engine)?))
    }

    fn assemble(dataset: &Dataset, trainer: AnchorTrainer) -> Self {
        let place = place_in(dataset, trainer.radiance_scale());
        Self { trainer, fingerprint: dataset.fingerprint.clone(), place }
    }

    /// Returns units, place and settings of the rasteriser of the scene as it is now.
    fn place(&self) -> Scene {
        Scene { raster: self.trainer.raster(), ..self.place.clone() }
    }
}

impl Reconstruction for AnchorRun {
    fn config(&self) -> &TrainConfig {
        self.trainer.config()
    }

    fn iteration(&self) -> u32 {
        self.trainer.iteration()
    }

    fn set_iterations(&mut self, iterations: u32) {
        self.trainer.set_iterations(iterations);
    }

    fn step(&mut self) -> Result<StepReport, TrainError> {
        // Splats that touch a view are those that were decoded for it, and tell nothing.
        Ok(StepReport { visible: 0, ..self.trainer.step()? })
    }

    fn size(&self) -> SceneSize {
        let scene = self.trainer.scene();
        SceneSize::Anchors { anchors: scene.anchors.len(), splats: scene.splats() }
    }

    fn radiance_scale(&self) -> RadianceScale {
        self.place.radiance_scale
    }

    fn render_options(&self) -> RenderOptions {
        RenderOptions { background: self.place.radiance_scale.normalised(self.config().background), ..self.place().render_options() }
    }

    fn engine(&mut self) -> &mut dyn Engine {
        self.trainer.engine()
    }

    fn response(&self) -> Option<Knots> {
        self.trainer.response()
    }

    fn content(&mut self) -> Result<SceneContent, TrainError> {
        let file = of_scene(&self.place(), self.trainer.scene(), self.trainer.response().as_ref())?;
        Ok(SceneContent::Arrays(file))
    }

    fn saved(&mut self) -> Result<SavedRun<'_>, TrainError> {
        let (config, fingerprint) = (self.trainer.config().clone(), self.fingerprint.clone());
        let checkpoint = AnchorCheckpoint { config, fingerprint, step: self.trainer.iteration(), snapshot: self.trainer.snapshot()? };
        Ok(SavedRun::Arrays(of_run(&self.place(), self.trainer.response().as_ref(), checkpoint)?))
    }

    fn renders_slowly(&self) -> bool {
        true
    }
}
