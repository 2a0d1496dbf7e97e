//! Rasteriser settings: cut-offs, anti-aliasing, supersampling, and the layers of a render.

use serde::{Deserialize, Serialize};

use crate::Image;

/// Limits at which the rasteriser stops. See [`Cutoffs::HDR`] and [`Cutoffs::PARITY`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cutoffs {
    /// Alpha below which a splat's contribution to a pixel is skipped; `min_contribution` may lower
    /// it.
    pub min_alpha: f32,
    /// Largest radiance that a skipped contribution may add to a pixel, normalised units: alphas
    /// are skipped below `min_contribution / max(radiance)` if that is less than `min_alpha`. At
    /// infinity `min_alpha` alone applies.
    #[serde(deserialize_with = "infinite_if_null")]
    pub min_contribution: f32,
    /// Lower bound of the alpha threshold at any radiance, so that footprints stay finite.
    pub alpha_floor: f32,
    /// Transmittance below which a pixel is finished.
    pub min_transmittance: f32,
    /// Upper bound of alpha, so that the backward pass can recover what lies behind.
    pub max_alpha: f32,
    /// Distance from the camera plane below which splats are culled, world units.
    pub near: f32,
}

/// Reads null as infinity: JSON has no infinity, and serde_json writes it as null.
fn infinite_if_null<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<f32, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f32::INFINITY))
}

impl Cutoffs {
    /// The values of 3D Gaussian splatting (Kerbl et al. 2023), derived for 8-bit output.
    pub const PARITY: Self = Self {
        min_alpha: 1.0 / 255.0,
        min_contribution: f32::INFINITY,
        alpha_floor: 1.0 / 255.0,
        min_transmittance: 1e-4,
        max_alpha: 0.99,
        near: 0.2,
    };

    /// The values of gsplat 1.5: those of 3D Gaussian splatting, with a higher cap of alpha and a
    /// nearer plane.
    pub const GSPLAT: Self = Self { max_alpha: 0.999, near: 0.01, ..Self::PARITY };

    /// Values derived for radiance.
    ///
    /// A skipped contribution is at most `alpha c`. The metrics and the loss apply the mu-law to
    /// radiance; its slope is at most 587 (at 0), and 587 / (1 + 5000 p) at p. Skipping
    /// `alpha < 1/255` changes a pixel of the splat's own brightness c >> 1/5000 by at most (1/255)
    /// c T'(c) = 4.6e-4, half an 8-bit step of the tone-mapped image, at any brightness. But around
    /// a lamp (c = 100) over a dark wall (p = 1e-3), it cuts the splat off at a radiance of 0.4,
    /// four hundred times the wall's. So the threshold falls with the splat's radiance: nothing
    /// above 2e-4 = 1/mu is skipped. The floor of 1e-5 is reached at c = 20 and bounds the
    /// footprint at sqrt(2 ln 1e5) = 4.8 standard deviations.
    ///
    /// A stop at transmittance 1e-4 hides at most 1e-4 of what is behind, again 1/mu for c = 2;
    /// 1e-5 does so for c = 20. An alpha cap of 0.99 would let 1 % of a lamp through every opaque
    /// splat in front of it; with 0.999 the divisions of the backward pass are still safe in f32.
    pub const HDR: Self =
        Self { min_alpha: 1.0 / 255.0, min_contribution: 2e-4, alpha_floor: 1e-5, min_transmittance: 1e-5, max_alpha: 0.999, near: 0.01 };
}

/// Treatment of splats smaller than a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Antialias {
    /// Dilates the screen covariance by 0.3 px^2, as 3DGS: small splats gain energy.
    #[default]
    Off,
    /// Averages over the pixel: dilation by 0.1 px^2 with opacity compensated by the ratio of
    /// areas, so that a splat smaller than a pixel keeps its light. It is the 2D filter of
    /// Mip-splatting (Yu et al. 2024) alone.
    Pixel,
    /// Mip-splatting: the filter of [`Antialias::Pixel`] and the 3D smoothing filter of
    /// [`crate::Splats::smoothing`].
    Mip,
}

/// Smallest ratio of areas before and after dilation that the opacity compensation follows
/// (Mip-splatting's guard). Below it, the compensation stays at its square root and has no
/// gradient.
pub const MIN_AREA_RATIO: f32 = 1e-6;

/// Relative margin around the field of view within which the projection's Jacobian is evaluated at
/// the splat's mean; beyond, it is evaluated at the margin. 0.3 of the half field of view on each
/// side, as in 3DGS.
pub const JACOBIAN_MARGIN: f64 = 0.3;

impl Antialias {
    /// Returns the dilation of the screen covariance, px^2.
    pub fn dilation_px2(self) -> f32 {
        match self {
            Self::Off => 0.3,
            Self::Pixel | Self::Mip => 0.1,
        }
    }

    /// Returns whether opacity shrinks by as much as dilation widens a splat.
    pub fn compensates_opacity(self) -> bool {
        self != Self::Off
    }
}

/// Settings of the rasteriser; part of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RasterConfig {
    /// Limits at which the rasteriser stops.
    pub cutoffs: Cutoffs,
    /// Treatment of small splats.
    pub antialias: Antialias,
    /// Number of samples along a pixel's side, 1 to [`MAX_SAMPLES`].
    ///
    /// A pixel is the mean of the square of this number of samples, each rendered as a pixel of its
    /// size. The pixel filter alone is correct for a single splat; splats that occlude one another
    /// within a pixel need supersampling.
    #[serde(default = "one_sample", skip_serializing_if = "is_one_sample")]
    pub samples: u8,
}

/// Largest number of samples along a pixel's side.
pub const MAX_SAMPLES: u8 = 4;

/// Returns the value for files that predate supersampling.
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

/// Options of a render. Those of a scene are [`crate::Scene::render_options`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderOptions {
    /// Settings of the rasteriser.
    pub raster: RasterConfig,
    /// Background radiance, normalised units.
    pub background: [f32; 3],
    /// Highest harmonic degree evaluated.
    pub active_degree: usize,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self { raster: RasterConfig::default(), background: [0.0; 3], active_degree: crate::sh::MAX_DEGREE }
    }
}

/// An image with coverage and depth, `[H*W]` each, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layers {
    /// Image as [`super::Engine::render`] makes it, over the background.
    pub image: Image,
    /// Coverage of the pixel by splats, 0 to 1: one minus the remaining transmittance.
    pub alpha: Vec<f32>,
    /// Mean depth of the splats along the viewing axis with their blending weights, world units;
    /// infinite where there are none.
    pub depth: Vec<f32>,
}

/// The number of pairs of a splat and a pixel over an image: a measure of the cost of blending.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Evaluations {
    /// Number of pixels in the engine's blocks that splats touch, including hidden splats.
    pub touched: u64,
    /// Number of those pairs in which the splat changes the pixel: alpha is at or above its
    /// threshold, and the splat is in front of the depth at which the pixel is finished. The same
    /// for every engine, except for rounding.
    pub alive: u64,
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
