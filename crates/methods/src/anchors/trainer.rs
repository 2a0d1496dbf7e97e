//! The training of anchors, one step at a time.
//!
//! In: a data set, a configuration, an engine of splats. Out: a scene of anchors in normalised
//! units. A step decodes the splats that its view shows, lets the engine compare their image with
//! the view's and return gradients by their parameters, takes these back through the networks, and
//! updates everything by Adam. Rounds of growth and pruning, the mean of the last states and the
//! order of views are those of any training ([`luxel_train::Schedule`]).

use luxel_core::engine::{AdamBetas, CameraGradientChoice, Dropout, LearningRates, SparseGradients, StatsCollection, StepConfig};
use luxel_core::{Dataset, Engine, Knots, RadianceScale, RasterConfig, RenderOptions, StepReport, View};
use luxel_train::{
    Initial, MethodStep, NamedChoice, Representation, Scheme, StepView, TrainConfig, TrainError, ViewTraining, first_splats, train_px,
};

use super::AnchorSnapshot;
use super::SPLATS_PER_ANCHOR;
use super::decode::Decoded;
use super::decoders::Decoders;
use super::engine::AnchorEngine;
use super::gradients::SplatGradients;
use super::groups::{Groups, numbers, numbers_mut};
use super::grow::{Changes, GrowthRules, grow};
use super::saved::{Progress, Saved};
use super::scene::AnchorScene;
use super::start::{First, first_anchors, median_color};
use super::statistics::Statistics;
use crate::captured::{GaussStep, GaussTone, captured_target, check_captured, tone_rate};

/// Part of the scene's extent that the standard deviation of a splat may reach.
const LARGEST_PART: f32 = 0.25;

/// A training run of anchors.
pub struct AnchorTrainer {
    /// The anchors, and the engine that steps and renders use in turn.
    renderer: AnchorEngine,
    views: ViewTraining,
    progress: Progress,
}

/// Checks that the method trains anchors, and that the data set has what it trains on.
fn check(dataset: &Dataset, config: &TrainConfig) -> Result<(), TrainError> {
    ViewTraining::check(dataset, config)?;
    if config.method.spec().representation != Representation::Anchors {
        return Err(TrainError::config("method", format!("{} trains no anchors", config.method.name())));
    }
    match config.method.spec().scheme {
        Scheme::Captured => check_captured(&dataset.train, config.method.name()),
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
        let Initial { splats, radiance_scale } = first_splats(dataset, &config)?;
        let limit = anchor_limit(&config, train_px(dataset));
        let First { anchors, voxel } = first_anchors(&splats.position, limit);
        let has_context = config.method.has_own_networks();
        let decoders = Decoders::new(config.color_model(), has_context, median_color(&splats), config.seed);
        let scene = AnchorScene { anchors, decoders };
        let (groups, statistics) = (Groups::new(&scene), Statistics::zeros(scene.anchors.len()));
        let tone = has_context.then(|| Box::new(GaussTone::new(config.seed)));
        let views = ViewTraining::new(dataset, config, radiance_scale, &scene.anchors.position)?;
        tracing::info!(anchors = scene.anchors.len(), limit, voxel, extent = views.schedule().extent, "initialised");
        let renderer = AnchorEngine::new(scene, engine);
        Ok(Self { renderer, views, progress: Progress { groups, statistics, voxel, average: None, tone } })
    }

    /// Resumes the run that `snapshot` was taken of, with the configuration of that run.
    ///
    /// # Errors
    /// Returns a [`TrainError`] if the snapshot belongs to another data set or is damaged.
    pub fn resume(dataset: &Dataset, snapshot: AnchorSnapshot, engine: Box<dyn Engine>) -> Result<Self, TrainError> {
        let Saved { state, scene, progress } = Saved::read(snapshot)?;
        let views = ViewTraining::resume(dataset, state)?;
        check(dataset, views.config())?;
        Ok(Self { renderer: AnchorEngine::new(scene, engine), views, progress })
    }

    /// Returns the configuration in force.
    pub fn config(&self) -> &TrainConfig {
        self.views.config()
    }

    /// Returns the number of steps done.
    pub fn iteration(&self) -> u32 {
        self.views.iteration()
    }

    /// Returns whether all steps are done.
    pub fn is_finished(&self) -> bool {
        self.views.is_finished()
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
        self.views.radiance_scale()
    }

    /// Returns the settings of the rasteriser to render the current scene with.
    pub fn raster(&self) -> RasterConfig {
        self.views.raster(self.iteration())
    }

    /// Returns the response of the camera that captured the training images, or `None` if the
    /// images are radiance.
    pub fn response(&self) -> Option<Knots> {
        self.views.response().or_else(|| Some(self.progress.tone.as_ref()?.response()))
    }

    /// Sets the step after which the run ends. The schedule stays as planned at the start. A mean
    /// that is being taken becomes the scene if the new end is the current step.
    pub fn set_iterations(&mut self, iterations: u32) {
        self.views.set_iterations(iterations);
        if self.views.schedule().is_averaging(self.iteration()) && self.is_finished() {
            self.load_average();
        }
    }

    /// Returns everything needed to resume from here bit for bit.
    ///
    /// # Errors
    /// [`TrainError::State`] if the state has no form as text.
    pub fn snapshot(&self) -> Result<AnchorSnapshot, TrainError> {
        super::saved::write(self.scene(), &self.views, &self.progress)
    }

    fn step_config(&self, step: u32) -> StepConfig {
        let (config, schedule) = (self.config(), self.views.schedule());
        let background = self.radiance_scale().normalised(config.background);
        let dropout = schedule.dropout_rate(config, step);
        StepConfig {
            step,
            render: RenderOptions { raster: self.views.raster(step), background, active_degree: 0 },
            loss: config.loss_weights(),
            learning_rates: LearningRates::ZERO,
            betas: AdamBetas::default(),
            position_noise: None,
            dropout: dropout.map(|rate| Dropout { rate, seed: self.views.dropout_seed(step) }),
            stats: if schedule.is_densifying(step) { StatsCollection::Gradients } else { StatsCollection::Off },
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
        let step = self.iteration().saturating_add(1);
        let index = self.views.next_view();
        let step_config = self.step_config(step);
        let Self { renderer: AnchorEngine { scene, engine }, views, progress } = self;
        let StepView { view, config, radiance_scale, planned_iterations } = views.look(step, index)?;
        let mut decoded = scene.decode(&view.camera, step_config.render.raster.cutoffs.near);
        engine.load(&decoded.splats, None)?;
        let method_step = MethodStep { train: config, engine: &step_config, radiance_scale, planned_iterations };
        let Found { report, gradients, by_context } = match &mut progress.tone {
            Some(tone) => channel_gradients(&mut **engine, tone, view, &decoded, method_step)?,
            None => {
                let (report, gradients) = engine.view_gradients(view, &step_config)?;
                Found { report, gradients, by_context: Vec::new() }
            }
        };
        if !report.loss.is_finite() {
            return Err(TrainError::NotFinite { step, view: view.name.clone() });
        }
        let by_splats = SplatGradients::new(&gradients, decoded.splats.len());
        engine.reuse_gradients(gradients);
        let by_scene = decoded.backward(scene, &by_splats, &by_context);
        progress.groups.update(scene, &by_scene, views.progress(step));
        views.learn_response(step, &report);
        if step_config.stats != StatsCollection::Off {
            progress.statistics.add(&decoded, &by_splats);
        }
        self.grow(step)?;
        self.average(step);
        self.views.finish(step);
        Ok(report)
    }

    fn grow(&mut self, step: u32) -> Result<(), TrainError> {
        let schedule = self.views.schedule();
        if !schedule.densifies_after(step) {
            return Ok(());
        }
        let config = self.config();
        let rules = GrowthRules {
            voxel: self.progress.voxel,
            interval: schedule.densify_interval,
            threshold: config.densify_threshold,
            prune_opacity: config.prune_opacity,
            limit: anchor_limit(config, self.views.train_px()),
            turnover: config.turnover,
            largest: LARGEST_PART * schedule.extent,
            seed: self.views.noise_seed(step),
        };
        let Changes { added, pruned } = grow(&mut self.renderer.scene, &mut self.progress.groups, &mut self.progress.statistics, &rules);
        tracing::debug!(step, added, pruned, anchors = self.scene().anchors.len(), "growth");
        if self.scene().anchors.is_empty() {
            return Err(TrainError::AllPruned { step });
        }
        Ok(())
    }

    /// Adds the numbers after `step` to their mean where that is due. After the last such step, the
    /// mean becomes the scene.
    fn average(&mut self, step: u32) {
        if !self.views.schedule().is_averaging(step) {
            // These steps are no longer among the last ones, because the end was moved.
            self.progress.average = None;
            self.views.set_averaged(0);
        }
        if self.views.schedule().averages_after(step) {
            let count = self.views.averaged() + 1;
            let now = numbers(self.scene()).concat();
            match &mut self.progress.average {
                Some(mean) => mean.iter_mut().zip(now).for_each(|(mean, value)| *mean += (value - *mean) / count as f32),
                None => self.progress.average = Some(now),
            }
            self.views.set_averaged(count);
            if step == self.views.schedule().end {
                self.load_average();
            }
        }
    }

    fn load_average(&mut self) {
        if let Some(mean) = self.progress.average.take() {
            let mut rest = &mean[..];
            for group in numbers_mut(&mut self.renderer.scene) {
                let (own, others) = rest.split_at(group.len());
                group.copy_from_slice(own);
                rest = others;
            }
        }
        self.views.set_averaged(0);
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
