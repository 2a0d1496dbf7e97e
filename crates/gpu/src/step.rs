//! The order of kernels in a frame and in a step, with their buffers.
//!
//! In: buffers, scene. Out: recorded commands.

use luxel_core::engine::StepConfig;
use luxel_core::{EngineError, Pass, View};

use crate::commands::{Binding, Commands, Groups, bind};
use crate::constants::Update;
use crate::device::{Buffer, Gpu};
use crate::forward::{self, Bound, Count, Dispatch, LENS_SLOT, PixelKind, SPLATS, Workgroups};
use crate::frame::{StepBuffers, tile_digits};
use crate::kernels::KernelId;
use crate::layout::Dispatches;
use crate::scene::{GpuScene, Shard};
use crate::screen::{loss_uniform, mu_law_parameter, optimizer_uniform, tiles};
use crate::targets::{Target, Targets};

/// Splats per workgroup of `project_backward` and `camera_backward`, which hold more per thread.
const SPLATS_BACKWARD: u64 = 128;

/// Returns the number of workgroups of `project_backward` or `camera_backward` for a shard.
pub(crate) fn backward_groups(shard: &Shard) -> u64 {
    (shard.len as u64).div_ceil(SPLATS_BACKWARD)
}

/// Whether the image of a step has vignetting, whose gradient is computed.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum VignettingKind {
    None,
    Learned,
}

impl VignettingKind {
    /// Returns the kind of a view's target.
    pub(crate) fn of(view: &View) -> Self {
        if view.target.vignetting.is_some() { Self::Learned } else { Self::None }
    }
}

/// Writes what a training step needs beside its camera; returns the view's target.
pub(crate) fn write_step<'t>(
    gpu: &Gpu,
    targets: &'t mut Targets,
    frame: &StepBuffers,
    splats: usize,
    view: &View,
    step: &StepConfig,
) -> Result<(&'t Target, VignettingKind), EngineError> {
    let target = targets.get(gpu, view)?;
    let loss = loss_uniform(&step.loss, view, mu_law_parameter(view)?, target.total);
    gpu.queue.write_buffer(&frame.loss.raw, 0, bytemuck::bytes_of(&loss));
    gpu.queue.write_buffer(&frame.optimizer.raw, 0, bytemuck::bytes_of(&optimizer_uniform(step, splats)));
    Ok((target, VignettingKind::of(view)))
}

/// The buffers, one per shard, into which a backward pass writes gradients in the place of first
/// moments.
#[derive(Clone, Copy)]
pub(crate) struct GradientOutput<'a> {
    pub(crate) gradients: &'a [Buffer],
    /// Statistics to which those of the view are added; the scene's own if there are none.
    pub(crate) statistics: Option<&'a [Buffer]>,
}

/// A recorder of the kernels of a frame.
pub(crate) struct Recorder<'a> {
    pub(crate) gpu: &'a Gpu,
    pub(crate) commands: &'a mut Commands,
    pub(crate) frame: &'a StepBuffers,
    pub(crate) scene: &'a GpuScene,
    /// Size of the camera; with supersampling, in samples.
    pub(crate) size_px: [u32; 2],
    /// Samples along the side of a pixel.
    pub(crate) samples: u32,
    pub(crate) pixels: PixelKind,
    /// Number of the light that is rendered.
    pub(crate) light: usize,
}

impl Recorder<'_> {
    fn add(&mut self, pass: Pass, id: KernelId, bindings: &[Binding<'_>], groups: Groups<'_>) {
        self.commands.add(self.gpu, pass, id, bindings, groups);
    }

    /// Records the first of two kernels for a pinhole, and the second, with the lens, for rays.
    fn add_either(&mut self, pass: Pass, [pinhole, rays]: [KernelId; 2], bindings: &[Binding<'_>], groups: Groups<'_>) {
        match self.pixels {
            PixelKind::Places => self.add(pass, pinhole, bindings, groups),
            PixelKind::Rays => {
                let lens = bind(LENS_SLOT, &self.frame.lens);
                let bindings: Vec<_> = bindings.iter().copied().chain([lens]).collect();
                self.add(pass, rays, &bindings, groups);
            }
        }
    }

    /// Records the passes up to the image.
    pub(crate) fn forward(&mut self) {
        self.project();
        self.dispatch_all(&forward::sort_by_depth());
        self.forward_from_bin();
    }

    /// Records the passes up to the image, for splats that are already projected and sorted by
    /// depth.
    pub(crate) fn forward_from_bin(&mut self) {
        let digits = tile_digits(self.tile_count());
        self.dispatch_all(&forward::bin(self.pixels));
        self.dispatch_all(&forward::sort_by_tile(digits));
        self.dispatch(&forward::rasterize(digits, self.pixels), None);
    }

    fn tile_count(&self) -> u32 {
        let [across, down] = tiles(self.size_px);
        across * down
    }

    /// Returns which of the two buffers holds the entries in the order of their tiles.
    fn sorted_entries(&self) -> usize {
        tile_digits(self.tile_count()) % 2
    }

    fn project(&mut self) {
        let scene = self.scene;
        let dispatch = forward::project(scene.rows.color_model, self.light, self.pixels);
        for shard in &scene.shards {
            self.dispatch(&dispatch, Some(shard));
        }
    }

    fn dispatch_all(&mut self, dispatches: &[Dispatch]) {
        for dispatch in dispatches {
            self.dispatch(dispatch, None);
        }
    }

    /// Records a dispatch of the passes up to the image, over all splats or those of a shard.
    fn dispatch(&mut self, dispatch: &Dispatch, shard: Option<&Shard>) {
        let frame = self.frame;
        let bound = dispatch.bindings.iter().filter_map(|Bound { slot, resource }| Some(bind(*slot, frame.resource(*resource, shard)?)));
        let bindings: Vec<_> = bound.collect();
        let groups = match dispatch.workgroups {
            Workgroups::Fixed(groups) => Groups::Line(groups),
            Workgroups::Indirect(offset) => Groups::Indirect(&frame.dispatches, offset),
            Workgroups::Per { count, plus, per } => {
                let count = match count {
                    Count::Splats => shard.map_or(self.scene.count, |shard| shard.len) as u64,
                    Count::Entries => frame.sizes.entries,
                    Count::Tiles => self.tile_count().into(),
                    Count::Pixels => self.size_px.map(u64::from).iter().product(),
                };
                Groups::Line((count + plus).div_ceil(per))
            }
        };
        self.add(dispatch.pass, dispatch.kernel, &bindings, groups);
    }

    /// Records the passes from the image to the entries' gradients.
    pub(crate) fn backward(&mut self, target: &Target, vignetting: VignettingKind) {
        self.loss(target, vignetting);
        self.rasterize_backward([KernelId::RasterizeBackward, KernelId::RasterizeBackwardRays]);
    }

    /// Records the pass from the image to the entries' gradients once more, which counts its work
    /// beside them.
    pub(crate) fn count_backward(&mut self) {
        self.rasterize_backward([KernelId::RasterizeBackwardCounted, KernelId::RasterizeBackwardCountedRays]);
    }

    /// Records pass `rasterize` once more, which counts its work in the place of the image.
    pub(crate) fn count_forward(&mut self) {
        let dispatch = forward::rasterize(tile_digits(self.tile_count()), self.pixels);
        let kernel = match self.pixels {
            PixelKind::Places => KernelId::RasterizeCounted,
            PixelKind::Rays => KernelId::RasterizeCountedRays,
        };
        self.dispatch(&Dispatch { kernel, ..dispatch }, None);
    }

    fn rasterize_backward(&mut self, kernels: [KernelId; 2]) {
        let frame = self.frame;
        let buffers = [
            bind(0, &frame.camera),
            bind(1, &frame.splats.footprints),
            bind(2, &frame.entries.buckets),
            bind(3, &frame.entries.order[self.sorted_entries()]),
            bind(4, &frame.entries.emitted),
            bind(5, &frame.entries.bucket_pixels),
            bind(6, &frame.pixels.image),
            bind(7, &frame.pixels.gradients),
            bind(8, &frame.entries.gradients),
        ];
        let groups = Groups::Indirect(&frame.dispatches, std::mem::offset_of!(Dispatches, buckets));
        self.add_either(Pass::RasterizeBackward, kernels, &buffers, groups);
    }

    fn loss(&mut self, target: &Target, vignetting: VignettingKind) {
        let [loss_ssim, loss_gradient] = match vignetting {
            VignettingKind::None => [KernelId::LossSsim, KernelId::LossGradient],
            VignettingKind::Learned => [KernelId::LossSsimVignetted, KernelId::LossGradientVignetted],
        };
        let frame = self.frame;
        let [across, down] = tiles(self.size_px.map(|side| side / self.samples));
        let grid = Groups::Grid([across, down]);
        // Without a mask the binding is not read.
        let mask = target.weights.as_deref().unwrap_or(&target.pixels);
        let inputs = [bind(0, &frame.camera), bind(1, &frame.loss), bind(2, &frame.pixels.image), bind(3, &target.pixels), bind(4, mask)];
        let derivatives = bind(5, &frame.pixels.derivatives);
        let ssim: Vec<_> = inputs.into_iter().chain([derivatives, bind(6, &frame.pixels.group_sums)]).collect();
        self.add(Pass::Loss, loss_ssim, &ssim, grid);
        let outputs = [bind(7, &frame.pixels.last_entries), bind(8, &frame.pixels.gradients), bind(9, &frame.state)];
        let gradient: Vec<_> = ssim.into_iter().chain(outputs).collect();
        // One row of workgroups more, of which the first makes the report.
        self.add(Pass::Loss, loss_gradient, &gradient, Groups::Grid([across, down + 1]));
        if vignetting == VignettingKind::Learned {
            // In the place of the sums that the report has read.
            let sums = [
                bind(0, &frame.camera),
                bind(1, &frame.loss),
                bind(2, &frame.pixels.image),
                bind(6, &frame.pixels.group_sums),
                bind(8, &frame.pixels.gradients),
            ];
            self.add(Pass::Loss, KernelId::VignettingSums, &sums, grid);
        }
    }

    /// Records the computation of each splat's contribution to the image, under a mask.
    pub(crate) fn contribute(&mut self, mask: &Buffer, out: &Buffer) {
        let frame = self.frame;
        let buffers = [
            bind(0, &frame.camera),
            bind(1, &frame.splats.footprints),
            bind(2, &frame.entries.buckets),
            bind(3, &frame.entries.order[self.sorted_entries()]),
            bind(4, &frame.entries.emitted),
            bind(5, &frame.entries.bucket_pixels),
            bind(6, &frame.pixels.last_entries),
            bind(7, mask),
            bind(8, &frame.entries.gradients),
        ];
        let groups = Groups::Indirect(&frame.dispatches, std::mem::offset_of!(Dispatches, buckets));
        self.add_either(Pass::Rasterize, [KernelId::Contribute, KernelId::ContributeRays], &buffers, groups);
        let sum =
            [bind(0, &frame.camera), bind(1, &frame.state), bind(2, &frame.splats.places), bind(3, &frame.entries.gradients), bind(4, out)];
        self.add(Pass::Rasterize, KernelId::ContributeSum, &sum, Groups::Line((self.scene.count as u64).div_ceil(SPLATS)));
    }

    /// Records the sums over the entries of splats that have many.
    pub(crate) fn gather(&mut self) {
        let frame = self.frame;
        let gather = [bind(0, &frame.camera), bind(1, &frame.state), bind(2, &frame.splats.places), bind(3, &frame.entries.gradients)];
        let groups = Groups::Line((self.scene.count as u64).div_ceil(SPLATS));
        self.add(Pass::ProjectBackward, KernelId::Gather, &gather, groups);
    }

    /// Records the sums for the gradient by the camera, one buffer per shard, before the update.
    /// Follows [`Self::gather`].
    pub(crate) fn camera_backward(&mut self, sums: &[Buffer]) {
        let model = self.scene.rows.color_model;
        let kernels = [KernelId::CameraBackward(model), KernelId::CameraBackwardRays(model)];
        for (shard, sums) in self.scene.shards.iter().zip(sums) {
            self.differentiate(kernels, shard, &shard.first, bind(10, sums));
        }
    }

    /// Records the update from the entries' gradients to parameters and moments, or to gradients in
    /// `output`. Follows [`Self::gather`].
    pub(crate) fn update(&mut self, output: Option<GradientOutput<'_>>) {
        let kind = if output.is_some() { Update::OnlyGradients } else { Update::Parameters };
        let model = self.scene.rows.color_model;
        let kernels = [KernelId::ProjectBackward(model, kind), KernelId::ProjectBackwardRays(model, kind)];
        for (n, shard) in self.scene.shards.iter().enumerate() {
            let first = output.and_then(|output| output.gradients.get(n)).unwrap_or(&shard.first);
            let stats = output.and_then(|output| output.statistics?.get(n)).unwrap_or(&shard.stats);
            self.differentiate(kernels, shard, first, bind(9, stats));
        }
    }

    /// Records a kernel that differentiates the splats of a shard, with the buffer that is its own.
    fn differentiate(&mut self, kernels: [KernelId; 2], shard: &Shard, first: &Buffer, own: Binding<'_>) {
        let frame = self.frame;
        let buffers = [
            bind(0, &frame.camera),
            bind(1, &shard.uniform),
            bind(2, &frame.optimizer),
            bind(3, &frame.state),
            bind(4, &frame.splats.places),
            bind(5, &frame.entries.gradients),
            bind(6, &shard.parameters),
            bind(7, first),
            bind(8, &shard.second),
            own,
        ];
        self.add_either(Pass::ProjectBackward, kernels, &buffers, Groups::Line(backward_groups(shard)));
    }
}
