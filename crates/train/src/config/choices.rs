//! Options whose values have names.

use luxel_core::engine::MomentFormat;
use luxel_core::{Activation, Antialias};
use luxel_metrics::GainChannels;
use serde::{Deserialize, Serialize};

use super::Method;
use super::spec::{OptionValue, ValueHelp};

/// A type whose values have names.
///
/// ```
/// use luxel_train::{Method, NamedChoice};
///
/// assert_eq!(Method::from_name("sh3"), Some(Method::Sh3));
/// assert_eq!(Method::Lcd.name(), "lcd");
/// assert_eq!(Method::HdrGs.name(), "hdr-gs");
/// ```
pub trait NamedChoice: Copy + PartialEq + 'static {
    /// The values with names and helps, in the order of listing.
    const VALUES: &'static [(Self, ValueHelp)];

    /// Returns the value with this name.
    fn from_name(name: &str) -> Option<Self> {
        Self::VALUES.iter().find(|(_, value)| value.name == name).map(|(choice, _)| *choice)
    }

    /// Returns the name of the value.
    fn name(self) -> &'static str {
        Self::VALUES.iter().find(|(choice, _)| *choice == self).map_or("", |(_, value)| value.name)
    }
}

/// Implements `OptionValue` for types whose values have names.
macro_rules! choice_options {
    ($($type:ty),+ $(,)?) => {
        $(impl OptionValue for $type {
            fn parse(text: &str) -> Result<Self, String> {
                let names = || Self::VALUES.iter().map(|(_, value)| value.name).collect::<Vec<_>>().join(", ");
                Self::from_name(text).ok_or_else(|| format!("found \"{text}\", expected one of {}", names()))
            }

            fn format(&self) -> Option<String> {
                Some(self.name().to_owned())
            }

            fn values() -> Vec<ValueHelp> {
                Self::VALUES.iter().map(|(_, value)| *value).collect()
            }
        })+
    };
}

/// Defines enumerations whose values have names; the doc comments are the helps.
macro_rules! choices {
    ($($(#[doc = $doc:literal])+ pub enum $type:ident = $default:ident { $($(#[doc = $help:literal])+ $value:ident: $name:literal,)+ })+) => {
        $(
            $(#[doc = $doc])+
            #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
            pub enum $type {
                $($(#[doc = $help])+ #[serde(rename = $name)] $value,)+
            }

            impl Default for $type {
                fn default() -> Self {
                    Self::$default
                }
            }

            impl NamedChoice for $type {
                const VALUES: &'static [(Self, ValueHelp)] =
                    &[$((Self::$value, ValueHelp { name: $name, help: concat!($($help),+).trim_ascii() })),+];
            }
        )+

        choice_options!($($type),+);
    };
}

choices! {
    /// Presets: values of options that belong together.
    pub enum Preset = Fast {
        /// 8000 steps, or fewer where more would not help, and no more splats than the images can
        /// tell apart
        Fast: "fast",
        /// The same in 30000 steps
        Full: "full",
        /// The published method: 30000 steps, 0.2 L1 + 0.8 (1 - SSIM), no bound on the number of
        /// splats, learning rates and cut-offs of 3DGS (Kerbl et al. 2023)
        Paper: "paper",
    }

    /// Scales of radiance under the mu-law.
    pub enum HdrNormalisation = Scene {
        /// One scale for all images, that of `scale_rule`: renders keep the unit of the data set
        Scene: "scene",
        /// Each image by its own maximum, as HDR-GS was published: renders have no unit
        Own: "self",
    }

    /// Values of a pixel whose squared difference a radiance field minimises.
    pub enum FieldLoss = Mulaw {
        /// Radiance in normalised units: lamps outweigh everything else
        Linear: "linear",
        /// The mu-law of radiance, not clamped
        Mulaw: "mulaw",
    }

    /// Strategies by which the number of splats grows.
    pub enum Strategy = Adc {
        /// Clone, split, prune and reset by screen-space gradients (Kerbl et al. 2023)
        Adc: "adc",
        /// Relocation, growth to `max_splats`, and noise (3DGS-MCMC, Kheradmand et al. 2024)
        Mcmc: "mcmc",
    }

    /// Parts of a scene that a run which starts from it leaves as they are.
    pub enum Freeze = None {
        /// Nothing
        None: "none",
        /// Positions, rotations, scales and opacities, to the bit, and the number and order of
        /// splats: only colours are trained, for other light on the same geometry
        Geometry: "geometry",
    }

    /// Presets of the rasteriser's cut-offs.
    pub enum CutoffPreset = Hdr {
        /// Derived for radiance
        Hdr: "hdr",
        /// The values of 3D Gaussian splatting, derived for 8-bit output
        Parity: "parity",
    }

    /// The gains that are optimised with the scene, for images whose exposure or white balance
    /// drifts.
    pub enum ExposureCompensation = Off {
        /// None: the images are exact
        Off: "off",
        /// One gain per image
        Exposure: "exposure",
        /// A gain per image and channel: exposure and white balance
        Color: "color",
    }

    /// The part of a view that a step trains on once no more splats are added.
    pub enum LateViews = Whole {
        /// All of it
        Whole: "whole",
        /// A strip between a border and a random place, across or down: 0.6 of the time a step,
        /// for a loss of about 0.1 dB
        Strips: "strips",
    }

    /// The rule by which the optimiser's rates follow the number of views a step.
    pub enum BatchRule = Sqrt {
        /// Learning rates and Adam's betas stay as they are for one view
        Keep: "keep",
        /// Learning rates times the root of the number of views; betas to its power
        Sqrt: "sqrt",
        /// Learning rates times the number of views; betas to its power
        Linear: "linear",
    }

    /// The rule by which the radiance of one normalised unit is chosen from the training views.
    pub enum ScaleRule = P99 {
        /// The median of (R + G + B) / 3 becomes 0.05, the middle of the mu-law's range
        Median20: "median20",
        /// The 99th percentile of (R + G + B) / 3 becomes 1: all but lamps and highlights lie in
        /// the mu-law's range
        P99: "p99",
        /// The largest channel value becomes 1
        Max: "max",
        /// Radiance stays as it is in the images
        Raw: "raw",
    }
}

choice_options!(Activation, Antialias, Method, MomentFormat);

impl NamedChoice for Activation {
    const VALUES: &'static [(Self, ValueHelp)] = &[
        (Self::Softplus, ValueHelp { name: "softplus", help: "" }),
        (Self::Exp, ValueHelp { name: "exp", help: "" }),
        (Self::Relu, ValueHelp { name: "relu", help: "" }),
    ];
}

impl NamedChoice for MomentFormat {
    const VALUES: &'static [(Self, ValueHelp)] = &[
        (Self::F32, ValueHelp { name: "f32", help: "Single precision" }),
        (
            Self::Bf16,
            ValueHelp { name: "bf16", help: "Sixteen bits, rounded at random: a third less memory for each splat; on a processor alone" },
        ),
    ];
}

impl NamedChoice for Antialias {
    const VALUES: &'static [(Self, ValueHelp)] = &[
        (
            Self::Off,
            ValueHelp { name: "off", help: "3DGS's dilation by 0.3 px^2: splats smaller than a pixel are enlarged and gain light" },
        ),
        (Self::Pixel, ValueHelp { name: "pixel", help: "A pixel's own filter: splats smaller than a pixel keep their light" }),
        (
            Self::Mip,
            ValueHelp { name: "mip", help: "Mip-splatting's filters: the pixel's, and no detail finer than the training images sample" },
        ),
    ];
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
