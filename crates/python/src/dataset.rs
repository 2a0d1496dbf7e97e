//! Data sets: posed images with their split, and points.

use std::path::PathBuf;
use std::sync::Arc;

use luxel::{Dataset, ImageLimits, ImageMemory};
use luxel_core::{Mask, PixelValues, View};
use luxel_io::{MemoryDataset, MemoryPoint, MemoryView};
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{image_of, motion_array, plane_of, rows_array, rows_of, shared_image, shared_mask};
use crate::camera::PyCamera;
use crate::errors::{OrRaise, invalid};
use crate::observer::PyObserver;
use crate::options::load_options;
use crate::wait::interruptible;
use crate::{names, process};

/// Views that are held out where nothing says which: every eighth, as for files.
const HOLD_OUT_EVERY: usize = 8;

/// Posed images of a place: those to train on, those held out, and points.
#[pyclass(name = "Dataset", module = "luxel", frozen)]
pub(crate) struct PyDataset {
    pub(crate) dataset: Arc<Dataset>,
}

/// A posed image.
#[pyclass(name = "View", module = "luxel", frozen)]
pub(crate) struct PyView {
    dataset: Arc<Dataset>,
    is_test: bool,
    index: usize,
}

impl PyView {
    pub(crate) fn view(&self) -> &View {
        let views = if self.is_test { &self.dataset.test } else { &self.dataset.train };
        &views[self.index]
    }

    /// Returns whether the view is of this data set.
    pub(crate) fn is_of(&self, dataset: &Arc<Dataset>) -> bool {
        Arc::ptr_eq(&self.dataset, dataset)
    }
}

impl PyDataset {
    fn views(&self, is_test: bool) -> Vec<PyView> {
        let count = if is_test { self.dataset.test.len() } else { self.dataset.train.len() };
        (0..count).map(|index| PyView { dataset: Arc::clone(&self.dataset), is_test, index }).collect()
    }
}

#[pymethods]
impl PyDataset {
    /// Reads the data set at `path`, a folder or a `transforms.json`; the layout is recognised.
    ///
    /// Args:
    ///     path: folder or file.
    ///     image_memory: limit on the memory that images take, such as "4GiB"; others are read when
    ///         they are needed.
    ///     cache: folder for images that have no room.
    ///     progress: function `progress(done, total, name)`.
    ///     **options: how files are read, as in the section `load` of `config.toml`: downscale,
    ///         transfer, color_space, format, supervision, exposures, masks, layer. downscale is a
    ///         number from 1, full size and the default, to 16, or "auto" as `luxel train` has it:
    ///         the smallest with which no training image is longer than 1600 pixels.
    ///
    /// Raises:
    ///     LuxelError: a file that is missing, damaged or of an unknown layout.
    #[staticmethod]
    #[pyo3(signature = (path, *, image_memory=None, cache=None, progress=None, **options))]
    fn open(
        py: Python<'_>,
        path: PathBuf,
        image_memory: Option<&str>,
        cache: Option<PathBuf>,
        progress: Option<Py<PyAny>>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let options = load_options(options)?;
        let image_memory = match image_memory {
            None => ImageMemory::default(),
            Some(text) => text.parse().map_err(|error| invalid(format!("image_memory: {error}")))?,
        };
        let observer = Arc::new(PyObserver::new(progress));
        let reported = Arc::clone(&observer);
        let read = move || {
            let limits = ImageLimits { image_memory, cache: cache.as_deref(), ..ImageLimits::default() };
            Dataset::open_within(&path, &options, limits, &*reported)
        };
        let dataset = interruptible(py, read)?;
        observer.failure()?;
        Ok(Self { dataset: Arc::new(dataset.or_raise()?) })
    }

    /// Makes a data set of arrays, without files.
    ///
    /// Args:
    ///     images: linear radiance, [height, width, 3] each. Pixels that are NaN, infinite or
    ///         negative are masked.
    ///     cameras: a Camera for each image, of its size. Lens distortion is removed.
    ///     masks: weights 0 to 1, [height, width] each, or None for an image without.
    ///     test: indices of the images that are held out; None for every eighth.
    ///     names: names of the images; None for numbers.
    ///     points: points of surfaces, [count, 3], world coordinates.
    ///     point_colors: display colours of the points, uint8 [count, 3].
    ///     color_space: space of the images.
    #[staticmethod]
    #[pyo3(signature = (images, cameras, *, masks=None, test=None, names=None, points=None, point_colors=None, color_space="linear-rec709"))]
    #[expect(clippy::too_many_arguments, reason = "arguments of Python have names")]
    fn from_arrays(
        py: Python<'_>,
        images: Vec<Bound<'_, PyAny>>,
        cameras: Vec<PyRef<'_, PyCamera>>,
        masks: Option<Vec<Option<Bound<'_, PyAny>>>>,
        test: Option<Vec<usize>>,
        names: Option<Vec<String>>,
        points: Option<&Bound<'_, PyAny>>,
        point_colors: Option<&Bound<'_, PyAny>>,
        color_space: &str,
    ) -> PyResult<Self> {
        let count = images.len();
        let lengths = [("cameras", Some(cameras.len())), ("masks", masks.as_ref().map(Vec::len)), ("names", names.as_ref().map(Vec::len))];
        for (name, found) in lengths {
            if let Some(found) = found.filter(|found| *found != count) {
                return Err(invalid(format!("{name}: {found}, expected one for each of {count} images")));
            }
        }
        if let Some(i) = test.iter().flatten().find(|i| **i >= count) {
            return Err(invalid(format!("test: index {i}, expected below {count}, the number of images")));
        }
        let is_test = |i: usize| match &test {
            Some(test) => test.contains(&i),
            None => count > 1 && i.is_multiple_of(HOLD_OUT_EVERY),
        };
        let mut views = Vec::with_capacity(count);
        for (i, (image, camera)) in images.iter().zip(&cameras).enumerate() {
            let image = image_of(&format!("images[{i}]"), image)?;
            let given = masks.as_ref().and_then(|masks| masks[i].as_ref());
            let weights = given.map(|mask| plane_of(&format!("masks[{i}]"), mask, [image.width, image.height])).transpose()?;
            let name = names.as_ref().map_or_else(|| format!("{i:05}"), |names| names[i].clone());
            let mask = weights.map(|weights| Mask { weights });
            views.push(MemoryView { name, camera: camera.world(), image, mask, is_test: is_test(i) });
        }
        let positions = points.map(|points| rows_of::<f64, 3>("points", points)).transpose()?.unwrap_or_default();
        let colors = point_colors.map(|colors| rows_of::<u8, 3>("point_colors", colors)).transpose()?;
        if let Some(colors) = colors.as_ref().filter(|colors| colors.len() != positions.len()) {
            return Err(invalid(format!("point_colors: {}, expected one for each of {} points", colors.len(), positions.len())));
        }
        let points = positions.iter().enumerate();
        let points =
            points.map(|(i, position)| MemoryPoint { position: *position, rgb8: colors.as_ref().map(|colors| colors[i]) }).collect();
        let parts = MemoryDataset { views, points, color_space: names::color_space(color_space)? };
        let dataset = interruptible(py, move || Dataset::from_memory(parts))?.or_raise()?;
        Ok(Self { dataset: Arc::new(dataset) })
    }

    /// Views to train on, sorted by name.
    #[getter]
    fn train(&self) -> Vec<PyView> {
        self.views(false)
    }

    /// Views held out to measure with, sorted by name.
    #[getter]
    fn test(&self) -> Vec<PyView> {
        self.views(true)
    }

    /// Points of surfaces in the world, float64 [count, 3].
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let world = |position: [f32; 3]| self.dataset.world_from_local.point(position.map(f64::from).into()).to_array();
        rows_array(py, self.dataset.points.iter().map(|point| world(point.position)).collect())
    }

    /// Display colours of the points, uint8 [count, 3]; grey where a point has none.
    #[getter]
    fn point_colors<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u8>>> {
        rows_array(py, self.dataset.points.iter().map(|point| point.rgb8.unwrap_or([128; 3])).collect())
    }

    /// Name of the colour space of all images.
    #[getter]
    fn color_space(&self) -> &'static str {
        self.dataset.color_space.name()
    }

    /// Length of a unit of the world, metres; None where it is unknown.
    #[getter]
    fn metres_per_unit(&self) -> Option<f64> {
        self.dataset.metres_per_unit
    }

    /// The layout that was found, in words.
    #[getter]
    fn format(&self) -> &str {
        &self.dataset.format
    }

    /// Warnings about the data set, such as 8-bit images.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.dataset.warnings().to_vec()
    }

    /// Digest of the content: equal exactly for equal inputs.
    #[getter]
    fn fingerprint(&self) -> &str {
        &self.dataset.fingerprint
    }

    /// Transform from the local coordinates that the library works in to the world, float64 [4,4].
    #[getter]
    fn world_from_local<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let frame = &self.dataset.world_from_local;
        let matrix3 = frame.rotation() * frame.scale();
        motion_array(py, &glam::DAffine3 { matrix3, translation: frame.translation() })
    }

    fn __repr__(&self) -> String {
        let (train, test, points) = (self.dataset.train.len(), self.dataset.test.len(), self.dataset.points.len());
        format!("<luxel.Dataset {}: {train} views to train on, {test} to test, {points} points>", self.dataset.format)
    }
}

#[pymethods]
impl PyView {
    /// Name of the image: its path without the extension.
    #[getter]
    fn name(&self) -> &str {
        &self.view().name
    }

    /// The camera, whose image is without lens distortion.
    #[getter]
    fn camera(&self) -> PyCamera {
        PyCamera::in_frame(self.view().camera.clone(), self.dataset.world_from_local)
    }

    /// The image, float32 [height, width, 3], read-only and shared: linear radiance, or values 0 to
    /// 1 as recorded where `exposure` is not None.
    #[getter]
    fn image<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        process::check()?;
        let loaded = py.detach(|| self.view().image.loaded()).or_raise()?;
        shared_image(py, loaded.shared())
    }

    /// Weights of the pixels, 0 to 1, float32 [height, width], read-only; None where all count.
    #[getter]
    fn mask<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f32>>>> {
        let Some(mask) = &self.view().mask else { return Ok(None) };
        process::check()?;
        let loaded = mask.loaded().or_raise()?;
        let size = self.view().camera.size_px.map(|side| side as usize);
        shared_mask(py, loaded.shared(), size).map(Some)
    }

    /// Exposure time of an image as a camera recorded it, seconds; None for radiance.
    #[getter]
    fn exposure(&self) -> Option<f32> {
        match self.view().values {
            PixelValues::Radiance => None,
            PixelValues::Recorded { exposure_s } => Some(exposure_s),
        }
    }

    fn __repr__(&self) -> String {
        let [w, h] = self.view().camera.size_px;
        format!("<luxel.View {} {w}x{h}>", self.view().name)
    }
}
