//! The arrays of the rasteriser.
//!
//! In: contiguous arrays of float32, as they are. Out: results as arrays, whose memory goes back to
//! the engine when the last array over it is gone: fresh memory costs as much time as a pass.

use std::sync::{Arc, Mutex, PoisonError};

use bytemuck::Pod;
use luxel_core::engine::Differentiable;
use luxel_cpu::CpuEngine;
use numpy::ndarray::ArrayViewMut;
use numpy::{Element, IntoPyArray, PyArray, PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::errors::invalid;

/// An array that comes in.
pub(crate) type Array<'py> = PyReadonlyArrayDyn<'py, f32>;
/// An array that goes out.
pub(crate) type OutArray<'py> = Bound<'py, PyArrayDyn<f32>>;

/// Returns an array's numbers, which must be contiguous.
pub(crate) fn numbers<'a>(name: &str, array: &'a Array<'_>) -> PyResult<&'a [f32]> {
    array.as_slice().map_err(|_| invalid(format!("{name}: array is not contiguous; pass numpy.ascontiguousarray of it")))
}

/// Returns an array's rows of `N` numbers.
pub(crate) fn rows<'a, const N: usize>(name: &str, array: &'a Array<'_>) -> PyResult<&'a [[f32; N]]> {
    if array.shape().last() != Some(&N) {
        return Err(invalid(format!("{name}: array of shape {:?}, expected [..., {N}]", array.shape())));
    }
    Ok(numbers(name, array)?.as_chunks().0)
}

/// Returns an array's flags, which must be contiguous.
pub(crate) fn flags<'a>(array: Option<&'a PyReadonlyArrayDyn<'_, bool>>) -> PyResult<Option<&'a [bool]>> {
    array.map(|array| array.as_slice()).transpose().map_err(|error| invalid(format!("visible: {error}")))
}

/// Returns numbers as an array of a shape.
pub(crate) fn shaped<'py, T: Element>(py: Python<'py>, values: Vec<T>, shape: &[usize]) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    values.into_pyarray(py).reshape(shape.to_vec())
}

/// Returns the places of positions [N, 3] along a space-filling curve: int64 [N].
#[pyfunction]
pub(crate) fn spatial_order<'py>(py: Python<'py>, positions: Array<'py>) -> PyResult<Bound<'py, PyArray1<i64>>> {
    let order = luxel_core::spatial_order(rows("means", &positions)?);
    Ok(order.into_iter().map(i64::from).collect::<Vec<_>>().into_pyarray(py))
}

/// Memory of a result that an array looks into; the engine takes it back for a later result.
#[pyclass(frozen)]
struct Lent {
    engine: Arc<CpuEngine>,
    numbers: Mutex<Vec<f32>>,
}

impl Drop for Lent {
    fn drop(&mut self) {
        let numbers = self.numbers.get_mut().unwrap_or_else(PoisonError::into_inner);
        self.engine.recycle(std::mem::take(numbers));
    }
}

/// Returns numbers of 32 bits as an array of a shape, whose memory goes back to the engine.
#[expect(unsafe_code, reason = "NumPy looks into memory of the library in place of copying it")]
pub(crate) fn lent<'py, T: Element + Pod>(
    py: Python<'py>,
    engine: &Arc<CpuEngine>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    if shape.iter().product::<usize>() != values.len() || size_of::<T>() != size_of::<f32>() {
        return shaped(py, values, shape);
    }
    let mut numbers = match bytemuck::allocation::try_cast_vec::<T, f32>(values) {
        Ok(numbers) => numbers,
        Err((_, values)) => return shaped(py, values, shape),
    };
    let first = numbers.as_mut_ptr().cast::<T>();
    let owner = Bound::new(py, Lent { engine: Arc::clone(engine), numbers: Mutex::new(numbers) })?.into_any();
    // SAFETY: the shape has as many numbers as the vector. The vector's memory stays where it is
    // until `Lent` is dropped, which the array keeps alive, and only the array reads and writes it
    // until then.
    Ok(unsafe { PyArray::borrow_from_array(&ArrayViewMut::from_shape_ptr(shape, first), owner) })
}
