//! The training loop, one step at a time.
//!
//! In: a data set, a configuration, an engine. Out: a scene in normalised units.
//!
//! Each step takes the next view of a shuffled epoch and updates all parameters. Where the schedule
//! asks for it, the step also adds and removes splats. At the end, the scene becomes the mean of
//! its last states ([`crate::average`]). All random numbers are drawn from the state's generator,
//! in a fixed order. On request, the trainer also optimises gains of the images ([`crate::gains`])
//! and the response of the camera ([`crate::camera_response`]).

use std::collections::VecDeque;

use luxel_core::engine::{DensifyPlan, PlanRow, PositionNoise, StatsCollection, StepConfig};
use luxel_core::{
    Antialias, ColorSpace, Dataset, Engine, Knots, Moments, RadianceScale, RasterConfig, RenderOptions, Scene, Snapshot, StepReport, View,
    logit, spatial_order,
};
use luxel_metrics::{log_gain, log_gain_of_view};

use crate::average::Average;
use crate::camera_response::{CameraResponse, exposure_of};
use crate::config::Strategy;
use crate::contribution::{contribution, visible_splats};
use crate::densify::{adc::Adc, mcmc::Mcmc};
use crate::gains::Gains;
use crate::noise::ToneScale;
use crate::recorded::{as_radiance, curve, is_recorded, radiance_of};
use crate::state::{Start, State};
use crate::views::TrainingViews;
use crate::{Schedule, TrainConfig, TrainError, choose_radiance_scale, initialise, smoothing};

/// Factor between the greatest distance of a camera from the cameras' centroid and the scene's
/// extent (Kerbl et al. 2023).
const EXTENT_MARGIN: f64 = 1.1;
/// The default of `percent_dense` with absolute gradients (AbsGS), and below it that of 3DGS.
const PERCENT_DENSE_ABSGRAD: f32 = 0.001;
const PERCENT_DENSE: f32 = 0.01;

/// A training run.
pub struct Trainer {
    engine: Box<dyn Engine>,
    views: TrainingViews,
    color_space: ColorSpace,
    schedule: Schedule,
    state: State,
    /// The mean of the parameters over the steps so far, while it is being taken.
    average: Option<Average>,
    /// The latest steps and the names of their views.
    recent: VecDeque<(u32, String)>,
}

/// Number of steps whose views are remembered; engines work ahead by fewer steps than that.
const RECENT: usize = 16;

impl Trainer {
    /// Starts a new run.
    ///
    /// # Errors
    /// Returns a [`TrainError`] if an option is out of range, if there is nothing to train on, or
    /// if the engine refuses the scene.
    pub fn new(dataset: &Dataset, config: TrainConfig, mut engine: Box<dyn Engine>) -> Result<Self, TrainError> {
        config.validate()?;
        check_views(dataset)?;
        let response = is_recorded(&dataset.train)?.then(|| CameraResponse::new(config.unit_exposure, &dataset.train));
        let radiance = response.as_ref().map(|response| as_radiance(dataset, &response.knots()));
        let start = radiance.as_ref().unwrap_or(dataset);
        let radiance_scale = match config.radiance_scale {
            Some(scale) => RadianceScale::try_from(scale).map_err(|e| TrainError::config("radiance-scale", e.to_string()))?,
            None => choose_radiance_scale(&start.train, config.scale_rule)?,
        };
        let initial = initialise(start, &config, radiance_scale)?;
        drop(radiance);
        let splats = initial.select(spatial_order(&initial.position));
        let extent = scene_extent(&dataset.train, &splats.position);
        engine.load(&splats, None)?;
        tracing::info!(
            splats = splats.len(),
            radiance_scale = radiance_scale.get(),
            extent,
            model = config.color_model().name(),
            "initialised"
        );
        let state = State::new(dataset, Start { config, extent, radiance_scale, response });
        let mut trainer = Self::assemble(dataset, (state, None), engine);
        trainer.warn_of_average();
        if trainer.state.config.antialias == Antialias::Mip {
            trainer.update_smoothing()?;
        }
        Ok(trainer)
    }

    /// Resumes the run that `snapshot` was taken of, with the configuration of that run.
    ///
    /// # Errors
    /// Returns a [`TrainError`] if the snapshot belongs to another data set or is damaged, or if
    /// the engine refuses it.
    pub fn resume(dataset: &Dataset, snapshot: Snapshot, mut engine: Box<dyn Engine>) -> Result<Self, TrainError> {
        check_views(dataset)?;
        let state = State::of_snapshot(&snapshot, dataset)?;
        let Snapshot { scene, moments, stats, average, .. } = snapshot;
        let parts = [("scene", &scene.splats), ("first moments", &moments.first), ("second moments", &moments.second)];
        for (what, splats) in parts.into_iter().chain(average.iter().map(|average| ("average", average))) {
            splats.validate().map_err(|source| TrainError::Checkpoint { what, source })?;
        }
        if average.as_ref().is_some_and(|average| [average.len(), average.sh.len()] != [scene.splats.len(), scene.splats.sh.len()]) {
            return Err(TrainError::State("the average of the parameters is of other splats than the scene's".to_owned()));
        }
        engine.load(&scene.splats, Some(&moments))?;
        engine.set_densify_stats(&stats)?;
        let average = average.map(|mean| Average::new(mean, state.averaged));
        Ok(Self::assemble(dataset, (state, average), engine))
    }

    fn assemble(dataset: &Dataset, (state, average): (State, Option<Average>), engine: Box<dyn Engine>) -> Self {
        let config = &state.config;
        let schedule = Schedule::new(config, state.planned_iterations, state.extent);
        let side_px = dataset.train.iter().flat_map(|view| view.camera.size_px).min().unwrap_or(1);
        let stages = config.resolution_schedule.stages(state.planned_iterations, config.densify_interval, side_px);
        let tone = ToneScale { radiance_scale: state.radiance_scale, mu: config.mu };
        let views = TrainingViews::new(&dataset.train, stages, config.noise_model, tone);
        Self { engine, views, color_space: dataset.color_space, schedule, state, average, recent: VecDeque::new() }
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

    /// Returns the factor by which the sides of the next step's images are reduced; 1 is full
    /// resolution.
    pub fn downscale(&self) -> u32 {
        self.views.factor(self.state.iteration.saturating_add(1))
    }

    /// Returns whether all steps are done.
    pub fn is_finished(&self) -> bool {
        self.state.iteration >= self.state.config.iterations
    }

    /// Returns the number of splats.
    pub fn splats_len(&self) -> usize {
        self.engine.len()
    }

    /// Returns the radiance of one normalised unit, in the units of the data set.
    pub fn radiance_scale(&self) -> RadianceScale {
        self.state.radiance_scale
    }

    /// Returns the engine, for renders and timings.
    pub fn engine(&mut self) -> &mut dyn Engine {
        &mut *self.engine
    }

    /// Returns the options to render the current scene with.
    pub fn render_options(&self) -> RenderOptions {
        self.render_options_of(self.state.iteration)
    }

    fn render_options_of(&self, step: u32) -> RenderOptions {
        let config = &self.state.config;
        RenderOptions {
            raster: RasterConfig { samples: self.schedule.samples(step), ..config.raster() },
            background: self.state.radiance_scale.normalised(config.background),
            active_degree: self.schedule.active_degree(step, config.color_model().max_degree()),
        }
    }

    /// Sets the step after which the run ends. The schedule (decay of learning rates,
    /// densification, degrees) stays as planned at the start, so a run that is made longer goes
    /// through the same steps first. Beyond the planned end, learning rates keep their final
    /// values. To stretch the schedule itself, start a new run.
    ///
    /// The steps that are averaged move with the end. If the mean is already complete, it is the
    /// scene, and a longer run continues from it. If the mean is still being taken, it continues if
    /// the next step is among those that are averaged now; otherwise that step drops it. If
    /// the new end is the current step, call [`Self::settle`] to make the mean the scene.
    pub fn set_iterations(&mut self, iterations: u32) {
        self.state.config.iterations = iterations.max(1);
        self.schedule = Schedule::new(&self.state.config, self.state.planned_iterations, self.schedule.extent);
        self.warn_of_average();
    }

    /// Warns if an average is requested but densification leaves no steps for it.
    fn warn_of_average(&self) {
        let (config, schedule) = (&self.state.config, &self.schedule);
        if config.average_share > 0.0 && schedule.densifies_to_the_end() {
            tracing::warn!(
                densify_until = schedule.densify_until,
                iterations = schedule.end,
                average_share = config.average_share,
                "nothing is averaged: splats are added and removed up to the last step; lower densify_until, or set average_share to 0"
            );
        }
    }

    /// Performs one step of training, with densification when it is due.
    ///
    /// # Errors
    /// Returns [`TrainError::NotFinite`] if the loss diverged, [`TrainError::AllPruned`] if no
    /// splat is left, or the error of the engine.
    pub fn step(&mut self) -> Result<StepReport, TrainError> {
        let step = self.state.iteration.saturating_add(1);
        let index = self.state.next_view();
        let mut config = self.step_config(step);
        let gain = self.gain(index);
        let (view, target_scale) = self.views.at(step, index, gain).ok_or(TrainError::NoTrainViews)?;
        config.loss.target_scale = target_scale;
        if let Some(response) = &self.state.response {
            let curve = curve(view, &response.knots(), self.state.radiance_scale, gain);
            config.loss.curve = curve.unwrap_or(config.loss.curve);
        }
        let report = self.engine.train_step(view, &config)?;
        if self.recent.len() == RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back((step, view.name.clone()));
        if !report.loss.is_finite() {
            // The engine may work ahead, so the report can be about an earlier step.
            let of_report = self.recent.iter().find(|(step, _)| *step == report.step).or(self.recent.back());
            let (step, view) = of_report.cloned().unwrap_or((step, String::new()));
            return Err(TrainError::NotFinite { step, view });
        }
        if let (Some(response), Some(by_knots)) = (&mut self.state.response, &report.by_knots) {
            response.update(by_knots, f64::from(step) / f64::from(self.state.planned_iterations.max(1)));
        }
        self.measure_gain(step, index)?;
        self.densify(step)?;
        self.average(step)?;
        self.state.iteration = step;
        Ok(report)
    }

    /// Returns the gain of training view `index`.
    fn gain(&self, index: usize) -> [f32; 3] {
        self.state.gains.as_ref().map_or([1.0; 3], |gains| gains.of(index))
    }

    /// Updates the gain of view `index`, unless it is not due after `step` or opacities are still
    /// recovering from a reset.
    fn measure_gain(&mut self, step: u32, index: usize) -> Result<(), TrainError> {
        if self.schedule.is_recovering(step) {
            return Ok(());
        }
        let Some(channels) = self.state.config.exposure_compensation.gain_channels() else { return Ok(()) };
        let (options, gain) = (self.render_options_of(step), self.gain(index));
        let Some(gains) = self.state.gains.as_mut().filter(|gains| gains.measures_after(step)) else { return Ok(()) };
        let Some((view, target_scale)) = self.views.at(step, index, gain) else { return Ok(()) };
        let render = self.engine.render(&view.camera, &options)?;
        let found = match (&self.state.response, exposure_of(view)) {
            (Some(response), Some(exposure_s)) => {
                let knots = response.knots();
                let exposure = self.state.radiance_scale.exposure(1.0, gain);
                let radiance = |i: usize, c: usize| {
                    let value = view.image.pixels.get(i).filter(|_| view.is_valid(i))?[c];
                    Some(radiance_of(value, c, &knots, exposure_s)? / exposure[c])
                };
                log_gain(&render, radiance, channels)
            }
            _ => log_gain_of_view(&render, view, target_scale, channels),
        };
        if let Some(found) = found {
            gains.shift(index, found);
        }
        Ok(())
    }

    /// Returns ln gain of every training view by channel, in the order of the views, or `None` if
    /// gains are not optimised.
    pub fn log_gains(&self) -> Option<&[[f32; 3]]> {
        self.state.gains.as_ref().map(Gains::logs)
    }

    /// Returns the response of the camera that captured the training images, or `None` if the
    /// images are radiance.
    pub fn response(&self) -> Option<Knots> {
        self.state.response.as_ref().map(CameraResponse::knots)
    }

    fn step_config(&self, step: u32) -> StepConfig {
        let config = &self.state.config;
        let learning_rates = self.schedule.learning_rates(config, step);
        let is_mcmc = config.strategy == Strategy::Mcmc;
        let noise = PositionNoise { scale: config.mcmc_noise * learning_rates.position, seed: self.state.noise_seed(step) };
        StepConfig {
            step,
            render: self.render_options_of(step),
            loss: config.loss(),
            learning_rates,
            position_noise: is_mcmc.then_some(noise),
            stats: self.stats_of(step),
        }
    }

    fn stats_of(&self, step: u32) -> StatsCollection {
        let config = &self.state.config;
        match config.strategy {
            Strategy::Adc if !self.schedule.is_densifying(step) => StatsCollection::Off,
            Strategy::Adc if config.absgrad => StatsCollection::GradientsAndAbsolute,
            Strategy::Adc => StatsCollection::Gradients,
            Strategy::Mcmc => StatsCollection::Off,
        }
    }

    /// Applies everything that is due after `step`: a round of densification, pruning of unseen
    /// splats, a cap on opacities, the smoothing filter.
    fn densify(&mut self, step: u32) -> Result<(), TrainError> {
        let is_round = self.schedule.densifies_after(step);
        let cap = self.schedule.opacity_cap_after(step);
        let unseen = self.unseen_after(step);
        if is_round || unseen.is_some() || cap.is_some() {
            let before = self.engine.len();
            let mut rows = if is_round { self.plan_round(step)? } else { all_rows(before) };
            if let Some(part) = unseen {
                let options = self.render_options_of(step);
                let is_visible = visible_splats(&mut *self.engine, &mut self.views, (step, part), &options)?;
                rows.retain(|row| is_visible.get(row.source as usize).is_some_and(|visible| *visible));
            }
            if rows.is_empty() {
                return Err(TrainError::AllPruned { step });
            }
            tracing::debug!(step, before, after = rows.len(), opacity_cap = cap, "densified");
            self.engine.densify(&DensifyPlan { rows, opacity_logit_cap: cap.map(logit), smoothing: None })?;
        }
        let is_mip = self.state.config.antialias == Antialias::Mip;
        if is_mip && (is_round || self.schedule.smooths_after(step)) {
            self.update_smoothing()?;
        }
        Ok(())
    }

    /// Returns the fraction of the views' pixels below which splats are pruned as unseen, if that
    /// is due after `step`.
    fn unseen_after(&self, step: u32) -> Option<f32> {
        let (part, strategy) = (self.state.config.prune_unseen, self.state.config.strategy);
        (part > 0.0 && strategy == Strategy::Adc && self.schedule.stops_adding_after(step)).then_some(part)
    }

    /// Adds the parameters after `step` to their mean where that is due. After the last such step,
    /// the mean becomes the scene.
    fn average(&mut self, step: u32) -> Result<(), TrainError> {
        if !self.schedule.is_averaging(step) {
            // These steps are no longer among the last ones, because the end was moved.
            self.average = None;
        }
        if self.schedule.averages_after(step) {
            let (splats, moments) = self.engine.save()?;
            match &mut self.average {
                Some(average) => average.add(splats),
                None => self.average = Some(Average::new(splats, 1)),
            }
            if step == self.schedule.end {
                self.load_average(&moments)?;
            }
        }
        self.state.averaged = self.average.as_ref().map_or(0, Average::count);
        Ok(())
    }

    /// Replaces the scene by the mean, if there is one. Adam's `moments` stay, so that a longer run
    /// can continue from there.
    fn load_average(&mut self, moments: &Moments) -> Result<(), TrainError> {
        if let Some(average) = self.average.take() {
            self.engine.load(average.mean(), Some(moments))?;
        }
        self.state.averaged = 0;
        Ok(())
    }

    /// Replaces the scene by the mean taken so far, if the run ends at the current step, as it can
    /// after [`Self::set_iterations`]. Returns whether there was such a mean.
    ///
    /// # Errors
    /// Returns [`TrainError::Engine`] if the engine fails.
    pub fn settle(&mut self) -> Result<bool, TrainError> {
        let is_due = self.average.is_some() && self.schedule.is_averaging(self.state.iteration) && self.is_finished();
        if is_due {
            let (_, moments) = self.engine.save()?;
            self.load_average(&moments)?;
        }
        Ok(is_due)
    }

    /// Returns the rows of the scene after a round of densification, in spatial order.
    fn plan_round(&mut self, step: u32) -> Result<Vec<PlanRow>, TrainError> {
        let geometry = self.engine.geometry()?;
        let config = &self.state.config;
        let max_splats = config.splat_limit(self.views.train_px());
        let rows = match config.strategy {
            Strategy::Adc => {
                let percent = config.percent_dense.unwrap_or(if config.absgrad { PERCENT_DENSE_ABSGRAD } else { PERCENT_DENSE });
                let extent = self.state.extent;
                let policy = Adc {
                    gradient_threshold: config.densify_threshold,
                    absgrad_threshold: config.absgrad.then_some(config.absgrad_threshold),
                    dense_scale: percent * extent,
                    prune_opacity: config.prune_opacity,
                    prune_scale: (config.prune_scale > 0.0 && self.schedule.has_reset_before(step)).then_some(config.prune_scale * extent),
                    max_splats,
                    max_replaced: (config.turnover * max_splats as f32) as usize,
                };
                let (stats, options) = (self.engine.densify_stats()?, self.render_options_of(step));
                let at = (step, step / self.schedule.densify_interval);
                let contribution = || contribution(&mut *self.engine, &mut self.views, at, &options);
                policy.plan((&stats, &geometry), contribution, &mut self.state.rng)?
            }
            Strategy::Mcmc => {
                let policy = Mcmc { dead_opacity: config.prune_opacity, growth: config.mcmc_growth, max_splats };
                policy.plan(&geometry, &mut self.state.rng)
            }
        };
        let positions: Vec<[f32; 3]> = rows.iter().filter_map(|row| geometry.position.get(row.source as usize).copied()).collect();
        Ok(spatial_order(&positions).into_iter().filter_map(|i| rows.get(i as usize).copied()).collect())
    }

    fn update_smoothing(&mut self) -> Result<(), TrainError> {
        let positions = self.engine.geometry()?.position;
        let filter = smoothing(&positions, &self.views.cameras(), self.state.config.raster().cutoffs.near);
        let plan = DensifyPlan { rows: all_rows(positions.len()), opacity_logit_cap: None, smoothing: Some(filter) };
        Ok(self.engine.densify(&plan)?)
    }

    /// Returns the current scene.
    ///
    /// # Errors
    /// Returns [`TrainError::Engine`] if the engine fails.
    pub fn scene(&mut self) -> Result<Scene, TrainError> {
        Ok(self.scene_and_moments()?.0)
    }

    /// Returns everything needed to resume from here bit for bit.
    ///
    /// # Errors
    /// Returns [`TrainError::Engine`] if the engine fails.
    pub fn snapshot(&mut self) -> Result<Snapshot, TrainError> {
        let (scene, moments) = self.scene_and_moments()?;
        let average = self.average.as_ref().map(|average| average.mean().clone());
        Ok(Snapshot { scene, moments, stats: self.engine.densify_stats()?, average, state_json: self.state.to_json()? })
    }

    fn scene_and_moments(&mut self) -> Result<(Scene, Moments), TrainError> {
        let (splats, moments) = self.engine.save()?;
        let raster = self.render_options().raster;
        let (radiance_scale, color_space) = (self.state.radiance_scale, self.color_space);
        Ok((Scene { splats, radiance_scale, color_space, raster, edits: Vec::new() }, moments))
    }
}

fn all_rows(count: usize) -> Vec<PlanRow> {
    (0u32..).take(count).map(PlanRow::keep).collect()
}

/// Checks the properties of views that every step relies on.
fn check_views(dataset: &Dataset) -> Result<(), TrainError> {
    if dataset.train.is_empty() {
        return Err(TrainError::NoTrainViews);
    }
    dataset.train.iter().try_for_each(View::validate)?;
    Ok(())
}

/// Returns the size of the scene, world units: the spread of the cameras (Kerbl et al. 2023) or the
/// median distance of the splats from the cameras' centroid, whichever is larger.
///
/// Cameras around a scene are about as far apart as they are from it. For cameras side by side,
/// their spread underestimates the scene, and pruning by it would remove the walls.
fn scene_extent(train: &[View], positions: &[[f32; 3]]) -> f32 {
    let centroid = train.iter().map(|view| view.camera.eye()).sum::<glam::DVec3>() / train.len().max(1) as f64;
    let radius = train.iter().map(|view| (view.camera.eye() - centroid).length()).fold(0.0, f64::max);
    let mut distances: Vec<f64> =
        positions.iter().map(|[x, y, z]| (glam::DVec3::new((*x).into(), (*y).into(), (*z).into()) - centroid).length()).collect();
    let at = distances.len() / 2;
    let typical = if distances.is_empty() { 1.0 } else { *distances.select_nth_unstable_by(at, f64::total_cmp).1 };
    let extent = (EXTENT_MARGIN * radius).max(typical) as f32;
    if extent.is_finite() && extent > f32::MIN_POSITIVE { extent } else { 1.0 }
}
