//! The training of anchors, one step at a time.
//!
//! In: a data set, a configuration, an engine of splats. Out: a scene of anchors in normalised
//! units. A step decodes the splats that its view shows, lets the engine compare their image with
//! the view's and return gradients by their parameters, takes these back through the networks, and
//! updates everything by Adam. Rounds of growth and pruning, the mean of the last states and the
//! order of views are those of any training ([`crate::Schedule`]).

use luxel_core::engine::{AdamBetas, CameraGradientChoice, Dropout, LearningRates, SparseGradients, StatsCollection, StepConfig};
use luxel_core::{Dataset, Engine, Knots, RadianceScale, RasterConfig, RenderOptions, StepReport, View};

use super::decode::Decoded;
use super::decoders::Decoders;
use super::engine::AnchorEngine;
use super::gradients::SplatGradients;
use super::groups::{Groups, numbers, numbers_mut};
use super::grow::{Changes, GrowthRules, grow};
use super::saved::Saved;
use super::scene::AnchorScene;
use super::start::{First, first_anchors, median_color};
use super::statistics::Statistics;
use super::{AnchorSnapshot, SPLATS_PER_ANCHOR};
use crate::camera_response::CameraResponse;
use crate::peers::{GaussStep, GaussTone, captured_target, check_captured, tone_rate};
use crate::pixel_weights::ToneScale;
use crate::recorded::is_recorded;
use crate::state::{Start, State, learns_response};
use crate::trainer::{SlotView, check_views, scene_extent, view_of};
use crate::views::TrainingViews;
use crate::{Initial, Method, MethodStep, NamedChoice, Schedule, TrainConfig, TrainError, initialise};

/// Part of the scene's extent that the standard deviation of a splat may reach.
const LARGEST_PART: f32 = 0.25;

/// A training run of anchors.
pub struct AnchorTrainer {
    /// The anchors, and the engine that steps and renders use in turn.
    renderer: AnchorEngine,
    views: TrainingViews,
    schedule: Schedule,
    state: State,
    groups: Groups,
    statistics: Statistics,
    /// Side of a voxel, world units.
    voxel: f32,
    /// Mean of the trained numbers over the steps so far, while it is being taken, one after
    /// another.
    average: Option<Vec<f32>>,
    /// The tone networks of GaussHDR.
    tone: Option<Box<GaussTone>>,
}

/// Checks that the method trains anchors, and that the data set has what it trains on.
fn check(dataset: &Dataset, config: &TrainConfig) -> Result<(), TrainError> {
    config.validate()?;
    if !config.method.has_anchors() {
        return Err(TrainError::config("method", format!("{} trains no anchors", config.method.name())));
    }
    check_views(dataset)?;
    match config.method {
        Method::GaussHdrAnchors => check_captured(&dataset.train, config.method.name()),
        _ => Ok(()),
    }
}

impl AnchorTrainer {
    /// Starts a new run.
    ///
    /// # Errors
    /// Returns a [`TrainError`] if an option is out of range, or if there is nothing to train on.
    pub fn new(dataset: &Dataset, config: TrainConfig, engine: Box<dyn Engine>) -> Result<Self, TrainError> {
        check(dataset, &config)?;
        let response = is_recorded(&dataset.train)?.then(|| CameraResponse::new(config.unit_exposure, &dataset.train));
        let knots = response.as_ref().map(CameraResponse::knots);
        let response = if learns_response(dataset, &config)? { response } else { None };
        let Initial { splats, radiance_scale } = initialise(dataset, &config, knots)?;
        let limit = anchor_limit(&config, crate::views::pixels(&dataset.train));
        let First { anchors, voxel } = first_anchors(&splats.position, limit);
        let has_context = config.method == Method::GaussHdrAnchors;
        let decoders = Decoders::new(config.color_model(), has_context, median_color(&splats), config.seed);
        let scene = AnchorScene { anchors, decoders };
        let extent = scene_extent(&dataset.train, &scene.anchors.position);
        tracing::info!(anchors = scene.anchors.len(), limit, voxel, extent, "initialised");
        let (groups, statistics) = (Groups::new(&scene), Statistics::zeros(scene.anchors.len()));
        let tone = has_context.then(|| Box::new(GaussTone::new(config.seed)));
        let state = State::new(dataset, Start { config, extent, radiance_scale, response, clearances: Vec::new() });
        Ok(Self::assemble(dataset, engine, Saved { state, scene, groups, statistics, voxel, average: None, tone }))
    }

    /// Resumes the run that `snapshot` was taken of, with the configuration of that run.
    ///
    /// # Errors
    /// Returns a [`TrainError`] if the snapshot belongs to another data set or is damaged.
    pub fn resume(dataset: &Dataset, snapshot: AnchorSnapshot, engine: Box<dyn Engine>) -> Result<Self, TrainError> {
        let saved = Saved::read(snapshot)?;
        saved.state.check_data(dataset)?;
        check(dataset, &saved.state.config)?;
        Ok(Self::assemble(dataset, engine, saved))
    }

    fn assemble(dataset: &Dataset, engine: Box<dyn Engine>, saved: Saved) -> Self {
        let Saved { state, scene, groups, statistics, voxel, average, tone } = saved;
        let config = &state.config;
        let schedule = Schedule::new(config, state.planned_iterations, state.extent);
        let side_px = dataset.train.iter().flat_map(|view| view.camera.size_px).min().unwrap_or(1);
        let stages = config.resolution_schedule.stages(state.planned_iterations, schedule.densify_interval, side_px);
        let scale = ToneScale { radiance_scale: state.radiance_scale, mu: config.mu };
        let views = TrainingViews::new(&dataset.train, stages, config.noise_model, scale);
        Self { renderer: AnchorEngine::new(scene, engine), views, schedule, state, groups, statistics, voxel, average, tone }
    }

    /// Returns the configuration in force.
    pub fn config(&self) -> &TrainConfig {
        &self.state.config
    }

    /// Returns the number of steps done.
    pub fn iteration(&self) -> u32 {
        self.state.iteration
    }

    /// Returns whether all steps are done.
    pub fn is_finished(&self) -> bool {
        self.state.iteration >= self.state.config.iterations
    }

    /// Returns the anchors and networks as they are now.
    pub fn scene(&self) -> &AnchorScene {
        &self.renderer.scene
    }

    /// Returns an engine that renders the anchors as they are now.
    pub fn engine(&mut self) -> &mut dyn Engine {
        &mut self.renderer
    }

    /// Returns the radiance of one normalised unit, in the units of the data set.
    pub fn radiance_scale(&self) -> RadianceScale {
        self.state.radiance_scale
    }

    /// Returns the settings of the rasteriser to render the current scene with.
    pub fn raster(&self) -> RasterConfig {
        self.raster_of(self.state.iteration)
    }

    /// Returns the response of the camera that captured the training images, or `None` if the
    /// images are radiance.
    pub fn response(&self) -> Option<Knots> {
        match &self.state.response {
            Some(response) => Some(response.knots()),
            None => Some(self.tone.as_ref()?.response()),
        }
    }

    /// Sets the step after which the run ends. The schedule stays as planned at the start. A mean
    /// that is being taken becomes the scene if the new end is the current step.
    pub fn set_iterations(&mut self, iterations: u32) {
        self.state.config.iterations = iterations.max(1);
        self.schedule = Schedule::new(&self.state.config, self.state.planned_iterations, self.schedule.extent);
        if self.schedule.is_averaging(self.state.iteration) && self.is_finished() {
            self.load_average();
        }
    }

    /// Returns everything needed to resume from here bit for bit.
    ///
    /// # Errors
    /// [`TrainError::State`] if the state has no form as text.
    pub fn snapshot(&self) -> Result<AnchorSnapshot, TrainError> {
        let Self { state, renderer, groups, statistics, voxel, average, tone, .. } = self;
        super::saved::write(state, &renderer.scene, groups, statistics, *voxel, average.as_deref(), tone.as_deref())
    }

    fn raster_of(&self, step: u32) -> RasterConfig {
        RasterConfig { samples: self.schedule.samples(step), ..self.state.config.raster() }
    }

    fn step_config(&self, step: u32) -> StepConfig {
        let config = &self.state.config;
        let background = self.state.radiance_scale.normalised(config.background);
        let dropout = self.schedule.dropout_rate(config, step);
        StepConfig {
            step,
            render: RenderOptions { raster: self.raster_of(step), background, active_degree: 0 },
            loss: config.loss_weights(),
            learning_rates: LearningRates::ZERO,
            betas: AdamBetas::default(),
            position_noise: None,
            dropout: dropout.map(|rate| Dropout { rate, seed: self.state.dropout_seed(step) }),
            stats: if self.schedule.is_densifying(step) { StatsCollection::Gradients } else { StatsCollection::Off },
            camera_gradient: CameraGradientChoice::default(),
        }
    }

    /// Performs one step of training, with growth when it is due.
    ///
    /// # Errors
    /// Returns [`TrainError::NotFinite`] if the loss diverged, [`TrainError::AllPruned`] if no
    /// anchor is left, [`TrainError::Read`] for an image that cannot be read, or the error of the
    /// engine.
    pub fn step(&mut self) -> Result<StepReport, TrainError> {
        let step = self.state.iteration.saturating_add(1);
        let index = self.state.next_views(&[]).first().copied().unwrap_or(0);
        let config = self.step_config(step);
        self.ask_ahead(step, index);
        let Self { renderer: AnchorEngine { scene, engine }, views, state, tone, .. } = self;
        let view = view_of(views, state, None, SlotView { step, slot: 0, index })?;
        let mut decoded = scene.decode(&view.camera, config.render.raster.cutoffs.near);
        engine.load(&decoded.splats, None)?;
        let (radiance_scale, planned_iterations) = (state.radiance_scale, state.planned_iterations);
        let method_step = MethodStep { train: &state.config, engine: &config, radiance_scale, planned_iterations };
        let Found { report, gradients, by_context } = match tone {
            Some(tone) => channel_gradients(&mut **engine, tone, view, &decoded, method_step)?,
            None => {
                let (report, gradients) = engine.view_gradients(view, &config)?;
                Found { report, gradients, by_context: Vec::new() }
            }
        };
        if !report.loss.is_finite() {
            return Err(TrainError::NotFinite { step, view: view.name.clone() });
        }
        let by_splats = SplatGradients::new(&gradients, decoded.splats.len());
        engine.reuse_gradients(gradients);
        let by_scene = decoded.backward(scene, &by_splats, &by_context);
        let progress = f64::from(step) / f64::from(state.planned_iterations.max(1));
        self.groups.update(scene, &by_scene, progress);
        if let (Some(response), Some(by_knots)) = (&mut state.response, &report.by_knots) {
            response.update(by_knots, progress);
        }
        if config.stats != StatsCollection::Off {
            self.statistics.add(&decoded, &by_splats);
        }
        self.grow(step)?;
        self.average(step);
        self.state.iteration = step;
        Ok(report)
    }

    /// Has the view of a step read, and asks for the next.
    fn ask_ahead(&mut self, step: u32, index: usize) {
        let Self { views, state, .. } = self;
        // Looked at first, so that the reader works while the engine does. An error comes again.
        let _ = views.part_at(step, index, state.gain(index), state.crop(step, 0));
        let (next, step) = (state.upcoming_view(0, &[]), step.saturating_add(1));
        views.ask(step, next, state.crop(step, 0));
    }

    fn grow(&mut self, step: u32) -> Result<(), TrainError> {
        if !self.schedule.densifies_after(step) {
            return Ok(());
        }
        let config = &self.state.config;
        let rules = GrowthRules {
            voxel: self.voxel,
            interval: self.schedule.densify_interval,
            threshold: config.densify_threshold,
            prune_opacity: config.prune_opacity,
            limit: anchor_limit(config, self.views.train_px()),
            turnover: config.turnover,
            largest: LARGEST_PART * self.schedule.extent,
            seed: self.state.noise_seed(step),
        };
        let Changes { added, pruned } = grow(&mut self.renderer.scene, &mut self.groups, &mut self.statistics, &rules);
        tracing::debug!(step, added, pruned, anchors = self.scene().anchors.len(), "growth");
        if self.scene().anchors.is_empty() {
            return Err(TrainError::AllPruned { step });
        }
        Ok(())
    }

    /// Adds the numbers after `step` to their mean where that is due. After the last such step, the
    /// mean becomes the scene.
    fn average(&mut self, step: u32) {
        if !self.schedule.is_averaging(step) {
            // These steps are no longer among the last ones, because the end was moved.
            (self.average, self.state.averaged) = (None, 0);
        }
        if self.schedule.averages_after(step) {
            let count = self.state.averaged + 1;
            let now = numbers(self.scene()).concat();
            match &mut self.average {
                Some(mean) => mean.iter_mut().zip(now).for_each(|(mean, value)| *mean += (value - *mean) / count as f32),
                None => self.average = Some(now),
            }
            self.state.averaged = count;
            if step == self.schedule.end {
                self.load_average();
            }
        }
    }

    fn load_average(&mut self) {
        if let Some(mean) = self.average.take() {
            let mut rest = &mean[..];
            for group in numbers_mut(&mut self.renderer.scene) {
                let (own, others) = rest.split_at(group.len());
                group.copy_from_slice(own);
                rest = others;
            }
        }
        self.state.averaged = 0;
    }
}

/// The engine's results of a step.
struct Found {
    report: StepReport,
    gradients: SparseGradients,
    /// By the context features, `[splats, 4]`, or empty.
    by_context: Vec<f32>,
}

/// Compares the images that GaussHDR makes of decoded splats with a captured one, and updates its
/// tone networks.
fn channel_gradients(
    engine: &mut dyn Engine,
    tone: &mut GaussTone,
    view: &View,
    decoded: &Decoded,
    step: MethodStep<'_>,
) -> Result<Found, TrainError> {
    let mut channels = GaussStep::new(captured_target(view, &step)?, tone, &decoded.context);
    let (report, gradients) = engine.channel_gradients(&view.camera, &mut channels, step.engine)?;
    let found = channels.gradients();
    if report.loss.is_finite() {
        tone.update(&found.by_numbers, tone_rate(step.train, step.engine.step, step.planned_iterations));
    }
    Ok(Found { report, gradients, by_context: found.by_features })
}

/// Returns the largest number of anchors for training images of `train_px` pixels in total: as many
/// as have the largest number of splats together.
fn anchor_limit(config: &TrainConfig, train_px: u64) -> usize {
    (config.splat_limit(train_px) / SPLATS_PER_ANCHOR).max(1)
}
