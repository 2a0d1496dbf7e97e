//! Choices by the names that the command line has for them.

use luxel::{ColorSpace, Tonemap};
use luxel_io::Transfer;
use pyo3::prelude::*;

use crate::errors::invalid;

/// Returns a colour space.
pub(crate) fn color_space(name: &str) -> PyResult<ColorSpace> {
    ColorSpace::from_name(name).ok_or_else(|| invalid(format!("color_space: found {name:?}, expected {}", ColorSpace::NAMES)))
}

/// Returns a colour space of a scene's colours, or of its renders: also that of a display.
pub(crate) fn scene_color_space(name: &str) -> PyResult<ColorSpace> {
    let unknown = || invalid(format!("color_space: found {name:?}, expected {}, or {}", ColorSpace::NAMES, ColorSpace::DisplaySrgb.name()));
    ColorSpace::of_scene(name).ok_or_else(unknown)
}

/// Returns a colour space, if one is named.
pub(crate) fn optional_color_space(name: Option<&str>) -> PyResult<Option<ColorSpace>> {
    name.map(color_space).transpose()
}

/// Returns a tone curve.
pub(crate) fn tonemap(name: &str) -> PyResult<Tonemap> {
    name.parse().map_err(|error| invalid(format!("tonemap: {error}")))
}

/// Returns the curve of samples, if one is named.
pub(crate) fn transfer(name: Option<&str>) -> PyResult<Option<Transfer>> {
    name.map(|name| name.parse().map_err(|error| invalid(format!("transfer: {error}")))).transpose()
}
