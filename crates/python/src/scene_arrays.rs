//! The arrays of a scene's splats as attributes of `Scene`.

use luxel_core::Splats;
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::invalid;
use crate::scene::PyScene;
use crate::splats::{self, Change, Numbers};
use crate::wait::with_locked;

impl PyScene {
    fn array<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let numbers = self.read(py, |scene| Numbers::of(&scene.splats, name));
        numbers.ok_or_else(|| invalid(format!("splats have no array {name:?}")))?.into_array(py)
    }

    fn set_array(&self, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.change(value.py(), vec![splats::change(name, value)?])
    }

    /// Changes the scene; it stays as it is if the changes do not go together.
    fn change(&self, py: Python<'_>, changes: Vec<Change>) -> PyResult<()> {
        let fault = with_locked(py, &self.state, |state| {
            let mut changed = state.scene.clone().into_core();
            changes.into_iter().for_each(|change| change(&mut changed.splats));
            let fault = splats::fault(&changed.splats);
            if fault.is_none() {
                state.replace(changed.into());
            }
            fault
        });
        fault.map_or(Ok(()), |message| Err(invalid(message)))
    }
}

#[pymethods]
impl PyScene {
    /// Positions, float32 [count, 3], local coordinates.
    #[getter]
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.array(py, "positions")
    }

    #[setter]
    fn set_positions(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.set_array("positions", value)
    }

    /// Quaternions w, x, y, z, float32 [count, 4], of any length but zero.
    #[getter]
    fn rotations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.array(py, "rotations")
    }

    #[setter]
    fn set_rotations(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.set_array("rotations", value)
    }

    /// Natural logarithms of the standard deviations along the axes, float32 [count, 3].
    #[getter]
    fn log_scales<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.array(py, "log_scales")
    }

    #[setter]
    fn set_log_scales(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.set_array("log_scales", value)
    }

    /// Logits of the opacity, float32 [count].
    #[getter]
    fn opacity_logits<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.array(py, "opacity_logits")
    }

    #[setter]
    fn set_opacity_logits(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.set_array("opacity_logits", value)
    }

    /// Harmonics of radiance or chromaticity, float32 [count, K, 3].
    #[getter]
    fn sh<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.array(py, "sh")
    }

    #[setter]
    fn set_sh(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.set_array("sh", value)
    }

    /// Raw luminance, float32 [count, M]; M is 0 for a model without luminance.
    #[getter]
    fn raw_luminance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.array(py, "raw_luminance")
    }

    #[setter]
    fn set_raw_luminance(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.set_array("raw_luminance", value)
    }

    /// Standard deviations of the smoothing filter, float32 [count]; empty without the filter.
    #[getter]
    fn smoothing<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.array(py, "smoothing")
    }

    #[setter]
    fn set_smoothing(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.set_array("smoothing", value)
    }

    /// Gains of the splats' light since training, float32 [count]; empty for 1 everywhere. Edits
    /// change them: cut-offs follow the radiance before them.
    #[getter]
    fn gain<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.array(py, "gain")
    }

    #[setter]
    fn set_gain(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.set_array("gain", value)
    }

    /// Takes the gains into the colours: cut-offs then follow the radiance with them.
    fn fold_gains(&self, py: Python<'_>) -> PyResult<()> {
        self.change(py, vec![Box::new(Splats::fold_gains)])
    }

    /// Changes several arrays at once, by name; their number of splats may differ from before.
    #[pyo3(signature = (**arrays))]
    fn set(&self, py: Python<'_>, arrays: Option<&Bound<'_, PyDict>>) -> PyResult<()> {
        let change = |(name, value): (Bound<'_, PyAny>, Bound<'_, PyAny>)| splats::change(&name.extract::<String>()?, &value);
        let changes = arrays.into_iter().flat_map(|arrays| arrays.iter()).map(change).collect::<PyResult<_>>()?;
        self.change(py, changes)
    }
}
