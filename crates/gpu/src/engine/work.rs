//! Counts of a step's work: what its time follows from on a given card.
//!
//! In: a view and a step. Out: [`Work`]. The passes over pixels run once more as kernels that are
//! the same text with counters (`counts.wgsl`), so that a change of the kernels changes the counts;
//! the other numbers follow from buffers. The scene is not changed.

use luxel_core::engine::{StatsCollection, StepConfig};
use luxel_core::{EngineError, View};

use super::{GpuEngine, Submission};
use crate::device::Buffer;
use crate::frame::tile_digits;
use crate::layout::{BLOCK_PX, DEPTH_DIGITS, ENTRY_GRADIENT_BYTES, Entry, State, TILE_PX};
use crate::scene::GpuScene;
use crate::screen::{pixel_kind, supersampled, tiles};
use crate::step::{GradientOutput, Recorder};

/// The work of a training step. With supersampling, pixels are samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Splats that touch the image.
    pub visible: u64,
    /// Entries: pairs of a splat and a tile.
    pub entries: u64,
    /// Pairs of a splat and a block of pixels that it touches.
    pub block_pairs: u64,
    /// Pairs of a splat and a pixel that it changes, and whose gradient is not zero.
    pub alive_pairs: u64,
    /// Entries that blocks look at in the forward pass, until all their pixels are finished.
    pub forward_steps: u64,
    /// Buckets in which a pixel has a gradient.
    pub buckets: u64,
    /// Entries that blocks look at in the backward pass: steps of its first phase.
    pub pixel_steps: u64,
    /// Steps of its second phase, in each of which every thread adds up a pair.
    pub sum_steps: u64,
    /// How often both phases run: a block with at most half a bucket's entries at a time, and two
    /// barriers within a workgroup.
    pub rounds: u64,
    /// Keys that the sorts move, once for each digit.
    pub keys_sorted: u64,
    /// Bytes of pixels' states before buckets, written by the forward pass.
    pub state_bytes: u64,
    /// Bytes of the entries' gradients.
    pub gradient_bytes: u64,
    /// Kernels of the step: each waits for those before it.
    pub dispatches: u64,
    /// Submissions of the step.
    pub submissions: u64,
}

impl Work {
    /// Returns the counts with their names, in the order of the fields.
    pub fn list(&self) -> [(&'static str, u64); 14] {
        [
            ("visible", self.visible),
            ("entries", self.entries),
            ("block_pairs", self.block_pairs),
            ("alive_pairs", self.alive_pairs),
            ("forward_steps", self.forward_steps),
            ("buckets", self.buckets),
            ("pixel_steps", self.pixel_steps),
            ("sum_steps", self.sum_steps),
            ("rounds", self.rounds),
            ("keys_sorted", self.keys_sorted),
            ("state_bytes", self.state_bytes),
            ("gradient_bytes", self.gradient_bytes),
            ("dispatches", self.dispatches),
            ("submissions", self.submissions),
        ]
    }

    /// Adds the numbers that `rasterize_backward` packs into the last of an entry's.
    fn add_entry(&mut self, packed: f32) {
        let bits = packed as u64;
        self.alive_pairs += bits & 0x1ff;
        self.pixel_steps += (bits >> 9) & 0xf;
        self.sum_steps += 8 * ((bits >> 13) & 0x3f);
        self.rounds += bits >> 19;
        self.buckets += u64::from(bits >> 19 > 0);
    }

    /// Adds the numbers that `rasterize` stores in the place of the image. A block takes as many
    /// steps as the pixel that looks at the most.
    fn add_image(&mut self, counts: &[f32], [width, height]: [u32; 2]) {
        let [across, down] = tiles([width, height]).map(|side| side * TILE_PX);
        let columns = across / BLOCK_PX[0];
        for block in 0..columns * (down / BLOCK_PX[1]) {
            let [left, top] = [block % columns * BLOCK_PX[0], block / columns * BLOCK_PX[1]];
            let rows = top..(top + BLOCK_PX[1]).min(height);
            let pixels = rows.flat_map(|y| (left..(left + BLOCK_PX[0]).min(width)).map(move |x| 3 * (y * width + x) as usize));
            let mut steps = 0;
            for at in pixels {
                steps = steps.max(counts[at] as u64);
                self.state_bytes += 16 * counts[at + 1] as u64;
            }
            self.forward_steps += steps;
        }
    }
}

impl GpuEngine {
    /// Counts the work of a training step, without changing the scene.
    ///
    /// # Errors
    /// The errors of [`Self::gradients`].
    pub fn count_work(&mut self, view: &View, step: &StepConfig) -> Result<Work, EngineError> {
        self.scene.check_trainable()?;
        self.wait_idle_checked()?;
        view.validate()?;
        let step = &StepConfig { stats: StatsCollection::Off, ..*step };
        let scratch = GpuScene::zeros(&self.gpu, self.scene.rows, self.scene.count, self.shard_len())?;
        let out: Vec<Buffer> = scratch.shards.into_iter().map(|shard| shard.first).collect();
        // This leaves everything that the passes over pixels read.
        let state = self.run(&Submission::Gradients { view, step, out: GradientOutput { gradients: &out, statistics: None } })?;
        let traffic = self.traffic;
        let camera = supersampled(&view.camera, &step.render).0;
        let [across, down] = tiles(camera.size_px);
        let entries = u64::from(state.entries);
        let mut work = Work {
            visible: state.visible.into(),
            entries,
            // The first digit of depths leaves out the splats that do not touch the image.
            keys_sorted: self.scene.count as u64
                + u64::from(DEPTH_DIGITS - 1) * u64::from(state.visible)
                + tile_digits(across * down) as u64 * entries,
            gradient_bytes: ENTRY_GRADIENT_BYTES * entries,
            dispatches: traffic.dispatches as u64,
            submissions: traffic.submissions as u64,
            ..Work::default()
        };
        self.record_counted(view, step, |recorder| recorder.count_backward())?;
        let emitted: Vec<Entry> = self.gpu.read(&self.frame.entries.emitted, entries as usize)?;
        work.block_pairs = emitted.iter().map(|entry| u64::from(entry.blocks.count_ones())).sum();
        let numbers = ENTRY_GRADIENT_BYTES as usize / 4;
        let gradients: Vec<f32> = self.gpu.read(&self.frame.entries.gradients, numbers * entries as usize)?;
        gradients.chunks_exact(numbers).filter_map(|entry| entry.last()).for_each(|last| work.add_entry(*last));
        self.record_counted(view, step, |recorder| recorder.count_forward())?;
        let pixels = camera.size_px.map(|side| side as usize).into_iter().product::<usize>();
        work.add_image(&self.gpu.read(&self.frame.pixels.image, 3 * pixels)?, camera.size_px);
        self.commands.forget();
        Ok(work)
    }

    /// Submits one of the counting kernels, for the frame that is in the buffers.
    fn record_counted(&mut self, view: &View, step: &StepConfig, record: fn(&mut Recorder<'_>)) -> Result<State, EngineError> {
        let (camera, samples) = supersampled(&view.camera, &step.render);
        let Self { gpu, scene, frame, commands, slots, .. } = self;
        let pixels = pixel_kind(&camera);
        record(&mut Recorder { gpu, commands, frame, scene, size_px: camera.size_px, samples, pixels, light: 0 });
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let segments = commands.encode(&mut encoder, None);
        let report = slots.take(gpu)?.submit(gpu, encoder, &frame.state, None, segments);
        self.receive(report)
    }
}
