//! Constants and structures that host and shaders share.
//!
//! Constants of the method come from core. Those of this engine are defined here, once, and are put
//! in front of every shader (`constants.rs`). Structures have the shaders' layout byte by byte;
//! this module's tests compare them by naga.

mod densify;

use bytemuck::{Pod, Zeroable};
use luxel_core::VIGNETTING_TERMS;

pub(crate) use self::densify::{DensifyUniform, PlanRowData};

/// Side of a tile, pixels: each pixel of a tile is a thread of a workgroup.
pub(crate) const TILE_PX: u32 = 16;
/// Size of a block of pixels: a tile is blocks of one size, each of which passes over splats that
/// do not touch it.
pub(crate) const BLOCK_PX: [u32; 2] = [8, 4];
/// Blocks of a tile.
pub(crate) const BLOCKS: u32 = TILE_PX * TILE_PX / (BLOCK_PX[0] * BLOCK_PX[1]);
/// Splats per workgroup of the backward pass, whose threads are now the splats and now the pixels
/// of a block: a subgroup on most hardware, so that its barriers cost nothing.
pub(crate) const BUCKET: u32 = BLOCK_PX[0] * BLOCK_PX[1];
/// Pairs that a workgroup of the sort counts and scatters.
pub(crate) const SORT_BLOCK: u32 = 1024;
/// Greatest number of bits of a digit of the sort: three such digits hold a depth. The digits of a
/// tile are as many, and as short, as the number of tiles allows.
pub(crate) const DIGIT_BITS: u32 = 9;
/// Greatest number of values of a digit.
pub(crate) const DIGITS: u32 = 1 << DIGIT_BITS;
/// Digits in the key of a depth.
pub(crate) const DEPTH_DIGITS: u32 = 3;
/// Key of a splat that is not visible: the sort leaves it out.
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
pub(crate) const FLAG_EDIT_GAIN: u32 = 32;

/// [`SortUniform::flags`]: the number of pairs is the step's number of entries.
pub(crate) const SORT_ENTRIES: u32 = 1;
/// [`SortUniform::flags`]: the values are the pairs' places.
pub(crate) const SORT_IDENTITY: u32 = 2;
/// [`SortUniform::flags`]: pairs with [`CULLED_KEY`] are left out; the number of the others becomes
/// [`State::visible`].
pub(crate) const SORT_COMPACT: u32 = 4;
/// [`SortUniform::flags`]: the number of pairs is [`State::visible`].
pub(crate) const SORT_VISIBLE: u32 = 8;

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
    /// First row of camera_from_world; w is the translation.
    pub(crate) row_x: [f32; 4],
    /// Second row.
    pub(crate) row_y: [f32; 4],
    /// Third row.
    pub(crate) row_z: [f32; 4],
    /// World coordinates of the camera; w is unused.
    pub(crate) eye: [f32; 4],
    /// Radiance behind all splats; w is unused.
    pub(crate) background: [f32; 4],
    /// Focal lengths.
    pub(crate) focal_px: [f32; 2],
    /// Principal point.
    pub(crate) center_px: [f32; 2],
    /// Least x/z and y/z at which the projection's Jacobian is evaluated.
    pub(crate) slope_min: [f32; 2],
    /// Greatest x/z and y/z at which the projection's Jacobian is evaluated.
    pub(crate) slope_max: [f32; 2],
    /// Size of the image; with supersampling, in samples.
    pub(crate) size_px: [u32; 2],
    /// Number of tiles across and down.
    pub(crate) tiles: [u32; 2],
    /// See [`luxel_core::Cutoffs::min_alpha`].
    pub(crate) min_alpha: f32,
    /// See [`luxel_core::Cutoffs::min_contribution`]; used if [`FLAG_MIN_CONTRIBUTION`] is set.
    pub(crate) min_contribution: f32,
    /// See [`luxel_core::Cutoffs::alpha_floor`].
    pub(crate) alpha_floor: f32,
    /// See [`luxel_core::Cutoffs::min_transmittance`].
    pub(crate) min_transmittance: f32,
    /// See [`luxel_core::Cutoffs::max_alpha`].
    pub(crate) max_alpha: f32,
    /// See [`luxel_core::Cutoffs::near`].
    pub(crate) near: f32,
    /// Variance that is added to footprints.
    pub(crate) dilation_px2: f32,
    /// Degree up to which harmonics are evaluated.
    pub(crate) active_degree: u32,
    /// Sum of `FLAG_` constants.
    pub(crate) flags: u32,
    /// Number of splats in all shards.
    pub(crate) count: u32,
    /// Number of entries for which the buffers have room.
    pub(crate) entry_capacity: u32,
    /// Samples along the side of a pixel of the image.
    pub(crate) samples: u32,
    /// See [`luxel_core::engine::Dropout::rate`]; 0 for all splats.
    pub(crate) dropout_rate: f32,
    /// See [`luxel_core::engine::Dropout::opacity_factor`].
    pub(crate) opacity_factor: f32,
    /// See [`luxel_core::engine::Dropout::seed`].
    pub(crate) dropout_seed: u32,
    /// Unused.
    pub(crate) padding: u32,
}

/// The lens of a camera whose pixels are rays. Twin: `Lens` in lens.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct LensUniform {
    /// k1 to k4 of a fisheye.
    pub(crate) coefficients: [f32; 4],
    /// First coefficients of [`luxel_core::engine::PixelAngle`].
    pub(crate) size_0: [f32; 4],
    /// Next coefficients.
    pub(crate) size_1: [f32; 4],
    /// Last coefficients.
    pub(crate) size_2: [f32; 4],
    /// Middle of the range of cosines.
    pub(crate) middle: f32,
    /// Reciprocal of half of that range.
    pub(crate) inverse_half_range: f32,
    /// Least cosine between a ray and the axis.
    pub(crate) least_cosine: f32,
    /// Angle to the axis up to which a fisheye sees.
    pub(crate) max_angle: f32,
    /// Its radius, for a focal length of 1.
    pub(crate) max_radius: f32,
    /// Largest growth of distances from the sphere to the plane of a fisheye.
    pub(crate) stretch: f32,
    /// 1 for panoramas, else 0.
    pub(crate) is_panorama: u32,
    /// Unused.
    pub(crate) padding: u32,
}

/// A part of the scene that fits into bindings. Twin: `Shard` in common.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct ShardUniform {
    /// First splat of the shard in the scene.
    pub(crate) base: u32,
    /// Number of splats.
    pub(crate) len: u32,
    /// Length of a row: the number of splats for which the shard's buffers have room.
    pub(crate) stride: u32,
    /// Unused.
    pub(crate) padding: u32,
}

/// The results of a step for the host and for later passes. Twin: `State` in common.wgsl.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct State {
    /// Number of entries: pairs of a splat and a tile.
    pub(crate) entries: u32,
    /// Reason why later passes change nothing: a `HALT_` constant.
    pub(crate) halted: u32,
    /// Number of entries that larger buffers would hold.
    pub(crate) needed: u32,
    /// Number of splats that touch the image.
    pub(crate) visible: u32,
    /// Mean absolute difference.
    pub(crate) l1: f32,
    /// Mean structural similarity.
    pub(crate) ssim: f32,
    /// Total loss.
    pub(crate) loss: f32,
    /// Unused.
    pub(crate) padding: u32,
}

/// A digit of a sort. Twin: `Sort` in sort.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct SortUniform {
    /// First bit of the digit.
    pub(crate) shift: u32,
    /// Number of pairs, unless [`SORT_ENTRIES`] or [`SORT_VISIBLE`] is set.
    pub(crate) count: u32,
    /// Sum of `SORT_` constants.
    pub(crate) flags: u32,
    /// Bits of the digit.
    pub(crate) bits: u32,
}

/// The loss of a step. Twin: `Loss` in loss.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct LossUniform {
    /// Parameter of the mu-law.
    pub(crate) mu: f32,
    /// 1 / ln(1 + mu).
    pub(crate) scale: f32,
    /// Weight of 1 - SSIM.
    pub(crate) ssim_weight: f32,
    /// Part of the absolute difference that is not squared.
    pub(crate) l1_weight: f32,
    /// Part that is squared, divided by twice the difference at which both have the same slope.
    pub(crate) l2_weight: f32,
    /// Factor of the sign of the difference in the gradient by the mu-law's value.
    pub(crate) l1_factor: f32,
    /// Factor of the difference.
    pub(crate) l2_factor: f32,
    /// Factor of half the derivative of the sum of SSIM.
    pub(crate) ssim_factor: f32,
    /// 1 / the sum of weights over pixels and channels.
    pub(crate) l1_mean: f32,
    /// 1 / the number of pixels and channels.
    pub(crate) ssim_mean: f32,
    /// 1 if pixels have weights.
    pub(crate) is_masked: u32,
    /// Unused.
    pub(crate) padding: u32,
    /// Factor of each channel of the target.
    pub(crate) target_scale: [f32; 3],
    /// Reciprocal of [`luxel_core::Vignetting::unit_px`].
    pub(crate) inverse_unit: f32,
    /// See [`luxel_core::Vignetting::log_gain`].
    pub(crate) log_gain: [f32; VIGNETTING_TERMS],
    /// See [`luxel_core::Vignetting::axis_px`].
    pub(crate) axis_px: [f32; 2],
    /// Unused.
    pub(crate) padding_2: [u32; 2],
}

/// The optimiser at a step. Twin: `Optimizer` in adam.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct OptimizerUniform {
    /// Rate of the position; all rates are divided by 1 - beta_1^t.
    pub(crate) position: f32,
    /// Rate of the quaternion.
    pub(crate) rotation: f32,
    /// Rate of the log scale.
    pub(crate) log_scale: f32,
    /// Rate of the opacity logit.
    pub(crate) opacity_logit: f32,
    /// Rate of the harmonics of degree 0.
    pub(crate) sh_dc: f32,
    /// Rate of the harmonics above degree 0.
    pub(crate) sh_rest: f32,
    /// Rate of the raw luminance of degree 0.
    pub(crate) luminance_dc: f32,
    /// Rate of the raw luminance above degree 0.
    pub(crate) luminance_rest: f32,
    /// sqrt(1 / (1 - beta_2^t)).
    pub(crate) root_correction_2: f32,
    /// Weight of the mean opacity, divided by the number of splats.
    pub(crate) opacity_weight: f32,
    /// Weight of the mean scale, divided by the number of scales.
    pub(crate) scale_weight: f32,
    /// Scale of the positions' noise; 0 for none.
    pub(crate) noise_scale: f32,
    /// Low half of the noise's seed.
    pub(crate) seed_low: u32,
    /// High half of the noise's seed.
    pub(crate) seed_high: u32,
    /// 1 if statistics are collected.
    pub(crate) stats: u32,
    /// Decay rate of the first moments.
    pub(crate) beta_1: f32,
    /// Decay rate of the second moments.
    pub(crate) beta_2: f32,
    /// Unused.
    pub(crate) padding_0: u32,
    /// Unused.
    pub(crate) padding_1: u32,
    /// Unused.
    pub(crate) padding_2: u32,
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

/// Entries of a tile that a workgroup of the backward pass differentiates. Twin: `Bucket` in
/// bin.wgsl and unwind.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Bucket {
    /// Number of the tile.
    pub(crate) tile: u32,
    /// First entry.
    pub(crate) first: u32,
    /// Number of entries; 0 if the slot is unused.
    pub(crate) len: u32,
    /// Number of the tile's entries in front of the bucket.
    pub(crate) before: u32,
}

/// In front of the buckets in their buffer: the head of `Buckets` in bin.wgsl and unwind.wgsl.
pub(crate) const BUCKETS_HEAD_BYTES: u64 = 16;

/// Arguments of the dispatches whose sizes the device computes. Twin: `Dispatches` in bin.wgsl.
/// Offsets of its fields are those of indirect dispatches.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Dispatches {
    /// Workgroups of the sort by tile.
    pub(crate) sort: [u32; 3],
    /// Unused.
    pub(crate) padding: u32,
    /// Workgroups of the backward pass.
    pub(crate) buckets: [u32; 3],
    /// Unused.
    pub(crate) padding_2: u32,
}

/// A pair of a splat and a tile. Twin: `Entry` in footprint.wgsl.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Entry {
    /// Number of the splat.
    pub(crate) splat: u32,
    /// One bit for each of the tile's blocks that the splat touches.
    pub(crate) blocks: u32,
}

/// Sums over an entry's pixels: three vec4f in rasterize_backward.wgsl.
pub(crate) const ENTRY_GRADIENT_BYTES: u64 = 48;
/// Transmittance and radiance of a bucket's pixels: rasterize.wgsl.
pub(crate) const BUCKET_PIXELS_BYTES: u64 = 16 * (TILE_PX * TILE_PX) as u64;
/// Sums of a workgroup for the gradient by the camera: two vec4f in camera_backward.wgsl.
pub(crate) const CAMERA_SUMS_BYTES: u64 = 32;
/// Sums of a workgroup of the loss: a vec4f in loss.wgsl and vignetting.wgsl.
pub(crate) const GROUP_SUMS_BYTES: u64 = 4 * VIGNETTING_TERMS as u64;
/// Rows of a shard's statistics: gradient, absolute gradient, views.
pub(crate) const STATS_ROWS: usize = 3;

#[cfg(test)]
mod tests;
