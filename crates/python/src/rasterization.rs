//! Differentiable rasterisation on NumPy arrays, on which `luxel.torch` builds: splats to ellipses,
//! ellipses to images, and their gradients.
//!
//! Arrays come in as they are, without a copy, and must be contiguous and of float32; results hand
//! their memory over. Work is done without Python's lock (GIL).

use std::sync::Arc;

use bytemuck::Pod;
use luxel_core::engine::{
    AbsoluteMeans, ActivatedSplats, BlendGradient, BlendOptions, BlendedSplats, CameraMatrices, Channels, Differentiable,
    DirectionalColors, EllipseGradient, MatrixCamera, PixelGradient, ProjectedSplats, ScreenEllipses, ShapeParameters,
};
use luxel_core::{ColorModel, EngineError};
use luxel_cpu::CpuEngine;
use numpy::{Element, IntoPyArray, PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::color_model::PyColorModel;
use crate::errors::invalid;
use crate::process::Home;
use crate::raster_arrays::{Array, OutArray, flags, lent, numbers, rows, shaped};

fn raise(error: &EngineError) -> PyErr {
    match error.remedy() {
        Some(remedy) => invalid(format!("{error}; {remedy}")),
        None => invalid(error.to_string()),
    }
}

/// Rasterises splats with gradients on the threads of the processor.
#[pyclass(module = "luxel._luxel", name = "Rasterizer", frozen)]
pub(crate) struct PyRasterizer {
    engine: Arc<CpuEngine>,
    home: Home,
}

#[pymethods]
impl PyRasterizer {
    /// Starts `threads` threads; 0 means one per core.
    #[new]
    #[pyo3(signature = (threads = 0))]
    fn new(threads: usize) -> PyResult<Self> {
        Ok(Self { engine: Arc::new(CpuEngine::new(threads).map_err(|error| raise(&error))?), home: Home::here() })
    }

    /// Projects splats to the screens of cameras. Returns the `Projection` with its arrays in a
    /// dictionary: `means2d`, `covars2d`, `conics`, `depths`, `opacities` and `radii`, each
    /// [C, N, ...], or [M, ...] with `camera_ids` and `gaussian_ids` [M] of the visible splats if
    /// packed; and `visible` [C, N].
    #[pyo3(signature = (means, quats, scales, opacities, viewmats, ks, width, height, *, near_plane = 0.01, far_plane = 1e10,
        radius_clip = 0.0, eps2d = 0.3, antialiased = false, packed = false))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn project<'py>(
        &self,
        py: Python<'py>,
        means: Array<'py>,
        quats: Array<'py>,
        scales: Array<'py>,
        opacities: Array<'py>,
        viewmats: Array<'py>,
        ks: Array<'py>,
        width: u32,
        height: u32,
        near_plane: f32,
        far_plane: f32,
        radius_clip: f32,
        eps2d: f32,
        antialiased: bool,
        packed: bool,
    ) -> PyResult<(PyProjection, Bound<'py, PyDict>)> {
        let splats = ActivatedSplats {
            position: rows("means", &means)?,
            rotation: rows("quats", &quats)?,
            scale: rows("scales", &scales)?,
            opacity: numbers("opacities", &opacities)?,
        };
        let cameras = cameras(numbers("viewmats", &viewmats)?, numbers("Ks", &ks)?)?;
        let mut options = BlendOptions {
            far: far_plane,
            min_radius_px: radius_clip,
            dilation_px2: eps2d,
            compensates_opacity: antialiased,
            ..BlendOptions::gsplat([width, height])
        };
        options.cutoffs.near = near_plane;
        let projected = self.home.detach(py, || self.engine.project(&splats, &cameras, &options))?;
        let (ellipses, projected) = projected.map_err(|error| raise(&error))?;
        let is_visible: Vec<bool> = ellipses.radius_px.iter().map(|radius| *radius != [0; 2]).collect();
        let visible = packed.then(|| (0..is_visible.len()).filter(|i| is_visible[*i]).collect());
        let projection = PyProjection {
            engine: Arc::clone(&self.engine),
            home: self.home,
            projected,
            visible,
            cameras: cameras.len(),
            splats: splats.len(),
            size: [width as usize, height as usize],
        };
        let arrays = projection.arrays(py, ellipses)?;
        arrays.set_item("visible", shaped(py, is_visible, &[cameras.len(), splats.len()])?)?;
        Ok((projection, arrays))
    }

    /// Evaluates a colour model towards cameras: radiance [C, N, 3]. The model is a degree of
    /// harmonics, and for method `lcd` that of the luminance and an activation.
    #[pyo3(signature = (means, eyes, sh, raw_luminance, visible, model, active_degree))]
    #[expect(clippy::too_many_arguments, reason = "arguments of Python")]
    fn colors<'py>(
        &self,
        py: Python<'py>,
        means: Array<'py>,
        eyes: Array<'py>,
        sh: Array<'py>,
        raw_luminance: Array<'py>,
        visible: Option<PyReadonlyArrayDyn<'py, bool>>,
        model: PyColorModel,
        active_degree: usize,
    ) -> PyResult<OutArray<'py>> {
        let visible = flags(visible.as_ref())?;
        let colors = directional(&means, &eyes, &sh, &raw_luminance, visible, model.model()?, active_degree)?;
        let values = self.home.detach(py, || self.engine.colors(&colors))?.map_err(|error| raise(&error))?;
        lent(py, &self.engine, values.into_flattened(), &[colors.eye.len(), colors.position.len(), 3])
    }

    /// Returns the gradients by means, eyes, harmonics and raw luminance from that by the colours.
    #[pyo3(signature = (means, eyes, sh, raw_luminance, visible, model, active_degree, gradient))]
    #[expect(clippy::too_many_arguments, reason = "arguments of Python")]
    fn colors_backward<'py>(
        &self,
        py: Python<'py>,
        means: Array<'py>,
        eyes: Array<'py>,
        sh: Array<'py>,
        raw_luminance: Array<'py>,
        visible: Option<PyReadonlyArrayDyn<'py, bool>>,
        model: PyColorModel,
        active_degree: usize,
        gradient: Array<'py>,
    ) -> PyResult<[OutArray<'py>; 4]> {
        let visible = flags(visible.as_ref())?;
        let colors = directional(&means, &eyes, &sh, &raw_luminance, visible, model.model()?, active_degree)?;
        let gradient = rows("gradient", &gradient)?;
        let found = self.home.detach(py, || self.engine.colors_backward(&colors, gradient))?.map_err(|error| raise(&error))?;
        Ok([
            lent(py, &self.engine, found.position.into_flattened(), means.shape())?,
            shaped(py, found.eye.into_flattened(), eyes.shape())?,
            lent(py, &self.engine, found.sh, sh.shape())?,
            lent(py, &self.engine, found.raw_luminance, raw_luminance.shape())?,
        ])
    }
}

fn directional<'a>(
    means: &'a Array<'_>,
    eyes: &'a Array<'_>,
    sh: &'a Array<'_>,
    raw_luminance: &'a Array<'_>,
    visible: Option<&'a [bool]>,
    model: ColorModel,
    active_degree: usize,
) -> PyResult<DirectionalColors<'a>> {
    let shape = sh.shape();
    let &[.., sh_per_splat, 3] = shape else { return Err(invalid(format!("sh: array of shape {shape:?}, expected [..., N, K, 3]"))) };
    Ok(DirectionalColors {
        model,
        active_degree,
        position: rows("means", means)?,
        eye: rows("eyes", eyes)?,
        sh: numbers("sh", sh)?,
        sh_per_splat,
        raw_luminance: numbers("raw_luminance", raw_luminance)?,
        visible,
    })
}

/// Returns the cameras of matrices [C, 4, 4] and [C, 3, 3].
fn cameras(viewmats: &[f32], ks: &[f32]) -> PyResult<Vec<MatrixCamera>> {
    let (poses, _) = viewmats.as_chunks::<16>();
    let (ks, _) = ks.as_chunks::<9>();
    if poses.len() != ks.len() {
        return Err(invalid(format!("{} viewmats and {} Ks, expected as many", poses.len(), ks.len())));
    }
    let camera = |(n, (pose, k)): (usize, (&[f32; 16], &[f32; 9]))| {
        let &[fx, skew, cx, zero, fy, cy, rest @ ..] = k;
        if skew != 0.0 || zero != 0.0 || rest != [0.0, 0.0, 1.0] {
            return Err(invalid(format!("Ks[{n}]: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], found {k:?}")));
        }
        if pose[12..] != [0.0, 0.0, 0.0, 1.0] {
            return Err(invalid(format!("viewmats[{n}]: expected a last row of 0, 0, 0, 1, found {:?}", &pose[12..])));
        }
        let rows = pose.as_chunks::<4>().0;
        Ok(MatrixCamera { camera_from_world: [rows[0], rows[1], rows[2]], focal_px: [fx, fy], center_px: [cx, cy] })
    };
    poses.iter().zip(ks).enumerate().map(camera).collect()
}

/// Splats on the screens of cameras.
#[pyclass(module = "luxel._luxel", name = "Projection", frozen)]
pub(crate) struct PyProjection {
    engine: Arc<CpuEngine>,
    home: Home,
    projected: Box<dyn ProjectedSplats>,
    /// Places of the visible splats among all, if arrays are packed.
    visible: Option<Vec<usize>>,
    cameras: usize,
    splats: usize,
    size: [usize; 2],
}

impl PyProjection {
    /// Returns the shape of arrays that begin with cameras and splats.
    fn shape(&self, rest: &[usize]) -> Vec<usize> {
        match &self.visible {
            Some(visible) => [&[visible.len()], rest].concat(),
            None => [&[self.cameras, self.splats], rest].concat(),
        }
    }

    /// Returns the rows of visible splats if arrays are packed, else all, as an array.
    fn packed<'py, T: Element + Pod, const N: usize>(
        &self,
        py: Python<'py>,
        all: Vec<[T; N]>,
        rest: &[usize],
    ) -> PyResult<Bound<'py, PyArrayDyn<T>>>
    where
        [T; N]: Pod,
    {
        let shape = self.shape(rest);
        match &self.visible {
            Some(visible) => {
                let rows: Vec<[T; N]> = visible.iter().map(|i| all[*i]).collect();
                if let Ok(numbers) = bytemuck::allocation::try_cast_vec(all.into_flattened()) {
                    self.engine.recycle(numbers);
                }
                shaped(py, rows.into_flattened(), &shape)
            }
            None => lent(py, &self.engine, all.into_flattened(), &shape),
        }
    }

    /// Returns numbers of visible splats if arrays are packed, else all, as an array.
    fn packed_numbers<'py>(&self, py: Python<'py>, all: Vec<f32>) -> PyResult<OutArray<'py>> {
        self.packed(py, bytemuck::allocation::cast_vec::<f32, [f32; 1]>(all), &[])
    }

    /// Returns rows at their places among all.
    fn unpack<T: Copy + Default>(&self, name: &str, packed: &[T]) -> PyResult<Option<Vec<T>>> {
        let Some(visible) = &self.visible else { return Ok(None) };
        if packed.len() != visible.len() {
            return Err(invalid(format!("{name}: {} rows, expected {}", packed.len(), visible.len())));
        }
        let mut all = vec![T::default(); self.cameras * self.splats];
        visible.iter().zip(packed).for_each(|(i, row)| all[*i] = *row);
        Ok(Some(all))
    }

    fn arrays<'py>(&self, py: Python<'py>, ellipses: ScreenEllipses) -> PyResult<Bound<'py, PyDict>> {
        let arrays = PyDict::new(py);
        arrays.set_item("means2d", self.packed(py, ellipses.mean_px, &[2])?)?;
        arrays.set_item("covars2d", self.packed(py, ellipses.covariance_px2, &[3])?)?;
        arrays.set_item("conics", self.packed(py, ellipses.conic, &[3])?)?;
        arrays.set_item("depths", self.packed_numbers(py, ellipses.depth)?)?;
        arrays.set_item("opacities", self.packed_numbers(py, ellipses.opacity)?)?;
        arrays.set_item("radii", self.packed(py, ellipses.radius_px, &[2])?)?;
        if let Some(visible) = &self.visible {
            let of_splat = |index: fn(usize, usize) -> usize| visible.iter().map(|i| index(*i, self.splats) as i64).collect::<Vec<_>>();
            arrays.set_item("camera_ids", of_splat(|i, n| i / n).into_pyarray(py))?;
            arrays.set_item("gaussian_ids", of_splat(|i, n| i % n).into_pyarray(py))?;
        }
        Ok(arrays)
    }
}

#[pymethods]
impl PyProjection {
    /// Blends channels [N, K] or [C, N, K] over a background [C, K]. Returns the `Blending`, images
    /// [C, H, W, K] and alpha [C, H, W, 1].
    #[pyo3(signature = (channels, background = None))]
    fn blend<'py>(
        slf: Bound<'py, Self>,
        channels: Array<'py>,
        background: Option<Array<'py>>,
    ) -> PyResult<(PyBlending, OutArray<'py>, OutArray<'py>)> {
        let (py, this) = (slf.py(), slf.get());
        let count = channels.shape().last().copied().unwrap_or(0);
        let background = background.as_ref().map(|background| numbers("background", background)).transpose()?;
        let values = Channels { values: numbers("channels", &channels)?, count, background };
        let (pixels, blended) = this.home.detach(py, || this.projected.blend(&values))?.map_err(|error| raise(&error))?;
        let [width, height] = this.size;
        let shape = [this.cameras, height, width, count];
        let blending = PyBlending { blended, projection: slf.clone().unbind(), channels: channels.shape().to_vec(), count };
        let images = lent(py, &this.engine, pixels.channels, &shape)?;
        Ok((blending, images, lent(py, &this.engine, pixels.alpha, &[this.cameras, height, width, 1])?))
    }

    /// Returns the gradients by means, quaternions, scales, covariances, opacities and viewmats
    /// from those by the projection's arrays, in their layout. Covariances are those in the world,
    /// xx, xy, xz, yy, yz, zz; either they or quaternions and scales are None. That by viewmats is
    /// None if it is not wanted.
    #[pyo3(signature = (means2d = None, covars2d = None, conics = None, depths = None, opacities = None, *, by_covariance = false,
        by_viewmats = true))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn backward<'py>(
        &self,
        py: Python<'py>,
        means2d: Option<Array<'py>>,
        covars2d: Option<Array<'py>>,
        conics: Option<Array<'py>>,
        depths: Option<Array<'py>>,
        opacities: Option<Array<'py>>,
        by_covariance: bool,
        by_viewmats: bool,
    ) -> PyResult<[Option<OutArray<'py>>; 6]> {
        let means2d = means2d.as_ref().map(|array| rows::<2>("means2d", array)).transpose()?;
        let covars2d = covars2d.as_ref().map(|array| rows::<3>("covars2d", array)).transpose()?;
        let conics = conics.as_ref().map(|array| rows::<3>("conics", array)).transpose()?;
        let depths = depths.as_ref().map(|array| numbers("depths", array)).transpose()?;
        let opacities = opacities.as_ref().map(|array| numbers("opacities", array)).transpose()?;
        let all_means = means2d.map(|rows| self.unpack("means2d", rows)).transpose()?.flatten();
        let all_covars = covars2d.map(|rows| self.unpack("covars2d", rows)).transpose()?.flatten();
        let all_conics = conics.map(|rows| self.unpack("conics", rows)).transpose()?.flatten();
        let all_depths = depths.map(|rows| self.unpack("depths", rows)).transpose()?.flatten();
        let all_opacities = opacities.map(|rows| self.unpack("opacities", rows)).transpose()?.flatten();
        let gradient = EllipseGradient {
            mean_px: all_means.as_deref().or(means2d),
            covariance_px2: all_covars.as_deref().or(covars2d),
            conic: all_conics.as_deref().or(conics),
            depth: all_depths.as_deref().or(depths),
            opacity: all_opacities.as_deref().or(opacities),
            shape: if by_covariance { ShapeParameters::Covariance } else { ShapeParameters::RotationAndScale },
            cameras: if by_viewmats { CameraMatrices::Differentiate } else { CameraMatrices::Skip },
        };
        let found = self.home.detach(py, || self.projected.backward(&gradient))?.map_err(|error| raise(&error))?;
        let mut viewmats = Vec::new();
        for rows in found.camera_from_world {
            viewmats.extend(rows.as_flattened());
            // The last row is constant.
            viewmats.extend([0.0; 4]);
        }
        let n = self.splats;
        Ok([
            Some(lent(py, &self.engine, found.position.into_flattened(), &[n, 3])?),
            (!by_covariance).then(|| lent(py, &self.engine, found.rotation.into_flattened(), &[n, 4])).transpose()?,
            (!by_covariance).then(|| lent(py, &self.engine, found.scale.into_flattened(), &[n, 3])).transpose()?,
            by_covariance.then(|| lent(py, &self.engine, found.covariance.into_flattened(), &[n, 6])).transpose()?,
            Some(lent(py, &self.engine, found.opacity, &[n])?),
            by_viewmats.then(|| shaped(py, viewmats, &[self.cameras, 4, 4])).transpose()?,
        ])
    }
}

/// Blended images.
#[pyclass(module = "luxel._luxel", name = "Blending", frozen)]
pub(crate) struct PyBlending {
    blended: Box<dyn BlendedSplats>,
    projection: Py<PyProjection>,
    /// Shape of the channels.
    channels: Vec<usize>,
    count: usize,
}

#[pymethods]
impl PyBlending {
    /// Returns the gradients by `means2d`, `covars2d`, `opacities`, `channels`, `background` if
    /// there was one, and the absolute ones by means2d as `absgrad` if wanted, from those by images
    /// and alpha.
    #[pyo3(signature = (images, alpha = None, *, absolute = false))]
    fn backward<'py>(
        &self,
        py: Python<'py>,
        images: Array<'py>,
        alpha: Option<Array<'py>>,
        absolute: bool,
    ) -> PyResult<Bound<'py, PyDict>> {
        let alpha = alpha.as_ref().map(|alpha| numbers("alpha", alpha)).transpose()?;
        let gradient = PixelGradient {
            channels: numbers("images", &images)?,
            alpha,
            absolute: if absolute { AbsoluteMeans::Collect } else { AbsoluteMeans::Skip },
        };
        let home = self.projection.get().home;
        let found = home.detach(py, || self.blended.backward(&gradient))?.map_err(|error| raise(&error))?;
        let BlendGradient { mean_px, covariance_px2, opacity, channels, background, absolute_mean_px } = found;
        let projection = self.projection.get();
        let arrays = PyDict::new(py);
        arrays.set_item("means2d", projection.packed(py, mean_px, &[2])?)?;
        arrays.set_item("covars2d", projection.packed(py, covariance_px2, &[3])?)?;
        arrays.set_item("opacities", projection.packed_numbers(py, opacity)?)?;
        arrays.set_item("channels", lent(py, &projection.engine, channels, &self.channels)?)?;
        if !background.is_empty() {
            arrays.set_item("background", shaped(py, background, &[projection.cameras, self.count])?)?;
        }
        if absolute {
            arrays.set_item("absgrad", projection.packed(py, absolute_mean_px, &[2])?)?;
        }
        Ok(arrays)
    }
}
