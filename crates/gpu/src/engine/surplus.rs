//! A test hook: a step in which `project` counts more tiles than `bin_emit` finds, as if a compiler
//! rounded the two differently. It is always compiled, not a feature, so that tests and programs
//! share one build.

use luxel_core::engine::StepConfig;
use luxel_core::{EngineError, RasterConfig, RenderOptions, Splats, View};

use super::{GpuEngine, Submission};
use crate::device::Buffer;
use crate::forward::PixelKind;
use crate::scene::GpuScene;
use crate::step::{GradientOutput, Recorder, VignettingKind};

impl GpuEngine {
    /// Computes [`Self::gradients`] with `surplus` tiles too many for each visible splat, and with
    /// NaN in all memory of the entries' gradients. Without supersampling.
    ///
    /// # Errors
    /// The errors of [`Self::gradients`].
    #[doc(hidden)]
    pub fn gradients_with_surplus(&mut self, view: &View, step: &StepConfig, surplus: u32) -> Result<Splats, EngineError> {
        view.validate()?;
        let step =
            &StepConfig { render: RenderOptions { raster: RasterConfig { samples: 1, ..step.render.raster }, ..step.render }, ..*step };
        let scratch = GpuScene::zeros(&self.gpu, self.scene.rows, self.scene.count, self.shard_len())?;
        let out: Vec<Buffer> = scratch.shards.into_iter().map(|shard| shard.first).collect();
        // This leaves footprints, places and the order of depths.
        let output = GradientOutput { gradients: &out, statistics: None };
        self.run(&Submission::Gradients { view, step, out: output })?;
        let Self { gpu, scene, frame, commands, targets, slots, .. } = self;
        let mut places: Vec<[u32; 2]> = gpu.read(&frame.splats.places, scene.count)?;
        for [_, touched] in places.iter_mut().filter(|[_, touched]| *touched > 0) {
            *touched += surplus;
        }
        gpu.queue.write_buffer(&frame.splats.places.raw, 0, bytemuck::cast_slice(&places));
        let gradients = &frame.entries.gradients.raw;
        gpu.queue.write_buffer(gradients, 0, bytemuck::cast_slice(&vec![f32::NAN; gradients.size() as usize / 4]));
        let target = targets.get(gpu, view)?;
        let mut recorder =
            Recorder { gpu, commands, frame, scene, size_px: view.camera.size_px, samples: 1, pixels: PixelKind::Places, light: 0 };
        recorder.forward_from_bin();
        recorder.backward(target, VignettingKind::of(view));
        recorder.update(Some(GradientOutput { gradients: &out, statistics: None }));
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let segments = commands.encode(&mut encoder, None);
        let report = slots.take(gpu)?.submit(gpu, encoder, &frame.state, None, segments);
        report.receive(gpu, slots)?;
        self.commands.forget();
        self.scene.download(&self.gpu, |n, shard| out.get(n).unwrap_or(&shard.first))
    }
}
