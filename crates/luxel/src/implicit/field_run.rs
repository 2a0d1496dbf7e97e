//! The training of a field as a run drives it.
//!
//! In: a data set, options or a checkpoint, threads. Out: a [`Reconstruction`]. Degenerate: a
//! checkpoint of another data set is an error.

use luxel_core::{Dataset, Engine, Knots, RadianceScale, RenderOptions, Scene, StepReport};
use luxel_field::FieldTrainer;
use luxel_train::{ArrayFile, Reconstruction, SavedRun, SceneContent, SceneSize, TrainConfig, TrainError, start_scale};

use super::field_files::{self, FieldCheckpoint, TrainingRecord};
use super::objective::options;
use super::place::{check_fingerprint, place_in};
use crate::Result;
use crate::error::Context;

/// A training of a field.
pub(super) struct FieldRun {
    trainer: FieldTrainer,
    config: TrainConfig,
    fingerprint: String,
    /// Units and place of the scene.
    place: Scene,
}

impl FieldRun {
    /// Starts a run.
    pub(super) fn new(dataset: &Dataset, config: &TrainConfig, threads: usize) -> Result<Self> {
        let context = "cannot start training";
        let scale = start_scale(dataset, config).context(context)?;
        let trainer = FieldTrainer::new(dataset, options(config, scale)?, threads).context(context)?;
        Ok(Self::assemble(dataset, trainer, config.clone()))
    }

    /// Continues a run.
    pub(super) fn resume(dataset: &Dataset, checkpoint: FieldCheckpoint, threads: usize) -> Result<Self> {
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
        Ok(SceneContent::Arrays(field_files::of_field(&self.place, self.trainer.field())?))
    }

    fn saved(&mut self) -> Result<SavedRun<'_>, TrainError> {
        let (config, fingerprint) = (self.config.clone(), self.fingerprint.clone());
        let training = TrainingRecord { config, fingerprint, state: *self.trainer.state() };
        let file: ArrayFile = field_files::of_run(&self.place, self.trainer.snapshot(), training)?;
        Ok(SavedRun::Arrays(file))
    }

    fn compares_images(&self) -> bool {
        false
    }

    fn renders_slowly(&self) -> bool {
        true
    }
}
