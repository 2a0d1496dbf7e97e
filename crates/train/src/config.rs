//! The options of training, in one table ([`OPTIONS`]).
//!
//! Windows and intervals that are unset depend on the number of iterations ([`crate::Schedule`]),
//! so that a short run is a short version of the long one. A [`Preset`] sets options that belong
//! together.

mod choices;
mod field_network;
mod options;
mod own_steps;
mod preset;
mod range;
mod registry;
mod spec;
mod validate;

pub use choices::{
    BatchRule, CutoffPreset, ExposureCompensation, FieldLoss, Freeze, HdrNormalisation, LateViews, NamedChoice, Preset, ScaleRule, Strategy,
};
pub use field_network::FieldNetworkChoice;
pub use options::{OPTIONS, TrainConfig};
pub use range::Range;
pub use registry::{ColorValues, Colors, Method, MethodSpec, Representation, Scheme};
pub use spec::{Condition, OptionSpec, ValueHelp};
pub use validate::Misplaced;

use luxel_core::engine::MomentFormat;
use luxel_core::{Antialias, ColorModel, Cutoffs, LossWeights, RasterConfig};

/// Largest number of views a step.
pub const MAX_BATCH: u32 = 1024;

/// Largest seed; integers in `config.toml` are signed.
pub const MAX_SEED: u64 = i64::MAX as u64;

/// The smallest bound on the number of splats that follows from [`TrainConfig::pixels_per_splat`].
/// Fewer splats would save little, however small the images.
const MIN_BOUND_BY_DATA: u32 = 40_000;

/// The most pixels of an image whose pixels are the mean of several samples where nothing else is
/// asked for. Larger images have smaller pixels, in which splats hide less of each other, and their
/// samples would take more memory and time.
const MOST_SUPERSAMPLED_PX: u64 = 200_000;

/// The most initial splats that stereo finds where nothing else is asked for.
const STEREO_POINTS: u32 = 20_000;

/// Number of training views from which stereo adds to the points of a data set by itself.
const LEAST_STEREO_VIEWS: usize = 8;

/// Degrees of LCD's harmonics as published.
const CHROMA_DEGREE: u8 = 3;
const LUMINANCE_DEGREE: u8 = 0;
/// Degrees of chromaticity and luminance for photographs that were developed for display.
const DEVELOPED_DEGREES: [u8; 2] = [1, 2];

/// Factor by which the bound that follows from the images may rise.
const MOST_RISE: usize = 4;

/// Largest number of splats of the MCMC strategy, if none is given.
pub const MCMC_DEFAULT_MAX_SPLATS: u32 = 100_000;

impl Default for TrainConfig {
    /// Returns the defaults of the table, with the values of the default preset.
    fn default() -> Self {
        Self::base().with_preset(|_| false)
    }
}

/// Parses radiance as options give it: `red,green,blue`, or one number for grey.
///
/// # Errors
/// Returns the reason, for people, if the text is not one or three numbers, or if a number is
/// negative or not finite.
pub fn parse_rgb(text: &str) -> Result<[f32; 3], String> {
    let values: Result<Vec<f32>, _> = text.split(',').map(|part| part.trim().parse::<f32>()).collect();
    let rgb = match values.as_deref() {
        Ok([grey]) => [*grey; 3],
        Ok([r, g, b]) => [*r, *g, *b],
        _ => return Err(format!("\"{text}\" is not a colour, expected three numbers such as 0,0.5,1 or one")),
    };
    if rgb.iter().all(|v| v.is_finite() && *v >= 0.0) { Ok(rgb) } else { Err(format!("\"{text}\": radiance is finite and not negative")) }
}

impl TrainConfig {
    /// Returns the default configuration under `preset`.
    pub fn from_preset(preset: Preset) -> Self {
        Self { preset, ..Self::default() }.with_preset(|_| false)
    }

    /// Returns this configuration with the values of its preset, except for the options (by name)
    /// that were given beside it. A number of steps that was given is made in full.
    #[must_use]
    pub fn with_preset(mut self, is_given: impl Fn(&str) -> bool) -> Self {
        let ends_early = is_given("early_end") || !is_given("iterations");
        self.preset.apply(&mut self, is_given);
        self.early_end = self.early_end.filter(|_| ends_early);
        self
    }

    /// Returns this configuration with a number of steps, all of which are made.
    #[must_use]
    pub fn with_steps(self, iterations: u32) -> Self {
        Self { iterations, early_end: None, ..self }
    }

    /// Returns the colour model selected by `method` and the degree options. Fields have none; LCD
    /// is returned for them.
    pub fn color_model(&self) -> ColorModel {
        self.method.spec().colors.model(self)
    }

    /// Returns the settings of the rasteriser at the end of training.
    pub fn raster(&self) -> RasterConfig {
        let cutoffs = match self.cutoffs {
            // Their rasteriser's cut-offs depend on no colour, as each splat has two.
            _ if self.method.has_own_networks() => Cutoffs::PARITY,
            CutoffPreset::Hdr => Cutoffs::HDR,
            CutoffPreset::Parity => Cutoffs::PARITY,
        };
        RasterConfig { cutoffs, antialias: self.antialias, samples: self.samples.unwrap_or(1) }
    }

    /// Returns the number of samples along a pixel's side at the end of a run on training images
    /// of at most `largest_px` pixels.
    pub fn samples_for(&self, largest_px: u64) -> u8 {
        let has_networks = self.method.has_own_steps() || self.method.spec().representation == Representation::Anchors;
        self.samples.unwrap_or(if has_networks || largest_px > MOST_SUPERSAMPLED_PX { 1 } else { 2 })
    }

    /// Returns the largest number of initial splats that stereo between so many training views
    /// finds, beside the points of the data set if it has any. Few views leave open where repeated
    /// texture is, and points are a better start than wrong ones (notebook, `few-views.md`).
    pub fn stereo_points_for(&self, views: usize, has_points: bool) -> u32 {
        self.stereo_points.unwrap_or(if has_points && views < LEAST_STEREO_VIEWS { 0 } else { STEREO_POINTS })
    }

    /// Returns the configuration with the degrees of LCD's harmonics decided that are left open:
    /// those of the scene that training starts from, if there is one, else the published ones, or,
    /// for photographs that were developed for display, a luminance that varies with the view. A
    /// luminance that is the same from everywhere was worse than harmonics of radiance on such
    /// photographs (notebook, `photographs-luminance.md`).
    #[must_use]
    pub fn with_degrees(self, is_developed: bool, scene: Option<ColorModel>) -> Self {
        if self.method.spec().colors != Colors::Lcd {
            return self;
        }
        let is_open = self.luminance_degree.is_none() && self.chroma_degree.is_none();
        let [chroma, luminance] = match scene {
            Some(ColorModel::Lcd { chroma_degree, luminance_degree, .. }) => [chroma_degree, luminance_degree],
            None if is_developed && is_open && self.preset != Preset::Paper => DEVELOPED_DEGREES,
            _ => [CHROMA_DEGREE, LUMINANCE_DEGREE],
        };
        let (chroma_degree, luminance_degree) = (self.chroma_degree.or(Some(chroma)), self.luminance_degree.or(Some(luminance)));
        Self { chroma_degree, luminance_degree, ..self }
    }

    /// Returns the weights of the loss.
    pub fn loss_weights(&self) -> LossWeights {
        let (opacity_weight, scale_weight) = match self.strategy {
            Strategy::Adc => (0.0, 0.0),
            Strategy::Mcmc => (self.mcmc_opacity_weight, self.mcmc_scale_weight),
        };
        LossWeights { ssim_weight: self.ssim_weight, squared_share: self.squared_share, opacity_weight, scale_weight }
    }

    /// Returns the initial opacity of splats.
    pub fn initial_opacity(&self) -> f32 {
        let default = match self.strategy {
            Strategy::Adc => 0.1,
            Strategy::Mcmc => 0.5,
        };
        self.init_opacity.unwrap_or(default)
    }

    /// Returns the initial scale of splats, as a multiple of the root mean squared distance to
    /// their 3 nearest neighbours. 3DGS-MCMC's small initial splats are visible only because 3DGS
    /// enlarges them.
    pub fn initial_scale(&self) -> f32 {
        let default = match (self.strategy, self.antialias) {
            (Strategy::Adc, _) => 1.0,
            (Strategy::Mcmc, Antialias::Off) => 0.1,
            (Strategy::Mcmc, Antialias::Pixel | Antialias::Mip) => 0.3,
        };
        self.init_scale.unwrap_or(default)
    }

    /// Returns the largest number of splats for training images of `train_px` pixels in total.
    pub fn splat_limit(&self, train_px: u64) -> usize {
        let by_data = |pixels: u32| u32::try_from(train_px / u64::from(pixels.max(1))).unwrap_or(u32::MAX).max(MIN_BOUND_BY_DATA);
        let default = match self.strategy {
            Strategy::Adc => u32::MAX,
            Strategy::Mcmc => MCMC_DEFAULT_MAX_SPLATS,
        };
        self.max_splats.or(self.pixels_per_splat.map(by_data)).unwrap_or(default) as usize
    }

    /// Returns whether moments are held in sixteen bits, which engines on a processor alone do.
    pub fn packs_moments(&self) -> bool {
        self.moments == MomentFormat::Bf16
    }

    /// Returns the number of splats to which [`Self::splat_limit`] may rise during training.
    pub fn most_splats(&self, train_px: u64) -> usize {
        let limit = self.splat_limit(train_px);
        let rises = self.has_validation_views() && self.max_splats.is_none() && self.pixels_per_splat.is_some();
        if rises { limit.saturating_mul(MOST_RISE) } else { limit }
    }

    /// Returns whether there are validation views, if there are enough views.
    pub(crate) fn has_validation_views(&self) -> bool {
        // Gains and poses of views that are not trained on would not be known.
        let are_views_alike = !self.refine_poses && !self.vignetting && self.exposure_compensation == ExposureCompensation::Off;
        let are_views_whole = self.batch == 1 && self.crop.is_none() && !self.method.has_own_steps();
        self.validation_share > 0.0 && self.strategy == Strategy::Adc && !self.freezes_geometry() && are_views_alike && are_views_whole
    }
}

#[cfg(test)]
mod tests;
