//! What host and shaders share: constants, and structures byte by byte.
//!
//! Constants of the method come from core; those of this engine stand here, once, and are put in front of every shader. Structures are
//! compared with the shaders' by naga in this module's tests.

use std::fmt::Write;

use bytemuck::{Pod, Zeroable};
use luxel_core::metrics::{SSIM_C1, SSIM_C2, SSIM_RADIUS, ssim_window};
use luxel_core::{
    ADAM_BETA1, ADAM_BETA2, ADAM_EPSILON, Activation, ColorModel, DEAD_CHROMA_FLOOR, MAX_EXP_ARGUMENT, MIN_AREA_RATIO, SH_OFFSET, sh,
};

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
const CULLED_KEY: u32 = (1 << (DIGIT_BITS * DEPTH_DIGITS)) - 1;
/// Entries of a splat that one thread sums.
const GATHER_ALONE: u32 = 32;
/// Workgroups along one dimension of a dispatch, at most: what every adapter allows.
pub(crate) const MAX_GROUPS: u32 = 65_535;
/// Enlarges footprints against rounding, pixels.
const MARGIN_PX: f32 = 0.01;

/// [`CameraUniform::flags`].
pub(crate) const FLAG_MIP: u32 = 1;
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

/// Rows of a shard's parameters, `[rows, stride]`: position 3, rotation 4, log scale 3, opacity logit, harmonics 3K, raw luminance M; behind
/// them the 3D filter, which is no parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Rows {
    pub(crate) color_model: ColorModel,
}

impl Rows {
    pub(crate) const POSITION: usize = 0;
    pub(crate) const ROTATION: usize = 3;
    pub(crate) const LOG_SCALE: usize = 7;
    pub(crate) const OPACITY: usize = 10;
    pub(crate) const SH: usize = 11;

    pub(crate) fn luminance(self) -> usize {
        Self::SH + 3 * self.color_model.sh_coefficients()
    }

    /// Parameters of a splat; the row of the 3D filter.
    pub(crate) fn parameters(self) -> usize {
        self.luminance() + self.color_model.luminance_coefficients()
    }
}

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
    pub(crate) padding: u32,
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
    pub(crate) l1_factor: f32,
    pub(crate) ssim_factor: f32,
    pub(crate) l1_mean: f32,
    pub(crate) ssim_mean: f32,
    pub(crate) is_masked: u32,
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

/// Constants in front of every shader.
pub(crate) fn constants() -> String {
    let mut text = String::new();
    let integers = [
        ("TILE_PX", TILE_PX),
        ("TILE_PIXELS", TILE_PX * TILE_PX),
        ("BUCKET", BUCKET),
        ("SORT_BLOCK", SORT_BLOCK),
        ("DIGITS", DIGITS),
        ("CULLED_KEY", CULLED_KEY),
        ("GATHER_ALONE", GATHER_ALONE),
        ("MAX_GROUPS", MAX_GROUPS),
        ("FLAG_MIP", FLAG_MIP),
        ("FLAG_SMOOTHING", FLAG_SMOOTHING),
        ("FLAG_MIN_CONTRIBUTION", FLAG_MIN_CONTRIBUTION),
        ("FLAG_TRAINING", FLAG_TRAINING),
        ("FLAG_ABSOLUTE", FLAG_ABSOLUTE),
        ("SORT_ENTRIES", SORT_ENTRIES),
        ("SORT_IDENTITY", SORT_IDENTITY),
        ("HALT_NONE", HALT_NONE),
        ("HALT_OVERFLOW", HALT_OVERFLOW),
        ("HALT_NOT_FINITE", HALT_NOT_FINITE),
        ("PLAN_KEEP_MOMENTS", PLAN_KEEP_MOMENTS),
        ("PLAN_NEW_OPACITY", PLAN_NEW_OPACITY),
        ("DENSIFY_CAP", DENSIFY_CAP),
        ("DENSIFY_SMOOTHING", DENSIFY_SMOOTHING),
        ("SSIM_RADIUS", SSIM_RADIUS as u32),
        ("SSIM_TAPS", 2 * SSIM_RADIUS as u32 + 1),
        ("ROW_POSITION", Rows::POSITION as u32),
        ("ROW_ROTATION", Rows::ROTATION as u32),
        ("ROW_LOG_SCALE", Rows::LOG_SCALE as u32),
        ("ROW_OPACITY", Rows::OPACITY as u32),
        ("ROW_SH", Rows::SH as u32),
        ("ACTIVATION_SOFTPLUS", 0),
        ("ACTIVATION_EXP", 1),
        ("ACTIVATION_RELU", 2),
    ];
    for (name, value) in integers {
        declare(&mut text, name, "u32", &format!("{value}u"));
    }
    let numbers = [
        ("MARGIN_PX", MARGIN_PX),
        ("MIN_AREA_RATIO", MIN_AREA_RATIO),
        ("SQRT_HALF_LOG2_E", std::f32::consts::LOG2_E.sqrt() * std::f32::consts::FRAC_1_SQRT_2),
        ("LOG2_E", std::f32::consts::LOG2_E),
        ("TWO_LN_2", 2.0 * std::f32::consts::LN_2),
        ("TAU", std::f32::consts::TAU),
        ("MAX_EXP_ARGUMENT", MAX_EXP_ARGUMENT),
        ("DEAD_CHROMA_FLOOR", DEAD_CHROMA_FLOOR),
        ("SH_OFFSET", SH_OFFSET),
        ("SSIM_C1", SSIM_C1 as f32),
        ("SSIM_C2", SSIM_C2 as f32),
        ("ADAM_BETA1", ADAM_BETA1),
        ("ADAM_BETA2", ADAM_BETA2),
        ("ADAM_EPSILON", ADAM_EPSILON),
        ("SH_C0", sh::C0),
        ("SH_C1", sh::C1),
    ];
    for (name, value) in numbers {
        declare(&mut text, name, "f32", &number(value));
    }
    let window = ssim_window().map(|weight| weight as f32);
    let tables: [(&str, &[f32]); 5] =
        [("SSIM_WINDOW", &window), ("SH_C2", &sh::C2), ("SH_C3", &sh::C3), ("SH_C4", &sh::C4), ("SH_C5", &sh::C5)];
    for (name, values) in tables {
        let list: Vec<String> = values.iter().map(|v| number(*v)).collect();
        let kind = format!("array<f32, {}>", values.len());
        declare(&mut text, name, &kind, &format!("{kind}({})", list.join(", ")));
    }
    text
}

/// Constants that follow from the colour model.
pub(crate) fn model_constants(model: ColorModel, update: Update) -> String {
    let rows = Rows { color_model: model };
    let (luminance_degree, activation) = match model {
        ColorModel::Sh { .. } => (0, Activation::Softplus),
        ColorModel::Lcd { luminance_degree, activation, .. } => (u32::from(luminance_degree), activation),
    };
    let activation = match activation {
        Activation::Softplus => "ACTIVATION_SOFTPLUS",
        Activation::Exp => "ACTIVATION_EXP",
        Activation::Relu => "ACTIVATION_RELU",
    };
    let mut text = String::new();
    let integers = [
        ("SH_DEGREE", model.sh_degree() as u32),
        ("LUMINANCE_DEGREE", luminance_degree),
        ("MAX_MODEL_DEGREE", model.max_degree() as u32),
        ("SH_COEFFICIENTS", model.sh_coefficients() as u32),
        ("LUMINANCE_COEFFICIENTS", model.luminance_coefficients() as u32),
        ("ROW_LUMINANCE", rows.luminance() as u32),
        ("ROW_SMOOTHING", rows.parameters() as u32),
        ("ROWS", rows.parameters() as u32),
    ];
    for (name, value) in integers {
        declare(&mut text, name, "u32", &format!("{value}u"));
    }
    declare(&mut text, "ACTIVATION", "u32", activation);
    declare(&mut text, "IS_LCD", "bool", &matches!(model, ColorModel::Lcd { .. }).to_string());
    declare(&mut text, "ONLY_GRADIENTS", "bool", &(update == Update::OnlyGradients).to_string());
    text
}

fn declare(text: &mut String, name: &str, kind: &str, value: &str) {
    // Writing to a string does not fail.
    let _ = writeln!(text, "const {name}: {kind} = {value};");
}

/// The shortest decimal that reads back as `value`.
fn number(value: f32) -> String {
    format!("{value:?}f")
}

#[cfg(test)]
mod tests {
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
                padding
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
        check!(KernelId::LossSsim, "Loss", LossUniform, [mu, scale, ssim_weight, l1_factor, ssim_factor, l1_mean, ssim_mean, is_masked]);
        let densify = KernelId::Densify(MODEL);
        check!(densify, "Densify", DensifyUniform, [source_base, source_len, source_stride, base, len, stride, flags, opacity_logit_cap]);
        check!(densify, "PlanRow", PlanRowData, [source, flags, opacity_logit, log_scale_shift, offset_sigma, smoothing]);
        check!(KernelId::BinScan, "Dispatches", Dispatches, [sort, padding, buckets, padding_2]);
        for kernel in [KernelId::BinRanges, KernelId::RasterizeBackward] {
            check!(kernel, "Bucket", Bucket, [tile, first, len, before]);
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

    #[test]
    fn constants_read_back_to_the_bit() {
        for value in [ADAM_EPSILON, sh::C0, MARGIN_PX, f32::MIN_POSITIVE, 1e30, -0.1] {
            assert_eq!(number(value).trim_end_matches('f').parse::<f32>().unwrap().to_bits(), value.to_bits());
        }
    }
}
