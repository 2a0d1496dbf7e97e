//! The choices of a plan: how brackets are found, the response curve, the white balance, the
//! colour spaces.

use luxel_core::ColorSpace;

use super::{ProjectionChoice, ResponseChoice};
use crate::BracketRule;

/// The user's choice of white balance for RAW files.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum WhiteBalance {
    /// The median of the camera's choices.
    #[default]
    AsShot,
    /// The choice of one photograph, by its name with or without extension.
    Photo(String),
    /// These camera colours of white.
    Neutral([f64; 3]),
}

/// Options of [`plan`](super::plan()) and [`check_options`](super::check_options).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlanOptions {
    /// How brackets are found.
    pub brackets: BracketRule,
    /// Whether a list of exposures is given.
    pub has_exposure_list: bool,
    /// Choice of the response curve.
    pub response: ResponseChoice,
    /// Choice of the white balance.
    pub white_balance: WhiteBalance,
    /// Space of the data set's images.
    pub color_space: ColorSpace,
    /// Space of pictures that do not state theirs.
    pub input_space: ColorSpace,
    /// Choice of the projection.
    pub projection: ProjectionChoice,
}
