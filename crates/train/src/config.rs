//! Every option of training, for the command line and for `config.toml`. The doc comments are the help texts.
//!
//! Windows and intervals left out follow from the number of iterations ([`crate::Schedule`]), so that a short run is a short version of
//! the long one. Options that go together have named values ([`Preset`]).

mod choices;
mod preset;
mod validate;

pub use choices::{CutoffPreset, ExposureCompensation, Method, ScaleRule, Strategy};
pub use preset::Preset;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Command, FromArgMatches};
use luxel_core::{Activation, Antialias, ColorModel, Cutoffs, LossConfig, RasterConfig, ToneCurve};
use serde::{Deserialize, Serialize};

use crate::{NoiseChoice, ResolutionSchedule};

/// Largest seed: integers of `config.toml` have a sign.
pub const MAX_SEED: u64 = i64::MAX as u64;

/// Options of training.
#[derive(Clone, Debug, PartialEq, Args, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainConfig {
    /// Recipe: values of the number of steps, the strategy, the number of splats, the loss, the learning rate of positions and others, in place of the defaults below.
    /// Options said beside it win; over a --config file it sets its values anew
    #[arg(long, value_enum, default_value_t, help_heading = "Training")]
    pub preset: Preset,
    /// Training steps, one view each; at least 1
    #[arg(long, value_name = "N", default_value_t = 9_000, help_heading = "Training")]
    pub iterations: u32,
    /// Seed of everything random, below 2^63
    #[arg(long, value_name = "N", default_value_t = 42, value_parser = clap::value_parser!(u64).range(..=MAX_SEED), help_heading = "Training")]
    pub seed: u64,
    /// Training on reduced images first: off, auto, or how many times a side from which step on, such as 4@0,2@1500,1@4000: a quarter
    /// until step 1500, half until step 4000, then full size. auto starts at 2, 4 or 8 by the size of the images, and is at full size after 35 %
    /// of the steps. Evaluation is at full size
    #[arg(long, value_name = "SCHEDULE", default_value_t, help_heading = "Training")]
    pub resolution_schedule: ResolutionSchedule,
    /// Part of the steps, at the end, over which the parameters are averaged: the scene is their mean. No step is averaged before densification ends.
    /// Where --resume moves the end, what is averaged moves with it: a shorter run ends with the mean as far as it was taken, a longer one goes on from the mean if that was
    /// finished and without it if not. Below 1; 0 for none
    #[arg(long, value_name = "PART", default_value_t = 0.15, help_heading = "Training")]
    pub average_share: f32,

    /// Colour model
    #[arg(long, value_enum, default_value_t = Method::Lcd, help_heading = "Colour model")]
    pub method: Method,
    /// Map from the raw luminance to luminance (lcd only) [default: softplus]
    #[arg(long, value_parser = activation_parser(), help_heading = "Colour model")]
    pub activation: Option<Activation>,
    /// Degree of the chromaticity's harmonics (lcd only), 0 to 5 [default: 3]
    #[arg(long, value_name = "DEGREE", help_heading = "Colour model")]
    pub chroma_degree: Option<u8>,
    /// Degree of the luminance's harmonics (lcd only), 0 to 3; above 0 brightness may vary with the view [default: 0]
    #[arg(long, value_name = "DEGREE", help_heading = "Colour model")]
    pub luminance_degree: Option<u8>,
    /// Steps after which one more degree of the harmonics takes part [default: 1000, in runs below 10000 steps a tenth of them]
    #[arg(long, value_name = "N", help_heading = "Colour model")]
    pub sh_interval: Option<u32>,

    /// How the radiance of one normalised unit is chosen from the training views
    #[arg(long, value_enum, default_value_t = ScaleRule::P99, help_heading = "Radiance and loss")]
    pub scale_rule: ScaleRule,
    /// Radiance of one normalised unit, in the units of the images, above 0; overrides --scale-rule
    #[arg(long, value_name = "RADIANCE", help_heading = "Radiance and loss")]
    pub radiance_scale: Option<f32>,
    /// Radiance behind everything, in the units of the images: red,green,blue or one number for grey
    #[arg(long, value_name = "R,G,B", value_parser = parse_rgb, default_value = "0,0,0", help_heading = "Radiance and loss")]
    pub background: [f32; 3],
    /// mu of the mu-law that prediction and image are seen through by the loss, at least 1
    #[arg(long, default_value_t = luxel_core::tone::MU, help_heading = "Radiance and loss")]
    pub mu: f32,
    /// Weight of 1 - SSIM in the loss, 0 to 1; L1 has the rest
    #[arg(long, value_name = "WEIGHT", default_value_t = 0.2, help_heading = "Radiance and loss")]
    pub ssim_weight: f32,
    /// Part of L1 that is replaced by d^2 / 0.06, d a pixel's difference under the mu-law, 0 to 1: what is far off, edges and highlights, counts for more
    #[arg(long, value_name = "PART", default_value_t = 0.5, help_heading = "Radiance and loss")]
    pub squared_share: f32,

    /// Gains of the training images found beside the scene, where exposure or white balance drifts between them. Their mean over the images is
    /// held at 1, so that no cast goes into the scene
    #[arg(long, value_enum, default_value_t, help_heading = "Captures")]
    pub exposure_compensation: ExposureCompensation,
    /// Noise of the training images, by which their pixels are weighted: auto (as the data set states it, which few do), off, or READ,SHOT in
    /// the units of the images: the variance of radiance p is READ^2 + SHOT p. Of a pixel as it is read: --downscale N averages what the data set states, while
    /// these two numbers are to be of the reduced image, READ / N and SHOT / N^2 of a camera's
    #[arg(long, value_name = "MODEL", default_value_t, help_heading = "Captures")]
    pub noise_model: NoiseChoice,
    /// Value that a camera records of the unit exposure (radiance times seconds = 1), above 0 and below 1: what fixes the scale of radiance under
    /// --supervision ldr. HDR-NeRF takes 0.73 for its synthetic scenes and 0.5 for real ones
    #[arg(long, value_name = "VALUE", default_value_t = 0.5, help_heading = "Captures")]
    pub unit_exposure: f32,

    /// Treatment of splats smaller than a pixel
    #[arg(long, value_parser = antialias_parser(), default_value = "pixel", help_heading = "Rasteriser")]
    pub antialias: Antialias,
    /// Samples along a pixel's side, 1 to 4: a pixel is the mean of their square, so that edges within it are seen as a camera sees them. A step
    /// takes two to three times as long with 2
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=i64::from(luxel_core::MAX_SAMPLES)), default_value_t = 1, help_heading = "Rasteriser")]
    pub samples: u8,
    /// Part of the steps, at the end, that take --samples; those before take one, 0 to 1
    #[arg(long, value_name = "PART", default_value_t = 0.25, help_heading = "Rasteriser")]
    pub samples_share: f32,
    /// Where the rasteriser stops looking
    #[arg(long, value_enum, default_value_t = CutoffPreset::Hdr, help_heading = "Rasteriser")]
    pub cutoffs: CutoffPreset,

    /// Splats to start from where the data set has no points, at least 1
    #[arg(long, value_name = "N", default_value_t = 100_000, help_heading = "Splats")]
    pub init_points: u32,
    /// Opacity at the start, above 0 and below 1 [default: 0.1 for adc, 0.5 for mcmc]
    #[arg(long, value_name = "OPACITY", help_heading = "Splats")]
    pub init_opacity: Option<f32>,
    /// Scale at the start, as a multiple of the root mean squared distance to the 3 nearest neighbours, above 0 [default: 1 for adc, 0.3 for
    /// mcmc, with --antialias off 0.1]
    #[arg(long, value_name = "FACTOR", help_heading = "Splats")]
    pub init_scale: Option<f32>,
    /// How the number of splats grows
    #[arg(long, value_enum, default_value_t = Strategy::Adc, help_heading = "Splats")]
    pub strategy: Strategy,
    /// Largest number of splats [default: by --pixels-per-splat; without that none for adc, 100000 for mcmc]
    #[arg(long, value_name = "N", help_heading = "Splats")]
    pub max_splats: Option<u32>,
    /// Bounds the number of splats by the data: pixels of all training images together, at full size, that there are for each splat at least.
    /// No bound is below 40000 splats. --max-splats wins; --preset paper has no bound
    #[arg(long, value_name = "PIXELS", default_value = "72", help_heading = "Splats")]
    pub pixels_per_splat: Option<u32>,
    /// Part of the largest number of splats that a round may replace once that is reached (adc), 0 to 1: the splats that the training views see
    /// least of go, and those whose gradients are largest are cloned or split in their place
    #[arg(long, value_name = "PART", default_value_t = 0.1, help_heading = "Splats")]
    pub turnover: f32,
    /// Split by sums of absolute pixel gradients (AbsGS; adc only)
    #[arg(long, help_heading = "Splats")]
    pub absgrad: bool,
    /// Step after which splats are added and removed [default: 500, in runs below 10000 steps a twentieth of them]
    #[arg(long, value_name = "STEP", help_heading = "Splats")]
    pub densify_from: Option<u32>,
    /// Step before which splats are added and removed [default: half of the steps for adc, five sixths for mcmc]
    #[arg(long, value_name = "STEP", help_heading = "Splats")]
    pub densify_until: Option<u32>,
    /// Steps between two rounds of adding and removing, at least 1
    #[arg(long, value_name = "N", default_value_t = 100, help_heading = "Splats")]
    pub densify_interval: u32,
    /// Mean screen-space gradient (NDC units) above which a splat is cloned or split (adc), above 0
    #[arg(long, value_name = "GRADIENT", default_value_t = 2e-4, help_heading = "Splats")]
    pub densify_threshold: f32,
    /// Mean absolute gradient (NDC units) above which a splat is split under --absgrad, above 0
    #[arg(long, value_name = "GRADIENT", default_value_t = 4e-4, help_heading = "Splats")]
    pub absgrad_threshold: f32,
    /// Scale, as a part of the scene's extent, up to which splats are cloned and above which they are split (adc) [default: 0.01, with --absgrad 0.001]
    #[arg(long, value_name = "PART", help_heading = "Splats")]
    pub percent_dense: Option<f32>,
    /// Opacity below which a splat is removed (adc) or moved (mcmc), 0 to 1
    #[arg(long, value_name = "OPACITY", default_value_t = 0.005, help_heading = "Splats")]
    pub prune_opacity: f32,
    /// Scale, as a part of the scene's extent, above which a splat is removed once opacities have been reset (adc), at least 0; 0 for none
    #[arg(long, value_name = "PART", default_value_t = 0.0, help_heading = "Splats")]
    pub prune_scale: f32,
    /// Once no more splats are added, those go that the training views see least of (adc): as many as make up this part of the images together, 0 to 1;
    /// 0 for none
    #[arg(long, value_name = "PART", default_value_t = 0.0, help_heading = "Splats")]
    pub prune_unseen: f32,
    /// Steps between two resets of all opacities to at most 0.01 while splats are added (adc); 0 for none. One that less than a third of
    /// the interval would be left after is not made
    #[arg(long, value_name = "N", default_value_t = 3000, help_heading = "Splats")]
    pub opacity_reset_interval: u32,
    /// Growth per round (mcmc), 0 to 1
    #[arg(long, value_name = "PART", default_value_t = 0.05, help_heading = "Splats")]
    pub mcmc_growth: f32,
    /// Strength of the noise on positions (mcmc), times the position's learning rate
    #[arg(long, value_name = "FACTOR", default_value_t = 5e5, help_heading = "Splats")]
    pub mcmc_noise: f32,
    /// Weight of the mean opacity in the loss (mcmc)
    #[arg(long, value_name = "WEIGHT", default_value_t = 0.01, help_heading = "Splats")]
    pub mcmc_opacity_weight: f32,
    /// Weight of the mean scale in the loss (mcmc)
    #[arg(long, value_name = "WEIGHT", default_value_t = 0.01, help_heading = "Splats")]
    pub mcmc_scale_weight: f32,

    /// Learning rate of positions at the start, times the scene's extent
    #[arg(long, value_name = "RATE", default_value_t = 4e-4, help_heading = "Learning rates")]
    pub position_lr: f32,
    /// Learning rate of positions at the end, times the scene's extent
    #[arg(long, value_name = "RATE", default_value_t = 4e-6, help_heading = "Learning rates")]
    pub position_lr_final: f32,
    /// Learning rate of the harmonics' constant terms; the others have a twentieth
    #[arg(long, value_name = "RATE", default_value_t = 2.5e-3, help_heading = "Learning rates")]
    pub sh_lr: f32,
    /// Learning rate of the harmonics' constant terms at the end, approached log-linearly; the others have a twentieth [default: as at the start]
    #[arg(long, value_name = "RATE", help_heading = "Learning rates")]
    pub sh_lr_final: Option<f32>,
    /// Learning rate of the raw luminance (lcd); its harmonics have a twentieth
    #[arg(long, value_name = "RATE", default_value_t = 0.05, help_heading = "Learning rates")]
    pub luminance_lr: f32,
    /// Learning rate of the raw luminance at the end, approached log-linearly [default: as at the start]
    #[arg(long, value_name = "RATE", help_heading = "Learning rates")]
    pub luminance_lr_final: Option<f32>,
    /// Learning rate of the opacity's logit
    #[arg(long, value_name = "RATE", default_value_t = 0.05, help_heading = "Learning rates")]
    pub opacity_lr: f32,
    /// Learning rate of the opacity's logit at the end, approached log-linearly [default: as at the start]
    #[arg(long, value_name = "RATE", help_heading = "Learning rates")]
    pub opacity_lr_final: Option<f32>,
    /// Learning rate of the scale's logarithm
    #[arg(long, value_name = "RATE", default_value_t = 5e-3, help_heading = "Learning rates")]
    pub scale_lr: f32,
    /// Learning rate of the scale's logarithm at the end, approached log-linearly [default: as at the start]
    #[arg(long, value_name = "RATE", help_heading = "Learning rates")]
    pub scale_lr_final: Option<f32>,
    /// Learning rate of rotations
    #[arg(long, value_name = "RATE", default_value_t = 1e-3, help_heading = "Learning rates")]
    pub rotation_lr: f32,
}

/// The least that [`TrainConfig::pixels_per_splat`] bounds splats by: what a scene is made of costs little up to here, however small its images.
const MIN_BOUND_BY_DATA: u32 = 40_000;

/// Largest number of splats of the MCMC strategy where none is given.
pub const MCMC_DEFAULT_MAX_SPLATS: u32 = 100_000;

impl Default for TrainConfig {
    /// The command line's defaults, so that they stand once, with the values of the default preset.
    fn default() -> Self {
        let matches = Self::augment_args(Command::new("defaults").no_binary_name(true)).get_matches_from(std::iter::empty::<&str>());
        let config = Self::from_arg_matches(&matches).unwrap_or_else(|error| unreachable!("an option without a default value: {error}"));
        config.with_preset(|_| false)
    }
}

fn activation_parser() -> impl TypedValueParser<Value = Activation> {
    PossibleValuesParser::new(["softplus", "exp", "relu"]).map(|name| match name.as_str() {
        "exp" => Activation::Exp,
        "relu" => Activation::Relu,
        _ => Activation::Softplus,
    })
}

fn antialias_parser() -> impl TypedValueParser<Value = Antialias> {
    let value = |name: &'static str, what: &'static str| PossibleValue::new(name).help(what);
    let values = [
        value("off", "3DGS's dilation by 0.3 px^2: what is smaller than a pixel is blown up, and gains light"),
        value("pixel", "A pixel's own filter: what is smaller than a pixel keeps its light"),
        value("mip", "Mip-splatting's filters: pixel's, and no detail finer than the photographs sampled"),
    ];
    PossibleValuesParser::new(values).map(|name| match name.as_str() {
        "pixel" => Antialias::Pixel,
        "mip" => Antialias::Mip,
        _ => Antialias::Off,
    })
}

/// Radiance as options say it: `red,green,blue`, or one number for grey; finite and not negative.
///
/// # Errors
/// What is wrong with the text, for people.
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
    /// The default configuration under `preset`.
    pub fn of_preset(preset: Preset) -> Self {
        Self { preset, ..Self::default() }.with_preset(|_| false)
    }

    /// This configuration with the values of its preset, except for the options (by field name) that were given beside it.
    #[must_use]
    pub fn with_preset(mut self, is_given: impl Fn(&str) -> bool) -> Self {
        self.preset.apply(&mut self, is_given);
        self
    }

    /// The colour model that `method` and the options beside it make up.
    pub fn color_model(&self) -> ColorModel {
        match self.sh_degree() {
            Some(degree) => ColorModel::Sh { degree },
            None => ColorModel::Lcd {
                chroma_degree: self.chroma_degree.unwrap_or(3),
                luminance_degree: self.luminance_degree.unwrap_or(0),
                activation: self.activation.unwrap_or_default(),
            },
        }
    }

    fn sh_degree(&self) -> Option<u8> {
        match self.method {
            Method::Lcd => None,
            Method::Sh0 => Some(0),
            Method::Sh1 => Some(1),
            Method::Sh2 => Some(2),
            Method::Sh3 => Some(3),
            Method::Sh4 => Some(4),
            Method::Sh5 => Some(5),
        }
    }

    /// How splats become pixels, at the end.
    pub fn raster(&self) -> RasterConfig {
        let cutoffs = match self.cutoffs {
            CutoffPreset::Hdr => Cutoffs::HDR,
            CutoffPreset::Parity => Cutoffs::PARITY,
        };
        RasterConfig { cutoffs, antialias: self.antialias, samples: self.samples }
    }

    /// The loss of a step, whose curve and scale may be of its view.
    pub fn loss(&self) -> LossConfig {
        let (opacity_weight, scale_weight) = match self.strategy {
            Strategy::Adc => (0.0, 0.0),
            Strategy::Mcmc => (self.mcmc_opacity_weight, self.mcmc_scale_weight),
        };
        LossConfig {
            curve: ToneCurve::MuLaw { mu: self.mu },
            target_scale: [1.0; 3],
            ssim_weight: self.ssim_weight,
            squared_share: self.squared_share,
            opacity_weight,
            scale_weight,
        }
    }

    /// Opacity of splats at the start.
    pub fn initial_opacity(&self) -> f32 {
        let default = match self.strategy {
            Strategy::Adc => 0.1,
            Strategy::Mcmc => 0.5,
        };
        self.init_opacity.unwrap_or(default)
    }

    /// Scale of splats at the start, as a multiple of the root mean squared distance to their 3 nearest neighbours. The small ones that 3DGS-MCMC
    /// starts from are seen because 3DGS blows them up.
    pub fn initial_scale(&self) -> f32 {
        let default = match (self.strategy, self.antialias) {
            (Strategy::Adc, _) => 1.0,
            (Strategy::Mcmc, Antialias::Off) => 0.1,
            (Strategy::Mcmc, Antialias::Pixel | Antialias::Mip) => 0.3,
        };
        self.init_scale.unwrap_or(default)
    }

    /// Largest number of splats for training images of `train_px` pixels together.
    pub fn splat_limit(&self, train_px: u64) -> usize {
        let by_data = |pixels: u32| u32::try_from(train_px / u64::from(pixels.max(1))).unwrap_or(u32::MAX).max(MIN_BOUND_BY_DATA);
        let default = match self.strategy {
            Strategy::Adc => u32::MAX,
            Strategy::Mcmc => MCMC_DEFAULT_MAX_SPLATS,
        };
        self.max_splats.or(self.pixels_per_splat.map(by_data)).unwrap_or(default) as usize
    }
}

#[cfg(test)]
mod tests;
