//! The numbers of splats as arrays.

use luxel_core::{Activation, ColorModel, Splats, SplatsError};
use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::prelude::*;

use crate::arrays::{flat_of, numbers_of, rows_array, rows_of};
use crate::errors::invalid;

/// Returns the array of this name; `None` for a name that splats do not have.
pub(crate) fn array<'py>(py: Python<'py>, splats: &Splats, name: &str) -> PyResult<Option<Bound<'py, PyAny>>> {
    let (n, model) = (splats.len(), splats.color_model);
    Ok(Some(match name {
        "positions" => rows_array(py, splats.position.clone())?.into_any(),
        "rotations" => rows_array(py, splats.rotation.clone())?.into_any(),
        "log_scales" => rows_array(py, splats.log_scale.clone())?.into_any(),
        "opacity_logits" => splats.opacity_logit.clone().into_pyarray(py).into_any(),
        "sh" => splats.sh.clone().into_pyarray(py).reshape([n, model.sh_coefficients(), 3])?.into_any(),
        "raw_luminance" => splats.raw_luminance.clone().into_pyarray(py).reshape([n, model.luminance_coefficients()])?.into_any(),
        "smoothing" => splats.smoothing.clone().into_pyarray(py).into_any(),
        _ => return Ok(None),
    }))
}

/// Puts new numbers into the array of this name. All arrays together are checked by
/// [`Splats::validate`].
pub(crate) fn set(splats: &mut Splats, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
    match name {
        "positions" => splats.position = rows_of(name, value)?,
        "rotations" => splats.rotation = rows_of(name, value)?,
        "log_scales" => splats.log_scale = rows_of(name, value)?,
        "opacity_logits" => splats.opacity_logit = numbers_of(name, value)?,
        "sh" => splats.sh = flat_of(name, value)?,
        "raw_luminance" => splats.raw_luminance = flat_of(name, value)?,
        "smoothing" => splats.smoothing = numbers_of(name, value)?,
        _ => return Err(invalid(format!("splats have no array {name:?}"))),
    }
    Ok(())
}

/// Checks lengths and numbers, and quaternions, which need a length.
pub(crate) fn check(splats: &Splats) -> PyResult<()> {
    splats.validate().map_err(|error| invalid(message(error)))?;
    match splats.rotation.iter().position(|q| !q.iter().map(|v| v * v).sum::<f32>().is_normal()) {
        Some(i) => Err(invalid(format!("rotations: quaternion {i} is {:?}, expected one that can be normalised", splats.rotation[i]))),
        None => Ok(()),
    }
}

/// Words what is wrong with splats by the names of the arrays.
fn message(error: SplatsError) -> String {
    let name = |field: &'static str| match field {
        "position" => "positions",
        "rotation" => "rotations",
        "log_scale" => "log_scales",
        "opacity_logit" => "opacity_logits",
        other => other,
    };
    match error {
        SplatsError::Length { array, found, expected } => format!("{}: {found} numbers, expected {expected}", name(array)),
        SplatsError::NotFinite { array, splat } => format!("{}: a number of splat {splat} is NaN or infinite", name(array)),
        other => other.to_string(),
    }
}

/// Returns the colour model of this name, as scene files and reports name it: `sh3`, `lcd`,
/// `lcd-c2-l1-exp`.
pub(crate) fn color_model(name: &str) -> PyResult<ColorModel> {
    let unknown = || invalid(format!("color_model: found {name:?}, expected \"sh0\" to \"sh5\", \"lcd\" or \"lcd-c3-l0-softplus\""));
    let degree = |text: &str| text.parse::<u8>().map_err(|_| unknown());
    let mut parts = name.split('-');
    let model = match parts.next() {
        Some("lcd") => {
            let (mut chroma_degree, mut luminance_degree, mut activation) = (3, 0, Activation::Softplus);
            for part in parts.by_ref() {
                match part {
                    "softplus" => activation = Activation::Softplus,
                    "exp" => activation = Activation::Exp,
                    "relu" => activation = Activation::Relu,
                    _ if part.starts_with('c') => chroma_degree = degree(&part[1..])?,
                    _ if part.starts_with('l') => luminance_degree = degree(&part[1..])?,
                    _ => return Err(unknown()),
                }
            }
            ColorModel::Lcd { chroma_degree, luminance_degree, activation }
        }
        Some(sh) => ColorModel::Sh { degree: degree(sh.strip_prefix("sh").ok_or_else(unknown)?)? },
        None => return Err(unknown()),
    };
    if parts.next().is_some() || !model.is_valid() { Err(unknown()) } else { Ok(model) }
}
