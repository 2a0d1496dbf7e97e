//! Files of cameras: `transforms.json`, nerfstudio's camera paths, OpenUSD.

use std::path::PathBuf;

use luxel::export::Up;
use luxel_app::usd_space::{UsdSpace, is_usd_file};
use luxel_io::{PathCamera, StageChoice, StageMotion};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::camera::PyCamera;
use crate::dataset::PyDataset;
use crate::errors::{OrRaise, invalid};

/// Returns the stage that a data set's scenes are exported to.
fn stage(dataset: Option<&PyDataset>, metres_per_unit: Option<f64>) -> PyResult<UsdSpace> {
    if let Some(metres) = metres_per_unit.filter(|metres| !(metres.is_normal() && *metres > 0.0)) {
        return Err(invalid(format!("metres_per_unit: found {metres}, expected a number above 0")));
    }
    let dataset: Option<&luxel_core::Dataset> = dataset.map(|dataset| &**dataset.dataset);
    let metres = metres_per_unit.or(dataset.and_then(|dataset| dataset.metres_per_unit));
    UsdSpace::new(metres, Up::Default, dataset).or_raise()
}

/// Reads the cameras of a file.
///
/// Files are a `transforms.json`, a camera path of nerfstudio, or OpenUSD (.usda, .usdc, .usdz).
/// Cameras of OpenUSD are in the stage of `Scene.export`, in which +Y is up: `dataset` tells where
/// up is in its world.
///
/// Args:
///     path: the file.
///     width, height: size of the images where an OpenUSD file has none, pixels.
///     camera: name or path of the camera in an OpenUSD file; None for the only one, or all if none
///         moves. One that moves gives a camera for each whole time code.
///     dataset: the data set of the scene, for OpenUSD; None for a world with -Y up.
///     metres_per_unit: length of a unit of the world, for OpenUSD; None for that of the data set.
///
/// Returns:
///     A Camera for each name, in the order of the file, in world coordinates.
///
/// Raises:
///     LuxelError: a file that cannot be read, or that leaves out sizes or lenses.
#[pyfunction]
#[pyo3(signature = (path, *, width=None, height=None, camera=None, dataset=None, metres_per_unit=None))]
pub(crate) fn read_cameras<'py>(
    py: Python<'py>,
    path: PathBuf,
    width: Option<u32>,
    height: Option<u32>,
    camera: Option<&str>,
    dataset: Option<PyRef<'py, PyDataset>>,
    metres_per_unit: Option<f64>,
) -> PyResult<Bound<'py, PyDict>> {
    let size_px = match (width, height) {
        (Some(width), Some(height)) => Some([width, height]),
        (None, None) => None,
        _ => return Err(invalid("width and height: one is given, expected both or none")),
    };
    let cameras = if is_usd_file(&path) {
        let choice = StageChoice { camera, size_px };
        stage(dataset.as_deref(), metres_per_unit)?.read_cameras(&path, choice).or_raise()?.cameras
    } else {
        luxel::read_cameras(&path).or_raise()?
    };
    let found = PyDict::new(py);
    for PathCamera { name, camera, .. } in cameras {
        found.set_item(name, PyCamera::checked(camera)?)?;
    }
    Ok(found)
}

/// Writes cameras to a file: .json, as `luxel render --cameras` takes them, or .usda (OpenUSD).
///
/// Args:
///     path: the file.
///     cameras: a Camera for each name.
///     moving: whether the cameras are the frames of one camera of OpenUSD, at time codes 0, 1,
///         2 and so on, and not a camera each.
///     fps: time codes of a second.
///     dataset: the data set of the scene, for OpenUSD, as in `read_cameras`.
///     metres_per_unit: length of a unit of the world, for OpenUSD.
///
/// Raises:
///     LuxelError: another extension; for OpenUSD, cameras that are not pinholes without
///         distortion.
#[pyfunction]
#[pyo3(signature = (path, cameras, *, moving=false, fps=24.0, dataset=None, metres_per_unit=None))]
pub(crate) fn write_cameras(
    path: PathBuf,
    cameras: &Bound<'_, PyDict>,
    moving: bool,
    fps: f64,
    dataset: Option<PyRef<'_, PyDataset>>,
    metres_per_unit: Option<f64>,
) -> PyResult<()> {
    if !(fps.is_finite() && fps > 0.0) {
        return Err(invalid(format!("fps: found {fps}, expected a number above 0")));
    }
    let mut named = Vec::with_capacity(cameras.len());
    for (name, camera) in cameras {
        let camera = camera.extract::<PyRef<'_, PyCamera>>()?.world();
        named.push(PathCamera::new(name.extract::<String>()?, camera));
    }
    if named.is_empty() {
        return Err(invalid("cameras: found none, expected at least one"));
    }
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    let text = match extension.as_deref() {
        Some("json") => luxel_io::camera_file_text(&named),
        Some("usda" | "usd") => {
            let motion = if moving { StageMotion::Moving { frames_per_second: fps } } else { StageMotion::Still };
            stage(dataset.as_deref(), metres_per_unit)?.cameras_text(&path, &named, motion).or_raise()?
        }
        _ => return Err(invalid(format!("{}: expected the extension .json, .usda or .usd", path.display()))),
    };
    luxel_app::files::write_text(&path, &text).or_raise()
}
