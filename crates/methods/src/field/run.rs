//! The training of a field as a run drives it.
//!
//! In: a data set, options or a checkpoint, threads. Out: a [`Reconstruction`]. Degenerate: a
//! checkpoint of another data set is an error.

use luxel_core::{Dataset, Engine, Knots, RadianceScale, RenderOptions, Scene, StepReport};
use luxel_train::{Reconstruction, SavedRun, SceneContent, SceneSize, TrainConfig, TrainError, start_scale};

use super::FieldTrainer;
use super::files::{FieldCheckpoint, TrainingRecord, of_field, of_run};
use super::run_options::options;
use crate::place::{check_fingerprint, place_in};

/// A training of a field.
pub struct FieldRun {
    trainer: FieldTrainer,
    config: TrainConfig,
    fingerprint: String,
    /// Units and place of the scene.
    place: Scene,
}

impl FieldRun {
    /// Starts a run. 0 threads are as many as the machine has cores.
    ///
    /// # Errors
    /// Options or data that cannot be used; threads that the system refuses.
    pub fn new(dataset: &Dataset, config: &TrainConfig, threads: usize) -> Result<Self, TrainError> {
        let scale = start_scale(dataset, config)?;
        let trainer = FieldTrainer::new(dataset, options(config, scale)?, threads).map_err(TrainError::of_method)?;
        Ok(Self::assemble(dataset, trainer, config.clone()))
    }

    /// Continues a run.
    ///
    /// # Errors
    /// A checkpoint of another data set, or that is damaged; threads that the system refuses.
    pub fn resume(dataset: &Dataset, checkpoint: FieldCheckpoint, threads: usize) -> Result<Self, TrainError> {
        let FieldCheckpoint { training: TrainingRecord { config, fingerprint, .. }, snapshot } = checkpoint;
        check_fingerprint(&fingerprint, dataset)?;
        Ok(Self::assemble(dataset, FieldTrainer::resume(dataset, snapshot, threads).map_err(TrainError::of_method)?, config))
    }

    fn assemble(dataset: &Dataset, trainer: FieldTrainer, config: TrainConfig) -> Self {
        let place = place_in(dataset, trainer.state().options.radiance_scale);
        Self { trainer, config, fingerprint: dataset.fingerprint.clone(), place }
    }
}

impl Reconstruction for FieldRun {
    fn config(&self) -> &TrainConfig {
        &self.config
    }

    fn iteration(&self) -> u32 {
        self.trainer.state().step
    }

    fn set_iterations(&mut self, iterations: u32) {
        self.trainer.set_iterations(iterations);
        self.config.iterations = iterations;
    }

    fn step(&mut self) -> Result<StepReport, TrainError> {
        let loss = self.trainer.step().map_err(TrainError::of_method)?.loss;
        Ok(StepReport { step: self.iteration(), loss, ..StepReport::default() })
    }

    fn size(&self) -> SceneSize {
        SceneSize::Field(self.trainer.field().parameter_count())
    }

    fn radiance_scale(&self) -> RadianceScale {
        self.place.radiance_scale
    }

    fn render_options(&self) -> RenderOptions {
        RenderOptions { background: self.place.radiance_scale.normalised(self.config.background), ..self.place.render_options() }
    }

    fn engine(&mut self) -> &mut dyn Engine {
        self.trainer.engine()
    }

    fn response(&self) -> Option<Knots> {
        self.trainer.field().response()
    }

    fn content(&mut self) -> Result<SceneContent, TrainError> {
        Ok(SceneContent::Arrays(of_field(&self.place, self.trainer.field())?))
    }

    fn saved(&mut self) -> Result<SavedRun<'_>, TrainError> {
        let (config, fingerprint) = (self.config.clone(), self.fingerprint.clone());
        let training = TrainingRecord { config, fingerprint, state: *self.trainer.state() };
        Ok(SavedRun::Arrays(of_run(&self.place, self.trainer.snapshot(), training)?))
    }

    fn compares_images(&self) -> bool {
        false
    }

    fn renders_slowly(&self) -> bool {
        true
    }
}
