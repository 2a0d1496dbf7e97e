//! The shaders: the files of each kernel, and their pipelines, which are compiled at first use and
//! kept.
//!
//! In: [`KernelId`]. Out: [`Kernel`].
//!
//! The text of a kernel is the constants (`constants.rs`) followed by some of the files in
//! `passes/`; the kernel is one of its entry points.

use luxel_core::ColorModel;

use crate::constants::{Update, constants, model_constants, windows};

/// The identity of a compute shader.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum KernelId {
    /// The projection, with the colour of a light by its number.
    Project(ColorModel, usize),
    SortCount,
    SortScan,
    SortScatter,
    BinSum,
    BinScan,
    BinEmit,
    BinRanges,
    Rasterize,
    LossSsim,
    LossGradient,
    /// The kernels of the loss for images with vignetting.
    LossSsimVignetted,
    LossGradientVignetted,
    VignettingSums,
    RasterizeBackward,
    Gather,
    ProjectBackward(ColorModel, Update),
    CameraBackward(ColorModel),
    /// The same where pixels are rays.
    CameraBackwardRays(ColorModel),
    /// Adam with gradients that are there already.
    Apply(ColorModel),
    Densify(ColorModel),
    Contribute,
    ContributeSum,
    /// The kernels above for cameras whose pixels are rays.
    ProjectRays(ColorModel, usize),
    BinEmitRays,
    RasterizeRays,
    RasterizeBackwardRays,
    ProjectBackwardRays(ColorModel, Update),
    ContributeRays,
    /// The passes over pixels, which count their work.
    RasterizeCounted,
    RasterizeCountedRays,
    RasterizeBackwardCounted,
    RasterizeBackwardCountedRays,
}

macro_rules! file {
    ($name:literal) => {
        include_str!(concat!("passes/", $name, ".wgsl"))
    };
}

const COMMON: &str = file!("common");
const FOOTPRINT: &str = file!("footprint");
const ROTATION: &str = file!("rotation");
const PARAMETERS: &str = file!("parameters");
const GEOMETRY: &str = file!("geometry");
const COLOR: &str = file!("color");
const ADAM: &str = file!("adam");
const NOISE: &str = file!("noise");
const COLOR_BACKWARD: &str = file!("color_backward");
const PROJECT: &str = file!("project");
const PROJECT_BACKWARD: &str = file!("project_backward");
const CAMERA_BACKWARD: &str = file!("camera_backward");
// What depends on the projection: for a pinhole, and, with the lens, for rays.
const ELLIPSE: &str = file!("ellipse");
const LINEARISE: &str = file!("linearise");
const POINT_BACKWARD: &str = file!("point_backward");
const LENS: &str = file!("lens");
const ELLIPSE_RAYS: &str = file!("ellipse_rays");
const LINEARISE_RAYS: &str = file!("linearise_rays");
const POINT_BACKWARD_RAYS: &str = file!("point_backward_rays");
const RASTERIZE: &str = file!("rasterize");
const UNWIND: &str = file!("unwind");
const RASTERIZE_BACKWARD: &str = file!("rasterize_backward");
// Whether work is counted.
const NO_COUNTS: &str = file!("no_counts");
const COUNTS: &str = file!("counts");
const SORT: &[&str] = &[COMMON, file!("sort")];
const BIN: &[&str] = &[COMMON, FOOTPRINT, ELLIPSE, file!("bin")];
const LOSS: &[&str] = &[COMMON, file!("no_vignetting"), file!("loss")];
const LOSS_VIGNETTED: &[&str] = &[COMMON, file!("loss"), file!("vignetting")];

impl KernelId {
    /// Returns the entry point.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Project(..) | Self::ProjectRays(..) => "project",
            Self::SortCount => "sort_count",
            Self::SortScan => "sort_scan",
            Self::SortScatter => "sort_scatter",
            Self::BinSum => "bin_sum",
            Self::BinScan => "bin_scan",
            Self::BinEmit | Self::BinEmitRays => "bin_emit",
            Self::BinRanges => "bin_ranges",
            Self::Rasterize | Self::RasterizeRays | Self::RasterizeCounted | Self::RasterizeCountedRays => "rasterize",
            Self::LossSsim | Self::LossSsimVignetted => "loss_ssim",
            Self::LossGradient | Self::LossGradientVignetted => "loss_gradient",
            Self::VignettingSums => "vignetting_sums",
            Self::RasterizeBackward | Self::RasterizeBackwardRays | Self::RasterizeBackwardCounted | Self::RasterizeBackwardCountedRays => {
                "rasterize_backward"
            }
            Self::Gather => "gather",
            Self::ProjectBackward(..) | Self::ProjectBackwardRays(..) => "project_backward",
            Self::CameraBackward(_) | Self::CameraBackwardRays(_) => "camera_backward",
            Self::Apply(_) => "apply",
            Self::Densify(_) => "densify",
            Self::Contribute | Self::ContributeRays => "contribute",
            Self::ContributeSum => "contribute_sum",
        }
    }

    #[rustfmt::skip]
    pub(crate) fn files(self) -> &'static [&'static str] {
        match self {
            Self::Project(..) => &[COMMON, ROTATION, LINEARISE, PARAMETERS, GEOMETRY, COLOR, FOOTPRINT, ELLIPSE, file!("place"), PROJECT],
            Self::ProjectRays(..) =>
                &[COMMON, LENS, ROTATION, LINEARISE_RAYS, PARAMETERS, GEOMETRY, COLOR, FOOTPRINT, ELLIPSE_RAYS, file!("place_rays"), PROJECT],
            Self::SortCount | Self::SortScan | Self::SortScatter => SORT,
            Self::BinSum | Self::BinScan | Self::BinEmit | Self::BinRanges => BIN,
            Self::BinEmitRays => &[COMMON, LENS, FOOTPRINT, ELLIPSE_RAYS, file!("bin")],
            Self::Rasterize => &[COMMON, FOOTPRINT, ELLIPSE, NO_COUNTS, RASTERIZE],
            Self::RasterizeRays => &[COMMON, LENS, FOOTPRINT, ELLIPSE_RAYS, NO_COUNTS, RASTERIZE],
            Self::RasterizeCounted => &[COMMON, FOOTPRINT, ELLIPSE, COUNTS, RASTERIZE],
            Self::RasterizeCountedRays => &[COMMON, LENS, FOOTPRINT, ELLIPSE_RAYS, COUNTS, RASTERIZE],
            Self::LossSsim | Self::LossGradient => LOSS,
            Self::LossSsimVignetted | Self::LossGradientVignetted | Self::VignettingSums => LOSS_VIGNETTED,
            Self::RasterizeBackward => &[COMMON, FOOTPRINT, ELLIPSE, NO_COUNTS, UNWIND, RASTERIZE_BACKWARD],
            Self::RasterizeBackwardRays => &[COMMON, LENS, FOOTPRINT, ELLIPSE_RAYS, NO_COUNTS, UNWIND, RASTERIZE_BACKWARD],
            Self::RasterizeBackwardCounted => &[COMMON, FOOTPRINT, ELLIPSE, COUNTS, UNWIND, RASTERIZE_BACKWARD],
            Self::RasterizeBackwardCountedRays => &[COMMON, LENS, FOOTPRINT, ELLIPSE_RAYS, COUNTS, UNWIND, RASTERIZE_BACKWARD],
            Self::Gather => &[COMMON, file!("gather")],
            Self::ProjectBackward(..) =>
                &[COMMON, ROTATION, LINEARISE, PARAMETERS, GEOMETRY, COLOR, ADAM, NOISE, COLOR_BACKWARD, POINT_BACKWARD, PROJECT_BACKWARD],
            Self::ProjectBackwardRays(..) => &[
                COMMON, LENS, ROTATION, LINEARISE_RAYS, PARAMETERS, GEOMETRY, COLOR, ADAM, NOISE, COLOR_BACKWARD, POINT_BACKWARD_RAYS, PROJECT_BACKWARD,
            ],
            Self::CameraBackward(_) => &[
                COMMON, ROTATION, LINEARISE, PARAMETERS, GEOMETRY, COLOR, ADAM, NOISE, COLOR_BACKWARD, POINT_BACKWARD, PROJECT_BACKWARD,
                CAMERA_BACKWARD,
            ],
            Self::CameraBackwardRays(_) => &[
                COMMON, LENS, ROTATION, LINEARISE_RAYS, PARAMETERS, GEOMETRY, COLOR, ADAM, NOISE, COLOR_BACKWARD, POINT_BACKWARD_RAYS, PROJECT_BACKWARD,
                CAMERA_BACKWARD,
            ],
            Self::Apply(_) => &[COMMON, ROTATION, PARAMETERS, ADAM, NOISE, file!("apply")],
            Self::Densify(_) => &[COMMON, ROTATION, file!("densify")],
            Self::Contribute => &[COMMON, FOOTPRINT, ELLIPSE, UNWIND, file!("contribute")],
            Self::ContributeRays => &[COMMON, LENS, FOOTPRINT, ELLIPSE_RAYS, UNWIND, file!("contribute")],
            Self::ContributeSum => &[COMMON, file!("contribute_sum")],
        }
    }
}

/// Returns the whole text of a kernel.
pub(crate) fn source(kernel: KernelId) -> String {
    let mut text = constants();
    match kernel {
        KernelId::Project(model, light) | KernelId::ProjectRays(model, light) => {
            text += &model_constants(model, light, Update::Parameters);
        }
        KernelId::Apply(model) | KernelId::Densify(model) => text += &model_constants(model, 0, Update::Parameters),
        KernelId::ProjectBackward(model, update) | KernelId::ProjectBackwardRays(model, update) => {
            text += &model_constants(model, 0, update);
        }
        KernelId::CameraBackward(model) | KernelId::CameraBackwardRays(model) => text += &model_constants(model, 0, Update::OnlyCamera),
        KernelId::LossSsim
        | KernelId::LossGradient
        | KernelId::LossSsimVignetted
        | KernelId::LossGradientVignetted
        | KernelId::VignettingSums => text += &windows(),
        _ => {}
    }
    for file in kernel.files() {
        text.push('\n');
        text.push_str(file);
    }
    text
}

/// A compiled kernel.
pub(crate) struct Kernel {
    pub(crate) pipeline: wgpu::ComputePipeline,
    pub(crate) layout: wgpu::BindGroupLayout,
}

impl Kernel {
    pub(crate) fn compile(device: &wgpu::Device, kernel: KernelId) -> Self {
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(kernel.name()),
            source: wgpu::ShaderSource::Wgsl(source(kernel).into()),
        });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(kernel.name()),
            layout: None,
            module: &module,
            entry_point: Some(kernel.name()),
            compilation_options: wgpu::PipelineCompilationOptions {
                // Zeroing is not needed: every shader writes its workgroup memory before it reads
                // it.
                zero_initialize_workgroup_memory: false,
                ..Default::default()
            },
            cache: None,
        });
        let layout = pipeline.get_bind_group_layout(0);
        Self { pipeline, layout }
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::{Activation, Mix};
    use naga::valid::{Capabilities, ValidationFlags, Validator};

    use super::*;
    use crate::adapter::{STORAGE_BUFFERS, WORKGROUP_BYTES, WORKGROUP_THREADS};

    /// Returns every kernel, for every kind of colour model.
    fn all() -> Vec<KernelId> {
        let lcd = |chroma_degree, luminance_degree, activation| ColorModel::Lcd { chroma_degree, luminance_degree, activation };
        let mut models: Vec<ColorModel> = (0..=5).map(|degree| ColorModel::Sh { degree }).collect();
        models.extend([lcd(0, 0, Activation::Softplus), lcd(3, 0, Activation::Softplus)]);
        models.extend([lcd(5, 3, Activation::Exp), lcd(1, 2, Activation::Relu), lcd(0, 3, Activation::Softplus)]);
        models.extend([0, 3].map(|degree| ColorModel::LogSh { degree }));
        models.extend(Mix::new([models[3], models[6], models[8], models[12]]).map(ColorModel::Mix));
        let mut kernels = vec![
            KernelId::SortCount,
            KernelId::SortScan,
            KernelId::SortScatter,
            KernelId::BinSum,
            KernelId::BinScan,
            KernelId::BinEmit,
            KernelId::BinRanges,
            KernelId::Rasterize,
            KernelId::LossSsim,
            KernelId::LossGradient,
            KernelId::LossSsimVignetted,
            KernelId::LossGradientVignetted,
            KernelId::VignettingSums,
            KernelId::RasterizeBackward,
            KernelId::Gather,
            KernelId::Contribute,
            KernelId::ContributeSum,
            KernelId::BinEmitRays,
            KernelId::RasterizeRays,
            KernelId::RasterizeBackwardRays,
            KernelId::ContributeRays,
            KernelId::RasterizeCounted,
            KernelId::RasterizeCountedRays,
            KernelId::RasterizeBackwardCounted,
            KernelId::RasterizeBackwardCountedRays,
        ];
        for model in models {
            kernels.extend([
                KernelId::Project(model, model.lights() - 1),
                KernelId::ProjectRays(model, 0),
                KernelId::ProjectBackwardRays(model, Update::Parameters),
                KernelId::ProjectBackward(model, Update::Parameters),
                KernelId::ProjectBackward(model, Update::OnlyGradients),
                KernelId::CameraBackward(model),
                KernelId::CameraBackwardRays(model),
                KernelId::Apply(model),
                KernelId::Densify(model),
            ]);
        }
        kernels
    }

    #[test]
    fn every_shader_is_valid_without_any_optional_feature() {
        for kernel in all() {
            let text = source(kernel);
            let module = naga::front::wgsl::parse_str(&text).unwrap_or_else(|e| panic!("{kernel:?}: {}", e.emit_to_string(&text)));
            let info = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module);
            let info = info.unwrap_or_else(|e| panic!("{kernel:?}: {}", e.emit_to_string(&text)));
            let index = module.entry_points.iter().position(|e| e.name == kernel.name()).unwrap_or_else(|| panic!("{kernel:?}"));
            let entry = info.get_entry_point(index);
            // Direct3D 12 provides none of them in an indirect dispatch.
            let asks_for_groups = module.entry_points[index]
                .function
                .arguments
                .iter()
                .any(|argument| matches!(argument.binding, Some(naga::Binding::BuiltIn(naga::BuiltIn::NumWorkGroups))));
            assert!(!asks_for_groups, "{kernel:?} asks for the number of workgroups");
            let mut layouter = naga::proc::Layouter::default();
            layouter.update(module.to_ctx()).unwrap();
            let (mut bytes, mut buffers) = (0, 0);
            for (_, variable) in module.global_variables.iter().filter(|(handle, _)| !entry[*handle].is_empty()) {
                match variable.space {
                    naga::AddressSpace::WorkGroup => bytes += layouter[variable.ty].size,
                    naga::AddressSpace::Storage { .. } => buffers += 1,
                    _ => {}
                }
            }
            assert!(bytes <= WORKGROUP_BYTES, "{kernel:?} takes {bytes} bytes of workgroup memory");
            assert!(buffers <= STORAGE_BUFFERS, "{kernel:?} takes {buffers} storage buffers");
            let threads = module.entry_points[index].workgroup_size.iter().product::<u32>();
            assert!(threads <= WORKGROUP_THREADS, "{kernel:?} takes {threads} threads");
        }
    }
}
