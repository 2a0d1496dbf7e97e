//! Small files, written whole or not at all: texts, JSON documents with their versions, arrays.

use std::path::Path;

use luxel::Result;
use luxel::error::Context;
use luxel_io::{IoError, NamedArray};
use luxel_train::{ArrayFile, FileArray};
use serde::Serialize;

use crate::schema::Document;

/// Writes a file atomically.
///
/// # Errors
/// The file cannot be written.
pub fn write_bytes(path: &Path, content: &[u8]) -> Result<()> {
    Ok(luxel_io::write_bytes(path, content)?)
}

/// Writes a text file atomically.
///
/// # Errors
/// The file cannot be written.
pub fn write_text(path: &Path, content: &str) -> Result<()> {
    write_bytes(path, content.as_bytes())
}

/// Reads a text file of at most `limit` bytes, without a byte order mark.
///
/// # Errors
/// The file cannot be read, is longer, or is not UTF-8.
pub fn read_text(path: &Path, limit: u64) -> Result<String> {
    Ok(luxel_io::read_text(path, limit)?)
}

/// Removes a file if it exists.
///
/// # Errors
/// The file exists and cannot be removed.
pub fn remove_if_there(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("{}: cannot remove", path.display()))
        }
        _ => Ok(()),
    }
}

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
