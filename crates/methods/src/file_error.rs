//! Files of scenes that are not stored as splats: what is read, and why it cannot be used.

use std::collections::BTreeMap;

/// Shape and values of the arrays of a file, by name.
pub type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// Says why a file is not one of a field or of anchors. The reader of the file adds its name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct FileError(String);

impl FileError {
    pub(crate) fn new(message: impl std::fmt::Display) -> Self {
        Self(message.to_string())
    }
}
