//! Files that are there whole or not at all: written beside their place, synced, renamed.

use std::io::{BufWriter, Write};
use std::path::Path;

use crate::IoError;

/// Writes `path` through `write`. On any error nothing is left behind and an older file of the name stays as it was. Missing
/// folders are created.
///
/// # Errors
/// `write`'s error, [`crate::IoErrorKind::System`] or [`crate::IoErrorKind::NoRoom`].
pub fn write_atomically(path: &Path, write: impl FnOnce(&mut (dyn WriteSeek + '_)) -> Result<(), IoError>) -> Result<(), IoError> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(|e| IoError::system(folder, "create folder", &e))?;
    let system = |e: &std::io::Error| IoError::system(path, "write", e);
    let file = temporary_in(folder).map_err(|e| system(&e))?;
    let mut buffer = BufWriter::with_capacity(1 << 20, file);
    write(&mut buffer)?;
    let file = buffer.into_inner().map_err(|e| system(e.error()))?;
    file.as_file().sync_all().map_err(|e| system(&e))?;
    file.persist(path).map_err(|e| system(&e.error))?;
    // The rename itself is durable once the folder is; where folders can't be synced (Windows) the rename is already ordered.
    if let Ok(handle) = std::fs::File::open(folder) {
        let _ = handle.sync_all();
    }
    Ok(())
}

/// A destination that can be written and sought in.
pub trait WriteSeek: Write + std::io::Seek {}
impl<T: Write + std::io::Seek> WriteSeek for T {}

/// A file with the permissions of an ordinary new one, where temporary files would be private: the system takes the user's mask off.
fn temporary_in(folder: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".luxel-").suffix(".tmp");
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder)
}
