//! Training of a field, one step at a time.
//!
//! In: a data set's training views, in memory; options. Out: a [`Field`] in normalised units.
//!
//! A step draws pixels of all views, marches their rays through the occupied cells, evaluates the
//! networks at the samples, renders, compares by the [`Objective`], and goes back. As many rays are
//! drawn as gave [`SAMPLES_PER_STEP`] samples at the density of the last step. All random numbers
//! are hashes of (seed, step, index), so that a resumed training needs no generator.
//!
//! Determinism: a step's rays are divided into [`TASKS`] parts whatever the number of threads. A
//! part sums the gradient of the networks' weights by itself, and the parts are added in their
//! order. The gradient of a level of the grid is summed by one thread, sample by sample.

use std::sync::{Mutex, PoisonError};

use glam::DVec2;
use luxel_core::{Dataset, Engine, PixelValues};
use luxel_lanes::Level;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::field::adam::{Moving, Rate};
use crate::field::engine::FieldEngine;
use crate::field::error::FieldError;
use crate::field::head::MAX_CHANNELS;
use crate::field::loss::PixelLoss;
use crate::field::objective::Objective;
use crate::field::options::FieldConfig;
use crate::field::radiance_field::{Field, FieldArrays, FieldShape};
use crate::field::raw::RAW;
use crate::field::sampling::TrainingRay;
use crate::field::task::{StepContext, TASKS, Task, TaskRoom};
use crate::field::threads::start_threads;
use crate::field::trunk::FieldNetwork;
use crate::field::views::TrainingViews;
use luxel_core::random;

/// Samples that a step aims at.
const SAMPLES_PER_STEP: usize = 1 << 16;
/// Rays of the first step.
const FIRST_RAYS: usize = 256;
/// Least and greatest number of rays of a step.
const RAYS: [usize; 2] = [64, 1 << 15];
/// Learning rate at its highest, of a hash grid and its networks.
const LEARNING_RATE: f32 = 1e-2;
/// Learning rate at its highest of a network without a grid, and of the networks of heads, as
/// NeRF, HDR-NeRF and Mono-HDR-NeRF have it.
const NETWORK_RATE: f32 = 5e-4;
/// Steps over which the learning rate rises.
const WARM_UP: u32 = 100;
/// Parts of the run after each of which the learning rate is multiplied by [`DECAY`].
const MILESTONES: [f64; 3] = [0.5, 0.75, 0.9];
const DECAY: f32 = 0.33;
/// Weight of the distortion loss: what a ray meets is in one place. With few views in a room, light
/// that floats before the cameras is the main risk.
const DISTORTION_WEIGHT: f32 = 1e-3;
/// Steps between updates of the occupancy grid.
const OCCUPANCY_EVERY: u32 = 16;
/// Steps until which an update looks at all cells.
const OCCUPANCY_ALL_UNTIL: u32 = 256;

/// Numbers of one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FieldStep {
    /// Mean loss of the step's rays, without the regularisers.
    pub loss: f32,
    /// Rays.
    pub rays: usize,
    /// Samples on them.
    pub samples: usize,
}

/// Everything that is needed to continue a training bit for bit.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldSnapshot {
    /// The shape and the place of the field.
    pub shape: FieldShape,
    /// Its arrays.
    pub arrays: FieldArrays,
    /// Adam's running means of the gradient: those of the table, then those of the weights.
    pub first: Vec<f32>,
    /// Adam's running means of its square, in the same order.
    pub second: Vec<f32>,
    /// Everything else.
    pub state: FieldState,
}

/// The scalars of a training's state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldState {
    /// Options.
    pub options: FieldConfig,
    /// Steps that the learning rates were planned for.
    pub planned: u32,
    /// Steps made so far.
    pub step: u32,
    /// Rays of the next step.
    pub rays: usize,
}

/// The training of a field.
pub struct FieldTrainer {
    /// The field, and the threads of steps and renders.
    renderer: FieldEngine,
    state: FieldState,
    views: TrainingViews,
    moments: Moments,
    gradient: Vec<f32>,
    tasks: Vec<Task>,
    /// Memory for tasks, one for each that ran at the same time.
    rooms: Mutex<Vec<TaskRoom>>,
    level: Level,
}

/// Adam's running means: those of the table, then those of the networks' weights.
struct Moments {
    first: Vec<f32>,
    second: Vec<f32>,
}

impl FieldTrainer {
    /// Starts a training. 0 threads are as many as the machine has cores.
    ///
    /// # Errors
    /// A data set without training views or valid pixels; an image that cannot be read; threads
    /// that the system refuses.
    pub fn new(dataset: &Dataset, options: FieldConfig, threads: usize) -> Result<Self, FieldError> {
        let pool = start_threads(threads)?;
        let views = TrainingViews::load(dataset, options.objective)?;
        let field = pool.install(|| Field::initial(dataset, &options));
        let count = field.parameter_count();
        let state = FieldState { options, planned: options.iterations, step: 0, rays: FIRST_RAYS };
        Ok(Self::assemble(field, state, views, Moments { first: vec![0.0; count], second: vec![0.0; count] }, pool))
    }

    /// Continues a training.
    ///
    /// # Errors
    /// As [`Self::new`]; [`FieldError::Arrays`] for a snapshot that is none.
    pub fn resume(dataset: &Dataset, snapshot: FieldSnapshot, threads: usize) -> Result<Self, FieldError> {
        let pool = start_threads(threads)?;
        let FieldSnapshot { shape, arrays, first, second, state } = snapshot;
        let views = TrainingViews::load(dataset, state.options.objective)?;
        let field = Field::from_arrays(shape, arrays)?;
        if shape.head != state.options.objective.head() || shape.network != state.options.network {
            return Err(FieldError::Arrays(format!("{:?}, {:?} for {:?}", shape.network, shape.head, state.options)));
        }
        for moments in [&first, &second] {
            if moments.len() != field.parameter_count() || moments.iter().any(|value| !value.is_finite()) {
                let expected = field.parameter_count();
                return Err(FieldError::Arrays(format!("{} moments, expected {expected} finite ones", moments.len())));
            }
        }
        if !(RAYS[0]..=RAYS[1]).contains(&state.rays) {
            return Err(FieldError::Arrays(format!("{} rays a step, expected {} to {}", state.rays, RAYS[0], RAYS[1])));
        }
        Ok(Self::assemble(field, state, views, Moments { first, second }, pool))
    }

    fn assemble(field: Field, state: FieldState, views: TrainingViews, moments: Moments, threads: rayon::ThreadPool) -> Self {
        let mut tasks = Vec::new();
        tasks.resize_with(TASKS, Task::default);
        let gradient = vec![0.0; field.table.len()];
        let renderer = FieldEngine { field, threads };
        Self { renderer, state, views, moments, gradient, tasks, rooms: Mutex::default(), level: Level::best() }
    }

    /// Returns the field as it stands.
    pub fn field(&self) -> &Field {
        &self.renderer.field
    }

    /// Returns an engine that renders the field as it stands.
    pub fn engine(&mut self) -> &mut dyn Engine {
        &mut self.renderer
    }

    /// Returns the scalars of the state.
    pub fn state(&self) -> &FieldState {
        &self.state
    }

    /// Returns the number of threads.
    pub fn threads(&self) -> usize {
        self.renderer.threads.current_num_threads()
    }

    /// Runs `work` on the training's threads.
    pub fn install<R: Send>(&self, work: impl FnOnce(&Field) -> R + Send) -> R {
        self.renderer.threads.install(|| work(&self.renderer.field))
    }

    /// Returns whether all steps are made.
    pub fn is_finished(&self) -> bool {
        self.state.step >= self.state.options.iterations
    }

    /// Sets the step after which the training ends. Learning rates stay as planned at the start.
    pub fn set_iterations(&mut self, iterations: u32) {
        self.state.options.iterations = iterations.max(1);
    }

    /// Returns everything that is needed to continue.
    pub fn snapshot(&self) -> FieldSnapshot {
        FieldSnapshot {
            shape: self.field().shape(),
            arrays: self.field().arrays(),
            first: self.moments.first.clone(),
            second: self.moments.second.clone(),
            state: self.state,
        }
    }

    /// Makes one step.
    ///
    /// # Errors
    /// [`FieldError::NotFinite`] if the loss is not a number.
    pub fn step(&mut self) -> Result<FieldStep, FieldError> {
        let step = self.state.step.saturating_add(1);
        let seed = random::bits(self.state.options.seed, u64::from(step));
        let rays = self.draw(seed);
        let (count, per_task) = (rays.len().max(1), rays.len().div_ceil(TASKS).max(1));
        let FieldEngine { field, threads } = &self.renderer;
        let networks = &field.networks;
        let lifts = networks.head.lifts(networks.of_head(&field.weights));
        let context = StepContext {
            field,
            options: &self.state.options,
            lifts: lifts.as_ref(),
            share: (count as f32).recip(),
            distortion_weight: DISTORTION_WEIGHT,
        };
        let (level, tasks, rooms) = (self.level, &mut self.tasks, &self.rooms);
        threads.install(|| {
            tasks.par_iter_mut().enumerate().for_each(|(part, task)| {
                let rays = rays.chunks(per_task).nth(part).unwrap_or(&[]);
                let mut room = lock(rooms).pop().unwrap_or_default();
                luxel_lanes::dispatch!(level, simd => task.run(simd, context, rays, &mut room));
                lock(rooms).push(room);
            });
        });
        let samples: usize = self.tasks.iter().map(|task| task.samples.len()).sum();
        let loss = (self.tasks.iter().map(|task| task.loss).sum::<f64>() / count as f64) as f32;
        if !loss.is_finite() {
            return Err(FieldError::NotFinite { step });
        }
        self.update(step);
        if step.is_multiple_of(OCCUPANCY_EVERY) {
            let (FieldEngine { field, threads }, all) = (&mut self.renderer, step <= OCCUPANCY_ALL_UNTIL);
            threads.install(|| field.update_occupancy(level, !seed, all));
        }
        let next = (count * SAMPLES_PER_STEP / samples.max(1)).clamp(RAYS[0], RAYS[1]);
        self.state.rays = next;
        self.state.step = step;
        Ok(FieldStep { loss, rays: rays.len(), samples })
    }

    /// Returns a learning rate at a step.
    fn rate(&self, highest: f32, step: u32) -> Rate {
        let part = f64::from(step) / f64::from(self.state.planned.max(1));
        let passed = MILESTONES.iter().filter(|milestone| part > **milestone).count();
        let warm = (step as f32 / WARM_UP as f32).min(1.0);
        Rate::new(highest * warm * DECAY.powi(passed as i32), step)
    }

    /// Draws the rays of a step.
    fn draw(&self, seed: u64) -> Vec<TrainingRay> {
        let (space, scale) = (self.field().shape().space, self.state.options.radiance_scale);
        let draw = |index: usize| {
            let (training, pixel) = self.views.pixel(random::bits(seed, 2 * index as u64))?;
            let view = &training.view;
            let width = view.camera.size_px[0] as usize;
            let ray = space.ray(&view.camera, DVec2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5))?;
            let weight = luxel_core::mask::weight(view.mask.as_deref(), pixel);
            let shift = random::uniform(seed, 2 * index as u64 + 1);
            let drawn = TrainingRay { ray, shift, weight, background: self.behind(seed, index as u64), ..TrainingRay::default() };
            let value = view.image.pixels[pixel];
            Some(match (view.values, &training.captured) {
                (PixelValues::Recorded { exposure_s }, _) => {
                    TrainingRay { captured: value, log_exposure: scale.exposure(exposure_s, [1.0; 3])[0].ln(), ..drawn }
                }
                (PixelValues::Radiance, None) => TrainingRay { radiance: scale.normalised(value), ..drawn },
                (PixelValues::Radiance, Some(beside)) => TrainingRay {
                    radiance: scale.normalised(value),
                    captured: beside.image.pixels[pixel],
                    captured_weight: luxel_core::mask::weight(beside.mask.as_deref(), pixel),
                    ..drawn
                },
            })
        };
        self.renderer.threads.install(|| (0..self.state.rays).into_par_iter().filter_map(draw).collect())
    }

    /// Draws the channels behind a ray. They differ from step to step, so that only an opaque field
    /// explains the images.
    fn behind(&self, seed: u64, ray: u64) -> [f32; MAX_CHANNELS] {
        let FieldConfig { objective, mu, .. } = self.state.options;
        let value = |c: u64| random::uniform(!seed, 3 * ray + c);
        let mut channels = [0.0; MAX_CHANNELS];
        for (channel, c) in channels.iter_mut().zip(0..RAW as u64) {
            *channel = match objective {
                Objective::Radiance { loss: PixelLoss::Linear } => value(c),
                _ => (value(c) * mu.ln_1p()).exp_m1() / mu,
            };
        }
        // From a stream of their own: radiance behind a ray must not tell its captured value.
        for (channel, c) in channels[RAW..].iter_mut().zip(0..RAW as u64) {
            *channel = random::uniform(seed.rotate_left(32), 3 * ray + c);
        }
        channels
    }

    /// Moves all parameters against the gradient of the tasks.
    fn update(&mut self, step: u32) {
        let of_field = match self.state.options.network {
            FieldNetwork::Grid(_) => LEARNING_RATE,
            FieldNetwork::Layers { .. } => NETWORK_RATE,
        };
        let (rate, of_head) = (self.rate(of_field, step), self.rate(NETWORK_RATE, step));
        let objective = self.state.options.objective;
        let Self { renderer: FieldEngine { field, threads }, moments: Moments { first, second }, gradient, tasks, level, .. } = self;
        let (level, table_len) = (*level, field.table.len());
        let (grid, tasks) = (&field.grid, &*tasks);
        let (first, first_weights) = first.split_at_mut(table_len);
        let (second, second_weights) = second.split_at_mut(table_len);
        let mut parts = Vec::with_capacity(grid.levels());
        let (mut rest, mut rest_first, mut rest_second, mut rest_gradient) = (&mut field.table[..], first, second, &mut gradient[..]);
        for number in 0..grid.levels() {
            let count = grid.numbers(number).len();
            let (parameters, a) = rest.split_at_mut(count);
            let (first, b) = rest_first.split_at_mut(count);
            let (second, c) = rest_second.split_at_mut(count);
            let (gradient, d) = rest_gradient.split_at_mut(count);
            (rest, rest_first, rest_second, rest_gradient) = (a, b, c, d);
            parts.push((number, Moving { parameters, first, second }, gradient));
        }
        threads.install(|| {
            parts.into_par_iter().with_max_len(1).for_each(|(number, moving, gradient)| {
                gradient.fill(0.0);
                luxel_lanes::dispatch!(level, simd => {
                    for task in tasks {
                        grid.scatter(simd, number, &task.samples.positions, &task.by_features, gradient);
                    }
                    rate.update(simd, moving, gradient);
                });
            });
        });
        let mut sum = vec![0.0; field.weights.len()];
        for task in tasks {
            sum.iter_mut().zip(&task.gradient).for_each(|(sum, value)| *sum += value);
        }
        let split = field.networks.before_head();
        if let Objective::Captured { unit_value } = objective {
            field.networks.head.unit_loss(&field.weights[split..], unit_value, &mut sum[split..]);
        }
        let (parameters, head) = field.weights.split_at_mut(split);
        let (first, first_head) = first_weights.split_at_mut(split);
        let (second, second_head) = second_weights.split_at_mut(split);
        let (sum, sum_head) = sum.split_at(split);
        let moving = Moving { parameters, first, second };
        luxel_lanes::dispatch!(level, simd => rate.update(simd, moving, sum));
        let moving = Moving { parameters: head, first: first_head, second: second_head };
        luxel_lanes::dispatch!(level, simd => of_head.update(simd, moving, sum_head));
    }
}

/// Locks the memory for tasks. A task that panicked leaves none behind.
fn lock(rooms: &Mutex<Vec<TaskRoom>>) -> std::sync::MutexGuard<'_, Vec<TaskRoom>> {
    rooms.lock().unwrap_or_else(PoisonError::into_inner)
}
