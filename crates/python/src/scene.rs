//! Scenes: splats of radiance that are rendered, edited and exported.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use luxel::{Device, DeviceOptions, Edit, Renderer, Scene};
use luxel_app::run::{RunFolder, open_scene};
use luxel_core::{Camera, Image, RadianceScale, RasterConfig, Similarity, Splats};
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{flat_of, image_array, motion_array, numbers_of, plane_array, rows_of};
use crate::camera::PyCamera;
use crate::errors::{OrRaise, invalid};
use crate::observer::PyObserver;
use crate::wait::{interruptible, locked, with_locked};
use crate::{json, names, process, splats};

/// A scene of Gaussian splats, each of which emits linear radiance.
///
/// The arrays of splats (`positions`, `rotations`, `log_scales`, `opacity_logits`, `sh`,
/// `raw_luminance`, `smoothing`, `gain`) are in the scene's local coordinates and normalised units:
/// `world_from_local` and `radiance_scale` lead to the world and to the radiance of the data set.
/// Reading one makes a copy; assigning one changes the scene. `set` changes several at once.
#[pyclass(name = "Scene", module = "luxel", frozen)]
pub(crate) struct PyScene {
    pub(crate) state: Arc<Mutex<State>>,
}

pub(crate) struct State {
    pub(crate) scene: Scene,
    /// Radiance behind everything, in the units of the data set.
    pub(crate) background: [f32; 3],
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

    /// Puts another scene in the place of this one.
    pub(crate) fn replace(&mut self, scene: Scene) {
        self.scene = scene;
        self.renderer = None;
    }
}

/// Choices of a render besides its camera; what is left out is the scene's own.
pub(crate) struct View {
    pub(crate) camera: PyCamera,
    pub(crate) background: Option<[f32; 3]>,
    pub(crate) samples: Option<u8>,
    pub(crate) device: DeviceOptions,
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

    /// Looks at the scene, without Python.
    pub(crate) fn read<T: Send>(&self, py: Python<'_>, read: impl FnOnce(&Scene) -> T + Send) -> T {
        with_locked(py, &self.state, |state| read(&state.scene))
    }

    /// Renders a view on a thread of its own.
    pub(crate) fn rendered<T: Send + 'static>(
        &self,
        py: Python<'_>,
        view: View,
        render: impl FnOnce(&mut Renderer, &Camera) -> luxel::Result<T> + Send + 'static,
    ) -> PyResult<T> {
        let state = Arc::clone(&self.state);
        let work = move || {
            let mut state = locked(&state);
            let camera = view.camera.seen_from(&state.scene.world_from_local);
            let (background, samples) = (view.background.unwrap_or(state.background), view.samples.unwrap_or(state.scene.raster.samples));
            let renderer = state.renderer(view.device)?;
            renderer.set_background(background);
            renderer.set_samples(samples)?;
            render(renderer, &camera)
        };
        interruptible(py, work)?.or_raise()
    }
}

#[pymethods]
impl PyScene {
    /// Reads a scene file, or the newest scene of a run folder.
    ///
    /// Formats are PLY of Luxel, plain and compressed 3DGS PLY, USD, GLB and SPZ, by content. A
    /// run's scene has the background that it was trained with.
    #[staticmethod]
    fn open(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let read = move || {
            let scene = open_scene(&path, &PyObserver::default())?;
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
    ///     color_model: "sh0" to "sh5", "logsh0" to "logsh5", "lcd", or with degrees and activation
    ///         "lcd-c3-l0-softplus".
    ///     radiance_scale: radiance in the units of the data set of one unit of the colours.
    ///     color_space: space of the colours: "linear-rec709" and others, or "display-srgb" of
    ///     colours that are a display's.
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
            gain: Vec::new(),
        };
        if let Some(message) = splats::fault(&splats) {
            return Err(invalid(message));
        }
        let radiance_scale = RadianceScale::new(radiance_scale)
            .ok_or_else(|| invalid(format!("radiance_scale: found {radiance_scale}, expected a positive number")))?;
        let scene = luxel_core::Scene {
            splats,
            radiance_scale,
            color_space: names::scene_color_space(color_space)?,
            raster: RasterConfig::default(),
            edits: Vec::new(),
            world_from_local: Similarity::IDENTITY,
            metres_per_unit: None,
        };
        Ok(Self::new(scene.into(), [0.0; 3]))
    }

    /// Writes the scene as PLY, whole or not at all: the exact model, and a tone-mapped preview
    /// that any viewer of 3D Gaussian splats shows.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let scene = self.read(py, Clone::clone);
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
        let view = View { camera: camera.clone(), background, samples, device: self::device(device, threads)? };
        let radiance = self.rendered(py, view, Renderer::render)?;
        image_array(py, radiance.into_image())
    }

    /// Renders radiance, coverage and depth: a dictionary of float32 arrays `radiance` [height,
    /// width, 3], `alpha` [height, width] and `depth` [height, width]. Depth is along the viewing
    /// axis in world units, infinite where there is nothing. On the processor.
    #[pyo3(signature = (camera, *, background=None, samples=None, threads=None))]
    fn render_layers<'py>(
        &self,
        py: Python<'py>,
        camera: &PyCamera,
        background: Option<[f32; 3]>,
        samples: Option<u8>,
        threads: Option<u32>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let view = View { camera: camera.clone(), background, samples, device: device("cpu", threads)? };
        let layers = self.rendered(py, view, Renderer::render_layers)?;
        let size = [layers.radiance.width(), layers.radiance.height()];
        let found = PyDict::new(py);
        found.set_item("radiance", image_array(py, layers.radiance.into_image())?)?;
        found.set_item("alpha", plane_array(py, size, layers.alpha)?)?;
        found.set_item("depth", plane_array(py, size, layers.depth)?)?;
        Ok(found)
    }

    /// Renders normals, float32 [height, width, 3]: unit vectors of the world, towards the camera;
    /// 0 where there is nothing. The normal of a splat is its shortest axis. On the processor.
    #[pyo3(signature = (camera, *, samples=None, threads=None))]
    fn render_normals<'py>(
        &self,
        py: Python<'py>,
        camera: &PyCamera,
        samples: Option<u8>,
        threads: Option<u32>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let view = View { camera: camera.clone(), background: None, samples, device: device("cpu", threads)? };
        let normals = self.rendered(py, view, Renderer::render_normals)?;
        let [width, height] = camera.world().size_px;
        let normals = Image::from_pixels(width as usize, height as usize, normals);
        image_array(py, normals.ok_or_else(|| invalid("the normals are not of the camera's size"))?)
    }

    /// Changes the light of the scene by an edit in its text form, such as
    /// "where L > p95 ~2; compress-above 2:4". Returns how many splats it selects.
    fn edit(&self, py: Python<'_>, edit: &str) -> PyResult<usize> {
        let edit: Edit = edit.parse().map_err(|error| invalid(format!("edit: {error}")))?;
        // It drops an engine with threads.
        process::check()?;
        let applied = with_locked(py, &self.state, |state| {
            state.renderer = None;
            state.scene.edit(&edit)
        });
        Ok(applied.or_raise()?.weights.iter().filter(|weight| **weight > 0.0).count())
    }

    /// Name of the colour model: "sh3", "lcd".
    #[getter]
    fn color_model(&self, py: Python<'_>) -> String {
        self.read(py, |scene| scene.splats.color_model.name())
    }

    /// Whether luminance is a parameter of its own.
    #[getter]
    fn separates_luminance(&self, py: Python<'_>) -> bool {
        self.read(py, |scene| scene.splats.color_model.separates_luminance())
    }

    /// Radiance of one normalised unit, in the units of the data set.
    #[getter]
    fn radiance_scale(&self, py: Python<'_>) -> f32 {
        self.read(py, |scene| scene.radiance_scale.get())
    }

    /// Length of a unit of the world, metres; None where it is unknown.
    #[getter]
    fn metres_per_unit(&self, py: Python<'_>) -> Option<f64> {
        self.read(py, |scene| scene.metres_per_unit)
    }

    /// Name of the colour space of the radiance.
    #[getter]
    fn color_space(&self, py: Python<'_>) -> &'static str {
        self.read(py, |scene| scene.color_space.name())
    }

    /// Edits of light since training, oldest first, in text form. The splats contain them.
    #[getter]
    fn edits(&self, py: Python<'_>) -> Vec<String> {
        self.read(py, |scene| scene.edits.clone())
    }

    /// Radiance behind everything, 3 numbers in the units of the data set.
    #[getter]
    fn background(&self, py: Python<'_>) -> [f32; 3] {
        with_locked(py, &self.state, |state| state.background)
    }

    #[setter]
    fn set_background(&self, py: Python<'_>, radiance: [f32; 3]) -> PyResult<()> {
        if !radiance.iter().all(|v| v.is_finite() && *v >= 0.0) {
            return Err(invalid(format!("background: found {radiance:?}, expected radiance that is finite and not negative")));
        }
        with_locked(py, &self.state, |state| state.background = radiance);
        Ok(())
    }

    /// Transform from the local coordinates of the splats to the world, float64 [4,4].
    #[getter]
    fn world_from_local<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let frame = self.read(py, |scene| scene.world_from_local);
        motion_array(py, &glam::DAffine3 { matrix3: frame.rotation() * frame.scale(), translation: frame.translation() })
    }

    /// Settings of the rasteriser, as a dictionary.
    #[getter]
    fn raster<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(py, &self.read(py, |scene| scene.raster))
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        self.read(py, |scene| scene.splats.len())
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        self.read(py, |scene| {
            format!("<luxel.Scene {} splats, {}, {}>", scene.splats.len(), scene.splats.color_model.name(), scene.color_space.name())
        })
    }

    /// Returns a copy, which changes on its own.
    fn copy(&self, py: Python<'_>) -> Self {
        with_locked(py, &self.state, |state| Self::new(state.scene.clone(), state.background))
    }
}
