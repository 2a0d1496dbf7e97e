//! The configuration of one training step, and what the step reports.

use serde::{Deserialize, Serialize};

use super::adam::AdamBetas;
use super::{CameraGradient, CameraGradientChoice, Dropout, RenderOptions};
use crate::{Knots, LossWeights, VIGNETTING_TERMS};

/// Adam's learning rates at one step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LearningRates {
    /// Rate of the position, world units.
    pub position: f32,
    /// Rate of the quaternion's components.
    pub rotation: f32,
    /// Rate of the log scale.
    pub log_scale: f32,
    /// Rate of the opacity logit.
    pub opacity_logit: f32,
    /// Rate of the harmonics of degree 0.
    pub sh_dc: f32,
    /// Rate of the harmonics above degree 0.
    pub sh_rest: f32,
    /// Rate of the raw luminance of degree 0.
    pub luminance_dc: f32,
    /// Rate of the raw luminance above degree 0.
    pub luminance_rest: f32,
}

impl LearningRates {
    /// All rates 0: a step that changes nothing, for its gradients.
    pub const ZERO: Self = Self {
        position: 0.0,
        rotation: 0.0,
        log_scale: 0.0,
        opacity_logit: 0.0,
        sh_dc: 0.0,
        sh_rest: 0.0,
        luminance_dc: 0.0,
        luminance_rest: 0.0,
    };

    /// Returns all rates times a factor.
    #[must_use]
    pub fn times(self, factor: f32) -> Self {
        Self {
            position: self.position * factor,
            rotation: self.rotation * factor,
            log_scale: self.log_scale * factor,
            opacity_logit: self.opacity_logit * factor,
            sh_dc: self.sh_dc * factor,
            sh_rest: self.sh_rest * factor,
            luminance_dc: self.luminance_dc * factor,
            luminance_rest: self.luminance_rest * factor,
        }
    }
}

/// Noise on positions after the update (3DGS-MCMC): `Sigma n sigmoid(100 (0.005 - opacity)) scale`,
/// n standard normal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PositionNoise {
    /// Factor of the noise; 5e5 times the position's learning rate in the original.
    pub scale: f32,
    /// Seed of this step's noise: n of splat i is a hash of (seed, i); see
    /// [`crate::random::standard_normal`].
    pub seed: u64,
}

/// Configuration of one training step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepConfig {
    /// Number of the step, 1 for the first: Adam's bias correction depends on it.
    pub step: u32,
    /// Render options.
    pub render: RenderOptions,
    /// Weights of the loss to minimise.
    pub loss: LossWeights,
    /// Learning rates.
    pub learning_rates: LearningRates,
    /// Adam's decay rates of the moments, in \[0, 1).
    pub betas: AdamBetas,
    /// Noise after the update.
    pub position_noise: Option<PositionNoise>,
    /// Splats that the step leaves out.
    pub dropout: Option<Dropout>,
    /// Statistics that the step adds to [`super::DensifyStats`].
    pub stats: StatsCollection,
    /// Whether the gradient by the camera is computed.
    pub camera_gradient: CameraGradientChoice,
}

/// Learning rate of a step at rest: so small that the scene does not change over any number of
/// steps. Adam's work is the same at any rate but 0.
const RATE_AT_REST: f32 = 1e-9;

impl StepConfig {
    /// Returns a step with the work of any other that leaves the scene as it is, to measure how
    /// long steps take.
    pub fn at_rest(step: u32, render: RenderOptions) -> Self {
        Self {
            step,
            render,
            loss: LossWeights::default(),
            learning_rates: LearningRates {
                position: RATE_AT_REST,
                rotation: RATE_AT_REST,
                log_scale: RATE_AT_REST,
                opacity_logit: RATE_AT_REST,
                sh_dc: RATE_AT_REST,
                sh_rest: RATE_AT_REST,
                luminance_dc: RATE_AT_REST,
                luminance_rest: RATE_AT_REST,
            },
            betas: AdamBetas::default(),
            position_noise: None,
            dropout: None,
            stats: StatsCollection::Gradients,
            camera_gradient: CameraGradientChoice::Skip,
        }
    }
}

/// The densification statistics that a step collects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StatsCollection {
    /// None.
    #[default]
    Off,
    /// Gradients and views; `abs_gradient` stays unchanged.
    Gradients,
    /// AbsGS's sums of absolute gradients as well, at the cost of a few operations per pixel and
    /// splat.
    GradientsAndAbsolute,
}

/// The results of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Number of the step that the report describes ([`StepConfig::step`]).
    pub step: u32,
    /// Total loss, without the regularisers.
    pub loss: f32,
    /// Mean absolute difference under the tone curve.
    pub l1: f32,
    /// Mean structural similarity under the tone curve.
    pub ssim: f32,
    /// Number of splats in front of the camera that touch the image.
    pub visible: u32,
    /// Gradient of the loss by the knots of the [`crate::Response`], if the loss uses one;
    /// bit-identical for any number of threads.
    pub by_knots: Option<Knots>,
    /// Gradient of the loss by the camera, if the step asked for it; bit-identical for any number
    /// of threads.
    pub camera: Option<CameraGradient>,
    /// Gradient of the loss by the coefficients of ln gain of the target's [`crate::Vignetting`],
    /// if it has one; bit-identical for any number of threads. An engine that works ahead then
    /// waits for the step.
    pub by_vignetting: Option<[f32; VIGNETTING_TERMS]>,
}
