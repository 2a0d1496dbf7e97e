//! Small files, written whole or not at all: texts, JSON documents with their versions, arrays.

use std::path::Path;

use luxel::Result;
use luxel::error::Context;
pub use luxel::files::{read_text, remove_if_there, write_bytes, write_text};
use luxel_io::{IoError, NamedArray};
use luxel_train::{ArrayFile, FileArray};
use serde::Serialize;

use crate::schema::Document;

/// Writes a JSON file atomically, with the version of its schema.
///
/// # Errors
/// The value has no form in JSON, or the file cannot be written.
pub fn write_json(path: &Path, document: Document, value: &impl Serialize) -> Result<()> {
    let content = serde_json::to_string_pretty(&document.versioned(value)).with_context(|| format!("{}: cannot encode", path.display()))?;
    write_text(path, &(content + "\n"))
}

/// Writes a file of arrays atomically.
///
/// # Errors
/// The file cannot be written.
pub(crate) fn write_arrays(path: &Path, file: &ArrayFile) -> Result<(), IoError> {
    let arrays = file.arrays.iter().map(|FileArray { name, shape, values }| NamedArray { name, shape, values });
    let arrays: Vec<NamedArray<'_>> = arrays.collect();
    luxel_io::write_arrays(path, file.format, &file.description, &arrays)
}
