//! Images from and to files, as arrays.

use std::path::PathBuf;

use luxel_core::tone::{display_rgb8, rec709_of};
use luxel_core::{Conversion, Image};
use luxel_io::{ExrOptions, ExrSample, ReadOptions};
use numpy::PyArray3;
use pyo3::prelude::*;

use crate::arrays::{image_array, image_of, plane_of};
use crate::camera::PyCamera;
use crate::errors::{OrRaise, invalid};
use crate::names;
use crate::wait::interruptible;

/// Reads an image as linear radiance.
///
/// Formats are OpenEXR, Radiance HDR, TIFF, PNG, JPEG, DPX and NumPy's .npy, by content.
///
/// Args:
///     path: the file.
///     transfer: curve of integer samples that do not state theirs, such as "srgb", "linear",
///         "logc3", "slog3".
///     layer: part, layer or view of an OpenEXR file that has several.
///     color_space: space to convert to, such as "acescg"; None keeps that of the file.
///
/// Returns:
///     (image, color_space): float32 [height, width, 3] linear and unbounded, and the name of its
///     colour space; None for a file that states none, and was not converted.
#[pyfunction]
#[pyo3(signature = (path, *, transfer=None, layer=None, color_space=None))]
pub(crate) fn read_image<'py>(
    py: Python<'py>,
    path: PathBuf,
    transfer: Option<&str>,
    layer: Option<String>,
    color_space: Option<&str>,
) -> PyResult<(Bound<'py, PyArray3<f32>>, Option<&'static str>)> {
    let options = ReadOptions { transfer: names::transfer(transfer)?, layer };
    let wanted = names::optional_color_space(color_space)?;
    let mut decoded = interruptible(py, move || luxel_io::read_image(&path, &options))?.or_raise()?;
    decoded.composite_over_black();
    let stated = decoded.color_space;
    let mut image = decoded.image;
    if let Some(wanted) = wanted {
        let conversion = Conversion::between(stated.unwrap_or_default(), wanted);
        image.pixels.iter_mut().for_each(|pixel| *pixel = conversion.apply(*pixel));
    }
    Ok((image_array(py, image)?, wanted.or(stated).map(|space| space.name())))
}

/// Writes an OpenEXR file of linear radiance, whole or not at all.
///
/// Args:
///     path: the file, which is replaced.
///     image: [height, width, 3], linear.
///     color_space: space of the pixels, whose chromaticities are written.
///     exr_type: "auto" for half floats unless a value exceeds 65504, "half" or "float".
///     alpha: [height, width], linear opacity; colours should be multiplied by it.
///     depth: [height, width], distance along the viewing axis, world units.
///     camera: the camera of the image, for its metadata.
///     attributes: further metadata, text or numbers by name.
#[pyfunction]
#[pyo3(signature = (path, image, *, color_space="linear-rec709", exr_type="auto", alpha=None, depth=None, camera=None, attributes=None))]
#[expect(clippy::too_many_arguments, reason = "arguments of Python have names")]
pub(crate) fn write_exr(
    py: Python<'_>,
    path: PathBuf,
    image: &Bound<'_, PyAny>,
    color_space: &str,
    exr_type: &str,
    alpha: Option<&Bound<'_, PyAny>>,
    depth: Option<&Bound<'_, PyAny>>,
    camera: Option<&PyCamera>,
    attributes: Option<std::collections::BTreeMap<String, Attribute>>,
) -> PyResult<()> {
    let image = image_of("image", image)?;
    let size = [image.width, image.height];
    let plane = |name: &str, plane: Option<&Bound<'_, PyAny>>| plane.map(|plane| plane_of(name, plane, size)).transpose();
    let sample = match exr_type {
        "auto" => ExrSample::smallest_for(&image),
        "half" => ExrSample::Half,
        "float" => ExrSample::Float,
        _ => return Err(invalid(format!("exr_type: found {exr_type:?}, expected \"auto\", \"half\" or \"float\""))),
    };
    let (mut texts, mut numbers) = (Vec::new(), Vec::new());
    for (name, value) in attributes.into_iter().flatten() {
        match value {
            Attribute::Number(value) => numbers.push((name, value)),
            Attribute::Text(value) => texts.push((name, value)),
        }
    }
    let options = ExrOptions {
        sample,
        color_space: names::scene_color_space(color_space)?,
        attributes: texts,
        numbers,
        camera: camera.map(PyCamera::world),
        alpha: plane("alpha", alpha)?,
        depth: plane("depth", depth)?,
        ..ExrOptions::default()
    };
    luxel::output::check_extension(&path, &["exr"]).or_raise()?;
    interruptible(py, move || luxel_io::write_exr(&path, &image, &options))?.or_raise()?;
    Ok(())
}

/// A value of an OpenEXR file's metadata.
#[derive(FromPyObject)]
pub(crate) enum Attribute {
    Number(f32),
    Text(String),
}

/// Writes an 8-bit tone-mapped picture as PNG, to look at.
///
/// Args:
///     path: the file, which is replaced.
///     image: [height, width, 3], light, or renders of a scene whose colours are a display's.
///     tonemap: curve: "agx", "aces", "reinhard", "mulaw" or "none", which shows a display's
///         colours as they are.
///     exposure: stops; at 0 a radiance of `white` is 1 before the curve.
///     white: radiance of 1, such as `scene.radiance_scale`.
///     color_space: space of the pixels; "display-srgb" for a display's colours.
#[pyfunction]
#[pyo3(signature = (path, image, *, tonemap="agx", exposure=0.0, white=1.0, color_space="linear-rec709"))]
pub(crate) fn write_preview(
    path: PathBuf,
    image: &Bound<'_, PyAny>,
    tonemap: &str,
    exposure: f32,
    white: f32,
    color_space: &str,
) -> PyResult<()> {
    let (image, space, curve) = (image_of("image", image)?, names::scene_color_space(color_space)?, names::tonemap(tonemap)?);
    if !(white > 0.0 && white.is_finite()) {
        return Err(invalid(format!("white: found {white}, expected a positive radiance")));
    }
    luxel::output::check_extension(&path, &["png"]).or_raise()?;
    let encode = |rgb: &[f32; 3]| display_rgb8(curve, exposure, rec709_of(space, rgb.map(|v| v / white)));
    let rgb8: Vec<[u8; 3]> = image.pixels.iter().map(encode).collect();
    luxel_io::write_png(&path, image.width, image.height, rgb8.as_flattened()).or_raise()
}

/// Returns an image in another colour space: [height, width, 3]. Radiance outside of its gamut
/// becomes negative.
#[pyfunction]
#[pyo3(signature = (image, source, target))]
pub(crate) fn convert_color_space<'py>(
    py: Python<'py>,
    image: &Bound<'py, PyAny>,
    source: &str,
    target: &str,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let Image { width, height, mut pixels } = image_of("image", image)?;
    let (source, target) = (names::scene_color_space(source)?, names::color_space(target)?);
    let conversion = Conversion::between(source, target);
    pixels.iter_mut().for_each(|pixel| *pixel = conversion.apply(source.towards(target, *pixel)));
    image_array(py, Image { width, height, pixels })
}
