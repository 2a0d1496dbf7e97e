//! Values through JSON: options from keyword arguments, results as dictionaries.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde::Serialize;
use serde_json::Value;

use crate::errors::invalid;

/// Returns a value as dictionaries, lists, numbers and text.
pub(crate) fn to_python<'py>(py: Python<'py>, value: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).map_err(|error| invalid(error.to_string()))?;
    py.import("json")?.call_method1("loads", (text,))
}

/// Returns a value of Python as JSON; what JSON does not have, such as a path, becomes its text.
pub(crate) fn from_python(value: &Bound<'_, PyAny>) -> PyResult<Value> {
    let py = value.py();
    let keywords = PyDict::new(py);
    keywords.set_item("default", py.import("builtins")?.getattr("str")?)?;
    let text: String = py.import("json")?.call_method("dumps", (value,), Some(&keywords))?.extract()?;
    serde_json::from_str(&text).map_err(|error| invalid(error.to_string()))
}
