//! Whole files into memory, regular ones only: pipes and devices may never end.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::IoError;
use crate::memory::check_memory;

/// Largest file that is read whole: far above real ones, and a guard against runaway files.
const MAX_BYTES: u64 = 16 << 30;

/// Returns the metadata of a file that must be a regular one.
pub(crate) fn regular_file(path: &Path) -> Result<std::fs::Metadata, IoError> {
    let metadata = std::fs::metadata(path).map_err(|e| IoError::system(path, "read", &e))?;
    if metadata.is_file() { Ok(metadata) } else { Err(IoError::invalid(path, "not a regular file, expected one")) }
}

/// Opens a regular file, and returns its length with it. Pipes and devices are refused before they
/// are opened, because opening one may wait for ever.
///
/// # Errors
/// A file that is missing, cannot be read, or is no regular one.
pub fn open_regular(path: &Path) -> Result<(File, u64), IoError> {
    regular_file(path)?;
    let system = |e: std::io::Error| IoError::system(path, "read", &e);
    let file = File::open(path).map_err(system)?;
    let length = file.metadata().map_err(system)?.len();
    Ok((file, length))
}

/// Reads a regular file.
///
/// # Errors
/// The same as [`open_regular`], and a file of more than 16 GiB.
pub fn read_file(path: &Path) -> Result<Vec<u8>, IoError> {
    let (file, length) = open_regular(path)?;
    if length > MAX_BYTES {
        return Err(IoError::unsupported(path, format!("{length} bytes, expected at most {MAX_BYTES}")));
    }
    check_memory(path, length)?;
    let system = |e: std::io::Error| IoError::system(path, "read", &e);
    let mut bytes = Vec::new();
    file.take(MAX_BYTES).read_to_end(&mut bytes).map_err(system)?;
    Ok(bytes)
}

/// Reads a text file of at most `limit` bytes, without a byte order mark.
///
/// # Errors
/// The same as [`open_regular`], and a file that is longer, or is not UTF-8.
pub fn read_text(path: &Path, limit: u64) -> Result<String, IoError> {
    let (file, _) = open_regular(path)?;
    let mut content = String::new();
    let refusal = |e: std::io::Error| match e.kind() {
        std::io::ErrorKind::InvalidData => IoError::invalid(path, format!("cannot read: {e}")),
        _ => IoError::system(path, "read", &e),
    };
    file.take(limit.saturating_add(1)).read_to_string(&mut content).map_err(refusal)?;
    if content.len() as u64 > limit {
        return Err(IoError::invalid(path, format!("more than {limit} bytes, expected a short text file")));
    }
    match content.strip_prefix('\u{feff}') {
        Some(text) => Ok(text.to_owned()),
        None => Ok(content),
    }
}
