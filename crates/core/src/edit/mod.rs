//! Edits of light: maps on the luminance of selected splats that leave geometry and chromaticity alone (LCD-GS, "luminance editing").
//!
//! In: a [`crate::Scene`]. Out: the same scene with other colour coefficients. The luminance of a splat is R + G + B of its degree-0
//! terms, in the units of the data set; an [`Edit`] turns it into a factor by which the splat's radiance is scaled in every direction.
//! - Models with a luminance of their own (`Lcd`): that alone changes; chromaticity coefficients keep their bits.
//! - Harmonics of radiance (`Sh`): a gain is exact; any other map is applied to evaluated colours and fitted again, which moves hues.
//!   [`Applied::hue_shift`] tells how far.
//!
//! A gain of all splats multiplies every pixel on black by itself, to rounding, under [`crate::Cutoffs::PARITY`]. Cut-offs that follow
//! radiance ([`crate::Cutoffs::HDR`]) keep more of a brighter splat's skirt, so that it holds within what they skip: `min_contribution`,
//! times the gain where it brightens, for each splat over the pixel. Edits see splats, not pixels: what is said of an image edited pixel
//! by pixel holds where splats of one luminance make up a pixel.
//!
//! Degenerate: a black splat stays black. Luminances of `Lcd` models end at 1e-8 normalised units, so a gain of 0 leaves that much.

mod apply;
mod display;
mod fidelity;
mod map;
mod mask;
mod refit;
mod select;
mod summary;
mod text;

pub use apply::Applied;
pub use fidelity::{Fidelity, FidelityMeter, chromaticity_distance, ideally_edited};
pub use map::{Curve, DEFAULT_AMOUNT, DEFAULT_RATIO, Map, MapChain};
pub use mask::Contributions;
pub use refit::ShMap;
pub use select::{Comparison, Level, MaskName, MaskShares, Quantity, Selection};
pub use summary::SelectionSummary;
pub use text::{EditTextError, Statement};

/// Maps on the luminance of selected splats, in order. The selection is made before the first map; soft edges fade all of them together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Edit {
    /// Which splats.
    pub selection: Selection,
    /// One after another.
    pub maps: Vec<Map>,
}

/// Why an edit was not applied. The scene is as it was.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EditError {
    /// Parameter out of range.
    #[error("{name} is {found}, expected {expected}")]
    Parameter {
        /// Which.
        name: &'static str,
        /// Its value.
        found: f32,
        /// What it should be.
        expected: &'static str,
    },
    /// Points that a curve can't go through.
    #[error("curve {0}")]
    Curve(String),
    /// Shares of a mask that were not given, or are not of this scene.
    #[error("mask {} of view {} has not been projected to this scene", .0.file, .0.view)]
    Mask(MaskName),
    /// The result does not fit into f32.
    #[error("splat {splat} of luminance {luminance} would overflow; lower the gain or the exponent")]
    Overflow {
        /// Index of the first such splat.
        splat: usize,
        /// Its luminance before the edit, units of the data set.
        luminance: f32,
    },
}

#[cfg(test)]
mod tests;
