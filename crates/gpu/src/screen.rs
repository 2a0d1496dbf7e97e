//! The uniforms of camera, loss and optimiser, computed once per step.
//!
//! In: camera, options, step. Out: structures that the shaders read. Degenerate: lens distortion
//! and invalid cameras are errors.

use bytemuck::Zeroable;
use luxel_core::engine::{Dropout, JACOBIAN_MARGIN, PixelAngle, StatsCollection, StepConfig};
use luxel_core::{
    Antialias, Camera, CameraProjection, EngineError, LossWeights, MAX_SAMPLES, RenderOptions, SQUARED_KNEE, ToneCurve, VIGNETTING_TERMS,
    View, Vignetting,
};

use crate::device::use_cpu;
use crate::forward::PixelKind;
use crate::layout::{
    CameraUniform, FLAG_ABSOLUTE, FLAG_COMPENSATION, FLAG_EDIT_GAIN, FLAG_MIN_CONTRIBUTION, FLAG_SMOOTHING, FLAG_TRAINING, LensUniform,
    LossUniform, OptimizerUniform, TILE_PX,
};

/// The purpose of a frame, which decides what it computes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Purpose {
    /// The image.
    Image,
    /// Gradients, with these statistics, without the splats that are left out.
    Training(StatsCollection, Option<Dropout>),
}

/// Returns the number of tiles across and down.
pub(crate) fn tiles(size_px: [u32; 2]) -> [u32; 2] {
    size_px.map(|side| side.div_ceil(TILE_PX))
}

/// Checks a camera.
pub(crate) fn check(camera: &Camera) -> Result<(), EngineError> {
    if !camera.distortion.is_none() {
        return Err(EngineError::invalid("camera: has lens distortion; undistort its image first"));
    }
    Ok(camera.validate()?)
}

/// Returns the camera of the samples, and the number of samples along the side of a pixel.
pub(crate) fn supersampled(camera: &Camera, options: &RenderOptions) -> (Camera, u32) {
    let samples = options.raster.samples.clamp(1, MAX_SAMPLES).into();
    (camera.upscaled(samples), samples)
}

/// The facts about the scene that shaders need.
#[derive(Clone, Copy)]
pub(crate) struct SceneFacts {
    /// Number of splats.
    pub(crate) count: u32,
    /// Whether the scene has a 3D filter.
    pub(crate) has_smoothing: bool,
    /// Whether the scene has gains of edits.
    pub(crate) has_gain: bool,
}

/// Returns the uniform of the camera (of samples, see [`supersampled`]) with its options. The
/// buffers have room for `entry_capacity` entries.
pub(crate) fn camera_uniform(
    camera: &Camera,
    options: &RenderOptions,
    purpose: Purpose,
    SceneFacts { count, has_smoothing, has_gain }: SceneFacts,
    entry_capacity: u32,
) -> CameraUniform {
    let pose = camera.camera_from_world;
    let rows = pose.matrix3.transpose().to_cols_array_2d();
    let translation = pose.translation.to_array();
    let row = |i: usize| [rows[i][0] as f32, rows[i][1] as f32, rows[i][2] as f32, translation[i] as f32];
    let [focal, center] = [camera.focal_px, camera.center_px].map(|v| v.to_array());
    let size = camera.size_px.map(f64::from);
    let margin = [0, 1].map(|i| JACOBIAN_MARGIN * size[i] / (2.0 * focal[i]));
    let eye = camera.eye().to_array().map(|v| v as f32);
    let [red, green, blue] = options.background;
    let cutoffs = options.raster.cutoffs;
    let antialias = options.raster.antialias;
    let flags = [
        (antialias.compensates_opacity(), FLAG_COMPENSATION),
        (antialias == Antialias::Mip && has_smoothing, FLAG_SMOOTHING),
        (has_gain, FLAG_EDIT_GAIN),
        (cutoffs.min_contribution.is_finite(), FLAG_MIN_CONTRIBUTION),
        (matches!(purpose, Purpose::Training(..)), FLAG_TRAINING),
        (matches!(purpose, Purpose::Training(StatsCollection::GradientsAndAbsolute, _)), FLAG_ABSOLUTE),
    ];
    let dropout = match purpose {
        Purpose::Training(_, Some(dropout)) => dropout,
        _ => Dropout { rate: 0.0, seed: 0 },
    };
    CameraUniform {
        row_x: row(0),
        row_y: row(1),
        row_z: row(2),
        eye: [eye[0], eye[1], eye[2], 0.0],
        background: [red, green, blue, 0.0],
        focal_px: focal.map(|v| v as f32),
        center_px: center.map(|v| v as f32),
        slope_min: [0, 1].map(|i| (-center[i] / focal[i] - margin[i]) as f32),
        slope_max: [0, 1].map(|i| ((size[i] - center[i]) / focal[i] + margin[i]) as f32),
        size_px: camera.size_px,
        tiles: tiles(camera.size_px),
        min_alpha: cutoffs.min_alpha,
        min_contribution: cutoffs.min_contribution.min(f32::MAX),
        alpha_floor: cutoffs.alpha_floor,
        min_transmittance: cutoffs.min_transmittance,
        max_alpha: cutoffs.max_alpha,
        near: cutoffs.near,
        dilation_px2: antialias.dilation_px2(),
        active_degree: options.active_degree.min(luxel_core::sh::MAX_DEGREE) as u32,
        flags: flags.iter().filter(|(set, _)| *set).map(|(_, flag)| flag).sum(),
        count,
        entry_capacity,
        samples: options.raster.samples.clamp(1, MAX_SAMPLES).into(),
        dropout_rate: dropout.rate,
        opacity_factor: dropout.opacity_factor(),
        dropout_seed: dropout.seed,
        padding: 0,
    }
}

/// Returns what pixels are to the kernels.
pub(crate) fn pixel_kind(camera: &Camera) -> PixelKind {
    if camera.projection.is_pinhole() { PixelKind::Places } else { PixelKind::Rays }
}

/// Returns the uniform of the lens of a camera whose pixels are rays.
pub(crate) fn lens_uniform(camera: &Camera) -> LensUniform {
    /// Angle beyond the field up to which distances grow in the box around a splat, radians; and
    /// the largest angle.
    const BEYOND: f64 = 0.6;
    const LARGEST: f64 = 2.7;
    const STEPS: u32 = 200;
    let size = PixelAngle::new(camera);
    let [size_0, size_1, size_2] = [0, 4, 8].map(|first| [0, 1, 2, 3].map(|i| size.coefficients[first + i] as f32));
    let (middle, inverse_half_range) = (size.middle as f32, (1.0 / size.half_range) as f32);
    let panorama =
        LensUniform { size_0, size_1, size_2, middle, inverse_half_range, least_cosine: -1.0, is_panorama: 1, ..Zeroable::zeroed() };
    let CameraProjection::Fisheye(lens) = camera.projection else { return panorama };
    let end = (lens.max_angle_rad + BEYOND).min(LARGEST);
    let growth = |step: u32| {
        let angle = end * f64::from(step) / f64::from(STEPS);
        lens.radius_derivative(angle).abs().max(lens.radius(angle).abs() / angle.sin())
    };
    LensUniform {
        coefficients: lens.coefficients.map(|k| k as f32),
        least_cosine: lens.max_angle_rad.cos() as f32,
        max_angle: lens.max_angle_rad as f32,
        max_radius: lens.radius(lens.max_angle_rad) as f32,
        stretch: (1..=STEPS).map(growth).fold(1.0, f64::max) as f32,
        is_panorama: 0,
        ..panorama
    }
}

/// Returns the parameter mu of the target's mu-law, the only curve of this engine.
pub(crate) fn mu_law_parameter(view: &View) -> Result<f32, EngineError> {
    match view.target.curve {
        ToneCurve::MuLaw { mu } => Ok(mu),
        ToneCurve::Response(_) => {
            let message = "gpu: pass loss: this engine cannot learn a camera's response from captured LDR images";
            Err(EngineError::invalid(message).with_remedy(use_cpu()))
        }
    }
}

/// Returns the uniform of the loss towards `view` under the mu-law with parameter `mu`. L1 is
/// averaged over pixels whose weights sum to `total`, SSIM over all pixels of the image.
pub(crate) fn loss_uniform(weights: &LossWeights, view: &View, mu: f32, total: f64) -> LossUniform {
    let size_px = view.camera.size_px;
    let log = f64::from(mu).ln_1p();
    // The derivative of the mu-law at radiance 0.
    let slope = f64::from(mu) / log;
    let (weight, squared) = (f64::from(weights.ssim_weight), f64::from(weights.squared_share));
    // The mean over no pixels is 0.
    let l1_mean = 1.0 / (3.0 * if total > 0.0 { total } else { 1.0 });
    let ssim_mean = 1.0 / (3.0 * f64::from(size_px[0]) * f64::from(size_px[1]));
    // Kernels for images without vignetting do not read it.
    let none = Vignetting { axis_px: [0.0; 2], unit_px: 1.0, log_gain: [0.0; VIGNETTING_TERMS] };
    let Vignetting { axis_px, unit_px, log_gain } = view.target.vignetting.unwrap_or(none);
    LossUniform {
        mu,
        scale: (1.0 / log) as f32,
        ssim_weight: weights.ssim_weight,
        l1_weight: 1.0 - weights.squared_share,
        l2_weight: (squared / (2.0 * f64::from(SQUARED_KNEE))) as f32,
        l1_factor: (slope * (1.0 - weight) * (1.0 - squared) * l1_mean) as f32,
        l2_factor: (slope * (1.0 - weight) * squared / f64::from(SQUARED_KNEE) * l1_mean) as f32,
        ssim_factor: (slope * -2.0 * weight * ssim_mean) as f32,
        l1_mean: l1_mean as f32,
        ssim_mean: ssim_mean as f32,
        is_masked: view.mask.is_some().into(),
        padding: 0,
        target_scale: view.target.scale,
        inverse_unit: 1.0 / unit_px,
        log_gain,
        axis_px,
        padding_2: [0; 2],
    }
}

/// Returns the uniform of the optimiser for `count` splats.
pub(crate) fn optimizer_uniform(step: &StepConfig, count: usize) -> OptimizerUniform {
    let [first, second] = step.betas.corrections(step.step).map(|correction| (1.0 / correction) as f32);
    let rates = step.learning_rates;
    let noise = step.position_noise;
    let seed = noise.map_or(0, |noise| noise.seed);
    OptimizerUniform {
        position: rates.position * first,
        rotation: rates.rotation * first,
        log_scale: rates.log_scale * first,
        opacity_logit: rates.opacity_logit * first,
        sh_dc: rates.sh_dc * first,
        sh_rest: rates.sh_rest * first,
        luminance_dc: rates.luminance_dc * first,
        luminance_rest: rates.luminance_rest * first,
        root_correction_2: second.sqrt(),
        opacity_weight: step.loss.opacity_weight / count.max(1) as f32,
        scale_weight: step.loss.scale_weight / (3 * count.max(1)) as f32,
        noise_scale: noise.map_or(0.0, |noise| noise.scale),
        seed_low: seed as u32,
        seed_high: (seed >> 32) as u32,
        stats: u32::from(step.stats != StatsCollection::Off),
        beta_1: step.betas.first,
        beta_2: step.betas.second,
        padding_0: 0,
        padding_1: 0,
        padding_2: 0,
    }
}
