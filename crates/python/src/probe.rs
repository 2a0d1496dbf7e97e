//! Light probes: the light that arrives at a point.

use std::path::PathBuf;

use luxel::Probe;
use luxel::probe::light_json;
use luxel_io::ExrSample;
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;

use crate::arrays::{image_array, matrix_array, plane_array};
use crate::errors::{OrRaise, invalid};
use crate::json;

/// The radiance that arrives at a point, as an environment map. +y is up, and the middle of a
/// latitude-longitude map looks along +z, as OpenEXR has it.
#[pyclass(name = "Probe", module = "luxel", frozen)]
pub(crate) struct PyProbe(Probe);

impl PyProbe {
    pub(crate) fn new(probe: Probe) -> Self {
        Self(probe)
    }
}

#[pymethods]
impl PyProbe {
    /// The map, float32 [height, width, 3], in the units of the data set.
    #[getter]
    fn image<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        image_array(py, self.0.image().clone())
    }

    /// Coverage of the pixels by splats, float32 [height, width]; None unless it was asked for.
    #[getter]
    fn alpha<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f32>>>> {
        self.0.alpha().map(|alpha| plane_array(py, [self.0.width(), self.0.height()], alpha.to_vec())).transpose()
    }

    /// Lamps, strongest first: dictionaries with direction, solid_angle_sr, radiance, peak_radiance
    /// and irradiance.
    #[getter]
    fn lights<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let lights: Vec<serde_json::Value> = self.0.lights.iter().map(light_json).collect();
        json::to_python(py, &lights)
    }

    /// Rotation from directions of the world to the axes of the map, float64 [3,3].
    #[getter]
    fn map_from_world<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        matrix_array(py, self.0.map_from_world.transpose().to_cols_array_2d())
    }

    /// Largest channel of any pixel.
    #[getter]
    fn peak_radiance(&self) -> f32 {
        self.0.summary.peak_radiance
    }

    /// Name of the colour space.
    #[getter]
    fn color_space(&self) -> &'static str {
        self.0.color_space().name()
    }

    /// Writes an OpenEXR file that names its projection, colour space and point.
    #[pyo3(signature = (path, *, exr_type="auto"))]
    fn save_exr(&self, path: PathBuf, exr_type: &str) -> PyResult<()> {
        let sample = match exr_type {
            "auto" => ExrSample::smallest_for(self.0.image()),
            "half" => ExrSample::Half,
            "float" => ExrSample::Float,
            other => return Err(invalid(format!("exr_type: found {other:?}, expected \"auto\", \"half\" or \"float\""))),
        };
        self.0.save_exr(path, sample).or_raise().map(drop)
    }

    fn __repr__(&self) -> String {
        format!("<luxel.Probe {}x{}, {} lights>", self.0.width(), self.0.height(), self.0.lights.len())
    }
}
