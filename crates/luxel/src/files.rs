//! Small files, written whole or not at all.

use std::path::Path;

use luxel_io::IoError;

use crate::Result;
use crate::error::{Context, bail};

/// Writes a file atomically.
///
/// # Errors
/// The file cannot be written.
pub fn write_bytes(path: &Path, content: &[u8]) -> Result<()> {
    luxel_io::write_atomically(path, |out| out.write_all(content).map_err(|e| IoError::system(path, "write", &e)))?;
    Ok(())
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
    use std::io::Read;
    let (file, _) = luxel_io::open_regular(path)?;
    let mut content = String::new();
    file.take(limit + 1).read_to_string(&mut content).with_context(|| format!("{}: cannot read", path.display()))?;
    if content.len() as u64 > limit {
        bail!("{}: more than {limit} bytes, expected a short text file", path.display());
    }
    match content.strip_prefix('\u{feff}') {
        Some(text) => Ok(text.to_owned()),
        None => Ok(content),
    }
}
