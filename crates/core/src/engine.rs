//! The contract between training and an engine: eleven passes behind a coarse, blocking, object-safe trait.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::edit::Contributions;
use crate::{Camera, Image, Knots, LossConfig, Moments, Remedy, Splats, View};

/// The passes of a training step, in order. Names of files, timings, benches and tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pass {
    /// Splats to screen-space ellipses.
    Project,
    /// Radiance towards the camera.
    Color,
    /// Splats to tiles.
    Bin,
    /// Front-to-back order.
    Sort,
    /// Blending.
    Rasterize,
    /// Loss and its gradient by the pixels.
    Loss,
    /// Gradient by the ellipses and colours.
    RasterizeBackward,
    /// Gradient by the colour model's coefficients and the viewing direction.
    ColorBackward,
    /// Gradient by position, rotation, scale and opacity.
    ProjectBackward,
    /// Parameter update.
    Adam,
    /// Adding and removing splats.
    Densify,
}

impl Pass {
    /// All, in order.
    pub const ALL: [Self; 11] = [
        Self::Project,
        Self::Color,
        Self::Bin,
        Self::Sort,
        Self::Rasterize,
        Self::Loss,
        Self::RasterizeBackward,
        Self::ColorBackward,
        Self::ProjectBackward,
        Self::Adam,
        Self::Densify,
    ];

    /// `rasterize_backward`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Project => "project",
            Self::Color => "color",
            Self::Bin => "bin",
            Self::Sort => "sort",
            Self::Rasterize => "rasterize",
            Self::Loss => "loss",
            Self::RasterizeBackward => "rasterize_backward",
            Self::ColorBackward => "color_backward",
            Self::ProjectBackward => "project_backward",
            Self::Adam => "adam",
            Self::Densify => "densify",
        }
    }
}

/// Where the rasteriser stops looking. See [`Cutoffs::HDR`] and [`Cutoffs::PARITY`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cutoffs {
    /// A splat's contribution to a pixel is skipped where its alpha is below this...
    pub min_alpha: f32,
    /// ...or below `min_contribution / max(radiance)` if that is smaller: what is skipped adds less than this to the pixel
    /// (normalised units). Infinity: the rule is `min_alpha` alone.
    #[serde(deserialize_with = "infinite_if_null")]
    pub min_contribution: f32,
    /// Lower bound of the alpha threshold whatever the radiance, so that footprints stay finite.
    pub alpha_floor: f32,
    /// A pixel is finished when the transmittance in front of it falls below this.
    pub min_transmittance: f32,
    /// Alpha is capped at this, so that what is behind can still be told.
    pub max_alpha: f32,
    /// Splats nearer to the camera plane than this are culled, world units.
    pub near: f32,
}

/// JSON has no infinity: serde_json writes it as null, which reads as infinity here. Formats that have one are read as ever.
fn infinite_if_null<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<f32, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f32::INFINITY))
}

impl Cutoffs {
    /// 3D Gaussian splatting's values (Kerbl et al. 2023): derived for 8-bit output.
    pub const PARITY: Self = Self {
        min_alpha: 1.0 / 255.0,
        min_contribution: f32::INFINITY,
        alpha_floor: 1.0 / 255.0,
        min_transmittance: 1e-4,
        max_alpha: 0.99,
        near: 0.2,
    };

    /// Derived for radiance. A skipped contribution is at most `alpha c`. The metrics and the loss see radiance through the mu-law,
    /// whose slope is at most 587 (at 0) and 587 / (1 + 5000 p) at p. Skipping `alpha < 1/255` moves a pixel of the splat's own
    /// brightness c >> 1/5000 by at most (1/255) c T'(c) = 4.6e-4, half an 8-bit step of the tone-mapped image, at any brightness;
    /// but the skirt of a lamp (c = 100) over a dark wall (p = 1e-3) is cut at a radiance of 0.4, four hundred times the wall. So
    /// the threshold falls with the splat's radiance: nothing above 2e-4 = 1/mu is skipped. The floor of 1e-5 is reached at c = 20
    /// and bounds the footprint at sqrt(2 ln 1e5) = 4.8 standard deviations. A stop at transmittance 1e-4 hides at most 1e-4 of
    /// what is behind, again 1/mu for c = 2; 1e-5 does it for c = 20. The cap of 0.99 would let 1 % of a lamp through every opaque
    /// splat in front of it; 0.999 is what f32 still divides by safely in the backward pass.
    pub const HDR: Self =
        Self { min_alpha: 1.0 / 255.0, min_contribution: 2e-4, alpha_floor: 1e-5, min_transmittance: 1e-5, max_alpha: 0.999, near: 0.01 };
}

/// What happens to splats smaller than a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Antialias {
    /// Dilation of the screen covariance by 0.3 px^2, as 3DGS: small splats gain energy.
    #[default]
    Off,
    /// What a pixel itself averages over: dilation by 0.1 px^2 with opacity compensated by the ratio of areas. A splat smaller than a pixel
    /// keeps its light. It is the 2D filter of Mip-splatting (Yu et al. 2024) alone.
    Pixel,
    /// Mip-splatting: the filter of [`Antialias::Pixel`] and the 3D smoothing filter of [`Splats::smoothing`].
    Mip,
}

/// Smallest ratio of areas before and after dilation that the opacity compensation follows (Mip-splatting's guard): below, the
/// compensation stays at its square root and has no gradient.
pub const MIN_AREA_RATIO: f32 = 1e-6;

/// Relative margin of the field of view within which the projection's Jacobian is evaluated where it is; beyond, at the margin.
/// 0.3 of the half field of view on each side, as in 3DGS.
pub const JACOBIAN_MARGIN: f64 = 0.3;

impl Antialias {
    /// Dilation of the screen covariance, px^2.
    pub fn dilation_px2(self) -> f32 {
        match self {
            Self::Off => 0.3,
            Self::Pixel | Self::Mip => 0.1,
        }
    }

    /// Whether opacity shrinks by as much as dilation widens a splat.
    pub fn compensates_opacity(self) -> bool {
        self != Self::Off
    }
}

/// How splats become pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RasterConfig {
    /// Where the rasteriser stops looking.
    pub cutoffs: Cutoffs,
    /// Treatment of small splats.
    pub antialias: Antialias,
    /// Samples along a pixel's side, 1 to [`MAX_SAMPLES`]: a pixel is the mean of their square, each of which is rendered as a pixel of its size
    /// would be. A pixel's own filter is right for one splat by itself; what splats hide of one another within a pixel takes samples.
    #[serde(default = "one_sample", skip_serializing_if = "is_one_sample")]
    pub samples: u8,
}

/// Most samples along a pixel's side.
pub const MAX_SAMPLES: u8 = 4;

/// What files of before there were samples mean.
fn one_sample() -> u8 {
    1
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands a reference")]
fn is_one_sample(samples: &u8) -> bool {
    *samples == 1
}

impl Default for RasterConfig {
    fn default() -> Self {
        Self { cutoffs: Cutoffs::HDR, antialias: Antialias::Off, samples: 1 }
    }
}

/// Options of a render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderOptions {
    /// How splats become pixels.
    pub raster: RasterConfig,
    /// Behind everything, normalised units.
    pub background: [f32; 3],
    /// Highest harmonic degree evaluated.
    pub active_degree: usize,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self { raster: RasterConfig::default(), background: [0.0; 3], active_degree: crate::sh::MAX_DEGREE }
    }
}

/// Adam's learning rates at one step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LearningRates {
    /// World units.
    pub position: f32,
    /// Quaternion components.
    pub rotation: f32,
    /// Log scale.
    pub log_scale: f32,
    /// Logit.
    pub opacity_logit: f32,
    /// Harmonics of degree 0.
    pub sh_dc: f32,
    /// Harmonics above.
    pub sh_rest: f32,
    /// Raw luminance of degree 0.
    pub luminance_dc: f32,
    /// Raw luminance above.
    pub luminance_rest: f32,
}

/// Adam's beta_1.
pub const ADAM_BETA1: f32 = 0.9;
/// Adam's beta_2.
pub const ADAM_BETA2: f32 = 0.999;
/// Adam's epsilon.
pub const ADAM_EPSILON: f32 = 1e-15;

/// Noise on positions after the update (3DGS-MCMC): Sigma n sigmoid(100 (0.005 - opacity)) `scale`, n standard normal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PositionNoise {
    /// Factor; 5e5 times the position's learning rate in the original.
    pub scale: f32,
    /// Seed of this step's noise: n of splat i is a hash of (seed, i), see [`crate::noise::standard_normal`].
    pub seed: u64,
}

/// One step of training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepConfig {
    /// 1 for the first step: Adam's bias correction.
    pub step: u32,
    /// Render options.
    pub render: RenderOptions,
    /// Loss.
    pub loss: LossConfig,
    /// Learning rates.
    pub learning_rates: LearningRates,
    /// Noise after the update.
    pub position_noise: Option<PositionNoise>,
    /// What to add to [`DensifyStats`] in this step.
    pub stats: StatsCollection,
}

/// Which densification statistics a step collects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StatsCollection {
    /// None.
    #[default]
    Off,
    /// Gradients and views; `abs_gradient` stays as it was.
    Gradients,
    /// AbsGS's sums of absolute gradients as well, which cost a few operations per pixel and splat.
    GradientsAndAbsolute,
}

/// What a step found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Step that the figures are of ([`StepConfig::step`]).
    pub step: u32,
    /// Total, without the regularisers.
    pub loss: f32,
    /// Mean absolute difference under the tone curve.
    pub l1: f32,
    /// Mean structural similarity under the tone curve.
    pub ssim: f32,
    /// Splats in front of the camera that touch the image.
    pub visible: u32,
    /// Gradient of the loss by the knots of the [`crate::Response`], if it is seen through one; the same bits for any number of threads.
    pub by_knots: Option<Knots>,
}

/// Per-splat statistics since the last densification, `[N]` each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DensifyStats {
    /// Sum over visible views of |dL/dmean|, mean in NDC units (half the image's side).
    pub gradient: Vec<f32>,
    /// Sum over visible views of the norm of the sums of absolute per-pixel gradients by x and y (AbsGS), NDC units.
    pub abs_gradient: Vec<f32>,
    /// Views in which the splat was visible.
    pub views: Vec<u32>,
}

impl DensifyStats {
    /// All zero.
    pub fn zeros(count: usize) -> Self {
        Self { gradient: vec![0.0; count], abs_gradient: vec![0.0; count], views: vec![0; count] }
    }
}

/// One splat of the scene after densification.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanRow {
    /// Splat it is made from.
    pub source: u32,
    /// Displacement along the source's principal axes, in standard deviations of the source.
    pub offset_sigma: [f32; 3],
    /// Added to the log scale.
    pub log_scale_shift: f32,
    /// Replaces the opacity; `None` keeps it.
    pub opacity_logit: Option<f32>,
    /// Whether Adam's moments go along (else they start at zero).
    pub keep_moments: bool,
}

impl PlanRow {
    /// The source as it is.
    pub fn keep(source: u32) -> Self {
        Self { source, offset_sigma: [0.0; 3], log_scale_shift: 0.0, opacity_logit: None, keep_moments: true }
    }
}

/// The scene after densification, row by row. Statistics start anew.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DensifyPlan {
    /// One per new splat.
    pub rows: Vec<PlanRow>,
    /// Opacities above this logit are lowered to it and their moments set to zero, after `rows`.
    pub opacity_logit_cap: Option<f32>,
    /// New 3D smoothing filter, one per row.
    pub smoothing: Option<Vec<f32>>,
}

/// What an engine could not do.
#[derive(Debug, thiserror::Error)]
pub enum EngineError {
    /// A camera that cannot be rendered.
    #[error("camera: {0}")]
    Camera(#[from] crate::CameraError),
    /// Arrays that do not make up a scene.
    #[error("splats: {0}")]
    Splats(#[from] crate::SplatsError),
    /// Input outside of the contract.
    #[error("{message}")]
    Invalid {
        /// Place, expected and found.
        message: String,
        /// What to do about it, where there is something beside mending the input.
        remedy: Option<Remedy>,
    },
    /// A device that failed: out of memory, lost, hung.
    #[error("{message}")]
    Device {
        /// Pass, resource and limit.
        message: String,
        /// What to do about it.
        remedy: Option<Remedy>,
    },
}

impl EngineError {
    /// Returns the error of input outside of the contract.
    pub fn invalid(message: impl Into<String>) -> Self {
        Self::Invalid { message: message.into(), remedy: None }
    }

    /// Returns the error of a device that failed.
    pub fn device(message: impl Into<String>) -> Self {
        Self::Device { message: message.into(), remedy: None }
    }

    /// Returns this error with what to do about it; errors of cameras and splats have no remedy but
    /// mending the input.
    #[must_use]
    pub fn with_remedy(mut self, new: Remedy) -> Self {
        if let Self::Invalid { remedy, .. } | Self::Device { remedy, .. } = &mut self {
            *remedy = Some(new);
        }
        self
    }

    /// Returns what to do about the error.
    ///
    /// ```
    /// use luxel_core::{EngineError, Remedy};
    ///
    /// let error = EngineError::device("gpu: out of memory").with_remedy(Remedy::lower("max_splats"));
    /// assert_eq!(error.remedy().map(Remedy::to_string).as_deref(), Some("lower max_splats"));
    /// ```
    pub fn remedy(&self) -> Option<&Remedy> {
        match self {
            Self::Invalid { remedy, .. } | Self::Device { remedy, .. } => remedy.as_ref(),
            Self::Camera(_) | Self::Splats(_) => None,
        }
    }
}

/// A renderer and trainer of splats. Blocking, object-safe, coarse.
pub trait Engine: Send {
    /// Takes over a scene; moments start at zero if absent. Statistics start anew.
    ///
    /// # Errors
    /// [`EngineError::Splats`] for invalid arrays, of moments too, [`EngineError::Invalid`] for moments of other splats: the engine keeps the scene
    /// it has. [`EngineError::Device`].
    fn load(&mut self, splats: &Splats, moments: Option<&Moments>) -> Result<(), EngineError>;

    /// The scene and moments as they stand.
    ///
    /// # Errors
    /// [`EngineError::Device`].
    fn save(&mut self) -> Result<(Splats, Moments), EngineError>;

    /// Radiance in normalised units as seen by `camera`, which must be undistorted.
    ///
    /// # Errors
    /// [`EngineError::Camera`], [`EngineError::Device`].
    fn render(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Image, EngineError>;

    /// [`Engine::render`], with how much of each pixel is covered and how far away that is.
    ///
    /// # Errors
    /// As [`Engine::render`]; [`EngineError::Invalid`] from an engine that has no depth.
    fn render_layers(&mut self, _camera: &Camera, _options: &RenderOptions) -> Result<Layers, EngineError> {
        Err(EngineError::invalid("this engine renders no depth and alpha").with_remedy(Remedy::set("device", "cpu")))
    }

    /// What each splat gives to the image that [`Engine::render`] makes, and how much of that lies in `mask` (`[H*W]`, row-major, 0 to 1): which
    /// splats a painted mask means.
    ///
    /// # Errors
    /// [`EngineError::Camera`], [`EngineError::Invalid`] if the mask is not of the camera's size, [`EngineError::Device`].
    fn contributions(&mut self, camera: &Camera, options: &RenderOptions, mask: &[f32]) -> Result<Contributions, EngineError>;

    /// How often blending looks at a splat from a pixel to make the image that [`Engine::render`] makes; nothing from an engine that does not
    /// count.
    ///
    /// # Errors
    /// As [`Engine::render`].
    fn evaluations(&mut self, _camera: &Camera, _options: &RenderOptions) -> Result<Option<Evaluations>, EngineError> {
        Ok(None)
    }

    /// One step of training towards `view`, whose image times [`LossConfig::target_scale`] is in normalised units; recorded values, if the loss is
    /// seen through a response. Views that share an image's allocation are the same image: an engine may keep what it makes of it.
    ///
    /// An engine may work ahead: the report is then of an earlier step, the newest that is known, and everything else the engine is asked waits
    /// for the steps on their way. If a loss is not finite such an engine changes nothing from that step on, reports the loss at one of the next
    /// calls, and refuses to hand out the scene.
    ///
    /// # Errors
    /// [`EngineError::Camera`], [`EngineError::Invalid`] if the image or its mask is not of the camera's size, or a curve that the engine does not
    /// have, [`EngineError::Device`].
    fn train_step(&mut self, view: &View, step: &StepConfig) -> Result<StepReport, EngineError>;

    /// Waits for all steps on their way: to measure, or before a pause.
    ///
    /// # Errors
    /// [`EngineError::Device`].
    fn finish(&mut self) -> Result<(), EngineError> {
        Ok(())
    }

    /// Statistics since the last [`Engine::densify`], [`Engine::load`] or [`Engine::set_densify_stats`].
    ///
    /// # Errors
    /// [`EngineError::Device`].
    fn densify_stats(&mut self) -> Result<DensifyStats, EngineError>;

    /// Puts back statistics when a run is resumed.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] if lengths differ from the scene's.
    fn set_densify_stats(&mut self, stats: &DensifyStats) -> Result<(), EngineError>;

    /// Position, log scale and opacity: what densification policies look at.
    ///
    /// # Errors
    /// [`EngineError::Device`].
    fn geometry(&mut self) -> Result<Geometry, EngineError>;

    /// Applies a plan.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] if a source does not exist or lengths differ.
    fn densify(&mut self, plan: &DensifyPlan) -> Result<(), EngineError>;

    /// Number of splats.
    fn len(&self) -> usize;

    /// No splats.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Time spent in each pass since the engine was made, in the order of [`Pass::ALL`].
    fn timings(&self) -> &[(Pass, Duration)];
}

/// An image with coverage and depth, `[H*W]` each, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layers {
    /// As [`Engine::render`] makes it: with the background, where the splats leave it to be seen.
    pub image: Image,
    /// Part of the pixel that splats cover, 0 to 1: one minus the transmittance left.
    pub alpha: Vec<f32>,
    /// Mean distance of the splats along the viewing axis, weighted as they are blended, world units; infinite where there are none.
    pub depth: Vec<f32>,
}

/// Pairs of a splat and a pixel, over an image: what the cost of blending is measured in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Evaluations {
    /// Pixels of the engine's blocks that splats touch, hidden splats too.
    pub touched: u64,
    /// Of these, the ones that the splat changes: alpha at or above its threshold, in front of where the pixel is finished. The same for any
    /// engine, but for rounding.
    pub alive: u64,
}

/// What densification policies look at, `[N]` each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Geometry {
    /// World.
    pub position: Vec<[f32; 3]>,
    /// Natural logarithm of the standard deviations.
    pub log_scale: Vec<[f32; 3]>,
    /// Logit.
    pub opacity_logit: Vec<f32>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raster_config_survives_json_bit_for_bit() {
        for cutoffs in [Cutoffs::PARITY, Cutoffs::HDR] {
            for antialias in [Antialias::Off, Antialias::Pixel, Antialias::Mip] {
                let config = RasterConfig { cutoffs, antialias, samples: 2 };
                let json = serde_json::to_string(&config).unwrap();
                assert_eq!(serde_json::from_str::<RasterConfig>(&json).unwrap(), config, "{json}");
            }
        }
    }
}
