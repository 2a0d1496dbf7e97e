//! The numbers of splats as arrays.

use luxel_core::{Activation, ColorModel, MAX_LIGHTS, Mix, Splats, SplatsError};
use numpy::{IntoPyArray, PyArrayDyn, PyArrayMethods};
use pyo3::prelude::*;

use crate::arrays::{flat_of, numbers_of, rows_of};
use crate::errors::invalid;

/// The numbers of an array.
pub(crate) struct Numbers {
    values: Vec<f32>,
    shape: Vec<usize>,
}

impl Numbers {
    /// Copies the numbers of the array of this name; `None` for a name that splats do not have.
    pub(crate) fn of(splats: &Splats, name: &str) -> Option<Self> {
        let (n, model) = (splats.len(), splats.color_model);
        let (values, shape): (&[f32], Vec<usize>) = match name {
            "positions" => (splats.position.as_flattened(), vec![n, 3]),
            "rotations" => (splats.rotation.as_flattened(), vec![n, 4]),
            "log_scales" => (splats.log_scale.as_flattened(), vec![n, 3]),
            "opacity_logits" => (&splats.opacity_logit, vec![n]),
            "sh" => (&splats.sh, vec![n, model.sh_coefficients(), 3]),
            "raw_luminance" => (&splats.raw_luminance, vec![n, model.luminance_coefficients()]),
            "smoothing" => (&splats.smoothing, vec![splats.smoothing.len()]),
            "gain" => (&splats.gain, vec![splats.gain.len()]),
            _ => return None,
        };
        Some(Self { values: values.to_vec(), shape })
    }

    /// Returns them as an array, without another copy.
    pub(crate) fn into_array(self, py: Python<'_>) -> PyResult<Bound<'_, PyArrayDyn<f32>>> {
        self.values.into_pyarray(py).reshape(self.shape)
    }
}

/// A change of splats that needs Python no more.
pub(crate) type Change = Box<dyn FnOnce(&mut Splats) + Send>;

/// Returns the change that puts new numbers into the array of this name. All arrays together are
/// checked by [`fault`].
pub(crate) fn change(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Change> {
    /// Returns the change that puts `values` into a field.
    fn put<T: Send + 'static>(values: T, field: fn(&mut Splats) -> &mut T) -> Change {
        Box::new(move |splats| *field(splats) = values)
    }
    Ok(match name {
        "positions" => put(rows_of(name, value)?, |splats| &mut splats.position),
        "rotations" => put(rows_of(name, value)?, |splats| &mut splats.rotation),
        "log_scales" => put(rows_of(name, value)?, |splats| &mut splats.log_scale),
        "opacity_logits" => put(numbers_of(name, value)?, |splats| &mut splats.opacity_logit),
        "sh" => put(flat_of(name, value)?, |splats| &mut splats.sh),
        "raw_luminance" => put(flat_of(name, value)?, |splats| &mut splats.raw_luminance),
        "smoothing" => put(numbers_of(name, value)?, |splats| &mut splats.smoothing),
        "gain" => put(numbers_of(name, value)?, |splats| &mut splats.gain),
        _ => return Err(invalid(format!("splats have no array {name:?}"))),
    })
}

/// Returns what is wrong with lengths and numbers, and with quaternions, which need a length.
pub(crate) fn fault(splats: &Splats) -> Option<String> {
    if let Err(error) = splats.validate() {
        return Some(message(error));
    }
    let i = splats.rotation.iter().position(|q| !q.iter().map(|v| v * v).sum::<f32>().is_normal())?;
    Some(format!("rotations: quaternion {i} is {:?}, expected one that can be normalised; leave such splats out", splats.rotation[i]))
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

/// Returns the colour model of this name, as scene files and reports name it: `sh3`, `logsh3`,
/// `lcd`, `lcd-c2-l1-exp`, and with `+` between them for a mix of lights.
pub(crate) fn color_model(name: &str) -> PyResult<ColorModel> {
    if !name.contains('+') {
        return color_model_of_light(name);
    }
    let lights: Vec<ColorModel> = name.split('+').map(color_model_of_light).collect::<PyResult<_>>()?;
    let count = lights.len();
    let mix = Mix::new(lights).map(ColorModel::Mix);
    mix.ok_or_else(|| invalid(format!("color_model: found {count} lights, expected at most {MAX_LIGHTS}")))
}

fn color_model_of_light(name: &str) -> PyResult<ColorModel> {
    let unknown = || {
        invalid(format!(
            "color_model: found {name:?}, expected \"sh0\" to \"sh5\", \"logsh0\" to \"logsh5\", \"lcd\" or \"lcd-c3-l0-softplus\""
        ))
    };
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
        Some(log) if log.starts_with("logsh") => ColorModel::LogSh { degree: degree(&log["logsh".len()..])? },
        Some(sh) => ColorModel::Sh { degree: degree(sh.strip_prefix("sh").ok_or_else(unknown)?)? },
        None => return Err(unknown()),
    };
    if parts.next().is_some() || !model.is_valid() { Err(unknown()) } else { Ok(model) }
}
