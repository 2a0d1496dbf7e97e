//! The table of options: for each its help, type, default, name of the value, range and conditions.
//!
//! Everything else follows from the table: the fields of [`TrainConfig`] and of `config.toml`, the
//! defaults, the checks, and [`OPTIONS`], from which a command line builds its arguments. To add an
//! option, add a row here and use the field; if presets differ in it, add a row to the table of
//! [`super::preset`], too. The doc comment is the help: one sentence on what the option does,
//! without a full stop; names of options stand in backticks. Range and default are added to it.
//! `was` is a name that configurations and checkpoints of earlier programs have.

use luxel_core::engine::MomentFormat;
use luxel_core::{Activation, Antialias, MAX_SAMPLES};
use serde::{Deserialize, Serialize};

use super::range::Range;
use super::spec::{Access, Condition, OptionSpec, OptionValue, check_in, parse_in};
use super::{
    BatchRule, CutoffPreset, ExposureCompensation, FieldLoss, FieldNetworkChoice, Freeze, HdrNormalisation, LateViews, MAX_BATCH, MAX_SEED,
    Method, Preset, ScaleRule, Strategy,
};
use crate::{NoiseChoice, ResolutionSchedule};

/// Writes the struct, its defaults and the list of options.
macro_rules! options {
    ($($heading:literal {
        $($(#[doc = $help:literal])+
        $name:ident: $type:ty = $default:expr, $value_name:literal, $range:expr
            $(, unset: $note:literal)? $(, needs: [$($condition:ident $(($of:ident))?),+])? $(, was: $old_name:literal)?;)+
    })+) => {
        /// Options of training. Each has a row in [`OPTIONS`].
        ///
        /// ```
        /// use luxel_train::{Preset, TrainConfig};
        ///
        /// let config = TrainConfig { iterations: 500, ..TrainConfig::from_preset(Preset::Paper) };
        /// assert_eq!((config.iterations, config.ssim_weight), (500, 0.8));
        /// config.validate().unwrap();
        /// ```
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct TrainConfig {
            $($($(#[doc = $help])+ $(#[serde(alias = $old_name)])? pub $name: $type,)+)+
        }

        impl TrainConfig {
            /// Returns the defaults of the table.
            pub(super) fn base() -> Self {
                Self { $($($name: $default,)+)+ }
            }
        }

        /// Every option of training, in the order of `config.toml`.
        pub static OPTIONS: &[OptionSpec] = &[$($(
            OptionSpec {
                name: stringify!($name),
                heading: $heading,
                value_name: $value_name,
                range: $range,
                default_note: options!(@note $($note)?),
                old_name: options!(@note $($old_name)?),
                conditions: &[$($(Condition::$condition $((Method::$of))?),+)?],
                help: concat!($($help),+),
                access: Access {
                    is_switch: <$type as OptionValue>::IS_SWITCH,
                    values: <$type as OptionValue>::values,
                    set: |config, text, range| {
                        config.$name = parse_in(text, range)?;
                        Ok(())
                    },
                    get: |config| config.$name.format(),
                    is_set: |config| config.$name.is_set(),
                    check: |config, range| check_in(&config.$name, range),
                },
            },
        )+)+];
    };
    (@note) => { None };
    (@note $note:literal) => { Some($note) };
}

options! {
    "Training" {
        /// Preset of values for the options below; explicit options take precedence, and the preset
        /// replaces the values of a configuration file
        preset: Preset = Preset::Fast, "PRESET", Range::Any;
        /// Number of training steps, of `batch` views each
        iterations: u32 = 8_000, "N", Range::AtLeast(1);
        /// Number of steps after which the run ends where validation views (`validation_share`) are
        /// much worse than the views that are trained on, because more steps would improve only the
        /// latter; where `iterations` is given without it, all its steps are made
        early_end: Option<u32> = Some(5_500), "N", Range::AtLeast(1);
        /// Number of views that a step trains on, by the mean of their gradients; it takes that
        /// many times as long
        batch: u32 = 1, "N", Range::Limits { min: 1, max: MAX_BATCH as u64 };
        /// Rule by which the optimiser's rates follow `batch`
        batch_rule: BatchRule = BatchRule::Sqrt, "BATCH_RULE", Range::Any, needs: [Batch];
        /// Format of the optimiser's moments in memory
        moments: MomentFormat = MomentFormat::F32, "FORMAT", Range::Any;
        /// Seed of all random numbers
        seed: u64 = 42, "N", Range::Limits { min: 0, max: MAX_SEED };
        /// Train on reduced images first: off, auto, or FACTOR@STEP pairs such as
        /// 4@0,2@1500,1@4000, which divide the sides by FACTOR from STEP on
        resolution_schedule: ResolutionSchedule = ResolutionSchedule::Auto, "SCHEDULE", Range::Any;
        /// Train each step on a random part of its view, of at most this many pixels a side, for
        /// images that are too large for a step
        crop: Option<u32> = None, "PX", Range::AtLeast(64), unset: "whole views";
        /// Part of its view that a step trains on once no more splats are added; it has no effect
        /// with `crop`, on frozen geometry, and in methods with steps of their own
        late_views: LateViews = LateViews::Strips, "PART", Range::Any;
        /// Fraction of the steps, at the end and after densification, over which the parameters are
        /// averaged to the final scene, but at most the second half of the steps with
        /// supersampling, if others come before them; 0 disables it
        average_share: f32 = 0.15, "FRACTION", Range::ShareBelowOne;
        /// Fraction of the splats that a step leaves out at random, against overfitting; it rises
        /// from 0 at the first step to this at the last, to half of this where validation views
        /// (`validation_share`) are nearly as good as other training views, and to twice this where
        /// they are much worse
        dropout: f32 = 0.2, "FRACTION", Range::ShareBelowOne;
    }
    "Colour model" {
        /// Colour model of splats, or anchors or a radiance field in place of splats
        method: Method = Method::Lcd, "METHOD", Range::Any;
        /// Map from the raw luminance to luminance
        activation: Option<Activation> = None, "ACTIVATION", Range::Any, unset: "softplus", needs: [LcdColors];
        /// Degree of the chromaticity's spherical harmonics
        chroma_degree: Option<u8> = None, "DEGREE", Range::UpTo(5), unset: "3; 1 for developed photographs where `luminance_degree` is unset, too, and `preset` is not paper", needs: [Lcd];
        /// Degree of the luminance's spherical harmonics; above 0, brightness varies with the view,
        /// as it does in photographs that a camera develops: JPEG, PNG or TIFF files, also where
        /// luxel prepare made radiance of single ones
        luminance_degree: Option<u8> = None, "DEGREE", Range::UpTo(3), unset: "0; 2 for developed photographs where `chroma_degree` is unset, too, and `preset` is not paper", needs: [Lcd];
        /// Number of steps between two increases of the degree of the spherical harmonics in use
        sh_interval: Option<u32> = None, "N", Range::AtLeast(1), unset: "1000, in runs below 10000 steps a tenth of them";
    }
    "Radiance and loss" {
        /// Rule that chooses the radiance of one normalised unit from the training views
        scale_rule: ScaleRule = ScaleRule::P99, "SCALE_RULE", Range::Any;
        /// Radiance of one normalised unit, in the units of the images; overrides `scale_rule`
        radiance_scale: Option<f32> = None, "RADIANCE", Range::Positive;
        /// Radiance of the background, in the units of the images: red,green,blue or one number for
        /// grey
        background: [f32; 3] = [0.0; 3], "R,G,B", Range::AtLeast(0);
        /// mu of the mu-law through which the loss compares prediction and image
        mu: f32 = luxel_core::tone::MU, "MU", Range::AtLeast(1);
        /// Weight of 1 - SSIM in the loss; L1 has the rest
        ssim_weight: f32 = 0.2, "WEIGHT", Range::Share;
        /// Fraction of L1 that is replaced by d^2 / 0.06, where d is a pixel's difference under the
        /// mu-law, so that large errors count more
        squared_share: f32 = 0.5, "FRACTION", Range::Share;
    }
    "Published methods" {
        /// Quantity whose squared error a radiance field minimises
        field_loss: Option<FieldLoss> = None, "FIELD_LOSS", Range::Any, unset: "mulaw", needs: [FieldOnRadiance];
        /// Network of a radiance field: grid, a hash grid with small networks, or a deep network
        /// without a grid as LAYERSxUNITS; the published 8x256 takes days
        field_network: Option<FieldNetworkChoice> = None, "NETWORK", Range::Any, unset: "grid", needs: [Field];
        /// Weight of the loss of radiance
        hdr_weight: f32 = 0.6, "WEIGHT", Range::AtLeast(0), needs: [Pairs];
        /// Weight of the loss of captured images
        ldr_weight: f32 = 1.0, "WEIGHT", Range::AtLeast(0), needs: [Pairs];
        /// Scale of radiance under the mu-law in the loss
        hdr_normalisation: HdrNormalisation = HdrNormalisation::Scene, "SCALE", Range::Any, needs: [Pairs];
        /// Weight of the loss of captured values that a network makes of the rendered radiance
        cycle_weight: f32 = 0.05, "WEIGHT", Range::AtLeast(0), needs: [Method(MonoHdrGs)];
        /// Learning rate of the network from radiance to captured values
        cycle_lr: f32 = 1e-5, "RATE", Range::Positive, needs: [Method(MonoHdrGs)];
        /// Number of hidden units of the networks that lift captured values to radiance
        lift_width: u32 = 128, "N", Range::Limits { min: 1, max: 1024 }, needs: [Method(MonoHdrGs)];
        /// Learning rate of the networks that lift captured values to radiance
        lift_lr: f32 = 5e-4, "RATE", Range::Positive, needs: [Method(MonoHdrGs)];
        /// Number of hidden units of the tone mapping networks
        tone_width: u32 = 128, "N", Range::Limits { min: 1, max: 1024 }, needs: [Method(HdrGs)];
        /// Learning rate of the tone mapping networks; with gausshdr and gausshdr-anchors it falls
        /// to a tenth of this
        tone_lr: f32 = 5e-4, "RATE", Range::Positive, needs: [ToneNetworks];
        /// Learning rate of the context features of splats
        feature_lr: f32 = 7.5e-3, "RATE", Range::Positive, needs: [Method(GaussHdr)];
    }
    "Captures" {
        /// Optimise gains of the training images with the scene, for exposure or white balance that
        /// drifts; their mean over the images stays 1
        exposure_compensation: ExposureCompensation = ExposureCompensation::Off, "EXPOSURE_COMPENSATION", Range::Any;
        /// Optimise the vignetting of each lens with the scene, and remove it from the scene; the
        /// mean of its logarithm over the frame stays 0
        vignetting: bool = false, "", Range::Any;
        /// Weight pixels by their noise: auto (as the data set states it), off, or READ,SHOT for a
        /// variance of READ^2 + SHOT p at radiance p of the images as they are read
        noise_model: NoiseChoice = NoiseChoice::Auto, "MODEL", Range::Any, needs: [RadianceImages];
        /// Value that a camera records at the unit exposure (radiance times seconds = 1), which
        /// fixes the scale of radiance
        unit_exposure: f32 = 0.5, "VALUE", Range::Between, needs: [CapturedImages];
    }
    "Poses" {
        /// Optimise the camera poses of the training images with the scene; the common part of all
        /// corrections is removed, so that the scene keeps its place and scale
        refine_poses: bool = false, "", Range::Any;
        /// Optimise the focal length with the poses: one factor for all images with the same lens
        refine_focal: bool = false, "", Range::Any, needs: [RefinePoses];
        /// Initial rate of poses: how far one step may move an image, in pixels; it falls to 0
        /// along a cosine
        pose_lr: Option<f32> = None, "PIXELS", Range::Positive, unset: "by the number of steps per image, 0.02 to 0.4", needs: [RefinePoses];
        /// Step after which poses are optimised, when the scene has some shape
        pose_from: Option<u32> = None, "STEP", Range::Any, unset: "a tenth of the steps", needs: [RefinePoses];
        /// Step after which poses are fixed, so that the scene converges
        pose_until: Option<u32> = None, "STEP", Range::AtLeast(1), unset: "four fifths of the steps", needs: [RefinePoses];
    }
    "Rasteriser" {
        /// Treatment of splats smaller than a pixel
        antialias: Antialias = Antialias::Pixel, "ANTIALIAS", Range::Any;
        /// Supersampling: number of samples along a pixel's side
        samples: Option<u8> = None, "N", Range::Limits { min: 1, max: MAX_SAMPLES as u64 }, unset: "2 where no training image has more than 200000 pixels, 1 for larger images and for methods with networks";
        /// Fraction of the steps, at the end, that use supersampling
        samples_share: f32 = 0.12, "FRACTION", Range::Share, needs: [Supersampling];
        /// Cut-offs of the rasteriser
        cutoffs: CutoffPreset = CutoffPreset::Hdr, "CUTOFFS", Range::Any;
    }
    "Splats" {
        /// Part of the scene that the run starts from that is not trained
        freeze: Freeze = Freeze::None, "PART", Range::Any;
        /// Number of initial splats where the data set has no points
        init_points: u32 = 100_000, "N", Range::AtLeast(1);
        /// Largest number of initial splats from stereo between the training views, in addition to
        /// the points of the data set; at most half of the limit on splats or, without points, of
        /// `init_points`; 0 disables it
        stereo_points: Option<u32> = None, "N", Range::Any, unset: "20000; 0 where a data set with points has fewer than 8 training views";
        /// Initial opacity
        init_opacity: Option<f32> = None, "OPACITY", Range::Between, unset: "0.1 for adc, 0.5 for mcmc";
        /// Initial scale, as a multiple of the root mean squared distance to the 3 nearest
        /// neighbours
        init_scale: Option<f32> = None, "FACTOR", Range::Positive, unset: "1 for adc, 0.3 for mcmc, 0.1 for mcmc without anti-aliasing";
        /// Strategy by which the number of splats grows
        strategy: Strategy = Strategy::Adc, "STRATEGY", Range::Any;
        /// Largest number of splats
        max_splats: Option<u32> = None, "N", Range::AtLeast(1), unset: "by `pixels_per_splat`; without that none for adc, 100000 for mcmc";
        /// Limit the number of splats to the pixels of all training images divided by this number,
        /// but not below 40000; with `validation_share` the limit rises up to fourfold where the
        /// scene needs it; `max_splats` overrides this
        pixels_per_splat: Option<u32> = Some(72), "PIXELS", Range::AtLeast(1);
        /// Fraction of the training views, of 12 or more, that are validation views: not trained on
        /// while splats are added, they tell how many the scene needs; 0 disables it
        validation_share: f32 = 0.1, "FRACTION", Range::ShareBelowOne, needs: [Adc], was: "hold_out";
        /// Fraction of the largest number of splats that a round may relocate once that number is
        /// reached; with validation views, down to a quarter of this on reduced images and where
        /// they are much worse than other training views
        turnover: f32 = 0.1, "FRACTION", Range::Share, needs: [Adc];
        /// Split splats by sums of absolute pixel gradients (AbsGS)
        absgrad: bool = false, "", Range::Any, needs: [Adc];
        /// Step after which densification begins
        densify_from: Option<u32> = None, "STEP", Range::Any, unset: "500, in runs below 10000 steps a twentieth of them";
        /// Step before which densification ends
        densify_until: Option<u32> = None, "STEP", Range::Any, unset: "half of the steps for adc, five sixths for mcmc";
        /// Number of steps between two rounds of densification; with `batch`, of views
        densify_interval: Option<u32> = None, "N", Range::AtLeast(1), unset: "100; for adc in runs below 9000 steps a ninetieth of them, at least 50";
        /// Mean screen-space gradient (NDC units) above which a splat is cloned or split
        densify_threshold: f32 = 2e-4, "GRADIENT", Range::Positive, needs: [Adc];
        /// Mean absolute gradient (NDC units) above which a splat is split
        absgrad_threshold: f32 = 4e-4, "GRADIENT", Range::Positive, needs: [Adc, Absgrad];
        /// Scale, as a fraction of the scene's extent, up to which splats are cloned and above
        /// which they are split
        percent_dense: Option<f32> = None, "FRACTION", Range::Positive, unset: "0.01, with `absgrad` 0.001", needs: [Adc];
        /// Opacity below which a splat is pruned (adc) or relocated (mcmc)
        prune_opacity: f32 = 0.005, "OPACITY", Range::Share;
        /// Scale, as a fraction of the scene's extent, above which splats are pruned after the
        /// first opacity reset; 0 disables it
        prune_scale: f32 = 0.0, "FRACTION", Range::AtLeast(0), needs: [Adc];
        /// Largest ratio of a splat's length to its width, above which it is shortened, every 100
        /// steps and at the end; 0 disables it [range: 0, or 1 and above]
        max_aspect: f32 = 0.0, "RATIO", Range::AtLeast(0);
        /// Prune, after densification, the splats that contribute least to the training views and
        /// together make up this fraction of the images; 0 disables it
        prune_unseen: f32 = 0.0, "FRACTION", Range::Share, needs: [Adc];
        /// Prune splats that a camera sees nearer than this fraction of the distance of its nearest
        /// initial splats; 0 disables it
        clearance: f32 = 0.4, "FRACTION", Range::ShareBelowOne;
        /// Number of steps between two resets of all opacities to at most 0.01 during
        /// densification, with `batch` of views; 0 disables them
        opacity_reset_interval: u32 = 2000, "N", Range::Any, needs: [Adc];
        /// Growth of the number of splats per round
        mcmc_growth: f32 = 0.05, "FRACTION", Range::Share, needs: [Mcmc];
        /// Strength of the noise on positions, as a multiple of the position's learning rate
        mcmc_noise: f32 = 5e5, "FACTOR", Range::AtLeast(0), needs: [Mcmc];
        /// Weight of the mean opacity in the loss
        mcmc_opacity_weight: f32 = 0.01, "WEIGHT", Range::AtLeast(0), needs: [Mcmc];
        /// Weight of the mean scale in the loss
        mcmc_scale_weight: f32 = 0.01, "WEIGHT", Range::AtLeast(0), needs: [Mcmc];
    }
    "Learning rates" {
        /// Initial learning rate of positions, times the scene's extent
        position_lr: f32 = 8e-4, "RATE", Range::Positive;
        /// Final learning rate of positions, times the scene's extent
        position_lr_final: f32 = 8e-6, "RATE", Range::Positive;
        /// Learning rate of the constant terms of the spherical harmonics; the other terms have a
        /// twentieth
        sh_lr: f32 = 2.5e-3, "RATE", Range::AtLeast(0);
        /// Final learning rate of the constant terms of the spherical harmonics, approached
        /// log-linearly; the other terms have a twentieth
        sh_lr_final: Option<f32> = None, "RATE", Range::Positive, unset: "the initial one";
        /// Learning rate of the raw luminance; its spherical harmonics have a twentieth
        luminance_lr: f32 = 0.05, "RATE", Range::AtLeast(0), needs: [Lcd];
        /// Final learning rate of the raw luminance, approached log-linearly
        luminance_lr_final: Option<f32> = None, "RATE", Range::Positive, unset: "the initial one", needs: [Lcd];
        /// Learning rate of the opacity's logit
        opacity_lr: f32 = 0.05, "RATE", Range::AtLeast(0);
        /// Final learning rate of the opacity's logit, approached log-linearly
        opacity_lr_final: Option<f32> = None, "RATE", Range::Positive, unset: "the initial one";
        /// Learning rate of the scale's logarithm
        scale_lr: f32 = 5e-3, "RATE", Range::AtLeast(0);
        /// Final learning rate of the scale's logarithm, approached log-linearly
        scale_lr_final: Option<f32> = None, "RATE", Range::Positive, unset: "the initial one";
        /// Learning rate of rotations
        rotation_lr: f32 = 1e-3, "RATE", Range::AtLeast(0);
    }
}
