//! Edits of light: maps on the luminance of selected splats that keep geometry and chromaticity
//! (LCD-GS, "luminance editing").
//!
//! In: a [`crate::Scene`]. Out: the same scene with other gains ([`crate::Splats::gain`]). The
//! luminance of a splat is R + G + B of its degree-0 terms, in the units of the data set. An
//! [`Edit`] turns it into a factor, which scales the splat's radiance in every direction.
//! - Models that separate luminance (`Lcd`): all coefficients stay bit-identical.
//! - Harmonics of radiance (`Sh`): so they do under a gain. Any other map is applied to evaluated
//!   colours, and harmonics are fitted to the result, which shifts hues. [`Applied::hue_shift`]
//!   reports by how much.
//! - Mixes ([`crate::Mix`]): maps change the gains of all lights by the same factor, and
//!   [`Map::Light`] those of one.
//!
//! Cut-offs ([`crate::Cutoffs::HDR`]) follow the radiance before the gain. So a gain of all splats
//! multiplies every pixel on a black background by that gain, up to rounding, and no map changes a
//! pixel that none of the selected splats reached before. Edits change splats, not pixels: they
//! match an edit of the image pixel by pixel where the splats of a pixel have equal luminance.
//!
//! Degenerate: a black splat stays black.

mod apply;
mod display;
mod fidelity;
mod hard_edge;
mod map;
mod mask;
mod refit;
mod select;
mod stack;
mod summary;
mod text;

pub use apply::Applied;
pub use fidelity::{Fidelity, FidelityMeter, chromaticity_distance, ideally_edited};
pub use hard_edge::HardEdge;
pub use map::{Curve, DEFAULT_AMOUNT, DEFAULT_RATIO, Map, MapChain};
pub use mask::Contributions;
pub use refit::ShMap;
pub use select::{Comparison, Level, MaskName, MaskShares, Quantity, Selection};
pub use stack::EditStack;
pub use summary::SelectionSummary;
pub use text::{EditTextError, Statement};

/// An edit: maps on the luminance of selected splats, in order.
///
/// The selection is evaluated before the first map; soft edges fade all maps together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Edit {
    /// Selection of splats.
    pub selection: Selection,
    /// Maps, applied one after another.
    pub maps: Vec<Map>,
}

/// Explains why an edit was not applied. The scene is unchanged.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EditError {
    /// A parameter is out of range.
    #[error("{name} is {found}, expected {expected}")]
    Parameter {
        /// Name of the parameter.
        name: &'static str,
        /// Value found.
        found: f32,
        /// Range expected.
        expected: &'static str,
    },
    /// The points do not define a curve.
    #[error("curve {0}")]
    Curve(String),
    /// The shares of a mask are missing or belong to another scene.
    #[error("mask {} of view {} has not been projected to this scene", .0.file, .0.view)]
    Mask(MaskName),
    /// The scene has no such light.
    #[error("light {number}: {}", lights_of(*.lights))]
    Light {
        /// Number of the light, 1 for the first.
        number: u8,
        /// Number of lights in the scene.
        lights: usize,
    },
    /// The result does not fit in f32.
    #[error("splat {splat} of luminance {luminance} would overflow; lower the gain or the exponent")]
    Overflow {
        /// Index of the first such splat.
        splat: usize,
        /// Its luminance before the edit, units of the data set.
        luminance: f32,
    },
}

/// Returns what lights a scene has, for an error.
fn lights_of(lights: usize) -> String {
    match lights {
        0 | 1 => "the scene has one light, expected a mix, as luxel mix makes them".to_owned(),
        lights => format!("the scene has {lights} lights"),
    }
}

#[cfg(test)]
mod tests;
