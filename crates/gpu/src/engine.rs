//! [`GpuEngine`]: submits steps to the device, and receives their reports later.
//!
//! In and out: see [`luxel_core::Engine`]. A step is one submission. The device counts its entries
//! (pairs of a splat and a tile).
//!
//! Degenerate: if the buffers are too small, the device halts, and this step and all later ones
//! change nothing. When the host reads the report, it enlarges the buffers and submits the same
//! steps again, so the result is the same as with buffers that were large enough from the start. A
//! loss that is not finite halts the device, too, before it changes anything.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use luxel_core::engine::{CameraGradientChoice, ParameterRows, StatsCollection, StepConfig};
use luxel_core::{Camera, ColorModel, EngineError, Pass, PassTime, RenderOptions, Splats, StepReport, View};

use crate::adapter::usable_binding;
use crate::commands::{Commands, Timer};
use crate::device::{Buffer, Gpu, render_less, use_cpu};
use crate::forward::PixelKind;
use crate::frame::{Sizes, StepBuffers, expected_entries, most_entries};
use crate::image_copy::{ImageCopy, image_bytes};
use crate::layout::{HALT_NOT_FINITE, HALT_OVERFLOW, State};
use crate::pending::{Pending, Report, Slots};
use crate::scene::{GpuScene, shard_len};
use crate::screen::{Purpose, SceneFacts, camera_uniform, check, lens_uniform, pixel_kind, supersampled, tiles};
use crate::step::{GradientOutput, Recorder, write_step};
use crate::targets::Targets;

mod batch;
mod camera;
mod contract;
mod lights;
mod retire;
mod surplus;
mod vignetting;
pub(crate) mod work;

/// The engine on a GPU. Equal inputs give equal bits on one adapter.
pub struct GpuEngine {
    gpu: Arc<Gpu>,
    /// Greatest size of a binding that the engine uses, bytes.
    binding_bytes: u64,
    /// Greatest number of splats in a shard, besides the limit of a binding.
    shard_limit: usize,
    scene: GpuScene,
    frame: StepBuffers,
    commands: Commands,
    targets: Targets,
    timer: Option<Timer>,
    pending: VecDeque<Pending>,
    slots: Slots,
    image_copy: ImageCopy,
    latest: Option<StepReport>,
    /// Step whose loss was not finite.
    diverged: Option<u32>,
    traffic: Traffic,
    timings: [PassTime; Pass::ALL.len()],
    /// Sums for the gradient by the camera, one buffer per shard; none until a step asks for it.
    camera_sums: Vec<Buffer>,
    batch: batch::BatchBuffers,
}

/// The cost of a step besides its arithmetic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Number of kernels.
    pub dispatches: usize,
    /// Number of submissions.
    pub submissions: usize,
    /// Bytes that the host reads back.
    pub bytes_read: u64,
    /// Bytes of the view's image and mask, if they had to be uploaded.
    pub image_bytes: u64,
}

/// The content of a submission.
enum Submission<'a> {
    Render { camera: &'a Camera, options: &'a RenderOptions, light: usize },
    Contributions { camera: &'a Camera, options: &'a RenderOptions, light: usize, mask: &'a Buffer, out: &'a Buffer },
    Train { view: &'a View, step: &'a StepConfig },
    Gradients { view: &'a View, step: &'a StepConfig, out: GradientOutput<'a> },
    CameraGradient { view: &'a View, step: &'a StepConfig },
}

impl<'a> Submission<'a> {
    /// Returns the view and the step of a submission with a backward pass.
    fn training(&self) -> Option<(&'a View, &'a StepConfig)> {
        match self {
            Self::Train { view, step } | Self::Gradients { view, step, .. } | Self::CameraGradient { view, step } => Some((view, step)),
            Self::Render { .. } | Self::Contributions { .. } => None,
        }
    }

    /// Returns the number of the light that is rendered.
    fn light(&self) -> usize {
        match self {
            Self::Render { light, .. } | Self::Contributions { light, .. } => *light,
            Self::Train { .. } | Self::Gradients { .. } | Self::CameraGradient { .. } => 0,
        }
    }

    /// Reports whether the gradient by the camera is computed.
    fn computes_camera(&self) -> bool {
        match self {
            Self::CameraGradient { .. } => true,
            Self::Train { step, .. } | Self::Gradients { step, .. } => Self::computes_camera_in(step),
            Self::Render { .. } | Self::Contributions { .. } => false,
        }
    }

    /// Reports whether a step asks for the gradient by its camera.
    fn computes_camera_in(step: &StepConfig) -> bool {
        step.camera_gradient == CameraGradientChoice::Compute
    }
}

impl GpuEngine {
    /// Makes an engine without a scene.
    ///
    /// # Errors
    /// [`EngineError::Device`] if the device has too little memory or fails.
    pub fn new(gpu: &Arc<Gpu>) -> Result<Self, EngineError> {
        Ok(Self {
            gpu: Arc::clone(gpu),
            binding_bytes: gpu.binding_bytes,
            shard_limit: usize::MAX,
            scene: GpuScene::empty(),
            frame: StepBuffers::new(gpu)?,
            commands: Commands::default(),
            targets: Targets::default(),
            timer: Timer::new(gpu)?,
            pending: VecDeque::new(),
            slots: Slots::default(),
            image_copy: ImageCopy::default(),
            latest: None,
            diverged: None,
            traffic: Traffic::default(),
            timings: Pass::ALL.map(|pass| PassTime { pass, time: Duration::ZERO }),
            camera_sums: Vec::new(),
            batch: batch::BatchBuffers::default(),
        })
    }

    /// Returns the device that the engine uses.
    pub fn gpu(&self) -> &Arc<Gpu> {
        &self.gpu
    }

    /// Limits bindings to `bytes`, as on a smaller adapter. For tests; takes effect at the next
    /// [`load`](luxel_core::Engine::load).
    pub fn limit_bindings(&mut self, bytes: u64) {
        self.binding_bytes = usable_binding(bytes).min(self.gpu.binding_bytes);
    }

    /// Limits shards to `splats` splats, as if bindings were that small. For tests; takes effect at
    /// the next [`load`](luxel_core::Engine::load).
    pub fn split_shards(&mut self, splats: usize) {
        self.shard_limit = splats.max(1);
    }

    /// Returns the buffers of the last frame.
    pub(crate) fn frame(&self) -> &StepBuffers {
        &self.frame
    }

    /// Returns the cost of the last submission.
    pub fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// Runs the forward and backward passes without the update, and returns the gradients in the
    /// layout of the splats; `smoothing` is empty. The step's statistics are added to the scene's.
    ///
    /// # Errors
    /// The errors of [`train_step`](luxel_core::Engine::train_step).
    pub fn gradients(&mut self, view: &View, step: &StepConfig) -> Result<(StepReport, Splats), EngineError> {
        self.scene.check_trainable()?;
        self.wait_idle_checked()?;
        view.validate()?;
        let scratch = GpuScene::zeros(&self.gpu, self.scene.rows, self.scene.count, self.shard_len())?;
        let out: Vec<Buffer> = scratch.shards.into_iter().map(|shard| shard.first).collect();
        let output = GradientOutput { gradients: &out, statistics: None };
        let state = self.run(&Submission::Gradients { view, step, out: output })?;
        let by_vignetting = self.read_vignetting_gradient(view)?;
        // Cached bindings would keep the buffers alive.
        self.commands.forget();
        let gradients = self.scene.download(&self.gpu, |n, shard| out.get(n).unwrap_or(&shard.first))?;
        Ok((StepReport { by_vignetting, ..step_report(&state, step.step) }, gradients))
    }

    /// Enlarges the buffers of entries after an overflow, and clears the halt.
    fn make_room(&mut self, state: &State, sizes: Sizes) -> Result<(), EngineError> {
        self.clear_halt();
        let most = self.most_entries(sizes);
        let needed = u64::from(state.needed);
        if needed > most {
            let (name, limit) = (&self.gpu.facts().name, self.binding_bytes >> 20);
            let message = format!("gpu: {name}: {needed} pairs of splats and tiles in one view, bindings of {limit} MiB hold {most}");
            return Err(EngineError::device(message).with_remedy(render_less().or(use_cpu())));
        }
        // A quarter more, so that a growing scene does not overflow at every step.
        let entries = (needed + needed / 4).min(most);
        tracing::debug!(needed, entries, "making room for entries");
        self.ensure(Sizes { entries, ..sizes })
    }

    /// Returns the greatest number of entries that fit besides buffers of these sizes.
    fn most_entries(&self, sizes: Sizes) -> u64 {
        let have = self.frame.sizes;
        most_entries(self.binding_bytes, sizes.training_tiles.max(have.training_tiles))
    }

    fn ensure(&mut self, sizes: Sizes) -> Result<(), EngineError> {
        let grown = self.frame.grown(sizes, self.most_entries(sizes));
        if grown == self.frame.sizes {
            return Ok(());
        }
        // Cached bindings would keep the old buffers alive.
        self.commands.forget();
        self.with_room(|engine| engine.frame.grow(&engine.gpu, grown))
    }

    /// Runs work that allocates memory of the device. If there is too little, frees all unused
    /// memory and the cached images, and runs it once more.
    fn with_room<T>(&mut self, work: impl Fn(&mut Self) -> Result<T, EngineError>) -> Result<T, EngineError> {
        let done = work(self);
        if done.is_ok() {
            return done;
        }
        // The work may be half done. Buffers stay in memory while bindings refer to them, and while
        // the device uses them.
        self.commands.forget();
        self.targets.clear();
        self.gpu.wait_for_all()?;
        work(self)
    }

    /// Submits work and waits for it. Repeats it with larger buffers after an overflow.
    fn run(&mut self, work: &Submission<'_>) -> Result<State, EngineError> {
        loop {
            let report = self.submit(work)?;
            let state = self.receive(report)?;
            if state.halted != HALT_OVERFLOW {
                if state.halted == HALT_NOT_FINITE {
                    self.clear_halt();
                }
                return Ok(state);
            }
            let (camera, options, training) = match work {
                Submission::Render { camera, options, .. } => (*camera, *options, false),
                Submission::Contributions { camera, options, .. } => (*camera, *options, true),
                Submission::Train { view, step } | Submission::Gradients { view, step, .. } | Submission::CameraGradient { view, step } => {
                    (&view.camera, &step.render, true)
                }
            };
            self.make_room(&state, required_sizes(&supersampled(camera, options).0, self.scene.count, training))?;
        }
    }

    /// Records work and submits it: one submission.
    fn submit(&mut self, work: &Submission<'_>) -> Result<Report, EngineError> {
        let (camera, options, purpose) = match work {
            Submission::Render { camera, options, .. } => (*camera, *options, Purpose::Image),
            // It reads what the backward pass reads.
            Submission::Contributions { camera, options, .. } => (*camera, *options, Purpose::Training(StatsCollection::Off, None)),
            Submission::Train { view, step } | Submission::Gradients { view, step, .. } | Submission::CameraGradient { view, step } => {
                (&view.camera, &step.render, Purpose::Training(step.stats, step.dropout))
            }
        };
        let (camera, samples) = &supersampled(camera, options);
        check(camera)?;
        self.prepare(camera, purpose != Purpose::Image)?;
        if work.computes_camera() {
            self.prepare_camera_sums()?;
        }
        if let Some((view, _)) = work.training() {
            self.with_room(|engine| engine.targets.get(&engine.gpu, view).map(|_| ()))?;
        }
        self.frame.set_tiles(&self.gpu, tiles(camera.size_px).into_iter().product());
        let Self { gpu, scene, frame, commands, targets, timer, slots, image_copy, camera_sums, .. } = self;
        let capacity = frame.sizes.entries.min(u32::MAX.into()) as u32;
        let uniform = camera_uniform(
            camera,
            options,
            purpose,
            SceneFacts { count: scene.count as u32, has_smoothing: scene.has_smoothing, has_gain: !scene.gain.is_empty() },
            capacity,
        );
        gpu.queue.write_buffer(&frame.camera.raw, 0, bytemuck::bytes_of(&uniform));
        let pixels = pixel_kind(camera);
        if pixels == PixelKind::Rays {
            gpu.queue.write_buffer(&frame.lens.raw, 0, bytemuck::bytes_of(&lens_uniform(camera)));
        }
        let target = work.training().map(|(view, step)| write_step(gpu, targets, frame, scene.count, view, step)).transpose()?;
        let mut recorder =
            Recorder { gpu, commands, frame, scene, size_px: camera.size_px, samples: *samples, pixels, light: work.light() };
        recorder.forward();
        if let Some((target, vignetting)) = target {
            recorder.backward(target, vignetting);
            recorder.gather();
            if work.computes_camera() {
                recorder.camera_backward(camera_sums);
            }
            match work {
                Submission::Gradients { out, .. } => recorder.update(Some(*out)),
                Submission::CameraGradient { .. } => {}
                _ => recorder.update(None),
            }
        }
        if let Submission::Contributions { mask, out, .. } = work {
            recorder.contribute(mask, out);
        }
        let dispatches = commands.len();
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let segments = commands.encode(&mut encoder, timer.as_ref());
        let copied = if purpose == Purpose::Image { image_bytes(camera.size_px) } else { 0 };
        if copied > 0 {
            image_copy.record(gpu, &mut encoder, &frame.pixels.image, copied)?;
        }
        let report = slots.take(gpu)?.submit(gpu, encoder, &frame.state, timer.as_ref(), segments);
        if copied > 0 {
            image_copy.map(copied);
        }
        let bytes_read = report.bytes + copied;
        self.traffic = Traffic { dispatches, submissions: 1, bytes_read, image_bytes: self.targets.take_uploaded() };
        if self.targets.take_dropped() {
            self.commands.forget();
        }
        self.gpu.check()?;
        Ok(report)
    }

    fn upload_mask(&self, mask: &[f32]) -> Result<Buffer, EngineError> {
        let buffer = self.gpu.storage("painted mask", size_of_val(mask) as u64)?;
        self.gpu.queue.write_buffer(&buffer.raw, 0, bytemuck::cast_slice(mask));
        Ok(buffer)
    }

    /// Makes the buffers at least as large as a view of `camera` needs.
    fn prepare(&mut self, camera: &Camera, training: bool) -> Result<(), EngineError> {
        let mut sizes = required_sizes(camera, self.scene.count, training);
        sizes.entries = expected_entries(sizes.splats);
        self.ensure(sizes)
    }

    /// Returns the greatest number of splats in a shard.
    fn shard_len(&self) -> usize {
        self.shard_len_for(self.scene.rows.color_model)
    }

    fn shard_len_for(&self, color_model: ColorModel) -> usize {
        shard_len(ParameterRows { color_model }, self.binding_bytes).min(self.shard_limit)
    }

    fn replace_scene(&mut self, scene: GpuScene) {
        self.scene = scene;
        self.camera_sums.clear();
        self.batch.clear();
        self.commands.forget();
        self.frame.set_count(&self.gpu, self.scene.count as u32);
    }
}

/// Returns the sizes of the buffers for a view of `camera`, without the entries.
fn required_sizes(camera: &Camera, splats: usize, training: bool) -> Sizes {
    let [across, down] = tiles(camera.size_px).map(u64::from);
    let [width, height] = camera.size_px.map(u64::from);
    let (tiles, pixels) = (across * down, width * height);
    let [training_tiles, training_pixels] = if training { [tiles, pixels] } else { [0; 2] };
    Sizes { splats: splats as u64, tiles, pixels, entries: 0, training_tiles, training_pixels }
}

fn step_report(state: &State, step: u32) -> StepReport {
    StepReport {
        step,
        loss: state.loss,
        l1: state.l1,
        ssim: state.ssim,
        visible: state.visible,
        by_knots: None,
        camera: None,
        by_vignetting: None,
    }
}
