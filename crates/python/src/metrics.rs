//! Metrics of images in memory and in files: those of `luxel compare`.

use std::path::PathBuf;
use std::sync::Arc;

use luxel::compare::{CompareOptions, ImageComparison};
use luxel_core::Mask;
use luxel_metrics::FlipChoice;
use pyo3::prelude::*;

use crate::arrays::{image_of, plane_of};
use crate::errors::OrRaise;
use crate::observer::PyObserver;
use crate::wait::interruptible;
use crate::{json, names};

/// Returns the options that images in memory and in files share; what is left out has its default.
fn measures(
    scale: Option<f32>,
    mu: Option<f32>,
    peak_luminance: Option<f32>,
    hdr_flip: bool,
    lpips_weights: Option<PathBuf>,
) -> CompareOptions {
    let base = CompareOptions::default();
    CompareOptions {
        scale,
        mu: mu.unwrap_or(base.mu),
        peak_luminance: peak_luminance.unwrap_or(base.peak_luminance),
        flip: if hdr_flip { FlipChoice::Compute } else { FlipChoice::Skip },
        lpips_weights,
        ..base
    }
}

/// Measures an image against a reference, both linear radiance.
///
/// Args:
///     reference, image: [height, width, 3]. Pixels of the reference that are not finite are left
///         out.
///     mask: weights, [height, width]; pixels of weight 0 are left out.
///     scale: radiance that is 1 in protocol `scene`; None for the 99.9th percentile of the
///         luminance of the reference.
///     mu: mu of the mu-law.
///     peak_luminance: luminance at which the display of PU21 has that radiance, cd/m2.
///     hdr_flip: whether HDR-FLIP is measured.
///     lpips_weights: file with weights of LPIPS, which is measured if they are given.
///     color_space: space of both images.
///
/// Returns:
///     dict with every metric of `luxel compare`, such as psnr_scene, psnr_gtmax and pu21_psnr. The
///     PSNR of equal images is 100 dB.
#[pyfunction]
#[pyo3(signature = (reference, image, *, mask=None, scale=None, mu=None, peak_luminance=None, hdr_flip=true, lpips_weights=None, color_space="linear-rec709"))]
#[expect(clippy::too_many_arguments, reason = "arguments of Python have names")]
pub(crate) fn compare<'py>(
    py: Python<'py>,
    reference: &Bound<'py, PyAny>,
    image: &Bound<'py, PyAny>,
    mask: Option<&Bound<'py, PyAny>>,
    scale: Option<f32>,
    mu: Option<f32>,
    peak_luminance: Option<f32>,
    hdr_flip: bool,
    lpips_weights: Option<PathBuf>,
    color_space: &str,
) -> PyResult<Bound<'py, PyAny>> {
    let (reference, image) = (image_of("reference", reference)?, image_of("image", image)?);
    let size = [reference.width, reference.height];
    let mask = mask.map(|mask| plane_of("mask", mask, size)).transpose()?.map(|weights| Mask { weights });
    let space = names::color_space(color_space)?;
    let options = measures(scale, mu, peak_luminance, hdr_flip, lpips_weights);
    let found: ImageComparison =
        interruptible(py, move || luxel::compare::compare_images(reference, image, mask, space, &options))?.or_raise()?;
    json::to_python(py, &found)
}

/// Measures an image file, or a folder of them, against a reference file or folder.
///
/// Args:
///     reference, test: files or folders; images of folders are matched by name.
///     scale, mu, peak_luminance, hdr_flip, lpips_weights: as for `compare`.
///     mask: file or folder of masks, black where pixels are left out.
///     transfer: curve of integer samples that do not state theirs.
///     color_space: space of images that do not state theirs.
///
/// Returns:
///     dict: the JSON document of `luxel compare`.
#[pyfunction]
#[pyo3(signature = (reference, test, *, scale=None, mu=None, peak_luminance=None, hdr_flip=true, lpips_weights=None, mask=None, transfer=None, color_space=None))]
#[expect(clippy::too_many_arguments, reason = "arguments of Python have names")]
pub(crate) fn compare_files<'py>(
    py: Python<'py>,
    reference: PathBuf,
    test: PathBuf,
    scale: Option<f32>,
    mu: Option<f32>,
    peak_luminance: Option<f32>,
    hdr_flip: bool,
    lpips_weights: Option<PathBuf>,
    mask: Option<PathBuf>,
    transfer: Option<&str>,
    color_space: Option<&str>,
) -> PyResult<Bound<'py, PyAny>> {
    let options = CompareOptions {
        mask,
        transfer: names::transfer(transfer)?,
        color_space: names::optional_color_space(color_space)?,
        ..measures(scale, mu, peak_luminance, hdr_flip, lpips_weights)
    };
    let observer = Arc::new(PyObserver::default());
    let found = interruptible(py, move || luxel::compare::compare(&reference, &test, &options, &*observer))?.or_raise()?;
    json::to_python(py, &found)
}
