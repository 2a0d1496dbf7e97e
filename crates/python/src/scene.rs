//! Scenes: splats of radiance that are rendered, edited and exported.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use luxel::export::{self, BakeKind, FileScale, Up};
use luxel::run::RunFolder;
use luxel::{Bake, Device, DeviceOptions, Edit, ExportOptions, ProbeOptions, Renderer, Scene, SelectedEngine};
use luxel_core::environment::Projection;
use luxel_core::{ColorModel, RadianceScale, RasterConfig, Similarity, Splats};
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{flat_of, image_array, motion_array, numbers_of, plane_array, rows_of};
use crate::camera::PyCamera;
use crate::dataset::PyDataset;
use crate::errors::{OrRaise, invalid};
use crate::observer::PyObserver;
use crate::probe::PyProbe;
use crate::wait::{interruptible, locked};
use crate::{json, names, splats};

/// A scene of Gaussian splats, each of which emits linear radiance.
///
/// The arrays of splats (`positions`, `rotations`, `log_scales`, `opacity_logits`, `sh`,
/// `raw_luminance`, `smoothing`) are in the scene's local coordinates and normalised units:
/// `world_from_local` and `radiance_scale` lead to the world and to the radiance of the data set.
/// Reading one makes a copy; assigning one changes the scene. `set` changes several at once.
#[pyclass(name = "Scene", module = "luxel", frozen)]
pub(crate) struct PyScene {
    state: Arc<Mutex<State>>,
}

struct State {
    scene: Scene,
    /// Radiance behind everything, in the units of the data set.
    background: [f32; 3],
    /// The engine that has the scene as it is, and the device it was opened for.
    renderer: Option<(DeviceOptions, Renderer)>,
}

impl State {
    /// Returns the renderer of a device, with the scene as it is.
    fn renderer(&mut self, device: DeviceOptions) -> luxel::Result<&mut Renderer> {
        if self.renderer.as_ref().is_none_or(|(opened, _)| *opened != device) {
            self.renderer = None;
            self.renderer = Some((device.clone(), Renderer::new(&self.scene, device)?));
        }
        let (_, renderer) = self.renderer.as_mut().ok_or_else(|| luxel::Error::new("the renderer is gone"))?;
        Ok(renderer)
    }

    /// Changes the scene; it stays as it is if the change fails.
    fn change<T>(&mut self, change: impl FnOnce(&mut luxel_core::Scene) -> PyResult<T>) -> PyResult<T> {
        let mut changed = self.scene.clone().into_core();
        let result = change(&mut changed)?;
        self.scene = changed.into();
        self.renderer = None;
        Ok(result)
    }
}

/// Returns a device by its name.
pub(crate) fn device(name: &str, threads: Option<u32>) -> PyResult<DeviceOptions> {
    let device: Device = name.parse().map_err(|error| invalid(format!("device: {error}")))?;
    Ok(DeviceOptions { device, threads })
}

impl PyScene {
    /// Returns a scene before a background.
    pub(crate) fn new(scene: Scene, background: [f32; 3]) -> Self {
        Self { state: Arc::new(Mutex::new(State { scene, background, renderer: None })) }
    }

    fn read<T>(&self, read: impl FnOnce(&Scene) -> T) -> T {
        read(&locked(&self.state).scene)
    }

    fn array<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let splats = self.read(|scene| splats::array(py, &scene.splats, name))?;
        splats.ok_or_else(|| invalid(format!("splats have no array {name:?}")))
    }

    fn set_array(&self, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
        locked(&self.state).change(|scene| {
            splats::set(&mut scene.splats, name, value)?;
            splats::check(&scene.splats)
        })
    }
}

#[pymethods]
impl PyScene {
    /// Reads a scene file, or the newest scene of a run folder.
    ///
    /// Formats are PLY of Luxel, plain and compressed 3DGS PLY, USD, GLB and SPZ, by content. A run's
    /// scene has the background that it was trained with.
    #[staticmethod]
    fn open(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let read = move || {
            let scene = Scene::open_reporting(&path, &PyObserver::default())?;
            let is_run = path.is_dir();
            let background = if is_run { RunFolder::open(&path)?.1.train.background } else { [0.0; 3] };
            Ok::<_, luxel::Error>(Self::new(scene, background))
        };
        interruptible(py, read)?.or_raise()
    }

    /// Makes a scene of arrays.
    ///
    /// Args:
    ///     positions: [count, 3], world coordinates.
    ///     rotations: [count, 4], quaternions w, x, y, z.
    ///     log_scales: [count, 3], natural logarithms of the standard deviations along the axes.
    ///     opacity_logits: [count].
    ///     sh: [count, K, 3], harmonics of radiance (model "sh3": 0 is mid-grey, K = 16) or of
    ///         chromaticity (model "lcd").
    ///     raw_luminance: [count, M] for the model "lcd".
    ///     color_model: "sh0" to "sh5", "lcd", or with degrees and activation "lcd-c3-l0-softplus".
    ///     radiance_scale: radiance in the units of the data set of one unit of the colours.
    ///     color_space: space of the colours.
    #[staticmethod]
    #[pyo3(signature = (positions, rotations, log_scales, opacity_logits, sh, raw_luminance=None, *, color_model="sh3", radiance_scale=1.0, color_space="linear-rec709"))]
    #[expect(clippy::too_many_arguments, reason = "arguments of Python have names")]
    fn from_arrays(
        positions: &Bound<'_, PyAny>,
        rotations: &Bound<'_, PyAny>,
        log_scales: &Bound<'_, PyAny>,
        opacity_logits: &Bound<'_, PyAny>,
        sh: &Bound<'_, PyAny>,
        raw_luminance: Option<&Bound<'_, PyAny>>,
        color_model: &str,
        radiance_scale: f32,
        color_space: &str,
    ) -> PyResult<Self> {
        let splats = Splats {
            color_model: splats::color_model(color_model)?,
            position: rows_of("positions", positions)?,
            rotation: rows_of("rotations", rotations)?,
            log_scale: rows_of("log_scales", log_scales)?,
            opacity_logit: numbers_of("opacity_logits", opacity_logits)?,
            sh: flat_of("sh", sh)?,
            raw_luminance: raw_luminance.map(|raw| flat_of("raw_luminance", raw)).transpose()?.unwrap_or_default(),
            smoothing: Vec::new(),
        };
        splats::check(&splats)?;
        let radiance_scale = RadianceScale::new(radiance_scale)
            .ok_or_else(|| invalid(format!("radiance_scale: found {radiance_scale}, expected a positive number")))?;
        let scene = luxel_core::Scene {
            splats,
            radiance_scale,
            color_space: names::color_space(color_space)?,
            raster: RasterConfig::default(),
            edits: Vec::new(),
            world_from_local: Similarity::IDENTITY,
            metres_per_unit: None,
        };
        Ok(Self::new(scene.into(), [0.0; 3]))
    }

    /// Writes the scene as PLY, whole or not at all: the exact model, and a tone-mapped preview that
    /// any viewer of 3D Gaussian splats shows.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let scene = self.read(Clone::clone);
        interruptible(py, move || scene.save(path))?.or_raise()
    }

    /// Renders the scene as a camera sees it: float32 [height, width, 3], linear radiance in the
    /// units of the data set. This is what `luxel render` writes, to the bit.
    ///
    /// Args:
    ///     camera: where from.
    ///     background: radiance behind everything, 3 numbers; None for the scene's own.
    ///     samples: samples along a pixel's side, 1 to 4; None for those of training.
    ///     device: "auto", "cpu", "gpu" or "gpu:NAME".
    ///     threads: threads of the processor; None for all cores.
    #[pyo3(signature = (camera, *, background=None, samples=None, device="auto", threads=None))]
    fn render<'py>(
        &self,
        py: Python<'py>,
        camera: &PyCamera,
        background: Option<[f32; 3]>,
        samples: Option<u8>,
        device: &str,
        threads: Option<u32>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let device = self::device(device, threads)?;
        let (state, camera) = (Arc::clone(&self.state), camera.clone());
        let render = move || {
            let mut state = locked(&state);
            let camera = camera.seen_from(&state.scene.world_from_local);
            let (background, samples) = (background.unwrap_or(state.background), samples.unwrap_or(state.scene.raster.samples));
            let renderer = state.renderer(device)?;
            renderer.set_background(background);
            renderer.set_samples(samples)?;
            renderer.render(&camera)
        };
        let radiance = interruptible(py, render)?.or_raise()?;
        image_array(py, radiance.into_image())
    }

    /// Renders radiance, coverage and depth: a dictionary of float32 arrays `radiance` [height,
    /// width, 3], `alpha` [height, width] and `depth` [height, width]. Depth is along the viewing axis
    /// in world units, infinite where there is nothing. On the processor.
    #[pyo3(signature = (camera, *, background=None, samples=None, threads=None))]
    fn render_layers<'py>(
        &self,
        py: Python<'py>,
        camera: &PyCamera,
        background: Option<[f32; 3]>,
        samples: Option<u8>,
        threads: Option<u32>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let on_cpu = device("cpu", threads)?;
        let (state, camera) = (Arc::clone(&self.state), camera.clone());
        let render = move || {
            let mut state = locked(&state);
            let camera = camera.seen_from(&state.scene.world_from_local);
            let (background, samples) = (background.unwrap_or(state.background), samples.unwrap_or(state.scene.raster.samples));
            let renderer = state.renderer(on_cpu)?;
            renderer.set_background(background);
            renderer.set_samples(samples)?;
            renderer.render_layers(&camera)
        };
        let layers = interruptible(py, render)?.or_raise()?;
        let size = [layers.radiance.width(), layers.radiance.height()];
        let found = PyDict::new(py);
        found.set_item("radiance", image_array(py, layers.radiance.into_image())?)?;
        found.set_item("alpha", plane_array(py, size, layers.alpha)?)?;
        found.set_item("depth", plane_array(py, size, layers.depth)?)?;
        Ok(found)
    }

    /// Changes the light of the scene by an edit in its text form, such as
    /// "where L > p95 ~2; compress-above 2:4". Returns how many splats it selects.
    fn edit(&self, edit: &str) -> PyResult<usize> {
        let edit: Edit = edit.parse().map_err(|error| invalid(format!("edit: {error}")))?;
        let mut state = locked(&self.state);
        let applied = state.scene.edit(&edit).or_raise()?;
        state.renderer = None;
        Ok(applied.weights.iter().filter(|weight| **weight > 0.0).count())
    }

    /// Exports the scene for other programs, in the format of the path's extension: .ply, .usda,
    /// .glb or .spz. Returns a dictionary that describes the file.
    ///
    /// Args:
    ///     path: the file, which is replaced.
    ///     bake: "exact", "linear" or "display"; None for what suits the format.
    ///     color_space: space of a linear bake.
    ///     tonemap: curve of a display bake.
    ///     exposure: stops.
    ///     max_degree: highest degree of the baked harmonics, 0 to 3.
    ///     max_splats: only this many splats, those that contribute most.
    ///     dataset: views that measure the bake, and refine one for a display.
    ///     scale: metres of one unit of the scene.
    #[pyo3(signature = (path, *, bake=None, color_space=None, tonemap=None, exposure=0.0, max_degree=3, max_splats=None, dataset=None, scale=1.0, device="auto"))]
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
        scale: f32,
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
        let scale = FileScale::Factor(scale);
        let options = ExportOptions { bake, max_splats, scale, ..ExportOptions::default() };
        let (scene, device) = (self.read(Clone::clone), self::device(device, None)?);
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
        Ok(found)
    }

    /// Renders the light that arrives at a point as an environment map.
    ///
    /// Args:
    ///     at: the point, world coordinates.
    ///     width: pixels of a latitude-longitude map, twice as wide as high, or of a face of a cube.
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
        let (scene, behind) = { let state = locked(&self.state); (state.scene.clone(), background.unwrap_or(state.background)) };
        let options = ProbeOptions {
            projection,
            width_px: width,
            near,
            up: up.map_or(Up::Default, |axis| Up::Axis(axis.into())),
            color_space: names::optional_color_space(color_space)?,
            background: scene.radiance_scale.normalised(behind),
            alpha,
            ..ProbeOptions::at(at)
        };
        let device = self::device(if alpha && device == "auto" { "cpu" } else { device }, None)?;
        let dataset = dataset.map(|dataset| Arc::clone(&dataset.dataset));
        let render = move || {
            let mut engine = SelectedEngine::open(&device)?.engine;
            let dataset = dataset.as_deref().map(|dataset| dataset.in_frame(scene.world_from_local));
            luxel::probe::probe(scene.into_core(), &options, dataset.as_deref(), engine.as_mut(), &PyObserver::default())
        };
        Ok(PyProbe::new(interruptible(py, render)?.or_raise()?))
    }

    /// Positions, float32 [count, 3], local coordinates.
    #[getter]
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.array(py, "positions")
    }

    #[setter]
    fn set_positions(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.set_array("positions", value)
    }

    /// Quaternions w, x, y, z, float32 [count, 4], of any length but zero.
    #[getter]
    fn rotations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.array(py, "rotations")
    }

    #[setter]
    fn set_rotations(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.set_array("rotations", value)
    }

    /// Natural logarithms of the standard deviations along the axes, float32 [count, 3].
    #[getter]
    fn log_scales<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.array(py, "log_scales")
    }

    #[setter]
    fn set_log_scales(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.set_array("log_scales", value)
    }

    /// Logits of the opacity, float32 [count].
    #[getter]
    fn opacity_logits<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.array(py, "opacity_logits")
    }

    #[setter]
    fn set_opacity_logits(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.set_array("opacity_logits", value)
    }

    /// Harmonics of radiance or chromaticity, float32 [count, K, 3].
    #[getter]
    fn sh<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.array(py, "sh")
    }

    #[setter]
    fn set_sh(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.set_array("sh", value)
    }

    /// Raw luminance, float32 [count, M]; M is 0 for a model without luminance.
    #[getter]
    fn raw_luminance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.array(py, "raw_luminance")
    }

    #[setter]
    fn set_raw_luminance(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.set_array("raw_luminance", value)
    }

    /// Standard deviations of the smoothing filter, float32 [count]; empty without the filter.
    #[getter]
    fn smoothing<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.array(py, "smoothing")
    }

    #[setter]
    fn set_smoothing(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        self.set_array("smoothing", value)
    }

    /// Changes several arrays at once, by name; their number of splats may differ from before.
    #[pyo3(signature = (**arrays))]
    fn set(&self, arrays: Option<&Bound<'_, PyDict>>) -> PyResult<()> {
        let Some(arrays) = arrays else { return Ok(()) };
        locked(&self.state).change(|scene| {
            for (name, value) in arrays.iter() {
                splats::set(&mut scene.splats, &name.extract::<String>()?, &value)?;
            }
            splats::check(&scene.splats)
        })
    }

    /// Name of the colour model: "sh3", "lcd".
    #[getter]
    fn color_model(&self) -> String {
        self.read(|scene| scene.splats.color_model.name())
    }

    /// Whether luminance is a parameter of its own.
    #[getter]
    fn separates_luminance(&self) -> bool {
        self.read(|scene| ColorModel::separates_luminance(scene.splats.color_model))
    }

    /// Radiance of one normalised unit, in the units of the data set.
    #[getter]
    fn radiance_scale(&self) -> f32 {
        self.read(|scene| scene.radiance_scale.get())
    }

    /// Name of the colour space of the radiance.
    #[getter]
    fn color_space(&self) -> &'static str {
        self.read(|scene| scene.color_space.name())
    }

    /// Edits of light since training, oldest first, in text form. The splats contain them.
    #[getter]
    fn edits(&self) -> Vec<String> {
        self.read(|scene| scene.edits.clone())
    }

    /// Radiance behind everything, 3 numbers in the units of the data set.
    #[getter]
    fn background(&self) -> [f32; 3] {
        locked(&self.state).background
    }

    #[setter]
    fn set_background(&self, radiance: [f32; 3]) -> PyResult<()> {
        if !radiance.iter().all(|v| v.is_finite() && *v >= 0.0) {
            return Err(invalid(format!("background: found {radiance:?}, expected radiance that is finite and not negative")));
        }
        locked(&self.state).background = radiance;
        Ok(())
    }

    /// Transform from the local coordinates of the splats to the world, float64 [4,4].
    #[getter]
    fn world_from_local<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let frame = self.read(|scene| scene.world_from_local);
        motion_array(py, &glam::DAffine3 { matrix3: frame.rotation() * frame.scale(), translation: frame.translation() })
    }

    /// Settings of the rasteriser, as a dictionary.
    #[getter]
    fn raster<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(py, &self.read(|scene| scene.raster))
    }

    fn __len__(&self) -> usize {
        self.read(|scene| scene.splats.len())
    }

    fn __repr__(&self) -> String {
        self.read(|scene| format!("<luxel.Scene {} splats, {}, {}>", scene.splats.len(), scene.splats.color_model.name(), scene.color_space.name()))
    }

    /// Returns a copy, which changes on its own.
    fn copy(&self) -> Self {
        let state = locked(&self.state);
        Self::new(state.scene.clone(), state.background)
    }
}
