//! Everything that a training on views keeps besides its scene, for scenes of other kinds than
//! splats: the order of the views, the schedule, the camera's response and all random numbers.
//!
//! In: a data set, a configuration, or the state of a checkpoint. Out: the view of each step, and
//! what its step needs to know. Everything is as in a training of splats, step for step.
//! Degenerate: a data set without views, or a state of another data set, is an error.

use luxel_core::{Dataset, Knots, RadianceScale, RasterConfig, StepReport, View};

use crate::camera_response::CameraResponse;
use crate::pixel_weights::ToneScale;
use crate::recorded::{is_recorded, learns_response};
use crate::state::{Start, State};
use crate::trainer::{SlotView, check_views, scene_extent, view_of};
use crate::views::{TrainingViews, pixels};
use crate::{Initial, MethodState, Schedule, TrainConfig, TrainError, initialise};

/// A training on views, without its scene.
pub struct ViewTraining {
    views: TrainingViews,
    schedule: Schedule,
    state: State,
}

/// The state of a [`ViewTraining`] in a checkpoint.
pub struct ViewState(State);

/// The view of a step, and what the step needs to know.
#[derive(Clone, Copy)]
pub struct StepView<'a> {
    /// The view.
    pub view: &'a View,
    /// The options of the run.
    pub config: &'a TrainConfig,
    /// Radiance of one normalised unit.
    pub radiance_scale: RadianceScale,
    /// Number of steps that the schedule is planned for.
    pub planned_iterations: u32,
}

impl ViewState {
    /// Reads a state.
    ///
    /// # Errors
    /// [`TrainError::State`] for text of something else.
    pub fn parse(json: &str) -> Result<Self, TrainError> {
        State::parse(json).map(Self)
    }

    /// Returns the configuration of the run.
    pub fn config(&self) -> &TrainConfig {
        &self.0.config
    }

    /// Returns the number of steps done.
    pub fn iteration(&self) -> u32 {
        self.0.iteration
    }

    /// Returns the number of states in the mean of the last ones.
    pub fn averaged(&self) -> u32 {
        self.0.averaged
    }

    /// Takes out what the method trains beside its scene.
    pub fn take_method(&mut self) -> Option<MethodState> {
        self.0.networks.take()
    }
}

/// Returns the splats that a scene of another kind is made from at the start of a run.
///
/// # Errors
/// Options out of range, or nothing to train on.
pub fn first_splats(dataset: &Dataset, config: &TrainConfig) -> Result<Initial, TrainError> {
    let response = is_recorded(&dataset.train)?.then(|| CameraResponse::new(config.unit_exposure, &dataset.train));
    initialise(dataset, config, response.as_ref().map(CameraResponse::knots))
}

/// Returns the number of pixels of the training views together.
pub fn train_px(dataset: &Dataset) -> u64 {
    pixels(&dataset.train)
}

impl ViewTraining {
    /// Checks the options, and that a data set has views to train on.
    ///
    /// # Errors
    /// An option out of range; no views, or views that are damaged.
    pub fn check(dataset: &Dataset, config: &TrainConfig) -> Result<(), TrainError> {
        config.validate()?;
        check_views(dataset)
    }

    /// Starts a training of a scene whose parts are at these positions.
    ///
    /// # Errors
    /// Views of both kinds, radiance and captured images.
    pub fn new(dataset: &Dataset, config: TrainConfig, radiance_scale: RadianceScale, positions: &[[f32; 3]]) -> Result<Self, TrainError> {
        let is_learned = learns_response(dataset, &config)?;
        let response = is_learned.then(|| CameraResponse::new(config.unit_exposure, &dataset.train));
        let extent = scene_extent(&dataset.train, positions);
        let state = State::new(dataset, Start { config, extent, radiance_scale, response, clearances: Vec::new() });
        Ok(Self::assemble(dataset, state))
    }

    /// Resumes a training.
    ///
    /// # Errors
    /// A state of another data set.
    pub fn resume(dataset: &Dataset, state: ViewState) -> Result<Self, TrainError> {
        let ViewState(state) = state;
        state.check_data(dataset)?;
        Self::check(dataset, &state.config)?;
        Ok(Self::assemble(dataset, state))
    }

    fn assemble(dataset: &Dataset, state: State) -> Self {
        let config = &state.config;
        let schedule = Schedule::new(config, state.planned_iterations, state.extent);
        let side_px = dataset.train.iter().flat_map(|view| view.camera.size_px).min().unwrap_or(1);
        let stages = config.resolution_schedule.stages(state.planned_iterations, schedule.densify_interval, side_px);
        let tone = ToneScale { radiance_scale: state.radiance_scale, mu: config.mu };
        let views = TrainingViews::new(&dataset.train, stages, config.noise_model, tone);
        Self { views, schedule, state }
    }

    /// Returns the configuration in force.
    pub fn config(&self) -> &TrainConfig {
        &self.state.config
    }

    /// Returns the schedule of the run.
    pub fn schedule(&self) -> &Schedule {
        &self.schedule
    }

    /// Returns the number of steps done.
    pub fn iteration(&self) -> u32 {
        self.state.iteration
    }

    /// Returns whether all steps are done.
    pub fn is_finished(&self) -> bool {
        self.state.iteration >= self.state.config.iterations
    }

    /// Returns the radiance of one normalised unit, in the units of the data set.
    pub fn radiance_scale(&self) -> RadianceScale {
        self.state.radiance_scale
    }

    /// Returns the number of pixels of the training views together.
    pub fn train_px(&self) -> u64 {
        self.views.train_px()
    }

    /// Returns the settings of the rasteriser at a step.
    pub fn raster(&self, step: u32) -> RasterConfig {
        RasterConfig { samples: self.schedule.samples(step), ..self.state.config.raster() }
    }

    /// Returns the learned response of the camera that captured the training images, or `None` if
    /// they are radiance or the method has networks for that.
    pub fn response(&self) -> Option<Knots> {
        self.state.response.as_ref().map(CameraResponse::knots)
    }

    /// Sets the step after which the run ends. The schedule stays as planned at the start.
    pub fn set_iterations(&mut self, iterations: u32) {
        self.state.config.iterations = iterations.max(1);
        self.schedule = Schedule::new(&self.state.config, self.state.planned_iterations, self.schedule.extent);
    }

    /// Returns the index of the next step's view. The order is shuffled, and each view comes once
    /// an epoch.
    pub fn next_view(&mut self) -> usize {
        self.state.next_views(&[]).first().copied().unwrap_or(0)
    }

    /// Returns a view as a step sees it, and asks for that of the next step in advance.
    ///
    /// # Errors
    /// An image that cannot be read.
    pub fn look(&mut self, step: u32, index: usize) -> Result<StepView<'_>, TrainError> {
        let Self { views, state, .. } = self;
        // Looked at first, so that the reader works while the engine does. An error comes again.
        let _ = views.part_at(step, index, state.gain(index), state.crop(step, 0));
        let (next, after) = (state.upcoming_view(0, &[]), step.saturating_add(1));
        views.ask(after, next, state.crop(after, 0));
        let view = view_of(views, state, None, SlotView { step, slot: 0, index })?;
        let State { config, radiance_scale, planned_iterations, .. } = &*state;
        Ok(StepView { view, config, radiance_scale: *radiance_scale, planned_iterations: *planned_iterations })
    }

    /// Returns the fraction of the planned steps that are done after `step`.
    pub fn progress(&self, step: u32) -> f64 {
        f64::from(step) / f64::from(self.state.planned_iterations.max(1))
    }

    /// Returns the seed of a step's noise.
    pub fn noise_seed(&self, step: u32) -> u64 {
        self.state.noise_seed(step)
    }

    /// Returns the seed of the splats that a step leaves out.
    pub fn dropout_seed(&self, step: u32) -> u32 {
        self.state.dropout_seed(step)
    }

    /// Changes the camera's response by a step's report, if it is learned.
    pub fn learn_response(&mut self, step: u32, report: &StepReport) {
        let progress = self.progress(step);
        if let (Some(response), Some(by_knots)) = (&mut self.state.response, &report.by_knots) {
            response.update(by_knots, progress);
        }
    }

    /// Returns the number of states in the mean of the last ones.
    pub fn averaged(&self) -> u32 {
        self.state.averaged
    }

    /// Sets the number of states in the mean of the last ones.
    pub fn set_averaged(&mut self, averaged: u32) {
        self.state.averaged = averaged;
    }

    /// Notes that a step is done.
    pub fn finish(&mut self, step: u32) {
        self.state.iteration = step;
    }

    /// Returns the state as text, with what the method trains beside its scene.
    ///
    /// # Errors
    /// [`TrainError::State`].
    pub fn to_json(&self, method: Option<MethodState>) -> Result<String, TrainError> {
        self.state.to_json(method)
    }
}
