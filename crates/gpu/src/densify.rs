//! Pass `densify`: uploads a plan to the device, which rebuilds the scene from it.
//!
//! In: scene, [`DensifyPlan`]. Out: a new scene. The shader is passes/densify.wgsl. Degenerate: a
//! plan that does not fit the scene is an error.

use luxel_core::engine::{DensifyPlan, PlanRow};
use luxel_core::{EngineError, Pass};

use crate::commands::{Commands, Groups, bind};
use crate::device::Gpu;
use crate::kernels::KernelId;
use crate::layout::{DENSIFY_CAP, DENSIFY_SMOOTHING, DensifyUniform, PLAN_KEEP_MOMENTS, PLAN_NEW_OPACITY, PlanRowData};
use crate::scene::{GpuScene, Shard};

/// Rows per workgroup.
const ROWS: u64 = 256;

/// Converts the rows of the plan to the shader's structure.
fn rows(plan: &DensifyPlan, shard: &Shard) -> Vec<PlanRowData> {
    let row = |(i, row): (usize, &PlanRow)| PlanRowData {
        source: row.source,
        flags: if row.keep_moments { PLAN_KEEP_MOMENTS } else { 0 } | row.opacity_logit.map_or(0, |_| PLAN_NEW_OPACITY),
        opacity_logit: row.opacity_logit.unwrap_or(0.0),
        log_scale_shift: row.log_scale_shift,
        offset_sigma: row.offset_sigma,
        smoothing: plan.smoothing.as_ref().and_then(|smoothing| smoothing.get(i)).copied().unwrap_or(0.0),
    };
    plan.rows.iter().enumerate().skip(shard.base).take(shard.len).map(row).collect()
}

/// Builds the scene that `plan` makes of `old`. Its statistics are zero.
pub(crate) fn apply(
    gpu: &Gpu,
    commands: &mut Commands,
    old: &GpuScene,
    plan: &DensifyPlan,
    shard_len: usize,
) -> Result<GpuScene, EngineError> {
    let gain = plan.rows.iter().filter_map(|row| old.gain.get(row.source as usize)).copied().collect();
    let mut scene = GpuScene::with_gain(gpu, old.rows, plan.rows.len(), shard_len, gain)?;
    scene.has_smoothing = old.has_smoothing || plan.smoothing.is_some();
    let cap = plan.opacity_logit_cap;
    for shard in &scene.shards {
        let rows = rows(plan, shard);
        let buffer = gpu.storage("plan", size_of_val(rows.as_slice()) as u64)?;
        gpu.queue.write_buffer(&buffer.raw, 0, bytemuck::cast_slice(&rows));
        for source in &old.shards {
            let config = gpu.uniform(
                "densify",
                &DensifyUniform {
                    source_base: source.base as u32,
                    source_len: source.len as u32,
                    source_stride: source.stride as u32,
                    // Only the rows of this shard were uploaded.
                    base: 0,
                    len: shard.len as u32,
                    stride: shard.stride as u32,
                    flags: cap.map_or(0, |_| DENSIFY_CAP) | plan.smoothing.as_ref().map_or(0, |_| DENSIFY_SMOOTHING),
                    opacity_logit_cap: cap.unwrap_or(0.0),
                },
            )?;
            let buffers = [
                bind(0, &config),
                bind(1, &buffer),
                bind(2, &source.parameters),
                bind(3, &source.first),
                bind(4, &source.second),
                bind(5, &shard.parameters),
                bind(6, &shard.first),
                bind(7, &shard.second),
            ];
            let groups = Groups::Line((shard.len as u64).div_ceil(ROWS));
            commands.add(gpu, Pass::Densify, KernelId::Densify(scene.rows.color_model), &buffers, groups);
        }
    }
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    commands.encode(&mut encoder, None);
    let submission = gpu.queue.submit([encoder.finish()]);
    commands.forget();
    // Both scenes are in memory until the device has finished.
    gpu.wait(submission)?;
    Ok(scene)
}
