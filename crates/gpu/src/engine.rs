//! [`GpuEngine`]: hands steps to the device and hears of them later.
//!
//! A step is one submission. How many entries (pairs of a splat and a tile) it has, the device finds out; where its buffers are too small, the
//! device halts: that step and those behind it change nothing. The host hears of it, makes room and hands the same steps in again, so that
//! the result is the one of buffers that were large enough from the start. A loss that is not finite halts the device as well, before anything
//! has been changed by it.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use luxel_core::engine::{ParameterRows, StatsCollection, StepConfig};
use luxel_core::{Camera, ColorModel, EngineError, Pass, Remedy, RenderOptions, Splats, StepReport, ToneCurve, View};

use crate::adapter::usable_binding;
use crate::commands::{Commands, Timer};
use crate::device::{Buffer, Gpu, render_less, resume, use_cpu};
use crate::frame::{Frame, Sizes, expected_entries, most_entries};
use crate::layout::{HALT_NONE, HALT_NOT_FINITE, HALT_OVERFLOW, State};
use crate::pending::{Pending, Report, Slots};
use crate::scene::{Scene, shard_len};
use crate::screen::{Purpose, camera_uniform, check, loss_uniform, of_samples, optimizer_uniform, tiles};
use crate::step::Recorder;
use crate::targets::Targets;

mod contract;
mod surplus;

/// The engine on a GPU. Equal inputs give equal bits on one adapter.
pub struct GpuEngine {
    gpu: Arc<Gpu>,
    /// Bytes of a binding that the engine allows itself.
    binding_bytes: u64,
    /// Splats of a shard at most, whatever a binding holds.
    shard_limit: usize,
    scene: Scene,
    frame: Frame,
    commands: Commands,
    targets: Targets,
    timer: Option<Timer>,
    pending: VecDeque<Pending>,
    slots: Slots,
    latest: Option<StepReport>,
    /// Step whose loss was not finite.
    diverged: Option<u32>,
    traffic: Traffic,
    timings: [(Pass, Duration); Pass::ALL.len()],
}

/// What a step costs besides its arithmetic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Kernels.
    pub dispatches: usize,
    /// Submissions.
    pub submissions: usize,
    /// Bytes that the host reads back.
    pub bytes_read: u64,
    /// Bytes of the view's image and mask, if they were not there.
    pub image_bytes: u64,
}

/// What is handed in.
enum Work<'a> {
    Render { camera: &'a Camera, options: &'a RenderOptions },
    Contributions { camera: &'a Camera, options: &'a RenderOptions, mask: &'a Buffer, out: &'a Buffer },
    Train { view: &'a View, step: &'a StepConfig },
    Gradients { view: &'a View, step: &'a StepConfig, out: &'a [Buffer] },
}

impl GpuEngine {
    /// An engine without a scene.
    ///
    /// # Errors
    /// [`EngineError::Device`].
    pub fn new(gpu: &Arc<Gpu>) -> Result<Self, EngineError> {
        Ok(Self {
            gpu: Arc::clone(gpu),
            binding_bytes: gpu.binding_bytes,
            shard_limit: usize::MAX,
            scene: Scene::empty(),
            frame: Frame::new(gpu)?,
            commands: Commands::default(),
            targets: Targets::default(),
            timer: Timer::new(gpu)?,
            pending: VecDeque::new(),
            slots: Slots::default(),
            latest: None,
            diverged: None,
            traffic: Traffic::default(),
            timings: Pass::ALL.map(|pass| (pass, Duration::ZERO)),
        })
    }

    /// The device it works on.
    pub fn gpu(&self) -> &Arc<Gpu> {
        &self.gpu
    }

    /// Holds the engine to bindings of `bytes`, as on a lesser adapter. For tests; counts from the next
    /// [`load`](luxel_core::Engine::load) on.
    pub fn limit_bindings(&mut self, bytes: u64) {
        self.binding_bytes = usable_binding(bytes).min(self.gpu.binding_bytes);
    }

    /// Holds shards to `splats` splats, as if bindings ended there. For tests; counts from the next
    /// [`load`](luxel_core::Engine::load) on.
    pub fn split_shards(&mut self, splats: usize) {
        self.shard_limit = splats.max(1);
    }

    /// Buffers of the last frame.
    pub(crate) fn frame(&self) -> &Frame {
        &self.frame
    }

    /// What the last step handed in was made of.
    pub fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// Forward and backward without the update: the seam at which data-parallel training reduces gradients. Gradients in the layout of the
    /// splats; `smoothing` is empty.
    ///
    /// # Errors
    /// As [`train_step`](luxel_core::Engine::train_step).
    pub fn gradients(&mut self, view: &View, step: &StepConfig) -> Result<(StepReport, Splats), EngineError> {
        self.settled()?;
        view.validate()?;
        let scratch = Scene::zeros(&self.gpu, self.scene.rows, self.scene.count, self.shard_len())?;
        let out: Vec<Buffer> = scratch.shards.into_iter().map(|shard| shard.first).collect();
        let state = self.run(&Work::Gradients { view, step, out: &out })?;
        // The bindings would keep the buffers for good.
        self.commands.forget();
        let gradients = self.scene.download(&self.gpu, |n, shard| out.get(n).unwrap_or(&shard.first))?;
        Ok((report_of(&state, step.step), gradients))
    }

    /// Sees to it that the device is at work on nothing and in a state to go on from.
    fn settle_all(&mut self) -> Result<(), EngineError> {
        while !self.pending.is_empty() {
            self.settle()?;
        }
        Ok(())
    }

    /// As [`Self::settle_all`]; an error if the scene is not one to go on from.
    fn settled(&mut self) -> Result<(), EngineError> {
        self.settle_all()?;
        match self.diverged {
            None => Ok(()),
            Some(step) => Err(EngineError::invalid(format!("the loss of step {step} is not finite"))
                .with_remedy(Remedy::advice("lower the learning rates").or(resume()))),
        }
    }

    /// Hears of the oldest step on its way.
    fn settle(&mut self) -> Result<(), EngineError> {
        let Some(Pending { view, step, report }) = self.pending.pop_front() else { return Ok(()) };
        let state = self.receive(report)?;
        match state.halted {
            HALT_OVERFLOW => {
                let mut again = vec![(view, step)];
                again.extend(self.drop_pending()?);
                let (view, step) = &again[0];
                self.make_room(&state, sizes_of(&of_samples(&view.camera, &step.render).0, self.scene.count, true))?;
                for (view, step) in again {
                    self.hand_in(view, step)?;
                }
            }
            HALT_NOT_FINITE => {
                self.drop_pending()?;
                self.diverged = Some(step.step);
                self.latest = Some(StepReport { loss: f32::NAN, ..report_of(&state, step.step) });
            }
            _ => self.latest = Some(report_of(&state, step.step)),
        }
        Ok(())
    }

    /// Waits for all steps on their way, which a halted device passes over; returns them.
    fn drop_pending(&mut self) -> Result<Vec<(View, StepConfig)>, EngineError> {
        let mut dropped = Vec::new();
        while let Some(Pending { view, step, report }) = self.pending.pop_front() {
            self.receive(report)?;
            dropped.push((view, step));
        }
        Ok(dropped)
    }

    fn receive(&mut self, report: Report) -> Result<State, EngineError> {
        let (state, segments, timestamps) = report.receive(&self.gpu, &mut self.slots)?;
        if let Some(timer) = &self.timer {
            timer.add(&segments, &timestamps, &mut self.timings);
        }
        Ok(state)
    }

    /// Lets a halted device go on.
    fn go_on(&self) {
        let halted = std::mem::offset_of!(State, halted) as u64;
        self.gpu.queue.write_buffer(&self.frame.state.raw, halted, bytemuck::bytes_of(&HALT_NONE));
    }

    /// Enlarges the buffers of entries after an overflow, and lets the device go on.
    fn make_room(&mut self, state: &State, sizes: Sizes) -> Result<(), EngineError> {
        self.go_on();
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

    /// Entries that there can be room for with buffers of these sizes besides.
    fn most_entries(&self, sizes: Sizes) -> u64 {
        let have = self.frame.sizes;
        most_entries(self.binding_bytes, sizes.training_tiles.max(have.training_tiles))
    }

    fn ensure(&mut self, sizes: Sizes) -> Result<(), EngineError> {
        let grown = self.frame.grown(sizes, self.most_entries(sizes));
        if grown == self.frame.sizes {
            return Ok(());
        }
        // The bindings would keep the old buffers.
        self.commands.forget();
        self.with_room(|engine| engine.frame.grow(&engine.gpu, grown))
    }

    /// Does what takes memory of the device; if there is too little, once more when the device has let go of all that nobody holds, and without the images
    /// that are kept.
    fn with_room<T>(&mut self, work: impl Fn(&mut Self) -> Result<T, EngineError>) -> Result<T, EngineError> {
        let done = work(self);
        if done.is_ok() {
            return done;
        }
        // It may have come half-way. And buffers are in memory as long as bindings hold them, and as long as the device is at work on them.
        self.commands.forget();
        self.targets.clear();
        self.gpu.wait_for_all()?;
        work(self)
    }

    /// Hands a step in.
    fn hand_in(&mut self, view: View, step: StepConfig) -> Result<(), EngineError> {
        let report = self.submit(&Work::Train { view: &view, step: &step })?;
        self.pending.push_back(Pending { view, step, report });
        Ok(())
    }

    /// Hands work in, waits for it, and does it again with more room if need be.
    fn run(&mut self, work: &Work<'_>) -> Result<State, EngineError> {
        loop {
            let report = self.submit(work)?;
            let state = self.receive(report)?;
            if state.halted != HALT_OVERFLOW {
                if state.halted == HALT_NOT_FINITE {
                    self.go_on();
                }
                return Ok(state);
            }
            let (camera, options, training) = match work {
                Work::Render { camera, options } => (*camera, *options, false),
                Work::Contributions { camera, options, .. } => (*camera, *options, true),
                Work::Train { view, step } | Work::Gradients { view, step, .. } => (&view.camera, &step.render, true),
            };
            self.make_room(&state, sizes_of(&of_samples(camera, options).0, self.scene.count, training))?;
        }
    }

    /// Hands work in: one submission.
    fn submit(&mut self, work: &Work<'_>) -> Result<Report, EngineError> {
        let (camera, options, purpose) = match work {
            Work::Render { camera, options } => (*camera, *options, Purpose::Image),
            // It needs what the backward pass needs.
            Work::Contributions { camera, options, .. } => (*camera, *options, Purpose::Training(StatsCollection::Off)),
            Work::Train { view, step } | Work::Gradients { view, step, .. } => (&view.camera, &step.render, Purpose::Training(step.stats)),
        };
        let (camera, samples) = &of_samples(camera, options);
        check(camera)?;
        self.prepare(camera, purpose != Purpose::Image)?;
        if let Work::Train { view, .. } | Work::Gradients { view, .. } = work {
            self.with_room(|engine| engine.targets.get(&engine.gpu, view).map(|_| ()))?;
        }
        let Self { gpu, scene, frame, commands, targets, timer, slots, .. } = self;
        let capacity = frame.sizes.entries.min(u32::MAX.into()) as u32;
        let uniform = camera_uniform(camera, options, purpose, (scene.count as u32, scene.has_smoothing), capacity);
        gpu.queue.write_buffer(&frame.camera.raw, 0, bytemuck::bytes_of(&uniform));
        let target = match work {
            Work::Render { .. } | Work::Contributions { .. } => None,
            Work::Train { view, step } | Work::Gradients { view, step, .. } => {
                let target = targets.get(gpu, view)?;
                let size_px = view.camera.size_px;
                let loss = loss_uniform((&step.loss, mu_of(step)?), size_px, target.total, target.weights.is_some());
                gpu.queue.write_buffer(&frame.loss.raw, 0, bytemuck::bytes_of(&loss));
                let optimizer = optimizer_uniform(step, scene.count);
                gpu.queue.write_buffer(&frame.optimizer.raw, 0, bytemuck::bytes_of(&optimizer));
                Some(target)
            }
        };
        let mut recorder = Recorder { gpu, commands, frame, scene, size_px: camera.size_px, samples: *samples };
        recorder.forward();
        if let Some(target) = target {
            recorder.backward(target);
            recorder.update(match work {
                Work::Gradients { out, .. } => Some(*out),
                _ => None,
            });
        }
        if let Work::Contributions { mask, out, .. } = work {
            recorder.contribute(mask, out);
        }
        let dispatches = commands.len();
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let segments = commands.encode(&mut encoder, timer.as_ref());
        let report = slots.take(gpu)?.submit(gpu, encoder, &frame.state, (timer.as_ref(), segments));
        self.traffic = Traffic { dispatches, submissions: 1, bytes_read: report.bytes, image_bytes: self.targets.take_uploaded() };
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

    /// Buffers that a view of `camera` needs at least.
    fn prepare(&mut self, camera: &Camera, training: bool) -> Result<(), EngineError> {
        let mut sizes = sizes_of(camera, self.scene.count, training);
        sizes.entries = expected_entries(sizes.splats);
        self.ensure(sizes)
    }

    /// Splats of a shard, at most.
    fn shard_len(&self) -> usize {
        self.shard_len_of(self.scene.rows.color_model)
    }

    fn shard_len_of(&self, color_model: ColorModel) -> usize {
        shard_len(ParameterRows { color_model }, self.binding_bytes).min(self.shard_limit)
    }

    fn replace_scene(&mut self, scene: Scene) {
        self.scene = scene;
        self.commands.forget();
        self.frame.set_count(&self.gpu, self.scene.count as u32);
    }
}

/// Buffers for a view of `camera`, but for the entries.
fn sizes_of(camera: &Camera, splats: usize, training: bool) -> Sizes {
    let [across, down] = tiles(camera.size_px).map(u64::from);
    let [width, height] = camera.size_px.map(u64::from);
    let (tiles, pixels) = (across * down, width * height);
    let [training_tiles, training_pixels] = if training { [tiles, pixels] } else { [0; 2] };
    Sizes { splats: splats as u64, tiles, pixels, entries: 0, training_tiles, training_pixels }
}

fn report_of(state: &State, step: u32) -> StepReport {
    StepReport { step, loss: state.loss, l1: state.l1, ssim: state.ssim, visible: state.visible, by_knots: None }
}

/// mu of the mu-law of a step's loss: the one curve this engine has.
fn mu_of(step: &StepConfig) -> Result<f32, EngineError> {
    match step.loss.curve {
        ToneCurve::MuLaw { mu } => Ok(mu),
        ToneCurve::Response(_) => {
            let message = "gpu: pass loss: this engine cannot learn a camera's response from captured LDR images";
            Err(EngineError::invalid(message).with_remedy(use_cpu()))
        }
    }
}
