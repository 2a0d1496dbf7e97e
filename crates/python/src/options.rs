//! Options of training and of reading, by their names in `config.toml`.

use luxel::{LoadOptions, Preset, Supervision, TrainConfig};
use luxel_app::run::RunConfig;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use crate::errors::{OrRaise, invalid};
use crate::json;

/// Returns keyword arguments as JSON.
fn given(options: Option<&Bound<'_, PyDict>>) -> PyResult<Map<String, Value>> {
    match options.map(|options| json::from_python(options)).transpose()? {
        None => Ok(Map::new()),
        Some(Value::Object(given)) => Ok(given),
        Some(_) => Err(invalid("options are given by name")),
    }
}

/// Returns `base` with the values in `given` in place of its own.
fn overlaid<T: Serialize + DeserializeOwned>(base: &T, given: &Map<String, Value>, kind: &str) -> PyResult<T> {
    let mut table = serde_json::to_value(base).map_err(luxel::Error::from).or_raise()?;
    if let Some(table) = table.as_object_mut() {
        for (name, value) in given {
            if value.is_null() {
                table.remove(name)
            } else {
                table.insert(name.clone(), value.clone())
            };
        }
    }
    serde_json::from_value(table).map_err(|error| invalid(format!("{kind}: {error}")))
}

/// Returns the settings of a training on images of a kind.
pub(crate) fn train_config(preset: Option<&str>, options: Option<&Bound<'_, PyDict>>, images: Supervision) -> PyResult<TrainConfig> {
    let mut given = given(options)?;
    if let Some(preset) = preset {
        given.insert("preset".to_owned(), preset.into());
    }
    let chosen = match given.get("preset") {
        None => Preset::default(),
        Some(name) => serde_json::from_value(name.clone()).map_err(|error| invalid(format!("preset: {error}")))?,
    };
    let config = overlaid(&TrainConfig::from_preset(chosen), &given, "options of training")?;
    let mut run = RunConfig::new("", config.with_preset(|name| given.contains_key(name)));
    run.load.supervision = images;
    match run.inapplicable(&given.keys().map(String::as_str).collect()) {
        Some(inapplicable) => Err(invalid(inapplicable.to_string())),
        None => Ok(run.train),
    }
}

/// Returns how a data set is read.
pub(crate) fn load_options(options: Option<&Bound<'_, PyDict>>) -> PyResult<LoadOptions> {
    overlaid(&LoadOptions::default(), &given(options)?, "options of reading")
}

/// Returns all options of training with their values under a preset, by name.
#[pyfunction]
#[pyo3(signature = (preset=None))]
pub(crate) fn training_options<'py>(py: Python<'py>, preset: Option<&str>) -> PyResult<Bound<'py, PyAny>> {
    json::to_python(py, &train_config(preset, None, Supervision::Hdr)?)
}
