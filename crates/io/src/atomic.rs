//! Files that are there whole or not at all: written beside their place, synced, renamed.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock, PoisonError};

use tempfile::NamedTempFile;

use crate::IoError;
use crate::confine::check_file;

/// Names of unfinished files begin and end with these.
const PREFIX: &str = ".luxel-";
const SUFFIX: &str = ".tmp";

/// Writes `path` through `write`. On any error nothing is left behind and an older file of the name
/// stays as it was; else the new one has its permissions. Where the name is a link, the file that
/// it leads to is written; in a folder that writing is confined to ([`crate::confine`]), the link
/// is replaced. Missing folders are created. The first write into a folder also removes what killed
/// processes left there ([`sweep_unfinished`]).
///
/// ```
/// use luxel_io::{IoError, write_atomically};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("reports/run.txt");
/// write_atomically(&path, |file| {
///     file.write_all(b"done").map_err(|e| IoError::system(&path, "write", &e))
/// })?;
/// assert_eq!(std::fs::read(&path)?, b"done");
///
/// // A failed write leaves the older file as it was.
/// let failed = write_atomically(&path, |_| Err(IoError::invalid(&path, "nothing to write")));
/// assert!(failed.is_err());
/// assert_eq!(std::fs::read(&path)?, b"done");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// `write`'s error, [`crate::IoErrorKind::System`] or [`crate::IoErrorKind::NoRoom`];
/// [`crate::IoErrorKind::Invalid`] where the name is a device, a pipe, or a link to a missing file.
pub fn write_atomically(path: &Path, write: impl FnOnce(&mut (dyn WriteSeek + '_)) -> Result<(), IoError>) -> Result<(), IoError> {
    replace(path, Durability::Synced, write)?;
    if let Some(notice) = WRITTEN.get() {
        notice(path);
    }
    Ok(())
}

/// Writes a file of these bytes, as [`write_atomically`] does.
///
/// # Errors
/// Those of [`write_atomically`].
pub fn write_bytes(path: &Path, content: &[u8]) -> Result<(), IoError> {
    write_atomically(path, |out| out.write_all(content).map_err(|e| IoError::system(path, "write", &e)))
}

/// Writes a file that can be made again at any time, and whose reader checks that it is whole: as
/// [`write_atomically`] does, but neither waits for the disk nor calls the notice.
pub(crate) fn write_cache_file(path: &Path, write: impl FnOnce(&mut (dyn WriteSeek + '_)) -> Result<(), IoError>) -> Result<(), IoError> {
    replace(path, Durability::Unsynced, write)
}

/// Whether a file must survive the machine.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Durability {
    Synced,
    Unsynced,
}

fn replace(
    path: &Path,
    durability: Durability,
    write: impl FnOnce(&mut (dyn WriteSeek + '_)) -> Result<(), IoError>,
) -> Result<(), IoError> {
    let is_confined = check_file(path)?;
    let place = if is_confined { checked(path, path.to_owned())? } else { place_of(path)? };
    let folder = place.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(|e| IoError::system(folder, "create folder", &e))?;
    let system = |e: &std::io::Error| IoError::system(path, "write", e);
    sweep_once(folder);
    let file = temporary_in(folder).map_err(|e| system(&e))?;
    let _unfinished = Unfinished::new(file.path());
    if let Ok(older) = std::fs::symlink_metadata(&place)
        && !older.is_symlink()
    {
        file.as_file().set_permissions(older.permissions()).map_err(|e| system(&e))?;
    }
    let mut buffer = BufWriter::with_capacity(1 << 20, file);
    write(&mut buffer)?;
    let file = buffer.into_inner().map_err(|e| system(e.error()))?;
    if durability == Durability::Synced {
        file.as_file().sync_all().map_err(|e| system(&e))?;
    }
    file.persist(&place).map_err(|e| system(&e.error))?;
    // The rename itself is durable once the folder is; where folders can't be synced (Windows) the
    // rename is already ordered.
    if durability == Durability::Synced
        && let Ok(handle) = std::fs::File::open(folder)
    {
        let _ = handle.sync_all();
    }
    Ok(())
}

/// Receives the path of each file that was written.
static WRITTEN: OnceLock<fn(&Path)> = OnceLock::new();

/// Calls `notice` with the path of each file that [`write_atomically`] finishes from now on, from
/// the thread that wrote it: for a program that lists what it wrote. The first call decides;
/// returns whether this is the first.
pub fn notice_written(notice: fn(&Path)) -> bool {
    WRITTEN.set(notice).is_ok()
}

/// Returns the path that a file of this name is written to: the target of links, if there are any.
fn place_of(path: &Path) -> Result<PathBuf, IoError> {
    let Ok(found) = std::fs::symlink_metadata(path) else { return Ok(path.to_owned()) };
    let place = match found.is_symlink() {
        true => {
            std::fs::canonicalize(path).map_err(|_| IoError::invalid(path, "is a link to a missing file, expected a file; remove it"))?
        }
        false => path.to_owned(),
    };
    checked(path, place)
}

/// Refuses a place that is neither free nor a file, a folder (which renaming refuses) or a link.
fn checked(path: &Path, place: PathBuf) -> Result<PathBuf, IoError> {
    match std::fs::symlink_metadata(&place) {
        Ok(found) if !found.is_file() && !found.is_dir() && !found.is_symlink() => {
            Err(IoError::invalid(path, "is a device or a pipe, expected a name for a file"))
        }
        _ => Ok(place),
    }
}

/// Files that are being written.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Keeps a file among [`UNFINISHED`] while it lives.
struct Unfinished(PathBuf);

impl Unfinished {
    fn new(path: &Path) -> Self {
        UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner).push(path.to_owned());
        Self(path.to_owned())
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner).retain(|path| *path != self.0);
    }
}

/// Removes what [`write_atomically`] has not finished on any thread: for a process that ends now,
/// without running destructors.
pub fn remove_unfinished() {
    for path in UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner).drain(..) {
        // The process ends either way, and finished files are not in the list any more.
        let _ = std::fs::remove_file(path);
    }
}

/// A destination that can be written and sought in.
pub trait WriteSeek: Write + std::io::Seek {}
impl<T: Write + std::io::Seek> WriteSeek for T {}

/// Returns a file with the permissions of an ordinary new one, where temporary files would be
/// private: the system takes the user's mask off. It is locked, which tells other processes that it
/// is not left over.
fn temporary_in(folder: &Path) -> std::io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(PREFIX).suffix(SUFFIX);
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    loop {
        let file = builder.tempfile_in(folder)?;
        // Elsewhere than on Unix, a lock would keep others from reading the finished file. A file
        // system without locks is no reason not to write: nothing is swept there.
        if !cfg!(unix) || file.as_file().try_lock().is_err() || file.path().exists() {
            return Ok(file);
        }
        // Another process swept it before it was locked.
    }
}

/// Returns whether this is the name of a file that [`write_atomically`] has not finished.
pub fn is_unfinished_name(name: &OsStr) -> bool {
    let name = name.as_encoded_bytes();
    name.starts_with(PREFIX.as_bytes()) && name.ends_with(SUFFIX.as_bytes())
}

/// Removes the unfinished files of killed processes from a folder. Files of processes that live are
/// locked, and stay. Whatever cannot be removed stays, too.
pub fn sweep_unfinished(folder: &Path) {
    if !cfg!(unix) {
        return;
    }
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        if !is_unfinished_name(&entry.file_name()) || !entry.file_type().is_ok_and(|kind| kind.is_file()) {
            continue;
        }
        let path = entry.path();
        let opened = std::fs::File::options().write(true).open(&path);
        if opened.is_ok_and(|file| file.try_lock().is_ok()) {
            let _ = std::fs::remove_file(&path);
        }
    }
}

/// Sweeps a folder before this process first writes into it.
fn sweep_once(folder: &Path) {
    static SWEPT: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
    if SWEPT.lock().unwrap_or_else(PoisonError::into_inner).insert(folder.to_owned()) {
        sweep_unfinished(folder);
    }
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;
    use crate::IoErrorKind;

    fn write_text(path: &Path, text: &str) -> Result<(), IoError> {
        write_atomically(path, |out| out.write_all(text.as_bytes()).map_err(|e| IoError::system(path, "write", &e)))
    }

    #[test]
    fn links_lead_to_the_file_and_permissions_stay() {
        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("disk/real.ply"), folder.path().join("link.ply"));
        write_text(&real, "old").unwrap();
        std::fs::set_permissions(&real, std::fs::Permissions::from_mode(0o600)).unwrap();
        symlink(&real, &link).unwrap();
        write_text(&link, "new").unwrap();
        assert!(link.is_symlink());
        assert_eq!(std::fs::read_to_string(&real).unwrap(), "new");
        assert_eq!(std::fs::metadata(&real).unwrap().permissions().mode() & 0o777, 0o600);
        std::fs::remove_file(&real).unwrap();
        assert!(write_text(&link, "new").unwrap_err().message.contains("a missing file"));
    }

    #[test]
    fn files_of_killed_processes_are_removed_and_files_in_progress_stay() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        for name in [".luxel-left.tmp", ".luxel-notes.txt", "a.tmp"] {
            std::fs::write(place(name), "half").unwrap();
        }
        symlink(place("a.tmp"), place(".luxel-link.tmp")).unwrap();
        let in_progress = temporary_in(folder.path()).unwrap();
        write_text(&place("report.html"), "whole").unwrap();
        let mut left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
        left.sort();
        let mut expected =
            vec![place(".luxel-link.tmp"), place(".luxel-notes.txt"), in_progress.path().into(), place("a.tmp"), place("report.html")];
        expected.sort();
        assert_eq!(left, expected);
        assert_eq!(std::fs::read_to_string(place("a.tmp")).unwrap(), "half");
    }

    #[test]
    fn devices_are_not_replaced() {
        let error = write_text(Path::new("/dev/null"), "new").unwrap_err();
        assert_eq!((error.kind, error.message.contains("is a device")), (IoErrorKind::Invalid, true));
        assert!(!std::fs::metadata("/dev/null").unwrap().is_file());
    }
}
