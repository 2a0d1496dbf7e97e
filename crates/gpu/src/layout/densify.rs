//! Layouts of densification: a plan's shards and rows.

use bytemuck::{Pod, Zeroable};

/// A pair of an old and a new shard of a plan. Twin: `Densify` in densify.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct DensifyUniform {
    /// First splat of the old shard.
    pub(crate) source_base: u32,
    /// Number of splats of the old shard.
    pub(crate) source_len: u32,
    /// Length of a row of the old shard.
    pub(crate) source_stride: u32,
    /// First row of the new shard in the plan.
    pub(crate) base: u32,
    /// Number of rows of the new shard.
    pub(crate) len: u32,
    /// Length of a row of the new shard.
    pub(crate) stride: u32,
    /// Sum of `DENSIFY_` constants.
    pub(crate) flags: u32,
    /// Largest opacity logit, if [`super::DENSIFY_CAP`] is set.
    pub(crate) opacity_logit_cap: f32,
}

/// A row of a plan. Twin: `PlanRow` in densify.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct PlanRowData {
    /// Splat of the old scene.
    pub(crate) source: u32,
    /// Sum of `PLAN_` constants.
    pub(crate) flags: u32,
    /// Opacity logit, if [`super::PLAN_NEW_OPACITY`] is set.
    pub(crate) opacity_logit: f32,
    /// Added to the log scale.
    pub(crate) log_scale_shift: f32,
    /// Offset of the position, standard deviations along the splat's axes.
    pub(crate) offset_sigma: [f32; 3],
    /// 3D filter, if [`super::DENSIFY_SMOOTHING`] is set.
    pub(crate) smoothing: f32,
}
