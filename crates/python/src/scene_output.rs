//! Files and light probes of a scene.

use std::path::PathBuf;
use std::sync::Arc;

use glam::DMat3;
use luxel::export::{self, BakeKind, FileScale, Up};
use luxel::lights::LightOptions;
use luxel::{Bake, ExportOptions, ProbeOptions, SelectedEngine};
use luxel_core::environment::Projection;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::rows_of;
use crate::dataset::PyDataset;
use crate::errors::{OrRaise, invalid};
use crate::names;
use crate::observer::PyObserver;
use crate::probe::PyProbe;
use crate::scene::{PyScene, device as opened};
use crate::wait::{interruptible, with_locked};

/// Returns the rotation of an array `[3,3]`.
fn rotation_of(value: &Bound<'_, PyAny>) -> PyResult<DMat3> {
    let rows = rows_of::<f64, 3>("rotation", value)?;
    let rows: [[f64; 3]; 3] = rows.try_into().map_err(|rows: Vec<_>| invalid(format!("rotation: {} rows, expected 3", rows.len())))?;
    let rotation = DMat3::from_cols_array_2d(&rows).transpose();
    match luxel_core::Similarity::turn(rotation) {
        Some(_) => Ok(rotation),
        None => Err(invalid(format!("rotation: found {rows:?}, expected a rotation"))),
    }
}

#[pymethods]
impl PyScene {
    /// Exports the scene for other programs, in the format of the path's extension: .ply, .usda,
    /// .usdc, .usdz, .glb, .spz or .sog. Returns a dictionary that describes the file.
    ///
    /// Args:
    ///     path: the file, which is replaced.
    ///     bake: "exact", "linear" or "display"; None for what suits the format.
    ///     color_space: space of a linear bake.
    ///     tonemap: curve of a display bake; by default "agx", and "none" for scenes whose colours
    ///         are a display's, which then stay as they are.
    ///     exposure: stops.
    ///     max_degree: highest degree of the baked harmonics, 0 to 3.
    ///     max_splats: only this many splats, those that contribute most.
    ///     dataset: views that measure the bake, and refine one for a display.
    ///     origin: point that becomes the origin of the file, world coordinates.
    ///     rotation: [3,3], turn of the scene about the origin.
    ///     scale: factor of lengths.
    ///     metres_per_unit: length of a unit of the file; the scene's scale must be known then.
    ///     lights: whether the lamps of the scene are put into the file, which is OpenUSD or .glb,
    ///         and all other light beside it as an environment map; needs a dataset.
    #[pyo3(signature = (path, *, bake=None, color_space=None, tonemap=None, exposure=0.0, max_degree=3, max_splats=None, dataset=None, origin=None, rotation=None, scale=1.0, metres_per_unit=None, lights=false, device="auto"))]
    #[expect(clippy::too_many_arguments, reason = "arguments of Python have names")]
    fn export<'py>(
        &self,
        py: Python<'py>,
        path: PathBuf,
        bake: Option<&str>,
        color_space: Option<&str>,
        tonemap: Option<&str>,
        exposure: f32,
        max_degree: u8,
        max_splats: Option<u64>,
        dataset: Option<&PyDataset>,
        origin: Option<[f64; 3]>,
        rotation: Option<&Bound<'py, PyAny>>,
        scale: f32,
        metres_per_unit: Option<f64>,
        lights: bool,
        device: &str,
    ) -> PyResult<Bound<'py, PyDict>> {
        let kind = match bake {
            None => None,
            Some("exact") => Some(BakeKind::Exact),
            Some("linear") => Some(BakeKind::Linear),
            Some("display") => Some(BakeKind::Display),
            Some(other) => return Err(invalid(format!("bake: found {other:?}, expected \"exact\", \"linear\" or \"display\""))),
        };
        let bake = Bake {
            kind,
            color_space: names::optional_color_space(color_space)?,
            tonemap: tonemap.map(names::tonemap).transpose()?,
            exposure_ev: exposure,
            max_degree,
            refine_steps: None,
        };
        if metres_per_unit.is_some() && scale != 1.0 {
            return Err(invalid("scale and metres_per_unit exclude each other: give one of them"));
        }
        let scale = metres_per_unit.map_or(FileScale::Factor(scale), FileScale::MetresPerUnit);
        let rotation = rotation.map(rotation_of).transpose()?.unwrap_or(DMat3::IDENTITY);
        let light_options = lights.then(LightOptions::default);
        let options = ExportOptions { bake, max_splats, origin, rotation, scale, lights: light_options, ..ExportOptions::default() };
        // Only the CPU engine renders coverage, which says which directions no view saw.
        let device = opened(if lights && device == "auto" { "cpu" } else { device }, None)?;
        let scene = self.read(py, Clone::clone);
        let dataset = dataset.map(|dataset| Arc::clone(&dataset.dataset));
        let write = move || {
            let mut engine = SelectedEngine::open(&device)?.engine;
            let dataset = dataset.as_deref().map(|dataset| &**dataset);
            export::export(scene.into_core(), &path, &options, dataset, engine.as_mut(), &PyObserver::default())
        };
        let exported = interruptible(py, write)?.or_raise()?;
        let found = PyDict::new(py);
        found.set_item("splats", exported.splats)?;
        found.set_item("file_bytes", exported.file_bytes)?;
        found.set_item("bake", exported.bake)?;
        found.set_item("color_space", exported.color_space.map(|space| space.name()))?;
        found.set_item("origin", exported.origin)?;
        found.set_item("metres_per_unit", exported.metres_per_unit)?;
        if let Some(lights) = exported.lights {
            found.set_item("lamps", lights.lamps)?;
            found.set_item("map", lights.map)?;
        }
        Ok(found)
    }

    /// Renders the light that arrives at a point as an environment map.
    ///
    /// Args:
    ///     at: the point, world coordinates.
    ///     width: pixels of a latitude-longitude map, twice as wide as high, or of a face of a
    ///         cube.
    ///     projection: "latlong" or "cube".
    ///     near: splats nearer than this are left out, world units.
    ///     up: axis of the scene that is up, such as [0, 0, 1]; None for that of the data set.
    ///     color_space: space of the map; None for that of the scene.
    ///     background: radiance behind everything, 3 numbers; None for the scene's own.
    ///     alpha: whether coverage is rendered, too (on the processor).
    ///     dataset: gives the up direction and the resolution of training.
    #[pyo3(signature = (at, *, width=2048, projection="latlong", near=None, up=None, color_space=None, background=None, alpha=false, dataset=None, device="auto"))]
    #[expect(clippy::too_many_arguments, reason = "arguments of Python have names")]
    fn probe(
        &self,
        py: Python<'_>,
        at: [f64; 3],
        width: usize,
        projection: &str,
        near: Option<f32>,
        up: Option<[f64; 3]>,
        color_space: Option<&str>,
        background: Option<[f32; 3]>,
        alpha: bool,
        dataset: Option<&PyDataset>,
        device: &str,
    ) -> PyResult<PyProbe> {
        let projection = match projection {
            "latlong" => Projection::LatitudeLongitude,
            "cube" => Projection::Cube,
            other => return Err(invalid(format!("projection: found {other:?}, expected \"latlong\" or \"cube\""))),
        };
        if !(1..=1 << 16).contains(&width) {
            return Err(invalid(format!("width: found {width}, expected 1 to {}", 1 << 16)));
        }
        let (scene, own) = with_locked(py, &self.state, |state| (state.scene.clone(), state.background));
        let options = ProbeOptions {
            projection,
            width_px: width,
            near,
            up: up.map_or(Up::Default, |axis| Up::Axis(axis.into())),
            color_space: names::optional_color_space(color_space)?,
            background: scene.radiance_scale.normalised(background.unwrap_or(own)),
            alpha,
            ..ProbeOptions::at(at)
        };
        let device = opened(if alpha && device == "auto" { "cpu" } else { device }, None)?;
        let dataset = dataset.map(|dataset| Arc::clone(&dataset.dataset));
        let render = move || {
            let mut engine = SelectedEngine::open(&device)?.engine;
            let dataset = dataset.as_deref().map(|dataset| dataset.in_frame(scene.world_from_local));
            luxel::probe::probe(scene.into_core(), &options, dataset.as_deref(), engine.as_mut(), &PyObserver::default())
        };
        Ok(PyProbe::new(interruptible(py, render)?.or_raise()?))
    }
}
