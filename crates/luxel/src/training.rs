//! Training as an iterator of steps, in memory: no run folder, no files unless a checkpoint is
//! asked for.
//!
//! In: a [`Dataset`] and settings; out: [`Progress`] step by step, metrics, and a [`Scene`]. A run
//! pauses when iteration pauses. A checkpoint holds everything: a resumed training gives the same
//! bits as an unbroken one. The crate `luxel-app` trains in a folder.

use std::collections::BTreeMap;
use std::path::Path;

use luxel_core::{Camera, ColorSpace, View};
use luxel_metrics::FieldOptions;
use luxel_metrics::{GainFit, Measures, SplitMetrics};
use luxel_train::{LensVignetting, Method, PoseReport, Preset, TrainConfig, Trainer};

use crate::device::SelectedEngine;
use crate::error::Context;
use crate::step_methods::{check_is_built, means_of};
use crate::{Dataset, DeviceOptions, Radiance, Result, Scene};

/// Numbers of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Progress {
    /// Steps made so far; 1 after the first.
    pub number: u32,
    /// Steps in all.
    pub total: u32,
    /// Loss of the step's view. An engine that works ahead gives the loss of a step shortly before.
    pub loss: f32,
    /// Number of splats.
    pub splats: usize,
    /// Splats that touch the step's image.
    pub visible: u32,
}

/// Settings of a training that has not started.
///
/// Settings have, in this order of precedence: the value given here, that of the preset, that of
/// [`Self::config`], the default.
#[derive(Clone, Debug)]
pub struct TrainingBuilder<'a> {
    dataset: &'a Dataset,
    device: DeviceOptions,
    config: TrainConfig,
    preset: Option<Preset>,
    steps: Option<u32>,
    seed: Option<u64>,
    method: Option<Method>,
    max_splats: Option<u32>,
    from: Option<&'a Scene>,
}

impl<'a> TrainingBuilder<'a> {
    /// Sets every option of the method. The others of this builder take precedence, in any order of
    /// calls.
    #[must_use]
    pub fn config(mut self, config: TrainConfig) -> Self {
        self.config = config;
        self
    }

    /// Sets the recipe: values of options that go together.
    #[must_use]
    pub fn preset(mut self, preset: Preset) -> Self {
        self.preset = Some(preset);
        self
    }

    /// Sets the number of steps, at least 1. Schedules scale with it.
    #[must_use]
    pub fn steps(mut self, steps: u32) -> Self {
        self.steps = Some(steps);
        self
    }

    /// Sets the seed of everything random. Equal seeds give equal scenes.
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = Some(seed);
        self
    }

    /// Sets the colour model.
    #[must_use]
    pub fn method(mut self, method: Method) -> Self {
        self.method = Some(method);
        self
    }

    /// Sets the largest number of splats.
    #[must_use]
    pub fn max_splats(mut self, max_splats: u32) -> Self {
        self.max_splats = Some(max_splats);
        self
    }

    /// Sets the scene whose splats the training starts from; see [`Trainer::from_scene`].
    #[must_use]
    pub fn from_scene(mut self, scene: &'a Scene) -> Self {
        self.from = Some(scene);
        self
    }

    /// Sets what computes; [`crate::Device::Auto`] by default.
    #[must_use]
    pub fn device(mut self, device: impl Into<DeviceOptions>) -> Self {
        self.device = device.into();
        self
    }

    /// Checks the settings, opens the device and makes the first splats.
    ///
    /// # Errors
    /// Settings out of range, a data set without training views, a device that is not there.
    pub fn start(self) -> Result<Training> {
        let config = self.resolved();
        let engine = open_engine(self.dataset, &self.device, &config)?;
        let trainer = match self.from {
            None => Trainer::new(self.dataset, config, means_of(engine)),
            Some(scene) => Trainer::from_scene(self.dataset, scene, config, means_of(engine)),
        };
        let trainer = trainer.context("cannot start training")?;
        Ok(Training::new(trainer, self.dataset))
    }

    /// Continues from a checkpoint of the same data set. Of the settings, the device alone is taken
    /// from here, and the number of steps if it was set.
    ///
    /// # Errors
    /// A checkpoint that is damaged or of another data set; fewer steps than are made already.
    pub fn resume(self, checkpoint: impl AsRef<Path>) -> Result<Training> {
        let path = checkpoint.as_ref();
        let snapshot = luxel_io::read_checkpoint(path).context("cannot read the checkpoint")?;
        let config = luxel_train::snapshot_config(&snapshot)?;
        let engine = open_engine(self.dataset, &self.device, &config)?;
        let mut trainer =
            Trainer::resume(self.dataset, snapshot, means_of(engine)).with_context(|| format!("{}: cannot resume", path.display()))?;
        if let Some(steps) = self.steps {
            let made = trainer.iteration();
            crate::error::ensure!(steps >= made, "{steps} steps: {made} are made already; give at least as many");
            trainer.set_iterations(steps);
        }
        trainer.finish_average()?;
        Ok(Training::new(trainer, self.dataset))
    }

    fn resolved(&self) -> TrainConfig {
        let mut config = self.config.clone();
        if let Some(preset) = self.preset {
            config = TrainConfig { preset, ..config }.with_preset(|_| false);
        }
        if let Some(steps) = self.steps {
            config = config.with_steps(steps);
        }
        config.seed = self.seed.unwrap_or(config.seed);
        config.method = self.method.unwrap_or(config.method);
        config.max_splats = self.max_splats.or(config.max_splats);
        config
    }
}

fn open_engine(dataset: &Dataset, device: &DeviceOptions, config: &TrainConfig) -> Result<Box<dyn luxel_core::Engine>> {
    check_is_built(config.method)?;
    let learns_response = dataset.train.iter().any(|view| view.values != luxel_core::PixelValues::Radiance);
    Ok(SelectedEngine::for_training(device, learns_response || config.method.has_own_steps() || config.packs_moments())?.engine)
}

/// A training in progress: an iterator of steps, which may move to another thread.
///
/// ```
/// use luxel::{Dataset, Device, Training, synthetic};
///
/// # fn main() -> luxel::Result<()> {
/// # let folder = tempfile::tempdir().unwrap();
/// # synthetic::write_dataset(folder.path(), synthetic::BallsOptions { side_px: 12, views: 4 })?;
/// let dataset = Dataset::open(folder.path())?;
/// let mut training = Training::builder(&dataset).device(Device::Cpu).steps(6).start()?;
/// for step in training.by_ref().take(4) {
///     assert!(step?.loss.is_finite());
/// }
/// // Paused after four steps. A checkpoint continues from here, bit for bit.
/// let checkpoint = folder.path().join("paused.safetensors");
/// training.checkpoint(&checkpoint)?;
/// let resumed = Training::builder(&dataset).device(Device::Cpu).resume(&checkpoint)?;
/// let scenes = [training, resumed].map(|mut training| {
///     assert_eq!(training.by_ref().count(), 2);
///     training.into_scene()
/// });
/// let [a, b] = scenes;
/// assert_eq!(a?, b?);
/// # Ok(())
/// # }
/// ```
pub struct Training {
    trainer: Trainer,
    color_space: ColorSpace,
    /// Names of the training views, in the order of the trainer's gains.
    names: Vec<String>,
    has_failed: bool,
}

impl Training {
    /// Returns the settings to start a training on `dataset` from.
    pub fn builder(dataset: &Dataset) -> TrainingBuilder<'_> {
        let (device, config) = (DeviceOptions::default(), TrainConfig::default());
        TrainingBuilder { dataset, device, config, preset: None, steps: None, seed: None, method: None, max_splats: None, from: None }
    }

    fn new(trainer: Trainer, dataset: &Dataset) -> Self {
        let names = dataset.train.iter().map(|view| view.name.clone()).collect();
        Self { trainer, color_space: dataset.color_space, names, has_failed: false }
    }

    /// Returns the settings in force.
    pub fn config(&self) -> &TrainConfig {
        self.trainer.config()
    }

    /// Returns the number of steps made so far.
    pub fn steps_made(&self) -> u32 {
        self.trainer.iteration()
    }

    /// Returns whether all steps are made.
    pub fn is_finished(&self) -> bool {
        self.trainer.is_finished()
    }

    /// Makes one step.
    ///
    /// # Errors
    /// A loss that is not finite, a device that gave up. The training cannot continue; resume it
    /// from a checkpoint.
    pub fn step(&mut self) -> Result<Progress> {
        let number = self.trainer.iteration() + 1;
        let report = self.trainer.step().with_context(|| format!("training step {number}"))?;
        Ok(Progress {
            number: self.trainer.iteration(),
            total: self.trainer.config().iterations,
            loss: report.loss,
            splats: self.trainer.splats_len(),
            visible: report.visible,
        })
    }

    /// Returns the cameras of the training views, in their order: as refined, if the settings ask
    /// for that, or as the data set has them.
    pub fn cameras(&self) -> Vec<Camera> {
        self.trainer.cameras()
    }

    /// Returns the corrections of the poses so far, or `None` if poses are not refined.
    pub fn pose_report(&self) -> Option<PoseReport> {
        self.trainer.pose_report()
    }

    /// Returns the vignetting of each lens so far, or `None` if the settings do not ask for it.
    pub fn vignetting(&self) -> Option<Vec<LensVignetting>> {
        self.trainer.vignetting()
    }

    /// Measures the scene as it stands against views, with the radiance scale, mu, raster settings,
    /// gains, vignetting and camera response of this training.
    ///
    /// # Errors
    /// A render that is not finite, a device that gave up.
    pub fn evaluate(&mut self, views: &[View]) -> Result<SplitMetrics> {
        let (options, scale, mu) = (self.trainer.render_options(), self.trainer.radiance_scale(), self.trainer.config().mu);
        let logs = self.trainer.log_gains().unwrap_or_default();
        let by_name: BTreeMap<&str, [f32; 3]> = self.names.iter().map(String::as_str).zip(logs.iter().copied()).collect();
        let known: Vec<[f32; 3]> = views.iter().map(|view| by_name.get(view.name.as_str()).copied().unwrap_or_default()).collect();
        let response = self.trainer.response();
        let measures = Measures {
            field: FieldOptions { color_space: self.color_space, ..FieldOptions::default() },
            response: response.as_ref(),
            gain_fit: GainFit::Known(&known),
            ..Measures::new(scale, mu)
        };
        let mut seen = views.to_vec();
        LensVignetting::show_in(&self.trainer.vignetting().unwrap_or_default(), views, &mut seen);
        Ok(luxel_metrics::evaluate(self.trainer.engine(), &options, &measures, &seen, &mut |_, _, _| {})?)
    }

    /// Renders the scene as it stands, from a camera in the local coordinates of the data set, such
    /// as those of its views.
    ///
    /// # Errors
    /// A camera that cannot be rendered, a device that gave up.
    pub fn render(&mut self, camera: &Camera) -> Result<Radiance> {
        let (options, scale) = (self.trainer.render_options(), self.trainer.radiance_scale());
        let image = self.trainer.engine().render(camera, &options).context("cannot render")?;
        let mut world_camera = camera.clone();
        self.trainer.world_from_local().apply_to_camera(&mut world_camera);
        Ok(Radiance::new(image, scale, self.color_space, &world_camera))
    }

    /// Writes everything that is needed to continue, whole or not at all.
    ///
    /// # Errors
    /// The file system's refusal, a device that gave up.
    pub fn checkpoint(&mut self, path: impl AsRef<Path>) -> Result<()> {
        let state = self.trainer.saved_state()?;
        luxel_io::write_checkpoint(path.as_ref(), state).context("cannot write the checkpoint")
    }

    /// Returns the scene as it stands.
    ///
    /// # Errors
    /// A device that gave up.
    pub fn scene(&mut self) -> Result<Scene> {
        Ok(self.trainer.scene()?.into())
    }

    /// Ends the training and returns its scene.
    ///
    /// # Errors
    /// A device that gave up.
    pub fn into_scene(mut self) -> Result<Scene> {
        self.scene()
    }
}

impl Iterator for Training {
    type Item = Result<Progress>;

    /// Makes the next step; `None` once all are made, and after a step that failed.
    fn next(&mut self) -> Option<Self::Item> {
        if self.has_failed || self.is_finished() {
            return None;
        }
        let step = self.step();
        self.has_failed = step.is_err();
        Some(step)
    }
}
