//! The methods, in one table: a row for each says what it trains, on what, and with which colours.
//!
//! In: a name, as options and files have it. Out: a [`Method`], which stands for its row
//! ([`Method::spec`]). Code asks the row's facts, and names a method only where its own
//! implementation is chosen. To add a method, add a row: names, help and the conditions of options
//! ([`super::Condition`]) follow from it.

use luxel_core::ColorModel;
use serde::{Deserialize, Serialize};

use super::spec::ValueHelp;
use super::{CHROMA_DEGREE, LUMINANCE_DEGREE, NamedChoice, TrainConfig};

/// A row of the table of methods.
///
/// ```
/// use luxel_train::{Method, NamedChoice, Representation, Scheme};
///
/// let method = Method::from_name("hdr-gs").unwrap();
/// assert_eq!(method, Method::HdrGs);
/// assert_eq!((method.spec().title, method.spec().scheme), ("HDR-GS", Scheme::Pairs));
///
/// let field = Method::find(|method| method.representation == Representation::Field).unwrap();
/// assert_eq!(field.name(), "nerf-grid");
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MethodSpec {
    /// Name in tables and reports.
    pub title: &'static str,
    /// The kind of scene that is trained.
    pub representation: Representation,
    /// Colours of the splats.
    pub colors: Colors,
    /// Meaning of the colours of the scene.
    pub values: ColorValues,
    /// Images that it is trained on.
    pub scheme: Scheme,
}

/// The kind of scene that a method trains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Representation {
    /// Splats, which are stored.
    Splats,
    /// Anchors, whose splats networks decode for each view.
    Anchors,
    /// A radiance field, which has no splats.
    Field,
}

impl Representation {
    /// Returns a noun for people.
    pub fn noun(self) -> &'static str {
        match self {
            Self::Splats => "splats",
            Self::Anchors => "anchors",
            Self::Field => "a radiance field",
        }
    }
}

/// The colours of a method's splats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Colors {
    /// LCD, whose degrees and activation are options.
    Lcd,
    /// LCD without harmonics, for networks that see the direction; its activation is an option.
    LcdConstants,
    /// This model.
    Fixed(ColorModel),
    /// No model: networks give radiance.
    Networks,
}

impl Colors {
    /// Returns the colour model of a run with these options.
    pub(super) fn model(self, config: &TrainConfig) -> ColorModel {
        let activation = config.activation.unwrap_or_default();
        match self {
            Self::Lcd | Self::Networks => ColorModel::Lcd {
                chroma_degree: config.chroma_degree.unwrap_or(CHROMA_DEGREE),
                luminance_degree: config.luminance_degree.unwrap_or(LUMINANCE_DEGREE),
                activation,
            },
            Self::LcdConstants => ColorModel::Lcd { chroma_degree: 0, luminance_degree: 0, activation },
            Self::Fixed(model) => model,
        }
    }
}

/// The meaning of the colours of a method's scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColorValues {
    /// Radiance.
    Radiance,
    /// Values that a camera captures at one exposure, which networks of the method lift to
    /// radiance.
    Captured,
}

/// The images that a method is trained on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// Radiance, or captured images alone, whose camera's response is learned with the scene.
    RadianceOrCaptured,
    /// Radiance.
    Radiance,
    /// Captured images, through networks of the method, beside the radiance of the same pose.
    Pairs,
    /// Captured images alone, through networks of the method.
    Captured,
}

impl Scheme {
    /// Returns whether networks of the method make captured images of the scene.
    pub fn has_networks(self) -> bool {
        matches!(self, Self::Pairs | Self::Captured)
    }
}

/// Writes the handles, their names and their rows; the doc comments are the helps.
macro_rules! methods {
    (default: $default:ident; $($(#[doc = $help:literal])+ $method:ident: $name:literal, $title:literal, $representation:ident of $colors:expr, $values:ident, on $scheme:ident;)+) => {
        /// Methods: colour models, and published methods that train on captured images beside
        /// radiance.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        pub enum Method {
            $($(#[doc = $help])+ #[serde(rename = $name)] $method,)+
        }

        impl Default for Method {
            fn default() -> Self {
                Self::$default
            }
        }

        impl NamedChoice for Method {
            const VALUES: &'static [(Self, ValueHelp)] =
                &[$((Self::$method, ValueHelp { name: $name, help: concat!($($help),+).trim_ascii() })),+];
        }

        impl Method {
            /// Returns the row of the method.
            pub fn spec(self) -> &'static MethodSpec {
                match self {
                    $(Self::$method => &const {
                        MethodSpec {
                            title: $title,
                            representation: Representation::$representation,
                            colors: $colors,
                            values: ColorValues::$values,
                            scheme: Scheme::$scheme,
                        }
                    },)+
                }
            }
        }
    };
}

/// Harmonics of RGB radiance.
const fn sh(degree: u8) -> Colors {
    Colors::Fixed(ColorModel::Sh { degree })
}

/// Harmonics of the logarithm of RGB radiance.
const fn log_sh(degree: u8) -> Colors {
    Colors::Fixed(ColorModel::LogSh { degree })
}

methods! {
    default: Lcd;

    // Handle: name, title, representation of colours, meaning of the colours, on which images.

    /// Luminance and chromaticity apart (LCD-GS)
    Lcd: "lcd", "LCD", Splats of Colors::Lcd, Radiance, on RadianceOrCaptured;
    /// Spherical harmonics of RGB radiance, degree 0
    Sh0: "sh0", "3DGS, degree 0", Splats of sh(0), Radiance, on RadianceOrCaptured;
    /// Spherical harmonics of RGB radiance, degree 1
    Sh1: "sh1", "3DGS, degree 1", Splats of sh(1), Radiance, on RadianceOrCaptured;
    /// Spherical harmonics of RGB radiance, degree 2
    Sh2: "sh2", "3DGS, degree 2", Splats of sh(2), Radiance, on RadianceOrCaptured;
    /// Spherical harmonics of RGB radiance, degree 3: 3D Gaussian splatting
    Sh3: "sh3", "3DGS", Splats of sh(3), Radiance, on RadianceOrCaptured;
    /// Spherical harmonics of RGB radiance, degree 4
    Sh4: "sh4", "3DGS, degree 4", Splats of sh(4), Radiance, on RadianceOrCaptured;
    /// Spherical harmonics of RGB radiance, degree 5
    Sh5: "sh5", "3DGS, degree 5", Splats of sh(5), Radiance, on RadianceOrCaptured;
    /// Spherical harmonics of the logarithm of RGB radiance, degree 3
    LogSh3: "logsh3", "3DGS, log radiance, degree 3", Splats of log_sh(3), Radiance, on RadianceOrCaptured;
    /// HDR-GS (Cai et al. 2024): log harmonics, and networks from log radiance and exposure to
    /// captured images, which are trained on beside the radiance
    HdrGs: "hdr-gs", "HDR-GS", Splats of log_sh(3), Radiance, on Pairs;
    /// Mono-HDR-GS (Zhang et al. 2025): harmonics of captured values of one exposure, which
    /// networks lift to radiance
    MonoHdrGs: "mono-hdr-gs", "Mono-HDR-GS", Splats of sh(3), Captured, on Pairs;
    /// GaussHDR (Liu et al. 2025) on plain splats: log harmonics and context features, which
    /// global and local tone networks map to the captured images that alone are trained on
    GaussHdr: "gausshdr", "GaussHDR, plain splats", Splats of log_sh(3), Radiance, on Captured;
    /// Anchors, whose splats networks decode for each view (Scaffold-GS, Lu et al. 2024), of
    /// luminance and chromaticity
    LcdAnchors: "lcd-anchors", "LCD on anchors", Anchors of Colors::LcdConstants, Radiance, on RadianceOrCaptured;
    /// GaussHDR as published, on anchors
    GaussHdrAnchors: "gausshdr-anchors", "GaussHDR, anchors", Anchors of log_sh(0), Radiance, on Captured;
    /// No splats: a radiance field on a hash grid, of softplus radiance (NeRF)
    NerfGrid: "nerf-grid", "NeRF", Field of Colors::Networks, Radiance, on Radiance;
    /// No splats: a field of log radiance and a tone mapper, trained on captured images of
    /// several exposures alone (HDR-NeRF)
    HdrNerfGrid: "hdr-nerf-grid", "HDR-NeRF", Field of Colors::Networks, Radiance, on Captured;
    /// No splats: a field of captured values of one exposure, which networks lift to radiance,
    /// trained on captured images beside the radiance (Mono-HDR-NeRF)
    MonoHdrNerfGrid: "mono-hdr-nerf-grid", "Mono-HDR-NeRF", Field of Colors::Networks, Captured, on Pairs;
}

impl Method {
    /// Returns the first method whose row is as asked for.
    pub fn find(is_wanted: impl Fn(&MethodSpec) -> bool) -> Option<Self> {
        Self::VALUES.iter().map(|(method, _)| *method).find(|method| is_wanted(method.spec()))
    }

    /// Returns the names of the methods that are as asked for, for people: `lcd, sh0 or sh1`.
    pub fn names_where(is_wanted: impl Fn(Self) -> bool) -> String {
        let names: Vec<&str> = Self::VALUES.iter().filter(|(method, _)| is_wanted(*method)).map(|(_, value)| value.name).collect();
        match names.split_last() {
            Some((last, others)) if !others.is_empty() => format!("{} or {last}", others.join(", ")),
            _ => names.concat(),
        }
    }

    /// Returns whether it stores splats.
    pub fn stores_splats(self) -> bool {
        self.spec().representation == Representation::Splats
    }

    /// Returns whether it has networks that make captured images of splats, stored or decoded.
    pub fn has_own_networks(self) -> bool {
        self.spec().representation != Representation::Field && self.spec().scheme.has_networks()
    }

    /// Returns whether its steps on splats are its own, over the engine's rasteriser with
    /// gradients.
    pub fn has_own_steps(self) -> bool {
        self.stores_splats() && self.has_own_networks()
    }

    /// Returns whether splats hold captured values, whose colours the method lifts to radiance.
    pub fn lifts_colors(self) -> bool {
        self.stores_splats() && self.spec().values == ColorValues::Captured
    }
}
