//! Constants and structures that host and shaders share.
//!
//! Constants of the method come from core. Those of this engine are defined here, once, and are put
//! in front of every shader (`constants.rs`). Structures have the shaders' layout byte by byte;
//! this module's tests compare them by naga.

use bytemuck::{Pod, Zeroable};

/// Side of a tile, pixels: each pixel of a tile is a thread of a workgroup.
pub(crate) const TILE_PX: u32 = 16;
/// Splats per workgroup of the backward pass, one for each thread: a subgroup on most hardware, so
/// that its barriers cost nothing.
pub(crate) const BUCKET: u32 = 32;
/// Pairs that a workgroup of the sort counts and scatters.
pub(crate) const SORT_BLOCK: u32 = 1024;
/// Bits of a digit of the sort: three digits hold a depth, one or two a tile.
pub(crate) const DIGIT_BITS: u32 = 9;
/// Number of values of a digit.
pub(crate) const DIGITS: u32 = 1 << DIGIT_BITS;
/// Digits in the key of a depth.
pub(crate) const DEPTH_DIGITS: u32 = 3;
/// Key of a splat that is not visible: behind all others.
pub(crate) const CULLED_KEY: u32 = (1 << (DIGIT_BITS * DEPTH_DIGITS)) - 1;
/// Greatest number of entries of a splat that one thread sums.
pub(crate) const GATHER_ALONE: u32 = 32;
/// Greatest number of workgroups along one dimension of a dispatch that every adapter allows.
pub(crate) const MAX_GROUPS: u32 = 65_535;
/// Enlarges footprints against rounding, pixels.
pub(crate) const MARGIN_PX: f32 = 0.01;

/// [`CameraUniform::flags`].
pub(crate) const FLAG_COMPENSATION: u32 = 1;
pub(crate) const FLAG_SMOOTHING: u32 = 2;
pub(crate) const FLAG_MIN_CONTRIBUTION: u32 = 4;
pub(crate) const FLAG_TRAINING: u32 = 8;
pub(crate) const FLAG_ABSOLUTE: u32 = 16;

/// [`SortUniform::flags`]: the number of pairs is the step's number of entries.
pub(crate) const SORT_ENTRIES: u32 = 1;
/// [`SortUniform::flags`]: the values are the pairs' places.
pub(crate) const SORT_IDENTITY: u32 = 2;

/// [`State::halted`].
pub(crate) const HALT_NONE: u32 = 0;
pub(crate) const HALT_OVERFLOW: u32 = 1;
pub(crate) const HALT_NOT_FINITE: u32 = 2;

/// [`PlanRowData::flags`].
pub(crate) const PLAN_KEEP_MOMENTS: u32 = 1;
pub(crate) const PLAN_NEW_OPACITY: u32 = 2;
/// [`DensifyUniform::flags`].
pub(crate) const DENSIFY_CAP: u32 = 1;
pub(crate) const DENSIFY_SMOOTHING: u32 = 2;

/// The camera with its options. Twin: `Camera` in common.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct CameraUniform {
    pub(crate) row_x: [f32; 4],
    pub(crate) row_y: [f32; 4],
    pub(crate) row_z: [f32; 4],
    pub(crate) eye: [f32; 4],
    pub(crate) background: [f32; 4],
    pub(crate) focal_px: [f32; 2],
    pub(crate) center_px: [f32; 2],
    pub(crate) slope_min: [f32; 2],
    pub(crate) slope_max: [f32; 2],
    pub(crate) size_px: [u32; 2],
    pub(crate) tiles: [u32; 2],
    pub(crate) min_alpha: f32,
    pub(crate) min_contribution: f32,
    pub(crate) alpha_floor: f32,
    pub(crate) min_transmittance: f32,
    pub(crate) max_alpha: f32,
    pub(crate) near: f32,
    pub(crate) dilation_px2: f32,
    pub(crate) active_degree: u32,
    pub(crate) flags: u32,
    pub(crate) count: u32,
    pub(crate) entry_capacity: u32,
    pub(crate) samples: u32,
}

/// Twin: `Shard` in common.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct ShardUniform {
    pub(crate) base: u32,
    pub(crate) len: u32,
    pub(crate) stride: u32,
    pub(crate) padding: u32,
}

/// Twin: `State` in common.wgsl.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct State {
    pub(crate) entries: u32,
    pub(crate) halted: u32,
    pub(crate) needed: u32,
    pub(crate) visible: u32,
    pub(crate) l1: f32,
    pub(crate) ssim: f32,
    pub(crate) loss: f32,
    pub(crate) padding: u32,
}

/// Twin: `Sort` in sort.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct SortUniform {
    pub(crate) shift: u32,
    pub(crate) count: u32,
    pub(crate) flags: u32,
    pub(crate) padding: u32,
}

/// Twin: `Loss` in loss.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct LossUniform {
    pub(crate) mu: f32,
    pub(crate) scale: f32,
    pub(crate) ssim_weight: f32,
    pub(crate) l1_weight: f32,
    pub(crate) l2_weight: f32,
    pub(crate) l1_factor: f32,
    pub(crate) l2_factor: f32,
    pub(crate) ssim_factor: f32,
    pub(crate) l1_mean: f32,
    pub(crate) ssim_mean: f32,
    pub(crate) is_masked: u32,
    pub(crate) padding: u32,
    pub(crate) target_scale: [f32; 3],
    pub(crate) padding_2: u32,
}

/// Twin: `Optimizer` in adam.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct OptimizerUniform {
    pub(crate) position: f32,
    pub(crate) rotation: f32,
    pub(crate) log_scale: f32,
    pub(crate) opacity_logit: f32,
    pub(crate) sh_dc: f32,
    pub(crate) sh_rest: f32,
    pub(crate) luminance_dc: f32,
    pub(crate) luminance_rest: f32,
    pub(crate) root_correction_2: f32,
    pub(crate) opacity_weight: f32,
    pub(crate) scale_weight: f32,
    pub(crate) noise_scale: f32,
    pub(crate) seed_low: u32,
    pub(crate) seed_high: u32,
    pub(crate) stats: u32,
    pub(crate) padding: u32,
}

/// Twin: `Densify` in densify.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct DensifyUniform {
    pub(crate) source_base: u32,
    pub(crate) source_len: u32,
    pub(crate) source_stride: u32,
    pub(crate) base: u32,
    pub(crate) len: u32,
    pub(crate) stride: u32,
    pub(crate) flags: u32,
    pub(crate) opacity_logit_cap: f32,
}

/// Twin: `PlanRow` in densify.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct PlanRowData {
    pub(crate) source: u32,
    pub(crate) flags: u32,
    pub(crate) opacity_logit: f32,
    pub(crate) log_scale_shift: f32,
    pub(crate) offset_sigma: [f32; 3],
    pub(crate) smoothing: f32,
}

/// A splat on the screen. Twin: `Footprint` in footprint.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Footprint {
    /// Centre.
    pub mean_px: [f32; 2],
    /// Triangular root of the inverse covariance, times sqrt(log2(e) / 2): xx, xy, yy.
    pub root: [f32; 3],
    /// log2 of the opacity, after compensation.
    pub log2_opacity: f32,
    /// log2 of the alpha below which the splat is skipped.
    pub log2_threshold: f32,
    /// Radiance towards the camera.
    pub radiance: [f32; 3],
    /// Half the ellipse's extent along y at the threshold.
    pub extent_y_px: f32,
    /// dy at the ellipse's rightmost point.
    pub right_dy_px: f32,
}

/// Twin: `Bucket` in bin.wgsl and unwind.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Bucket {
    pub(crate) tile: u32,
    pub(crate) first: u32,
    pub(crate) len: u32,
    pub(crate) before: u32,
}

/// In front of the buckets in their buffer: the head of `Buckets` in bin.wgsl and unwind.wgsl.
pub(crate) const BUCKETS_HEAD_BYTES: u64 = 16;

/// Twin: `Dispatches` in bin.wgsl. Offsets of its fields are those of indirect dispatches.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Dispatches {
    pub(crate) sort: [u32; 3],
    pub(crate) padding: u32,
    pub(crate) buckets: [u32; 3],
    pub(crate) padding_2: u32,
}

/// Sums over an entry's pixels: three vec4f in rasterize_backward.wgsl.
pub(crate) const ENTRY_GRADIENT_BYTES: u64 = 48;
/// Transmittance and radiance of a bucket's pixels: rasterize.wgsl.
pub(crate) const BUCKET_PIXELS_BYTES: u64 = 16 * (TILE_PX * TILE_PX) as u64;
/// Rows of a shard's statistics: gradient, absolute gradient, views.
pub(crate) const STATS_ROWS: usize = 3;

/// Whether the update moves parameters or only returns their gradients.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Update {
    /// Adam.
    Parameters,
    /// Gradients are stored in place of the first moments.
    OnlyGradients,
}

#[cfg(test)]
mod tests;
