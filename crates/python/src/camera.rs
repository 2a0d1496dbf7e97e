//! Cameras, from and to the conventions of other programs.

use glam::{DAffine3, DMat3, DVec2, DVec3};
use luxel::PathCamera;
use luxel_core::{Camera, CameraProjection, Distortion, Fisheye, Similarity};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{matrix_array, motion_array, motion_of, rows_array, rows_of, vector_array};
use crate::errors::{OrRaise, invalid};
use crate::{json, lens};

/// A posed camera: where it is, how it projects, how large its image is.
///
/// World coordinates are those of the data set's files. Camera axes are OpenCV's: x right, y down,
/// z forwards. Pixels are counted from the image's top left corner, whose pixel has its middle at
/// (0.5, 0.5). Cameras do not change; methods return new ones.
///
/// Args:
///     camera_from_world: float64 [4,4] or [3,4], the rigid motion from world to camera
///         coordinates, which other programs call view matrix or extrinsics.
///     K: float64 [3,3] with fx, fy, cx, cy in pixels; of a panorama, pixels per radian.
///     width, height: size of the image, pixels.
///     projection: "pinhole", "fisheye" (OpenCV's model, Kannala-Brandt) or "equirectangular".
///     fisheye: k1 to k4 of a fisheye.
///     max_angle: angle to the axis in degrees up to which a fisheye sees; None for 100, or less
///         where its radius stops growing sooner.
///     distortion: k1, k2, p1, p2 of a pinhole's lens (OpenCV). `Dataset.from_arrays` removes it
///         from images; a camera with it cannot render.
///
/// Raises:
///     LuxelError: a pose that is not rigid, or a lens or size that cannot be used.
#[pyclass(name = "Camera", module = "luxel", frozen, eq)]
#[derive(Clone, PartialEq)]
pub(crate) struct PyCamera {
    /// The camera in the local coordinates of a data set, or in the world.
    local: Camera,
    /// The coordinates of `local`.
    frame: Similarity,
}

impl PyCamera {
    /// Returns a camera of a data set, held in `frame`.
    pub(crate) fn in_frame(local: Camera, frame: Similarity) -> Self {
        Self { local, frame }
    }

    /// Returns a camera of the world, checked.
    pub(crate) fn checked(camera: Camera) -> PyResult<Self> {
        let without_lens = Camera { distortion: Distortion::default(), ..camera.clone() };
        without_lens.validate().map_err(|error| invalid(format!("camera: {error}")))?;
        Ok(Self { local: camera, frame: Similarity::IDENTITY })
    }

    /// Returns the camera in the world.
    pub(crate) fn world(&self) -> Camera {
        let mut camera = self.local.clone();
        self.frame.apply_to_camera(&mut camera);
        camera
    }

    /// Returns the camera in other local coordinates. From equal ones nothing is computed, so that
    /// renders are those of the command line to the bit.
    pub(crate) fn seen_from(&self, world_from_local: &Similarity) -> Camera {
        let mut camera = self.local.clone();
        if self.frame != *world_from_local {
            self.frame.then(&world_from_local.inverse()).apply_to_camera(&mut camera);
        }
        camera
    }

    fn with(&self, local: Camera) -> Self {
        Self { local, frame: self.frame }
    }
}

/// Returns the camera of a pose and the numbers of its lens.
fn assembled(pose: DAffine3, k: &Bound<'_, PyAny>, size_px: [u32; 2], projection: CameraProjection) -> PyResult<Camera> {
    let rows = rows_of::<f64, 3>("K", k)?;
    let &[[fx, skew, cx], [below, fy, cy], last] = rows.as_slice() else {
        return Err(invalid(format!("K: {} rows, expected 3", rows.len())));
    };
    if skew != 0.0 || below != 0.0 || last != [0.0, 0.0, 1.0] {
        return Err(invalid(format!("K: found {rows:?}, expected fx, fy, cx and cy alone: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")));
    }
    let (focal_px, center_px) = (DVec2::new(fx, fy), DVec2::new(cx, cy));
    Ok(Camera { camera_from_world: pose, focal_px, center_px, size_px, distortion: Distortion::default(), projection })
}

/// Returns the projection of this name.
fn projection_of(name: &str, fisheye: Option<[f64; 4]>, max_angle: Option<f64>) -> PyResult<CameraProjection> {
    if name != "fisheye" && (fisheye.is_some() || max_angle.is_some()) {
        return Err(invalid(format!("fisheye and max_angle are for projection \"fisheye\", found {name:?}")));
    }
    match name {
        "pinhole" => Ok(CameraProjection::Pinhole),
        "equirectangular" => Ok(CameraProjection::Equirectangular),
        "fisheye" => {
            let lens = Fisheye::new(fisheye.unwrap_or_default());
            let max_angle_rad = max_angle.map_or(lens.max_angle_rad, f64::to_radians);
            Ok(CameraProjection::Fisheye(Fisheye { max_angle_rad, ..lens }))
        }
        _ => Err(invalid(format!("projection: found {name:?}, expected \"pinhole\", \"fisheye\" or \"equirectangular\""))),
    }
}

#[pymethods]
#[expect(non_snake_case, reason = "everybody calls the matrix of a lens K")]
impl PyCamera {
    #[new]
    #[pyo3(signature = (camera_from_world, K, width, height, *, projection="pinhole", fisheye=None, max_angle=None, distortion=None))]
    #[expect(clippy::too_many_arguments, reason = "arguments of Python have names")]
    fn new(
        camera_from_world: &Bound<'_, PyAny>,
        K: &Bound<'_, PyAny>,
        width: u32,
        height: u32,
        projection: &str,
        fisheye: Option<[f64; 4]>,
        max_angle: Option<f64>,
        distortion: Option<[f64; 4]>,
    ) -> PyResult<Self> {
        let pose = motion_of("camera_from_world", camera_from_world)?;
        let mut camera = assembled(pose, K, [width, height], projection_of(projection, fisheye, max_angle)?)?;
        if let Some([k1, k2, p1, p2]) = distortion {
            camera.distortion = Distortion { k1, k2, p1, p2 };
        }
        Self::checked(camera)
    }

    /// Makes a pinhole camera of OpenCV's view matrix, as the constructor does.
    #[staticmethod]
    fn from_opencv(camera_from_world: &Bound<'_, PyAny>, K: &Bound<'_, PyAny>, width: u32, height: u32) -> PyResult<Self> {
        let pose = motion_of("camera_from_world", camera_from_world)?;
        Self::checked(assembled(pose, K, [width, height], CameraProjection::Pinhole)?)
    }

    /// Makes a pinhole camera of a camera-to-world matrix in OpenGL's axes (x right, y up, z
    /// backwards), as Blender, nerfstudio and instant-ngp have it.
    #[staticmethod]
    fn from_opengl(world_from_camera: &Bound<'_, PyAny>, K: &Bound<'_, PyAny>, width: u32, height: u32) -> PyResult<Self> {
        let motion = motion_of("world_from_camera", world_from_camera)?;
        let pose = Camera::pose_from_opengl(motion.matrix3, motion.translation);
        Self::checked(assembled(pose, K, [width, height], CameraProjection::Pinhole)?)
    }

    /// Makes a camera of COLMAP's numbers.
    ///
    /// Args:
    ///     model: name of the camera model, such as "PINHOLE" or "OPENCV_FISHEYE".
    ///     params: its parameters, in COLMAP's order.
    ///     width, height: size of the image, pixels.
    ///     qvec: quaternion w, x, y, z from world to camera coordinates.
    ///     tvec: translation from world to camera coordinates.
    #[staticmethod]
    fn from_colmap(model: &str, params: Vec<f64>, width: u32, height: u32, qvec: [f64; 4], tvec: [f64; 3]) -> PyResult<Self> {
        Self::checked(lens::from_colmap(model, &params, [width, height], qvec, tvec)?)
    }

    /// Makes a camera of a frame of `transforms.json`: a dictionary with `transform_matrix`, the
    /// lens (`fl_x`, `fl_y`, `cx`, `cy`, `k1` ...) and the size (`w`, `h`), which may also be in
    /// `shared`, the dictionary around the frames.
    #[staticmethod]
    #[pyo3(signature = (frame, shared=None))]
    fn from_nerfstudio(frame: &Bound<'_, PyDict>, shared: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut document = shared.map_or_else(|| Ok(serde_json::json!({})), |shared| json::from_python(shared))?;
        let mut frame = json::from_python(frame)?;
        if let Some(frame) = frame.as_object_mut() {
            frame.entry("file_path").or_insert_with(|| "camera".into());
        }
        document["frames"] = serde_json::json!([frame]);
        let cameras = luxel::decode_cameras("frame", document.to_string().as_bytes()).or_raise()?;
        let [PathCamera { camera, .. }] = <[PathCamera; 1]>::try_from(cameras).map_err(|_| invalid("frame: expected one camera"))?;
        Self::checked(camera)
    }

    /// Makes a camera that renders a whole panorama of `width` x `width / 2` pixels; its middle
    /// shows the direction that the pose looks in.
    #[staticmethod]
    fn panorama(camera_from_world: &Bound<'_, PyAny>, width: u32) -> PyResult<Self> {
        Self::checked(Camera::panorama(motion_of("camera_from_world", camera_from_world)?, width))
    }

    /// Makes a pinhole camera at `eye` that looks at `target`.
    ///
    /// Args:
    ///     eye, target, up: world coordinates.
    ///     fov: horizontal field of view, degrees.
    ///     width, height: size of the image, pixels.
    #[staticmethod]
    #[pyo3(signature = (eye, target, up, fov, width, height))]
    fn look_at(eye: [f64; 3], target: [f64; 3], up: [f64; 3], fov: f64, width: u32, height: u32) -> PyResult<Self> {
        let (eye, target, up) = (DVec3::from_array(eye), DVec3::from_array(target), DVec3::from_array(up));
        let forward = (target - eye).normalize_or_zero();
        let right = forward.cross(up).normalize_or_zero();
        if right == DVec3::ZERO {
            return Err(invalid("eye and target are the same point, or up is the viewing direction"));
        }
        if !(fov > 0.0 && fov < 180.0) {
            return Err(invalid(format!("fov: found {fov}, expected above 0 and below 180 degrees")));
        }
        let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        let size = DVec2::new(width.into(), height.into());
        Self::checked(Camera {
            camera_from_world: DAffine3 { matrix3: rotation, translation: -(rotation * eye) },
            focal_px: DVec2::splat(0.5 * size.x / (0.5 * fov.to_radians()).tan()),
            center_px: 0.5 * size,
            size_px: [width, height],
            distortion: Distortion::default(),
            projection: CameraProjection::Pinhole,
        })
    }

    /// Rigid motion from world to camera coordinates, float64 [4,4].
    #[getter]
    fn camera_from_world<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        motion_array(py, &self.world().camera_from_world)
    }

    /// Rigid motion from camera to world coordinates, float64 [4,4].
    #[getter]
    fn world_from_camera<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        motion_array(py, &self.world().camera_from_world.inverse())
    }

    /// Matrix of the lens, float64 [3,3], pixels.
    #[getter]
    fn K<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let Camera { focal_px: f, center_px: c, .. } = self.local;
        matrix_array(py, [[f.x, 0.0, c.x], [0.0, f.y, c.y], [0.0, 0.0, 1.0]])
    }

    /// Width of the image, pixels.
    #[getter]
    fn width(&self) -> u32 {
        self.local.size_px[0]
    }

    /// Height of the image, pixels.
    #[getter]
    fn height(&self) -> u32 {
        self.local.size_px[1]
    }

    /// Position in the world, float64 [3].
    #[getter]
    fn position<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector_array(py, self.world().eye())
    }

    /// Viewing direction in the world, a unit vector, float64 [3].
    #[getter]
    fn forward<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector_array(py, self.world().forward())
    }

    /// "pinhole", "fisheye" or "equirectangular".
    #[getter]
    fn projection(&self) -> &'static str {
        self.local.projection.name()
    }

    /// k1 to k4 of a fisheye; None for other projections.
    #[getter]
    fn fisheye(&self) -> Option<[f64; 4]> {
        match self.local.projection {
            CameraProjection::Fisheye(lens) => Some(lens.coefficients),
            CameraProjection::Pinhole | CameraProjection::Equirectangular => None,
        }
    }

    /// Angle to the axis up to which a fisheye sees, degrees; None for other projections.
    #[getter]
    fn max_angle(&self) -> Option<f64> {
        match self.local.projection {
            CameraProjection::Fisheye(lens) => Some(lens.max_angle_rad.to_degrees()),
            CameraProjection::Pinhole | CameraProjection::Equirectangular => None,
        }
    }

    /// k1, k2, p1, p2 of the lens; zeros without distortion.
    #[getter]
    fn distortion(&self) -> [f64; 4] {
        let Distortion { k1, k2, p1, p2 } = self.local.distortion;
        [k1, k2, p1, p2]
    }

    /// Returns (camera_from_world, K), as OpenCV and gsplat take them: float64 [4,4] and [3,3].
    #[expect(clippy::type_complexity, reason = "two arrays")]
    fn to_opencv<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>)> {
        Ok((self.camera_from_world(py)?, self.K(py)?))
    }

    /// Returns the camera-to-world matrix in OpenGL's axes, float64 [4,4].
    fn to_opengl<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let mut motion = self.world().camera_from_world.inverse();
        motion.matrix3 *= DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        motion_array(py, &motion)
    }

    /// Returns COLMAP's numbers as a dictionary: model, params, width, height, qvec, tvec.
    fn to_colmap<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(py, &lens::to_colmap(&self.world())?)
    }

    /// Returns a frame of `transforms.json` as a dictionary.
    #[pyo3(signature = (file_path="camera"))]
    fn to_nerfstudio<'py>(&self, py: Python<'py>, file_path: &str) -> PyResult<Bound<'py, PyAny>> {
        let named = PathCamera::new(file_path, self.world());
        let document: serde_json::Value =
            serde_json::from_str(&luxel_io::camera_file_text(&[named])).map_err(luxel::Error::from).or_raise()?;
        json::to_python(py, &document["frames"][0])
    }

    /// Projects points of the world. Returns (pixels, depth): float64 [count,2] and [count], NaN
    /// where a point is not seen: behind the camera, or outside of a fisheye's field. Depth is
    /// along the axis of a pinhole, and the distance for other projections. Ignores distortion.
    #[expect(clippy::type_complexity, reason = "two arrays")]
    fn project<'py>(
        &self,
        py: Python<'py>,
        points: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>)> {
        let camera = self.world();
        let none = (DVec2::NAN, f64::NAN);
        let points = rows_of::<f64, 3>("points", points)?;
        let found: Vec<(DVec2, f64)> = points.into_iter().map(|point| camera.project(point.into()).unwrap_or(none)).collect();
        let depth: Vec<f64> = found.iter().map(|(_, depth)| *depth).collect();
        let pixels = rows_array(py, found.into_iter().map(|(pixel, _)| pixel.to_array()).collect())?;
        Ok((pixels, numpy::IntoPyArray::into_pyarray(depth, py)))
    }

    /// Returns the directions in the world that places of the image show, unit vectors, float64
    /// [count,3]; NaN where the image shows nothing. Ignores distortion.
    fn directions<'py>(&self, py: Python<'py>, pixels: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let camera = self.world();
        let world_from_camera = camera.camera_from_world.matrix3.transpose();
        let direction = |[x, y]: [f64; 2]| {
            let point = camera.unproject(DVec2::new(x, y));
            point.map_or(DVec3::NAN, |point| (world_from_camera * point).normalize()).to_array()
        };
        rows_array(py, rows_of::<f64, 2>("pixels", pixels)?.into_iter().map(direction).collect())
    }

    /// Returns the camera of an image that is `factor` times smaller a side; sizes are rounded
    /// down.
    fn downscaled(&self, factor: u32) -> PyResult<Self> {
        if factor == 0 {
            return Err(invalid("factor: found 0, expected at least 1"));
        }
        Ok(self.with(self.local.downscaled(factor)))
    }

    /// Returns the camera at another pose, with the same lens.
    fn moved_to(&self, camera_from_world: &Bound<'_, PyAny>) -> PyResult<Self> {
        let pose = motion_of("camera_from_world", camera_from_world)?;
        Self::checked(Camera { camera_from_world: pose, ..self.local.clone() })
    }

    fn __repr__(&self) -> String {
        let DVec3 { x, y, z } = self.world().eye();
        let Camera { focal_px: f, size_px: [w, h], .. } = self.local;
        format!("<luxel.Camera {} {w}x{h}, focal length {:.1} px, at ({x:.4}, {y:.4}, {z:.4})>", self.projection(), f.x)
    }

    /// Pickles the camera: data loaders of torch send it to other processes.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        let frame =
            [self.frame.rotation().to_cols_array().to_vec(), vec![self.frame.scale()], self.frame.translation().to_array().to_vec()];
        let text = serde_json::to_string(&(&self.local, frame.concat())).map_err(luxel::Error::from).or_raise()?;
        Ok((py.get_type::<Self>().getattr("_restored")?, (text,)))
    }

    #[staticmethod]
    fn _restored(text: &str) -> PyResult<Self> {
        let (local, frame): (Camera, Vec<f64>) = serde_json::from_str(text).map_err(luxel::Error::from).or_raise()?;
        let frame: [f64; 13] = frame.try_into().map_err(|_| invalid("a pickled camera is damaged"))?;
        let [turn @ .., scale, x, y, z] = frame;
        let frame = Similarity::new(DMat3::from_cols_array(&turn), scale, DVec3::new(x, y, z));
        Ok(Self { local, frame: frame.ok_or_else(|| invalid("a pickled camera is damaged"))? })
    }
}
