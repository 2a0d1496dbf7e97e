//! Small files, written whole or not at all, and checks of paths before writing.

use std::path::Path;

use luxel_core::Remedy;
use serde::Serialize;

use crate::error::{Context, bail};
use crate::{Error, Result};

/// Writes a file atomically.
///
/// # Errors
/// The file cannot be written.
pub fn write_bytes(path: &Path, content: &[u8]) -> Result<()> {
    luxel_io::write_atomically(path, |out| out.write_all(content).map_err(|e| luxel_io::IoError::system(path, "write", &e)))?;
    Ok(())
}

/// Refuses an output path that is a folder, or an existing file unless `overwrite` is set.
///
/// # Errors
/// The path is taken.
pub fn check_free(path: &Path, overwrite: bool) -> Result<()> {
    if path.is_dir() {
        bail!("{}: is a folder, expected a name for a file", path.display());
    }
    if path.exists() && !overwrite {
        let remedy = Remedy::advice("give another name").or(Remedy::set("overwrite", "true"));
        return Err(Error::new(format!("{}: exists already", path.display())).with_remedy(remedy));
    }
    Ok(())
}

/// Returns whether both paths lead to one file or folder, existing or not.
pub fn is_same(a: &Path, b: &Path) -> bool {
    let real = |path: &Path| {
        let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let by_its_folder = || Some(std::fs::canonicalize(absolute.parent()?).ok()?.join(absolute.file_name()?));
        std::fs::canonicalize(path).ok().or_else(by_its_folder).unwrap_or(absolute)
    };
    real(a) == real(b)
}

/// Refuses an output path that leads to one of `inputs`.
///
/// # Errors
/// It does.
pub fn check_no_input<'a>(path: &Path, inputs: impl IntoIterator<Item = &'a Path>) -> Result<()> {
    let Ok(real) = std::fs::canonicalize(path) else { return Ok(()) };
    if inputs.into_iter().any(|input| std::fs::canonicalize(input).is_ok_and(|input| input == real)) {
        bail!("{}: is read by this command, so it is not written over; give another name", path.display());
    }
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

/// Writes a JSON file atomically.
///
/// # Errors
/// The value has no form in JSON, or the file cannot be written.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let content = serde_json::to_string_pretty(value).with_context(|| format!("{}: cannot encode", path.display()))?;
    write_text(path, &(content + "\n"))
}

/// Reads a text file of at most `limit` bytes.
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
    Ok(content)
}
