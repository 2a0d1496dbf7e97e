//! The order of kernels in a frame and in a step, with their buffers.
//!
//! In: buffers, scene. Out: recorded commands.

use luxel_core::Pass;

use crate::commands::{Binding, Commands, Groups, bind};
use crate::device::{Buffer, Gpu};
use crate::frame::{StepBuffers, tile_digits};
use crate::kernels::KernelId;
use crate::layout::{DEPTH_DIGITS, DIGITS, Dispatches, SORT_BLOCK, Update};
use crate::scene::GpuScene;
use crate::screen::tiles;
use crate::targets::Target;

/// Splats per workgroup of the kernels that run over them.
const SPLATS: u64 = 256;
/// Splats per workgroup of `project_backward`, which holds more per thread.
const SPLATS_BACKWARD: u64 = 128;
/// Tiles per workgroup of `bin_ranges`.
const TILES: u64 = 64;

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
}

impl Recorder<'_> {
    fn add(&mut self, pass: Pass, id: KernelId, bindings: &[Binding<'_>], groups: Groups<'_>) {
        self.commands.add(self.gpu, pass, id, bindings, groups);
    }

    /// Records the passes up to the image.
    pub(crate) fn forward(&mut self) {
        self.project();
        self.sort_by_depth();
        self.forward_from_bin();
    }

    /// Records the passes up to the image, for splats that are already projected and sorted by
    /// depth.
    pub(crate) fn forward_from_bin(&mut self) {
        self.bin();
        self.sort_by_tile();
        self.rasterize();
    }

    fn tile_count(&self) -> u32 {
        let [across, down] = tiles(self.size_px);
        across * down
    }

    /// Records the sort of entries by tile, which keeps the order of depths.
    fn sorted_entries(&self) -> usize {
        tile_digits(self.tile_count()) % 2
    }

    fn project(&mut self) {
        let (frame, scene) = (self.frame, self.scene);
        for shard in &scene.shards {
            let buffers = [
                bind(0, &frame.camera),
                bind(1, &shard.uniform),
                bind(2, &shard.parameters),
                bind(3, &frame.splats.footprints),
                bind(4, &frame.splats.depth_keys[0]),
                bind(5, &frame.splats.places),
            ];
            let groups = Groups::Line((shard.len as u64).div_ceil(SPLATS));
            self.add(Pass::Project, KernelId::Project(scene.rows.color_model), &buffers, groups);
        }
    }

    /// Records one digit of a sort: from buffers number `from` to the other buffers.
    fn sort_digit(&mut self, config: &Buffer, keys: &[Buffer; 2], values: &[Buffer; 2], from: usize, groups: Groups<'_>) {
        let (frame, to) = (self.frame, 1 - from);
        let counts = [bind(0, config), bind(1, &frame.state), bind(2, &keys[from]), bind(6, &frame.digit_counts)];
        self.add(Pass::Sort, KernelId::SortCount, &counts, groups);
        let scan = [bind(0, config), bind(1, &frame.state), bind(6, &frame.digit_counts), bind(7, &frame.digit_totals)];
        self.add(Pass::Sort, KernelId::SortScan, &scan, Groups::Line(DIGITS.into()));
        let scatter = [
            bind(0, config),
            bind(1, &frame.state),
            bind(2, &keys[from]),
            bind(3, &values[from]),
            bind(4, &keys[to]),
            bind(5, &values[to]),
            bind(6, &frame.digit_counts),
            bind(7, &frame.digit_totals),
        ];
        self.add(Pass::Sort, KernelId::SortScatter, &scatter, groups);
    }

    fn sort_by_depth(&mut self) {
        let frame = self.frame;
        let groups = Groups::Line((self.scene.count as u64).div_ceil(SORT_BLOCK.into()));
        for (digit, config) in frame.depth_sorts.iter().enumerate() {
            self.sort_digit(config, &frame.splats.depth_keys, &frame.splats.order, digit % 2, groups);
        }
    }

    fn bin(&mut self) {
        let frame = self.frame;
        let order = &frame.splats.order[DEPTH_DIGITS as usize % 2];
        let blocks = Groups::Line((self.scene.count as u64).div_ceil(SPLATS));
        let sum = [bind(0, &frame.camera), bind(2, order), bind(3, &frame.splats.places), bind(4, &frame.splats.block_sums)];
        self.add(Pass::Bin, KernelId::BinSum, &sum, blocks);
        let scan = [bind(0, &frame.camera), bind(1, &frame.state), bind(4, &frame.splats.block_sums), bind(8, &frame.dispatches)];
        self.add(Pass::Bin, KernelId::BinScan, &scan, Groups::Line(1));
        let emit = [
            bind(0, &frame.camera),
            bind(1, &frame.state),
            bind(2, order),
            bind(3, &frame.splats.places),
            bind(4, &frame.splats.block_sums),
            bind(5, &frame.splats.footprints),
            bind(6, &frame.entries.tiles[0]),
            bind(7, &frame.entries.splats),
        ];
        self.add(Pass::Bin, KernelId::BinEmit, &emit, blocks);
    }

    fn sort_by_tile(&mut self) {
        let frame = self.frame;
        let groups = Groups::Indirect(&frame.dispatches, std::mem::offset_of!(Dispatches, sort));
        for (digit, config) in frame.tile_sorts[..tile_digits(self.tile_count())].iter().enumerate() {
            self.sort_digit(config, &frame.entries.tiles, &frame.entries.order, digit % 2, groups);
        }
        let ranges = [
            bind(0, &frame.camera),
            bind(1, &frame.state),
            bind(9, &frame.entries.tiles[self.sorted_entries()]),
            bind(10, &frame.pixels.ranges),
            bind(11, &frame.entries.buckets),
        ];
        // One beyond the last tile: see the remark on rounding in bin.wgsl.
        self.add(Pass::Sort, KernelId::BinRanges, &ranges, Groups::Line((u64::from(self.tile_count()) + 1).div_ceil(TILES)));
    }

    fn rasterize(&mut self) {
        let frame = self.frame;
        let buffers = [
            bind(0, &frame.camera),
            bind(1, &frame.splats.footprints),
            bind(2, &frame.pixels.ranges),
            bind(3, &frame.entries.order[self.sorted_entries()]),
            bind(4, &frame.entries.splats),
            bind(5, &frame.pixels.image),
            bind(6, &frame.pixels.last_entries),
            bind(7, &frame.entries.bucket_pixels),
        ];
        self.add(Pass::Rasterize, KernelId::Rasterize, &buffers, Groups::Line(self.tile_count().into()));
    }

    /// Records the passes from the image to the entries' gradients.
    pub(crate) fn backward(&mut self, target: &Target) {
        self.loss(target);
        let frame = self.frame;
        let buffers = [
            bind(0, &frame.camera),
            bind(1, &frame.splats.footprints),
            bind(2, &frame.entries.buckets),
            bind(3, &frame.entries.order[self.sorted_entries()]),
            bind(4, &frame.entries.splats),
            bind(5, &frame.entries.bucket_pixels),
            bind(6, &frame.pixels.image),
            bind(7, &frame.pixels.gradients),
            bind(8, &frame.entries.gradients),
        ];
        let groups = Groups::Indirect(&frame.dispatches, std::mem::offset_of!(Dispatches, buckets));
        self.add(Pass::RasterizeBackward, KernelId::RasterizeBackward, &buffers, groups);
    }

    fn loss(&mut self, target: &Target) {
        let frame = self.frame;
        let grid = Groups::Grid(tiles(self.size_px.map(|side| side / self.samples)));
        // Without a mask the binding is not read.
        let mask = target.weights.as_deref().unwrap_or(&target.pixels);
        let inputs = [bind(0, &frame.camera), bind(1, &frame.loss), bind(2, &frame.pixels.image), bind(3, &target.pixels), bind(4, mask)];
        let derivatives = bind(5, &frame.pixels.derivatives);
        let ssim: Vec<_> = inputs.into_iter().chain([derivatives, bind(6, &frame.pixels.group_sums)]).collect();
        self.add(Pass::Loss, KernelId::LossSsim, &ssim, grid);
        let report = [bind(0, &frame.camera), bind(1, &frame.loss), bind(6, &frame.pixels.group_sums), bind(9, &frame.state)];
        self.add(Pass::Loss, KernelId::LossReport, &report, Groups::Line(1));
        let outputs = [derivatives, bind(7, &frame.pixels.last_entries), bind(8, &frame.pixels.gradients)];
        let gradient: Vec<_> = inputs.into_iter().chain(outputs).collect();
        self.add(Pass::Loss, KernelId::LossGradient, &gradient, grid);
    }

    /// Records the computation of each splat's contribution to the image, under a mask.
    pub(crate) fn contribute(&mut self, mask: &Buffer, out: &Buffer) {
        let frame = self.frame;
        let buffers = [
            bind(0, &frame.camera),
            bind(1, &frame.splats.footprints),
            bind(2, &frame.entries.buckets),
            bind(3, &frame.entries.order[self.sorted_entries()]),
            bind(4, &frame.entries.splats),
            bind(5, &frame.entries.bucket_pixels),
            bind(6, &frame.pixels.last_entries),
            bind(7, mask),
            bind(8, &frame.entries.gradients),
        ];
        let groups = Groups::Indirect(&frame.dispatches, std::mem::offset_of!(Dispatches, buckets));
        self.add(Pass::Rasterize, KernelId::Contribute, &buffers, groups);
        let sum =
            [bind(0, &frame.camera), bind(1, &frame.state), bind(2, &frame.splats.places), bind(3, &frame.entries.gradients), bind(4, out)];
        self.add(Pass::Rasterize, KernelId::ContributeSum, &sum, Groups::Line((self.scene.count as u64).div_ceil(SPLATS)));
    }

    /// Records the update from the entries' gradients to parameters and moments, or to gradients in
    /// the place of first moments, one buffer per shard.
    pub(crate) fn update(&mut self, gradients: Option<&[Buffer]>) {
        let (frame, scene) = (self.frame, self.scene);
        let gather = [bind(0, &frame.camera), bind(1, &frame.state), bind(2, &frame.splats.places), bind(3, &frame.entries.gradients)];
        let groups = Groups::Line((scene.count as u64).div_ceil(SPLATS));
        self.add(Pass::ProjectBackward, KernelId::Gather, &gather, groups);
        let kind = if gradients.is_some() { Update::OnlyGradients } else { Update::Parameters };
        for (n, shard) in scene.shards.iter().enumerate() {
            let first = gradients.and_then(|buffers| buffers.get(n)).unwrap_or(&shard.first);
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
                bind(9, &shard.stats),
            ];
            let groups = Groups::Line((shard.len as u64).div_ceil(SPLATS_BACKWARD));
            self.add(Pass::ProjectBackward, KernelId::ProjectBackward(scene.rows.color_model, kind), &buffers, groups);
        }
    }
}
