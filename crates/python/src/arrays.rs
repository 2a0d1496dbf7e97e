//! Arrays of NumPy and images of the library.
//!
//! Results go out without a copy: their memory becomes the array's. Images of data sets are shared
//! and therefore read-only. What comes in may be anything that NumPy makes an array of.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DMat4, DVec3};
use luxel_core::{Image, Mask};
use numpy::ndarray::{ArrayView, Dim, IntoDimension, Ix2, Ix3};
use numpy::{Element, IntoPyArray, PyArray, PyArray1, PyArray2, PyArray3, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::invalid;

/// Returns an image as an array `[H,W,3]`.
pub(crate) fn image_array(py: Python<'_>, image: Image) -> PyResult<Bound<'_, PyArray3<f32>>> {
    let Image { width, height, pixels } = image;
    pixels.into_flattened().into_pyarray(py).reshape([height, width, 3])
}

/// Returns values of pixels as an array `[H,W]`.
pub(crate) fn plane_array(py: Python<'_>, size: [usize; 2], values: Vec<f32>) -> PyResult<Bound<'_, PyArray2<f32>>> {
    let [width, height] = size;
    values.into_pyarray(py).reshape([height, width])
}

/// Returns rows of `N` numbers as an array `[rows,N]`.
pub(crate) fn rows_array<const N: usize, T: Element>(py: Python<'_>, rows: Vec<[T; N]>) -> PyResult<Bound<'_, PyArray2<T>>> {
    let count = rows.len();
    rows.into_flattened().into_pyarray(py).reshape([count, N])
}

/// Returns a matrix as an array, row by row.
pub(crate) fn matrix_array<const R: usize, const C: usize>(py: Python<'_>, rows: [[f64; C]; R]) -> PyResult<Bound<'_, PyArray2<f64>>> {
    rows_array(py, rows.to_vec())
}

/// Keeps an image or a mask alive for the arrays that look into it.
#[pyclass(frozen)]
struct Owner {
    _image: Option<Arc<Image>>,
    _mask: Option<Arc<Mask>>,
}

/// Returns a shared image as a read-only array `[H,W,3]`, without a copy.
pub(crate) fn shared_image(py: Python<'_>, image: Arc<Image>) -> PyResult<Bound<'_, PyArray3<f32>>> {
    let owner = Bound::new(py, Owner { _image: Some(Arc::clone(&image)), _mask: None })?.into_any();
    let shape: Ix3 = Dim([image.height, image.width, 3]);
    shared(image.pixels.as_flattened(), shape, owner)
}

/// Returns a shared mask as a read-only array `[H,W]` of weights, without a copy.
pub(crate) fn shared_mask(py: Python<'_>, mask: Arc<Mask>, size: [usize; 2]) -> PyResult<Bound<'_, PyArray2<f32>>> {
    let owner = Bound::new(py, Owner { _image: None, _mask: Some(Arc::clone(&mask)) })?.into_any();
    let shape: Ix2 = Dim([size[1], size[0]]);
    shared(&mask.weights, shape, owner)
}

/// Returns a read-only array over memory of `owner`.
#[expect(unsafe_code, reason = "NumPy looks into memory of the library in place of copying it")]
fn shared<'py, D>(values: &[f32], shape: D, owner: Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArray<f32, D>>>
where
    D: numpy::ndarray::Dimension + IntoDimension<Dim = D>,
{
    let view = ArrayView::from_shape(shape, values).map_err(|error| invalid(error.to_string()))?;
    // SAFETY: `values` are in a vector behind the owner's `Arc`. They neither move nor change as
    // long as the owner lives, which the array keeps alive, and nobody writes: the array is
    // read-only.
    let array = unsafe { PyArray::borrow_from_array(&view, owner) };
    array.getattr("flags")?.setattr("writeable", false)?;
    Ok(array)
}

/// Returns anything array-like as a contiguous array of `T`.
pub(crate) fn array_of<'py, T: Element>(name: &str, value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let py = value.py();
    let keywords = PyDict::new(py);
    keywords.set_item("dtype", T::get_dtype(py))?;
    let array = py.import("numpy")?.call_method("ascontiguousarray", (value,), Some(&keywords));
    let array = array.map_err(|error| invalid(format!("{name}: not an array of numbers: {error}")))?;
    array.cast_into::<PyArrayDyn<T>>().map_err(|error| invalid(format!("{name}: {error}")))
}

/// Returns an array's numbers and shape; `expected` is for errors.
fn shaped<T: Element + Copy, const D: usize>(name: &str, value: &Bound<'_, PyAny>, expected: &str) -> PyResult<(Vec<T>, [usize; D])> {
    let array = array_of::<T>(name, value)?;
    let found = array.shape();
    let shape: [usize; D] = found.try_into().map_err(|_| invalid(format!("{name}: array of shape {found:?}, expected {expected}")))?;
    Ok((array.to_vec().map_err(|error| invalid(format!("{name}: {error}")))?, shape))
}

/// Refuses arrays of 8 and 16 bits without a sign: such images are encoded, and mean no radiance as
/// they are.
fn refuse_codes(name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
    let Some(dtype) = value.getattr_opt("dtype")? else { return Ok(()) };
    let dtype = dtype.str()?.to_string();
    if ["uint8", "uint16"].contains(&dtype.as_str()) {
        let remedy = "read the file with luxel.read_image, or undo the image's transfer curve and scale";
        return Err(invalid(format!("{name}: array of {dtype}, which are encoded values; expected linear radiance as floats: {remedy}")));
    }
    Ok(())
}

/// Returns an image of an array `[H,W,3]`.
pub(crate) fn image_of(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Image> {
    const EXPECTED: &str = "[height, width, 3]";
    refuse_codes(name, value)?;
    let (values, shape) = shaped::<f32, 3>(name, value, EXPECTED)?;
    let [height, width, 3] = shape else { return Err(invalid(format!("{name}: array of shape {shape:?}, expected {EXPECTED}"))) };
    let pixels = values.as_chunks::<3>().0.to_vec();
    Image::from_pixels(width, height, pixels).ok_or_else(|| invalid(format!("{name}: an image of {width} x {height} pixels")))
}

/// Returns the values of an array `[H,W]` of that size; logical values become 0 and 1.
pub(crate) fn plane_of(name: &str, value: &Bound<'_, PyAny>, size: [usize; 2]) -> PyResult<Vec<f32>> {
    let expected = format!("[{}, {}]", size[1], size[0]);
    let (values, shape) = shaped::<f32, 2>(name, value, &expected)?;
    if shape == [size[1], size[0]] { Ok(values) } else { Err(invalid(format!("{name}: array of shape {shape:?}, expected {expected}"))) }
}

/// Returns the rows of an array `[rows,N]`.
pub(crate) fn rows_of<T: Element + Copy, const N: usize>(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<[T; N]>> {
    let expected = format!("[count, {N}]");
    let (values, shape) = shaped::<T, 2>(name, value, &expected)?;
    if shape[1] != N {
        return Err(invalid(format!("{name}: array of shape {shape:?}, expected {expected}")));
    }
    Ok(values.as_chunks::<N>().0.to_vec())
}

/// Returns the numbers of an array `[count]`.
pub(crate) fn numbers_of<T: Element + Copy>(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<T>> {
    shaped::<T, 1>(name, value, "[count]").map(|(values, _)| values)
}

/// Returns the numbers of an array of any shape `[count,...]`, row by row.
pub(crate) fn flat_of<T: Element + Copy>(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<T>> {
    array_of::<T>(name, value)?.to_vec().map_err(|error| invalid(format!("{name}: {error}")))
}

/// Returns the motion of an array `[4,4]` or `[3,4]`.
pub(crate) fn motion_of(name: &str, value: &Bound<'_, PyAny>) -> PyResult<DAffine3> {
    const EXPECTED: &str = "[4, 4] or [3, 4]";
    let (values, shape) = shaped::<f64, 2>(name, value, EXPECTED)?;
    let row = |i: usize| DVec3::new(values[4 * i], values[4 * i + 1], values[4 * i + 2]);
    match shape {
        [4, 4] if values[12..] != [0.0, 0.0, 0.0, 1.0] => {
            Err(invalid(format!("{name}: the last row is {:?}, expected 0, 0, 0, 1", &values[12..])))
        }
        [3 | 4, 4] => Ok(DAffine3 {
            matrix3: DMat3::from_cols(row(0), row(1), row(2)).transpose(),
            translation: DVec3::new(values[3], values[7], values[11]),
        }),
        _ => Err(invalid(format!("{name}: array of shape {shape:?}, expected {EXPECTED}"))),
    }
}

/// Returns a motion as an array `[4,4]`.
pub(crate) fn motion_array<'py>(py: Python<'py>, motion: &DAffine3) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let matrix = DMat4::from(*motion).transpose();
    matrix_array(py, matrix.to_cols_array_2d())
}

/// Returns three numbers as an array `[3]`.
pub(crate) fn vector_array(py: Python<'_>, v: DVec3) -> Bound<'_, PyArray1<f64>> {
    v.to_array().to_vec().into_pyarray(py)
}
