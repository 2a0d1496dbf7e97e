//! Lamps and geometry of a scene for other programs: its light, and a proxy mesh.

use std::path::PathBuf;
use std::sync::Arc;

use luxel::export::Up;
use luxel::lights::{DomeOptions, LightOptions, SceneLights, WindowOptions, lights_json, scene_lights};
use luxel::mesh::{MeshOptions, SceneMesh, TriangleMesh, mesh};
use luxel::{Dataset, Probe, SelectedEngine};
use numpy::PyArray2;
use pyo3::prelude::*;

use crate::arrays::rows_array;
use crate::camera::PyCamera;
use crate::dataset::PyDataset;
use crate::errors::{OrRaise, invalid};
use crate::observer::PyObserver;
use crate::probe::PyProbe;
use crate::scene::{PyScene, device as opened};
use crate::wait::{interruptible, with_locked};
use crate::{json, names};

/// The lamps of a scene, and the rest of its light as a map without them.
#[pyclass(name = "Lights", module = "luxel", frozen)]
pub(crate) struct PyLights {
    lights: SceneLights,
    up: Up,
    dataset: Arc<Dataset>,
}

#[pymethods]
impl PyLights {
    /// Lamps, strongest first, then portals: dictionaries as in the JSON of `luxel lights`.
    #[getter]
    fn lamps<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(py, &lights_json(&self.lights))
    }

    /// All other light; None if it was not asked for.
    #[getter]
    fn map(&self) -> Option<PyProbe> {
        self.lights.dome.as_ref().map(|dome: &Probe| PyProbe::new(dome.clone()))
    }

    /// Part of the map's directions that no view saw, 0 to 1.
    #[getter]
    fn unseen_share(&self) -> f64 {
        self.lights.unseen_share
    }

    /// Bright groups of splats that stay in the map, each with the reason.
    #[getter]
    fn left_in_map(&self) -> Vec<String> {
        self.lights.left_in_map.clone()
    }

    /// Name of the colour space.
    #[getter]
    fn color_space(&self) -> &'static str {
        self.lights.color_space.name()
    }

    /// Writes the lamps as .usda, .glb, .json or .csv; the map goes beside them as NAME_dome.exr.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| self.lights.save(path, self.up, &self.dataset)).or_raise()
    }

    fn __len__(&self) -> usize {
        self.lights.lights.len()
    }

    fn __repr__(&self) -> String {
        format!("<luxel.Lights {}>", luxel_core::text::plural(self.lights.lights.len(), "lamp"))
    }
}

/// A triangle mesh of what the cameras of a scene saw.
#[pyclass(name = "Mesh", module = "luxel", frozen)]
pub(crate) struct PyMesh {
    made: SceneMesh,
    world: TriangleMesh,
}

#[pymethods]
impl PyMesh {
    /// Positions of the vertices, float32 [vertices,3], world coordinates.
    #[getter]
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        rows_array(py, self.world.positions.clone())
    }

    /// Unit normals of the vertices, float32 [vertices,3], towards the free side.
    #[getter]
    fn normals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        rows_array(py, self.world.normals.clone())
    }

    /// Linear radiance of the vertices, float32 [vertices,3], in the units of the data set.
    #[getter]
    fn radiance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        rows_array(py, self.world.radiance.clone())
    }

    /// Vertices of the triangles, uint32 [triangles,3], counterclockwise from the free side.
    #[getter]
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        rows_array(py, self.world.triangles.clone())
    }

    /// Side of a voxel, world units.
    #[getter]
    fn voxel(&self) -> f64 {
        self.made.report.lengths.voxel
    }

    /// Name of the colour space of the radiance.
    #[getter]
    fn color_space(&self) -> &'static str {
        self.made.color_space().name()
    }

    /// Writes the mesh: .usdc, .usda, .usdz, .glb, .ply or .obj.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| self.made.save(path)).or_raise()
    }

    fn __repr__(&self) -> String {
        format!("<luxel.Mesh {}>", luxel_core::text::plural(self.made.triangles(), "triangle"))
    }
}

fn up_of(axis: Option<[f64; 3]>) -> Up {
    axis.map_or(Up::Default, |axis| Up::Axis(axis.into()))
}

#[pymethods]
impl PyScene {
    /// Finds the lamps of the scene, and renders the rest of its light as a map without them.
    ///
    /// Args:
    ///     dataset: views that measure the lamps.
    ///     medians: a lamp is this many times as bright as the median pixel.
    ///     windows: large flat parts that are this many times as bright as the median pixel are
    ///         rectangles of light, such as windows; None for none.
    ///     portals: leaves the light of windows in the map, whose portals they are.
    ///     most: most lamps; weaker ones stay in the map.
    ///     map: whether the map is rendered.
    ///     at: point of the map, world coordinates; None for one between the cameras and what they
    ///         look at.
    ///     width: pixels of the map, twice as wide as high.
    ///     fill: whether directions that no view saw get the median radiance of the views; else
    ///         they are black.
    ///     up: axis of the scene that is up, such as [0, 0, 1]; None for that of the data set.
    ///     color_space: linear space of lamps and map.
    #[pyo3(signature = (dataset, *, medians=100.0, windows=30.0, portals=false, most=32, map=true, at=None, width=1024, fill=true, up=None, color_space="linear-rec709", device="auto"))]
    #[expect(clippy::too_many_arguments, reason = "arguments of Python have names")]
    fn lights(
        &self,
        py: Python<'_>,
        dataset: &PyDataset,
        medians: f64,
        windows: Option<f64>,
        portals: bool,
        most: usize,
        map: bool,
        at: Option<[f64; 3]>,
        width: usize,
        fill: bool,
        up: Option<[f64; 3]>,
        color_space: &str,
        device: &str,
    ) -> PyResult<PyLights> {
        if !(medians > 1.0 && medians.is_finite()) {
            return Err(invalid(format!("medians: found {medians}, expected a number above 1")));
        }
        if !(1..=1 << 16).contains(&width) {
            return Err(invalid(format!("width: found {width}, expected 1 to {}", 1 << 16)));
        }
        if windows.is_some_and(|medians| !(medians > 1.0 && medians.is_finite())) {
            return Err(invalid(format!("windows: found {windows:?}, expected a number above 1")));
        }
        if portals && (windows.is_none() || !map) {
            return Err(invalid("portals: they are windows of the map, which needs windows and map"));
        }
        let windows = windows.map(|medians| WindowOptions { medians, are_portals: portals });
        let up = up_of(up);
        let dome = map.then_some(DomeOptions { at, width_px: width, fill, up });
        let options =
            LightOptions { medians, windows, most, color_space: names::color_space(color_space)?, dome, ..LightOptions::default() };
        let scene = with_locked(py, &self.state, |state| state.scene.clone());
        // Only the CPU engine renders coverage, which says which directions no view saw.
        let device = opened(if map && fill && device == "auto" { "cpu" } else { device }, None)?;
        let dataset = Arc::clone(&dataset.dataset);
        let views = Arc::clone(&dataset);
        let find = move || {
            let mut engine = SelectedEngine::open(&device)?.engine;
            scene_lights(scene.into_core(), &views, &options, engine.as_mut(), &PyObserver::default())
        };
        Ok(PyLights { lights: interruptible(py, find)?.or_raise()?, up, dataset })
    }

    /// Makes a proxy mesh: what the cameras saw, as triangles.
    ///
    /// Args:
    ///     dataset: its training views look at the scene, unless there are `cameras`; it tells
    ///         where up is.
    ///     cameras: cameras that look at the scene.
    ///     voxel: finest detail, world units; None for 1/256 of the scene's diagonal or what the
    ///         images resolve.
    ///     triangles: simplifies the mesh to this many.
    ///     min_island: parts that are smaller across are removed, world units; None for 16 voxels.
    ///     max_hole: flat holes that are smaller across are filled, world units; None for 32
    ///         voxels.
    ///     max_depth: what lies further away is left out, world units.
    ///     image_size: longest side of the depth images, pixels.
    ///     max_views: of more cameras, evenly spread ones are taken.
    ///     up: axis of the scene that is up, such as [0, 0, 1]; None for that of the data set.
    ///     color_space: space of the radiance; None for that of the scene.
    #[pyo3(signature = (dataset=None, *, cameras=None, voxel=None, triangles=None, min_island=None, max_hole=None, max_depth=None, image_size=400, max_views=200, up=None, color_space=None))]
    #[expect(clippy::too_many_arguments, reason = "arguments of Python have names")]
    fn mesh(
        &self,
        py: Python<'_>,
        dataset: Option<&PyDataset>,
        cameras: Option<Vec<PyRef<'_, PyCamera>>>,
        voxel: Option<f64>,
        triangles: Option<usize>,
        min_island: Option<f64>,
        max_hole: Option<f64>,
        max_depth: Option<f64>,
        image_size: u32,
        max_views: usize,
        up: Option<[f64; 3]>,
        color_space: Option<&str>,
    ) -> PyResult<PyMesh> {
        let up = up_of(up);
        let color_space = names::optional_color_space(color_space)?;
        let scene = with_locked(py, &self.state, |state| state.scene.clone());
        let options = MeshOptions {
            voxel,
            triangles,
            min_island,
            max_hole,
            max_depth,
            image_size,
            max_views,
            up,
            color_space,
            ..MeshOptions::default()
        };
        let dataset = dataset.map(|dataset| Arc::clone(&dataset.dataset));
        let frame = scene.world_from_local;
        let eyes = match (&cameras, &dataset) {
            (Some(cameras), _) => cameras.iter().map(|camera| camera.seen_from(&frame)).collect(),
            (None, Some(dataset)) => dataset.in_frame(frame).train.iter().map(|view| view.camera.clone()).collect::<Vec<_>>(),
            (None, None) => return Err(invalid("dataset and cameras: both are None; expected one that looks at the scene")),
        };
        // Only the CPU engine has surface images.
        let device = opened("cpu", None)?;
        let make = move || {
            let mut engine = SelectedEngine::open(&device)?.engine;
            let dataset = dataset.as_deref().map(|dataset| &**dataset);
            mesh(&scene.into_core(), &eyes, &options, dataset, engine.as_mut(), &PyObserver::default())
        };
        let made = interruptible(py, make)?.or_raise()?;
        let (world, _) = made.in_world();
        Ok(PyMesh { made, world })
    }
}
