//! Training, step by step.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use luxel::{Dataset, Progress, Supervision, Training};
use luxel_core::{PixelValues, View};
use numpy::PyArray3;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::image_array;
use crate::camera::PyCamera;
use crate::dataset::{PyDataset, PyView};
use crate::errors::{OrRaise, invalid};
use crate::options::train_config;
use crate::scene::{PyScene, device};
use crate::wait::{interruptible, locked, with_locked};
use crate::{json, process};

/// Numbers of one step of training.
#[pyclass(name = "Progress", module = "luxel", frozen, get_all)]
pub(crate) struct PyProgress {
    /// Steps made so far; 1 after the first.
    number: u32,
    /// Steps in all.
    total: u32,
    /// Loss of the step's view, or of a step shortly before.
    loss: f32,
    /// Number of splats.
    splats: usize,
    /// Splats that touch the step's image.
    visible: u32,
}

impl PyProgress {
    fn new(progress: Progress) -> Self {
        let Progress { number, total, loss, splats, visible, .. } = progress;
        Self { number, total, loss, splats, visible }
    }
}

#[pymethods]
impl PyProgress {
    fn __repr__(&self) -> String {
        format!("<luxel.Progress step {} of {}, loss {:.5}, {} splats>", self.number, self.total, self.loss, self.splats)
    }
}

/// A training in progress: an iterator of steps, which pauses when iteration pauses.
///
/// Args:
///     dataset: the views to train on.
///     preset: "fast", "full" or "paper"; None for "fast".
///     steps: number of steps; None for that of the preset.
///     device: "auto", "cpu", "gpu" or "gpu:NAME".
///     threads: threads of the processor; None for all cores.
///     resume: a checkpoint to continue from, which has all other settings.
///     **options: further options by their names in the section `train` of `config.toml`, such as
///         method="lcd", max_splats=40000, seed=42. `training_options()` lists them.
///
/// Raises:
///     LuxelError: an option that is unknown or out of range; a device that is not there.
#[pyclass(name = "Training", module = "luxel", frozen)]
pub(crate) struct PyTraining {
    training: Arc<Mutex<Training>>,
    dataset: Arc<Dataset>,
}

impl PyTraining {
    fn with<T: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut Training, &Dataset) -> luxel::Result<T> + Send + 'static,
    ) -> PyResult<T> {
        let (training, dataset) = (Arc::clone(&self.training), Arc::clone(&self.dataset));
        interruptible(py, move || work(&mut locked(&training), &dataset))?.or_raise()
    }

    /// Makes a step on this thread: a hand-over for each would cost more than short steps take.
    fn made_step(&self, py: Python<'_>) -> PyResult<Option<PyProgress>> {
        process::check()?;
        let made = with_locked(py, &self.training, Iterator::next);
        py.check_signals()?;
        made.transpose().or_raise().map(|made| made.map(PyProgress::new))
    }
}

#[pymethods]
impl PyTraining {
    #[new]
    #[pyo3(signature = (dataset, *, preset=None, steps=None, device="auto", threads=None, resume=None, **options))]
    #[expect(clippy::too_many_arguments, reason = "arguments of Python have names")]
    fn new(
        py: Python<'_>,
        dataset: &PyDataset,
        preset: Option<&str>,
        steps: Option<u32>,
        device: &str,
        threads: Option<u32>,
        resume: Option<PathBuf>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        if resume.is_some() && (preset.is_some() || options.is_some_and(|options| !options.is_empty())) {
            return Err(invalid("resume: the checkpoint has the settings; leave preset and options out"));
        }
        let is_radiance = dataset.dataset.train.iter().all(|view| view.values == PixelValues::Radiance);
        let images = if is_radiance { Supervision::Hdr } else { Supervision::Ldr };
        let mut config = train_config(preset, options, images)?;
        if let Some(steps) = steps {
            config = config.with_steps(steps);
        }
        let device = self::device(device, threads)?;
        let dataset = Arc::clone(&dataset.dataset);
        let used = Arc::clone(&dataset);
        let start = move || {
            let builder = Training::builder(&used).device(device);
            match (resume, steps) {
                (None, _) => builder.config(config).start(),
                (Some(path), None) => builder.resume(path),
                (Some(path), Some(steps)) => builder.steps(steps).resume(path),
            }
        };
        let training = interruptible(py, start)?.or_raise()?;
        Ok(Self { training: Arc::new(Mutex::new(training)), dataset })
    }

    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<PyProgress>> {
        self.made_step(py)
    }

    /// Makes one step and returns its numbers.
    fn step(&self, py: Python<'_>) -> PyResult<PyProgress> {
        self.made_step(py)?.ok_or_else(|| invalid("all steps are made"))
    }

    /// Number of steps made so far.
    #[getter]
    fn steps_made(&self, py: Python<'_>) -> u32 {
        with_locked(py, &self.training, |training| training.steps_made())
    }

    /// Whether all steps are made.
    #[getter]
    fn is_finished(&self, py: Python<'_>) -> bool {
        with_locked(py, &self.training, |training| training.is_finished())
    }

    /// The settings in force, by name.
    #[getter]
    fn options<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(py, &with_locked(py, &self.training, |training| training.config().clone()))
    }

    /// Measures the scene as it stands against views: a dictionary with `mean`, and `views` with
    /// each view's metrics.
    ///
    /// Args:
    ///     views: "test", "train", or a list of views of the data set.
    #[pyo3(signature = (views=None))]
    fn evaluate<'py>(&self, py: Python<'py>, views: Option<Views<'py>>) -> PyResult<Bound<'py, PyAny>> {
        let chosen: Vec<View> = match views.unwrap_or(Views::Split("test".to_owned())) {
            Views::Split(split) => match split.as_str() {
                "test" => self.dataset.test.clone(),
                "train" => self.dataset.train.clone(),
                _ => return Err(invalid(format!("views: found {split:?}, expected \"test\", \"train\" or a list of views"))),
            },
            Views::List(views) => {
                if views.iter().any(|view| !view.is_of(&self.dataset)) {
                    return Err(invalid("views: found a view of another data set than the training's"));
                }
                views.iter().map(|view| view.view().clone()).collect()
            }
        };
        if chosen.is_empty() {
            return Err(invalid("views: there are none to measure with"));
        }
        let metrics = self.with(py, move |training, _| training.evaluate(&chosen))?;
        json::to_python(py, &metrics)
    }

    /// Renders the scene as it stands: float32 [height, width, 3], in the units of the data set.
    fn render<'py>(&self, py: Python<'py>, camera: &PyCamera) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let camera = camera.clone();
        let radiance = self.with(py, move |training, dataset| training.render(&camera.seen_from(&dataset.world_from_local)))?;
        image_array(py, radiance.into_image())
    }

    /// Returns the scene as it stands.
    fn scene(&self, py: Python<'_>) -> PyResult<PyScene> {
        let (scene, background) = self.with(py, |training, _| Ok((training.scene()?, training.config().background)))?;
        Ok(PyScene::new(scene, background))
    }

    /// Cameras of the training views, in their order, as refined if poses are.
    #[getter]
    fn cameras(&self, py: Python<'_>) -> Vec<PyCamera> {
        let frame = self.dataset.world_from_local;
        with_locked(py, &self.training, |training| training.cameras()).into_iter().map(|camera| PyCamera::in_frame(camera, frame)).collect()
    }

    /// Writes everything that is needed to continue, whole or not at all.
    fn checkpoint(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        self.with(py, move |training, _| training.checkpoint(path))
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let (made, total) = with_locked(py, &self.training, |training| (training.steps_made(), training.config().iterations));
        format!("<luxel.Training {made} of {total} steps>")
    }
}

/// Views to measure with.
#[derive(FromPyObject)]
pub(crate) enum Views<'py> {
    Split(String),
    List(Vec<PyRef<'py, PyView>>),
}
