//! The training loop, one step at a time.
//!
//! In: a data set, a configuration, an engine. Out: a scene in normalised units.
//!
//! Each step takes the next view of a shuffled epoch, or a batch of views, and updates all
//! parameters; the processes of a distributed run share a batch out. Where the schedule
//! asks for it, the step also adds and removes splats. At the end, the scene becomes the mean of
//! its last states ([`crate::average`]). All random numbers are drawn from the state's generator,
//! in a fixed order. On request, the trainer also optimises gains of the images ([`crate::gains`])
//! and the response of the camera ([`crate::camera_response`]).

mod aspect;
mod average;
mod batch;
mod densify;
mod fit;
mod health;
mod method;
mod plan;
mod poses;
mod saved;
mod scene_start;
mod start;
mod vignetting;

pub(crate) use self::batch::{SlotView, view_of};
pub use self::method::{lifted_engine, snapshot_scene};
pub use self::saved::RunState;
pub(crate) use self::start::{check_views, scene_extent};

use std::collections::VecDeque;

use luxel_core::engine::{Dropout, PositionNoise, StepConfig};
use luxel_core::{
    ColorSpace, Engine, Exchange, Knots, RadianceScale, RasterConfig, RenderOptions, Scene, Similarity, Snapshot, Splats, StepReport,
};

use self::batch::rates_of_batch;
use crate::average::Average;
use crate::config::Strategy;
use crate::gains::Gains;
use crate::poses::Poses;
use crate::reduce::BatchMean;
use crate::state::State;
use crate::step_method::StepMethod;
use crate::validation_views::ValidationView;
use crate::views::TrainingViews;
use crate::vignetting::Lenses;
use crate::{Schedule, TrainConfig, TrainError, resolution};

/// A training run.
pub struct Trainer {
    engine: Box<dyn Engine>,
    views: TrainingViews,
    color_space: ColorSpace,
    world_from_local: Similarity,
    metres_per_unit: Option<f64>,
    schedule: Schedule,
    state: State,
    /// The mean of the parameters over the steps so far, while it is being taken.
    average: Option<Average>,
    /// The latest steps and the names of their views.
    recent: VecDeque<(u32, String)>,
    visibility: health::Visibility,
    /// The poses that corrections apply to, if poses are optimised.
    poses: Option<Poses>,
    /// The lenses of the views, if their vignetting is optimised.
    lenses: Option<Lenses>,
    /// The method, if it has a step of its own.
    method: Option<Box<dyn StepMethod>>,
    /// The validation views while splats are added.
    validation: Vec<ValidationView>,
    /// The connection to the other ranks of a distributed run.
    exchange: Box<dyn Exchange>,
    batch_mean: BatchMean,
    /// The views of the current step, one a slot of the batch.
    step_views: Vec<usize>,
    /// Whether this rank is to stop, and whether any rank was at the last step.
    wants_to_stop: bool,
    is_asked_to_stop: bool,
}

/// Returns the report of a step from those of its views: mean loss, most visible splats.
fn batch_report(reports: &[StepReport]) -> StepReport {
    let [report] = reports else {
        let mean = |value: fn(&StepReport) -> f32| {
            (reports.iter().map(|report| f64::from(value(report))).sum::<f64>() / reports.len().max(1) as f64) as f32
        };
        return StepReport {
            step: reports.first().map_or(0, |report| report.step),
            loss: mean(|report| report.loss),
            l1: mean(|report| report.l1),
            ssim: mean(|report| report.ssim),
            visible: reports.iter().map(|report| report.visible).max().unwrap_or(0),
            ..StepReport::default()
        };
    };
    *report
}

/// Number of views of the latest steps that are remembered; engines work ahead by fewer than that.
const RECENT: usize = 16;

impl Trainer {
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

    /// Returns the steps that are left, in steps as costly as the last `made` ones on average: the
    /// number of pixels of a step changes over a run.
    pub fn steps_left_at_pace(&self, made: u32) -> f64 {
        let (step, end) = (self.state.iteration, self.state.config.iterations);
        let work = |steps| resolution::work(self.views.stages(), steps, |step| self.schedule.samples_per_pixel(step));
        let of_made = work(step.saturating_sub(made) + 1..=step);
        if of_made > 0.0 { work(step + 1..=end) * f64::from(made.min(step)) / of_made } else { f64::from(end.saturating_sub(step)) }
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
    /// the new end is the current step, call [`Self::finish_average`] to make the mean the scene.
    ///
    /// All of these steps are made, whatever `early_end` was.
    pub fn set_iterations(&mut self, iterations: u32) {
        self.state.config.early_end = None;
        self.move_end(iterations);
    }

    fn move_end(&mut self, iterations: u32) {
        self.state.config.iterations = iterations.max(1);
        self.schedule = Schedule::new(&self.state.config, self.state.planned_iterations, self.schedule.extent);
        self.warn_of_average();
    }

    /// Performs one step of training, with densification when it is due.
    ///
    /// # Errors
    /// Returns [`TrainError::NotFinite`] if the loss diverged, [`TrainError::NotFiniteSplat`] if a
    /// parameter did (checked every 100 steps and at the end), [`TrainError::AllPruned`] if no
    /// splat is left, or the error of the engine.
    pub fn step(&mut self) -> Result<StepReport, TrainError> {
        let step = self.state.iteration.saturating_add(1);
        self.step_views = self.state.next_views(&self.validation_in(step));
        let config = self.step_config(step);
        let views: Vec<SlotView> = self.step_views.iter().enumerate().map(|(slot, index)| SlotView { step, slot, index: *index }).collect();
        let reports = self.train_on(&views, &config)?;
        for of in &views {
            if self.recent.len() == RECENT {
                self.recent.pop_front();
            }
            self.recent.push_back((step, self.views.name(of.index).to_owned()));
        }
        let report = batch_report(&reports);
        if !report.loss.is_finite() {
            // The engine may work ahead, so the report can be about an earlier step.
            let of_report = self.recent.iter().find(|(step, _)| *step == report.step).or(self.recent.back());
            let (step, view) = of_report.cloned().unwrap_or((step, String::new()));
            return Err(TrainError::NotFinite { step, view });
        }
        for (of, report) in views.iter().zip(&reports) {
            if let (Some(response), Some(by_knots)) = (&mut self.state.response, &report.by_knots) {
                response.update(by_knots, f64::from(step) / f64::from(self.state.planned_iterations.max(1)));
            }
            self.learn_vignetting(step, of.index, report);
            self.correct_pose(step, of.index, report);
        }
        self.measure_gains(&views)?;
        self.densify(step)?;
        self.average(step)?;
        self.limit_aspect(step)?;
        self.watch_visibility(step, report.visible);
        self.check_parameters(step)?;
        self.state.iteration = step;
        Ok(report)
    }

    /// Returns ln gain of every training view by channel, in the order of the views, or `None` if
    /// gains are not optimised.
    pub fn log_gains(&self) -> Option<&[[f32; 3]]> {
        self.state.gains.as_ref().map(Gains::logs)
    }

    /// Returns the response of the camera that captured the training images, or `None` if the
    /// images are radiance.
    pub fn response(&self) -> Option<Knots> {
        match &self.state.response {
            Some(response) => Some(response.knots()),
            None => self.method.as_ref()?.response(),
        }
    }

    /// Returns the transform from the coordinates of the splats to those of the data set's files.
    pub fn world_from_local(&self) -> Similarity {
        self.world_from_local
    }

    fn step_config(&self, step: u32) -> StepConfig {
        let config = &self.state.config;
        let (factor, betas) = rates_of_batch(config);
        let learning_rates = self.schedule.learning_rates(config, step).times(factor * self.rate_factor(step));
        let has_noise = config.strategy == Strategy::Mcmc && !config.freezes_geometry();
        let noise = PositionNoise { scale: config.mcmc_noise * learning_rates.position, seed: self.state.noise_seed(step) };
        StepConfig {
            step,
            render: self.render_options_of(step),
            loss: config.loss_weights(),
            learning_rates,
            betas,
            position_noise: has_noise.then_some(noise),
            dropout: self.dropout_rate(step).map(|rate| Dropout { rate, seed: self.state.dropout_seed(step) }),
            stats: self.stats_of(step),
            camera_gradient: self.camera_gradient_of(step),
        }
    }

    /// Returns the current scene. That of a method that lifts colours to radiance is without the
    /// lift, of log harmonics that come close to its colours.
    ///
    /// # Errors
    /// Returns [`TrainError::Engine`] if the engine fails.
    pub fn scene(&mut self) -> Result<Scene, TrainError> {
        let splats = self.engine.splats()?;
        let scene = self.scene_of(splats);
        Ok(match &self.method {
            None => scene,
            Some(method) => Scene { splats: method.plain_splats(scene.splats, &self.views.cameras()), ..scene },
        })
    }

    /// Returns everything needed to resume from here bit for bit.
    ///
    /// # Errors
    /// Returns [`TrainError::Engine`] if the engine fails.
    pub fn snapshot(&mut self) -> Result<Snapshot, TrainError> {
        let (splats, moments) = self.engine.save()?;
        let scene = self.scene_of(splats);
        let average = self.average.as_ref().map(|average| average.mean().clone());
        Ok(Snapshot { scene, moments, stats: self.engine.densify_stats()?, average, state_json: self.state_json()? })
    }

    /// Returns the scene of these splats.
    fn scene_of(&self, splats: Splats) -> Scene {
        let raster = self.render_options().raster;
        let (radiance_scale, color_space) = (self.state.radiance_scale, self.color_space);
        let (world_from_local, metres_per_unit) = (self.world_from_local, self.metres_per_unit);
        Scene { splats, radiance_scale, color_space, raster, edits: Vec::new(), world_from_local, metres_per_unit }
    }
}
