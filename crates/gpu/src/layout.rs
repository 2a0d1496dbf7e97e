//! What host and shaders share: constants, and structures byte by byte.
//!
//! Constants of the method come from core; those of this engine stand here, once, and are put in front of every shader. Structures are
//! compared with the shaders' by naga in this module's tests.

use bytemuck::{Pod, Zeroable};

/// Side of a tile, pixels: its pixels are a workgroup's threads.
pub(crate) const TILE_PX: u32 = 16;
/// Splats that a workgroup of the backward pass differentiates, a thread each: a subgroup on most hardware, so that its barriers cost nothing.
pub(crate) const BUCKET: u32 = 32;
/// Pairs that a workgroup of the sort counts and scatters.
pub(crate) const SORT_BLOCK: u32 = 1024;
/// Bits of a digit of the sort: three digits hold a depth, one or two a tile.
pub(crate) const DIGIT_BITS: u32 = 9;
/// Values of a digit.
pub(crate) const DIGITS: u32 = 1 << DIGIT_BITS;
/// Digits of a depth's key.
pub(crate) const DEPTH_DIGITS: u32 = 3;
/// Key of a splat that is not seen: behind all others.
pub(crate) const CULLED_KEY: u32 = (1 << (DIGIT_BITS * DEPTH_DIGITS)) - 1;
/// Entries of a splat that one thread sums.
pub(crate) const GATHER_ALONE: u32 = 32;
/// Workgroups along one dimension of a dispatch, at most: what every adapter allows.
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

/// Camera and options. Twin: `Camera` in common.wgsl.
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

/// Whether the update moves parameters or shows its gradients.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Update {
    /// Adam.
    Parameters,
    /// Gradients in place of the first moments.
    OnlyGradients,
}

#[cfg(test)]
mod tests {
    use luxel_core::ColorModel;

    use super::*;
    use crate::kernels::{KernelId, source};

    /// A structure's name, size, and its fields' names and offsets as the shader has them.
    fn shader_struct(kernel: KernelId, name: &str) -> (u32, Vec<(String, u32)>) {
        let module = naga::front::wgsl::parse_str(&source(kernel)).unwrap();
        module
            .types
            .iter()
            .find_map(|(_, ty)| match &ty.inner {
                naga::TypeInner::Struct { members, span } if ty.name.as_deref() == Some(name) => {
                    Some((*span, members.iter().map(|m| (m.name.clone().unwrap(), m.offset)).collect()))
                }
                _ => None,
            })
            .unwrap_or_else(|| panic!("{kernel:?} has no struct {name}"))
    }

    macro_rules! check {
        ($kernel:expr, $name:literal, $twin:ty, [$($field:ident),+ $(,)?]) => {{
            let (size, fields) = shader_struct($kernel, $name);
            assert_eq!(size as usize, size_of::<$twin>(), "size of {}", $name);
            let expected = [$((stringify!($field).to_owned(), std::mem::offset_of!($twin, $field) as u32)),+];
            assert_eq!(fields, expected, "fields of {}", $name);
        }};
    }

    const MODEL: ColorModel = ColorModel::Sh { degree: 3 };

    #[test]
    fn structures_lie_in_memory_as_the_shaders_expect() {
        let update = KernelId::ProjectBackward(MODEL, Update::Parameters);
        check!(
            update,
            "Camera",
            CameraUniform,
            [
                row_x,
                row_y,
                row_z,
                eye,
                background,
                focal_px,
                center_px,
                slope_min,
                slope_max,
                size_px,
                tiles,
                min_alpha,
                min_contribution,
                alpha_floor,
                min_transmittance,
                max_alpha,
                near,
                dilation_px2,
                active_degree,
                flags,
                count,
                entry_capacity,
                samples
            ]
        );
        check!(update, "Shard", ShardUniform, [base, len, stride, padding]);
        check!(update, "State", State, [entries, halted, needed, visible, l1, ssim, loss, padding]);
        check!(
            update,
            "Optimizer",
            OptimizerUniform,
            [
                position,
                rotation,
                log_scale,
                opacity_logit,
                sh_dc,
                sh_rest,
                luminance_dc,
                luminance_rest,
                root_correction_2,
                opacity_weight,
                scale_weight,
                noise_scale,
                seed_low,
                seed_high,
                stats,
                padding
            ]
        );
        check!(KernelId::SortCount, "Sort", SortUniform, [shift, count, flags, padding]);
        check!(
            KernelId::LossSsim,
            "Loss",
            LossUniform,
            [
                mu,
                scale,
                ssim_weight,
                l1_weight,
                l2_weight,
                l1_factor,
                l2_factor,
                ssim_factor,
                l1_mean,
                ssim_mean,
                is_masked,
                padding,
                target_scale
            ]
        );
        let densify = KernelId::Densify(MODEL);
        check!(densify, "Densify", DensifyUniform, [source_base, source_len, source_stride, base, len, stride, flags, opacity_logit_cap]);
        check!(densify, "PlanRow", PlanRowData, [source, flags, opacity_logit, log_scale_shift, offset_sigma, smoothing]);
        check!(KernelId::BinScan, "Dispatches", Dispatches, [sort, padding, buckets, padding_2]);
        for kernel in [KernelId::BinRanges, KernelId::RasterizeBackward] {
            check!(kernel, "Bucket", Bucket, [tile, first, len, before]);
            let (_, fields) = shader_struct(kernel, "Buckets");
            assert_eq!(fields.last(), Some(&("slots".to_owned(), BUCKETS_HEAD_BYTES as u32)));
        }
        // The shader has no arrays of three here: they would be strewn over 16 bytes a number.
        let (size, fields) = shader_struct(KernelId::Rasterize, "Footprint");
        assert_eq!(size as usize, size_of::<Footprint>());
        let offset = |name: &str| fields.iter().find(|(field, _)| field == name).map(|(_, offset)| *offset as usize).unwrap();
        for (name, expected) in [
            ("mean_px", std::mem::offset_of!(Footprint, mean_px)),
            ("root_x", std::mem::offset_of!(Footprint, root)),
            ("root_xy", std::mem::offset_of!(Footprint, root) + 4),
            ("root_y", std::mem::offset_of!(Footprint, root) + 8),
            ("log2_opacity", std::mem::offset_of!(Footprint, log2_opacity)),
            ("log2_threshold", std::mem::offset_of!(Footprint, log2_threshold)),
            ("red", std::mem::offset_of!(Footprint, radiance)),
            ("green", std::mem::offset_of!(Footprint, radiance) + 4),
            ("blue", std::mem::offset_of!(Footprint, radiance) + 8),
            ("extent_y_px", std::mem::offset_of!(Footprint, extent_y_px)),
            ("right_dy_px", std::mem::offset_of!(Footprint, right_dy_px)),
        ] {
            assert_eq!(offset(name), expected, "{name}");
        }
    }
}
