//! Whole files into memory, regular ones only: pipes and devices may never end.

use std::io::Read;
use std::path::Path;

use crate::IoError;

/// Largest file that is read whole: far above real ones, and a guard against runaway files.
const MAX_BYTES: u64 = 16 << 30;

/// Returns the metadata of a file that must be a regular one.
pub(crate) fn regular_file(path: &Path) -> Result<std::fs::Metadata, IoError> {
    let metadata = std::fs::metadata(path).map_err(|e| IoError::system(path, "read", &e))?;
    if metadata.is_file() { Ok(metadata) } else { Err(IoError::invalid(path, "not a regular file, expected one")) }
}

/// Reads a regular file.
pub(crate) fn read_file(path: &Path) -> Result<Vec<u8>, IoError> {
    let length = regular_file(path)?.len();
    if length > MAX_BYTES {
        return Err(IoError::unsupported(path, format!("{length} bytes, expected at most {MAX_BYTES}")));
    }
    let system = |e: std::io::Error| IoError::system(path, "read", &e);
    let mut bytes = Vec::new();
    std::fs::File::open(path).map_err(system)?.take(MAX_BYTES).read_to_end(&mut bytes).map_err(system)?;
    Ok(bytes)
}
