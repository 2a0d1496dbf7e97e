//! Bakes: a radiance scene as plain harmonics, which files of other programs can hold.
//!
//! In: a scene of any colour model. Out: [`Baked`], a scene of [`ColorModel::Sh`] of degree <= 3 in
//! one of two appearances:
//! - [`Appearance::Linear`]: radiance in the units of the data set times an exposure, in a colour
//!   space of choice, unbounded. Harmonics stay harmonics, exactly (matrix and exposure are
//!   linear); luminance times chromaticity is fitted by least squares.
//! - [`Appearance::Display`]: colours 0..1 for an sRGB screen, under a tone curve. Tone mapping per
//!   splat does not commute with blending: it is a preview, and may be refined against tone-mapped
//!   renders.
//!
//! In both, a 3D smoothing filter is applied to scales and opacities, as other programs do not know
//! it.
//!
//! Colours that are a display's already ([`ColorSpace::DisplaySrgb`]) stay what they are in a
//! display bake, unless another curve or an exposure is asked for; those are of the light that the
//! colours stand for.
//!
//! Degenerate: where a fit undershoots 0 its view dependence is drawn towards the mean until it
//! does not: viewers that do not clamp show negative colours as rainbow speckle.

mod exposure;
mod fit;
mod record;

use glam::DVec3;
use luxel_core::tone::Tonemap;
use luxel_core::{Antialias, ColorModel, ColorSpace, Cutoffs, RadianceScale, RasterConfig, Scene, Similarity, Splats, sigmoid};
use rayon::prelude::*;

pub use exposure::{MIDDLE_GREY, display_exposure};
pub(crate) use fit::{Bake, MAX_BAKED};
pub(crate) use record::{BakeRecord, Origin, RECORD_KEY, WorldRecord, place};

/// Returns a radiance of which sums are finite; NaN, which a sum of infinities of both signs gives,
/// counts as 0.
fn bounded(radiance: f32) -> f32 {
    if radiance > 0.0 { radiance.min(f32::MAX / 16.0) } else { 0.0 }
}

/// The appearance of a bake.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Appearance {
    /// For a screen: tone-mapped and sRGB-encoded.
    Display {
        /// Curve.
        tonemap: Tonemap,
        /// Stops on top of [`display_exposure`].
        exposure_ev: f32,
    },
    /// Scene-linear radiance in the units of the data set.
    Linear {
        /// Space of the harmonics' colours.
        color_space: ColorSpace,
        /// Stops.
        exposure_ev: f32,
    },
}

impl Appearance {
    /// The appearance of the scene file's own display layer.
    pub const PREVIEW: Self = Self::Display { tonemap: Tonemap::Agx, exposure_ev: 0.0 };

    /// The appearance of colours that are a display's, which stay as they are.
    pub const KEPT: Self = Self::Display { tonemap: Tonemap::None, exposure_ev: 0.0 };

    /// Returns the appearance of the display layer of a scene whose colours are of this space.
    pub fn preview_of(space: ColorSpace) -> Self {
        if space.is_linear() { Self::PREVIEW } else { Self::KEPT }
    }

    /// Returns whether colours of this space stay as they are.
    pub fn keeps(self, space: ColorSpace) -> bool {
        self == Self::KEPT && !space.is_linear()
    }
}

/// How to bake.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BakeOptions {
    /// Appearance.
    pub appearance: Appearance,
    /// Highest degree of the harmonics, 0 to 3; never above the model's.
    pub max_degree: u8,
}

/// A baked scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Baked {
    /// Harmonics of display colours or of radiance, `radiance_scale` 1, to be rendered with its own
    /// `raster`. Gains of edits are in the harmonics; OpenUSD files alone hold gains beside them.
    pub scene: Scene,
    /// Appearance that was requested.
    pub appearance: Appearance,
    /// Factor from the scene's normalised radiance to baked values, before any curve.
    pub exposure: f32,
    /// How the world of the file came from that of the data set; the identity
    /// until [`Self::transform`], before which the splats are in the scene's local coordinates.
    pub file_from_world: Similarity,
}

impl Baked {
    /// Bakes every splat.
    pub fn new(scene: &Scene, options: &BakeOptions) -> Self {
        let bake = Bake::new(scene, options);
        let from = &scene.splats;
        let k = bake.coefficients();
        let mut splats = Splats {
            color_model: ColorModel::Sh { degree: bake.degree() as u8 },
            sh: vec![0.0; from.len() * 3 * k],
            raw_luminance: Vec::new(),
            smoothing: Vec::new(),
            gain: Vec::new(),
            position: from.position.clone(),
            rotation: from.rotation.clone(),
            log_scale: from.log_scale.clone(),
            opacity_logit: from.opacity_logit.clone(),
        };
        splats.sh.par_chunks_mut(3 * k).enumerate().for_each(|(i, sh)| {
            let channels = bake.splat(from, i);
            for (m, rgb) in sh.chunks_exact_mut(3).enumerate() {
                rgb.iter_mut().zip(&channels).for_each(|(to, channel)| *to = channel[m]);
            }
        });
        for (i, deviation) in from.smoothing.iter().enumerate() {
            (splats.log_scale[i], splats.opacity_logit[i]) = smoothed(from.log_scale[i], from.opacity_logit[i], *deviation);
        }
        let (color_space, raster) = match options.appearance {
            // As they are rendered by the program that they are from.
            _ if options.appearance.keeps(scene.color_space) => (ColorSpace::DisplaySrgb, scene.raster),
            Appearance::Display { .. } => {
                (ColorSpace::DisplaySrgb, RasterConfig { cutoffs: Cutoffs::PARITY, antialias: Antialias::Off, ..RasterConfig::default() })
            }
            Appearance::Linear { color_space, .. } => {
                // Thresholds for skipping are in units of radiance and scale with it.
                let cutoffs = scene.raster.cutoffs;
                let cutoffs = Cutoffs { min_contribution: cutoffs.min_contribution * bake.exposure(), ..cutoffs };
                (color_space, RasterConfig { cutoffs, ..scene.raster })
            }
        };
        Self {
            scene: Scene {
                splats,
                radiance_scale: RadianceScale::ONE,
                color_space,
                raster,
                edits: Vec::new(),
                world_from_local: scene.world_from_local,
                metres_per_unit: scene.metres_per_unit,
            },
            appearance: options.appearance,
            exposure: bake.exposure(),
            file_from_world: Similarity::IDENTITY,
        }
    }

    /// Describes the bake in words.
    pub fn description(&self) -> String {
        let degree = self.scene.splats.color_model.sh_degree();
        match self.appearance {
            Appearance::Linear { .. } => format!("linear, {:?} of normalised radiance, harmonics of degree {degree}", self.exposure),
            Appearance::Display { tonemap, .. } => {
                format!(
                    "exposure {:?} of normalised radiance, curve {tonemap} with its display encoding, harmonics of degree {degree}",
                    self.exposure
                )
            }
        }
    }

    /// Returns the length of a unit of the file, metres; `None` if it is unknown.
    pub fn metres_per_unit(&self) -> Option<f64> {
        self.scene.metres_per_unit.map(|metres| metres / self.file_from_world.scale())
    }

    /// Returns the place of the scene's local origin in the file.
    pub(crate) fn origin_in_file(&self) -> DVec3 {
        self.file_from_world.point(self.scene.world_from_local.translation())
    }

    /// Draws view dependence towards the mean where a channel would be negative: after harmonics
    /// were changed.
    pub fn lift_negative(&mut self) {
        let splats = &mut self.scene.splats;
        let lift = fit::Lift::new(splats.color_model.sh_degree());
        let k = splats.color_model.sh_coefficients();
        splats.sh.par_chunks_mut(3 * k).for_each(|sh| {
            for c in 0..3 {
                let mut channel = [0.0; MAX_BAKED];
                channel.iter_mut().zip(sh.iter().skip(c).step_by(3)).for_each(|(to, from)| *to = *from);
                lift.apply(&mut channel);
                sh.iter_mut().skip(c).step_by(3).zip(channel).for_each(|(to, from)| *to = from);
            }
        });
    }

    /// Moves the splats into the world of a file, which `file_from_world` turns and scales. They
    /// stay relative to the origin of the scene's local coordinates, which that transform moves,
    /// too.
    pub fn transform(&mut self, file_from_world: &Similarity) {
        let about_origin = file_from_world.linear();
        Similarity::scaling(self.scene.world_from_local.scale()).then(&about_origin).apply(&mut self.scene.splats);
        // Bakes are made in the world of the data set: nothing was moved before.
        self.file_from_world = *file_from_world;
    }
}

/// Returns the log scale and opacity logit with the 3D smoothing filter of `deviation` applied:
/// variances add, and the opacity shrinks by the ratio of volumes (Yu et al. 2024, eq. 9).
pub(crate) fn smoothed(log_scale: [f32; 3], opacity_logit: f32, deviation: f32) -> ([f32; 3], f32) {
    // The range within which a variance neither vanishes nor overflows.
    let variance = |log_scale: f32| (2.0 * f64::from(log_scale).clamp(-100.0, 100.0)).exp();
    let added = f64::from(deviation).powi(2);
    let wide = log_scale.map(|s| 0.5 * (variance(s) + added).ln());
    let ratio: f64 = log_scale.iter().zip(wide).map(|(s, w)| f64::from(*s).clamp(-100.0, 100.0) - w).sum::<f64>().exp();
    (wide.map(|s| s as f32), luxel_core::logit((f64::from(sigmoid(opacity_logit)) * ratio) as f32))
}

#[cfg(test)]
mod tests;
