//! Colour models as tuples of Python, for the rasteriser.

use luxel_core::{Activation, ColorModel};
use pyo3::prelude::*;

use crate::errors::invalid;

/// A colour model: degree of the harmonics, and for method `lcd` luminance degree and activation.
/// Harmonics of log radiance are those with the activation "exp" and no luminance.
#[derive(FromPyObject)]
pub(crate) struct PyColorModel(u8, Option<u8>, Option<String>);

impl PyColorModel {
    /// Returns the model, after checking its degrees.
    pub(crate) fn model(self) -> PyResult<ColorModel> {
        let Self(degree, luminance_degree, activation) = self;
        let activation = match activation.as_deref() {
            None => None,
            Some("softplus") => Some(Activation::Softplus),
            Some("exp") => Some(Activation::Exp),
            Some("relu") => Some(Activation::Relu),
            Some(other) => return Err(invalid(format!("activation {other:?}, expected \"softplus\", \"exp\" or \"relu\""))),
        };
        let model = match (luminance_degree, activation) {
            (Some(luminance_degree), Some(activation)) => ColorModel::Lcd { chroma_degree: degree, luminance_degree, activation },
            (None, None) => ColorModel::Sh { degree },
            (None, Some(Activation::Exp)) => ColorModel::LogSh { degree },
            _ => return Err(invalid("activation: expected a degree of the luminance with it, unless it is \"exp\"")),
        };
        if model.is_valid() { Ok(model) } else { Err(invalid(format!("colour model {}: degrees are at most 5", model.name()))) }
    }
}
