//! Named choices among the options.

use clap::ValueEnum;
use luxel_metrics::GainChannels;
use serde::{Deserialize, Serialize};

/// Colour models by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Luminance and chromaticity apart (LCD-GS)
    #[default]
    Lcd,
    /// Spherical harmonics of RGB radiance, degree 0
    Sh0,
    /// Spherical harmonics of RGB radiance, degree 1
    Sh1,
    /// Spherical harmonics of RGB radiance, degree 2
    Sh2,
    /// Spherical harmonics of RGB radiance, degree 3: 3D Gaussian splatting
    Sh3,
    /// Spherical harmonics of RGB radiance, degree 4
    Sh4,
    /// Spherical harmonics of RGB radiance, degree 5
    Sh5,
}

/// How the number of splats grows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Strategy {
    /// Clone, split, prune and reset by screen-space gradients (Kerbl et al. 2023)
    #[default]
    Adc,
    /// Relocation, growth to --max-splats and noise (3DGS-MCMC, Kheradmand et al. 2024)
    Mcmc,
}

/// Presets of the rasteriser's cut-offs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CutoffPreset {
    /// Derived for radiance
    #[default]
    Hdr,
    /// The values of 3D Gaussian splatting, derived for 8-bit output
    Parity,
}

/// What is found beside the scene of each training image, whose exposure or white balance drifts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ExposureCompensation {
    /// Nothing: images are taken at their word
    #[default]
    Off,
    /// One gain an image
    Exposure,
    /// A gain an image and channel: exposure and white balance
    Color,
}

impl ExposureCompensation {
    /// Returns the channels that share a gain, or `None` if there are no gains.
    pub(crate) fn gain_channels(self) -> Option<GainChannels> {
        match self {
            Self::Off => None,
            Self::Exposure => Some(GainChannels::Shared),
            Self::Color => Some(GainChannels::Separate),
        }
    }
}

/// How the radiance of one normalised unit is chosen from the training views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ScaleRule {
    /// The median of (R + G + B) / 3 becomes 0.05, the middle of the mu-law's range
    Median20,
    /// The 99th percentile of (R + G + B) / 3 becomes 1: all but lamps and highlights lie in the mu-law's range
    #[default]
    P99,
    /// The largest channel value becomes 1
    Max,
    /// Radiance as it is in the images
    Raw,
}
