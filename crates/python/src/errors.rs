//! One exception for all errors of the library, with its message and its remedy.

use pyo3::exceptions::PyException;
use pyo3::prelude::*;

pyo3::create_exception!(
    luxel,
    LuxelError,
    PyException,
    "Explains why something could not be done: what, where, expected and found.\n\n\
     `remedy` says what to do about it, or is None. The message contains it."
);

/// Returns the exception of an error of the library.
pub(crate) fn raise(error: &luxel::Error) -> PyErr {
    let remedy = error.remedy().map(ToString::to_string);
    let mut message = format!("{error:#}");
    if let Some(remedy) = &remedy {
        message += "; ";
        message += remedy;
    }
    with_remedy(message, remedy)
}

/// Returns the exception of an argument that cannot be used.
pub(crate) fn invalid(message: impl Into<String>) -> PyErr {
    with_remedy(message.into(), None)
}

/// Returns the exception of a message that contains its remedy.
pub(crate) fn with_remedy(message: String, remedy: Option<String>) -> PyErr {
    Python::attach(|py| {
        let raised = LuxelError::new_err(message);
        // An exception without the attribute still has its message.
        let _ = raised.value(py).setattr("remedy", remedy);
        raised
    })
}

/// Turns errors of the library into exceptions.
pub(crate) trait OrRaise<T> {
    /// Returns the value, or the exception of the error.
    fn or_raise(self) -> PyResult<T>;
}

impl<T, E: Into<luxel::Error>> OrRaise<T> for Result<T, E> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(|error| raise(&error.into()))
    }
}
