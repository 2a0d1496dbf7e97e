//! Batches: the gradients of single views, which the host adds up, and the update from their sum.
//!
//! In and out: [`SparseGradients`], converted from and to the rows of the device's shards. Nothing
//! works ahead: each view's gradients are read back. Degenerate: a loss that is not finite is in
//! the report, and its gradients are none.

use luxel_core::engine::{SPLATS_PER_BLOCK, SparseGradients, StepConfig};
use luxel_core::{EngineError, Pass, StepReport, View};

use super::{GpuEngine, Submission, step_report};
use crate::commands::{Groups, bind};
use crate::device::{Buffer, Gpu};
use crate::kernels::KernelId;
use crate::layout::{HALT_NONE, STATS_ROWS};
use crate::scene::{GpuScene, Shard};
use crate::screen::optimizer_uniform;
use crate::step::{GradientOutput, backward_groups};

/// The buffers of a batch, one per shard; none until the first batch of a scene.
#[derive(Default)]
pub(super) struct BatchBuffers {
    gradients: Vec<Buffer>,
    statistics: Vec<Buffer>,
}

impl BatchBuffers {
    fn new(gpu: &Gpu, scene: &GpuScene) -> Result<Self, EngineError> {
        let of = |label, rows: usize| -> Result<Vec<Buffer>, EngineError> {
            scene.shards.iter().map(|shard| gpu.storage(label, 4 * (rows * shard.stride) as u64)).collect()
        };
        Ok(Self { gradients: of("gradients of a batch", scene.rows.count())?, statistics: of("statistics of a batch", STATS_ROWS)? })
    }

    /// Frees the buffers.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }
}

impl GpuEngine {
    /// Returns the buffers of the scene's batches; the caller puts them back.
    fn take_batch(&mut self) -> Result<BatchBuffers, EngineError> {
        if self.batch.gradients.len() != self.scene.shards.len() {
            self.batch = self.with_room(|engine| BatchBuffers::new(&engine.gpu, &engine.scene))?;
        }
        Ok(std::mem::take(&mut self.batch))
    }

    /// Runs the forward and backward passes of a view, and reads its gradients.
    pub(super) fn read_view_gradients(&mut self, view: &View, step: &StepConfig) -> Result<(StepReport, SparseGradients), EngineError> {
        self.wait_idle_checked()?;
        let batch = self.take_batch()?;
        let read = self.view_gradients_in(&batch, view, step);
        self.batch = batch;
        read
    }

    fn view_gradients_in(
        &mut self,
        batch: &BatchBuffers,
        view: &View,
        step: &StepConfig,
    ) -> Result<(StepReport, SparseGradients), EngineError> {
        for (shard, statistics) in self.scene.shards.iter().zip(&batch.statistics) {
            self.gpu.queue.write_buffer(&statistics.raw, 0, bytemuck::cast_slice(&vec![0.0f32; STATS_ROWS * shard.stride]));
        }
        let out = GradientOutput { gradients: &batch.gradients, statistics: Some(&batch.statistics) };
        let state = self.run(&Submission::Gradients { view, step, out })?;
        let report = step_report(&state, step.step);
        if state.halted != HALT_NONE {
            return Ok((StepReport { loss: f32::NAN, ..report }, SparseGradients::none(self.scene.rows)));
        }
        let camera = if Submission::computes_camera_in(step) { Some(self.read_camera_gradient(view, step)?) } else { None };
        let by_vignetting = self.read_vignetting_gradient(view)?;
        Ok((StepReport { camera, by_vignetting, ..report }, self.download_gradients(batch)?))
    }

    fn download_gradients(&self, batch: &BatchBuffers) -> Result<SparseGradients, EngineError> {
        let GpuScene { rows, count, shards, .. } = &self.scene;
        let mut dense = SparseGradients::none(*rows);
        let blocks = count.div_ceil(SPLATS_PER_BLOCK);
        dense.reserve(blocks);
        (0..blocks).for_each(|block| {
            dense.push(block as u32);
        });
        let block_len = dense.block_len();
        let values = dense.values_mut();
        for ((shard, gradients), statistics) in shards.iter().zip(&batch.gradients).zip(&batch.statistics) {
            for (buffer, first_row, buffer_rows) in [(gradients, 0, rows.count()), (statistics, rows.count(), STATS_ROWS)] {
                let found: Vec<f32> = self.gpu.read(buffer, buffer_rows * shard.stride)?;
                for row in 0..buffer_rows {
                    for (i, value) in found[row * shard.stride..][..shard.len].iter().enumerate() {
                        values[place(shard, i, first_row + row, block_len)] = *value;
                    }
                }
            }
        }
        let mut seen = SparseGradients::none(*rows);
        for (block, values) in dense.iter().filter(|(_, values)| values.iter().any(|value| *value != 0.0)) {
            seen.push(block).copy_from_slice(values);
        }
        Ok(seen)
    }

    /// Makes the update of a step from gradients of its splats.
    pub(super) fn update_from(&mut self, gradients: &SparseGradients, step: &StepConfig) -> Result<(), EngineError> {
        self.wait_idle_checked()?;
        gradients.check(self.scene.rows, self.scene.count)?;
        let batch = self.take_batch()?;
        let GpuScene { rows, count, shards, .. } = &self.scene;
        let optimizer = optimizer_uniform(step, *count);
        self.gpu.queue.write_buffer(&self.frame.optimizer.raw, 0, bytemuck::bytes_of(&optimizer));
        for ((shard, by_parameters), statistics) in shards.iter().zip(&batch.gradients).zip(&batch.statistics) {
            for (buffer, first_row, buffer_rows) in [(by_parameters, 0, rows.count()), (statistics, rows.count(), STATS_ROWS)] {
                let values = shard_rows(gradients, shard, first_row, buffer_rows);
                self.gpu.queue.write_buffer(&buffer.raw, 0, bytemuck::cast_slice(&values));
            }
            let buffers = [
                bind(1, &shard.uniform),
                bind(2, &self.frame.optimizer),
                bind(4, by_parameters),
                bind(5, statistics),
                bind(6, &shard.parameters),
                bind(7, &shard.first),
                bind(8, &shard.second),
                bind(9, &shard.stats),
            ];
            let groups = Groups::Line(backward_groups(shard));
            self.commands.add(&self.gpu, Pass::Adam, KernelId::Apply(rows.color_model), &buffers, groups);
        }
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.commands.encode(&mut encoder, None);
        self.gpu.queue.submit([encoder.finish()]);
        self.batch = batch;
        self.gpu.check()
    }
}

/// Returns where the value of a row of the shard's splat `i` lies among the blocks.
fn place(shard: &Shard, i: usize, row: usize, block_len: usize) -> usize {
    let splat = shard.base + i;
    splat / SPLATS_PER_BLOCK * block_len + row * SPLATS_PER_BLOCK + splat % SPLATS_PER_BLOCK
}

/// Returns some rows of the shard's splats, zero for those without a gradient.
fn shard_rows(gradients: &SparseGradients, shard: &Shard, first_row: usize, rows: usize) -> Vec<f32> {
    let mut out = vec![0.0; rows * shard.stride];
    for (block, values) in gradients.iter() {
        let base = block as usize * SPLATS_PER_BLOCK;
        let own = base.max(shard.base)..(base + SPLATS_PER_BLOCK).min(shard.base + shard.len);
        for row in 0..rows {
            for splat in own.clone() {
                out[row * shard.stride + splat - shard.base] = values[(first_row + row) * SPLATS_PER_BLOCK + splat - base];
            }
        }
    }
    out
}
