//! Comparison of the structures with the shaders', by naga.

use luxel_core::ColorModel;

use super::*;
use crate::constants::Update;
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
    let lens_fields = KernelId::ProjectRays(MODEL, 0);
    check!(
        lens_fields,
        "Lens",
        LensUniform,
        [
            coefficients,
            size_0,
            size_1,
            size_2,
            middle,
            inverse_half_range,
            least_cosine,
            max_angle,
            max_radius,
            stretch,
            is_panorama,
            padding,
        ]
    );
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
            samples,
            dropout_rate,
            opacity_factor,
            dropout_seed,
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
            beta_1,
            beta_2,
            padding_0,
            padding_1,
            padding_2
        ]
    );
    check!(KernelId::SortCount, "Sort", SortUniform, [shift, count, flags, bits]);
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
            target_scale,
            inverse_unit,
            log_gain,
            axis_px,
            padding_2
        ]
    );
    let densify = KernelId::Densify(MODEL);
    check!(densify, "Densify", DensifyUniform, [source_base, source_len, source_stride, base, len, stride, flags, opacity_logit_cap]);
    check!(densify, "PlanRow", PlanRowData, [source, flags, opacity_logit, log_scale_shift, offset_sigma, smoothing]);
    check!(KernelId::BinEmit, "Entry", Entry, [splat, blocks]);
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
