//! New files in the folder of what is shown: a run's own, or that of a scene file.
//!
//! In: a name from the page, and a content; out: a file or a folder that was not there before.
//! Nothing is ever replaced, and nothing is written outside of the folder: names are plain, and a
//! subfolder that is a link to elsewhere is refused.

use std::path::{Path, PathBuf};

use luxel::{Error, Remedy, Result};

/// Advice of an error about a name that is taken.
const TAKEN: &str = "give another name";
/// Length of a name, bytes.
const MAX_NAME: usize = 80;
/// Names that are devices on Windows.
const RESERVED: [&str; 6] = ["con", "prn", "aux", "nul", "com", "lpt"];

/// A folder that new files may be made in.
#[derive(Clone, Debug)]
pub(crate) struct Folder(PathBuf);

impl Folder {
    /// Returns the folder at a path, which must exist.
    ///
    /// # Errors
    /// It cannot be found.
    pub(crate) fn new(path: &Path) -> Result<Self> {
        let real =
            std::fs::canonicalize(path).map_err(|error| Error::new(format!("{}: cannot find the folder: {error}", path.display())))?;
        Ok(Self(real))
    }

    /// Writes a new file `name` into `subfolder`, or into the folder itself where that is empty;
    /// `extension` is added to a name without it. Returns its path.
    ///
    /// # Errors
    /// A name that is not plain or taken; the file system's refusal.
    pub(crate) fn new_file(&self, subfolder: &str, name: &str, extension: &str, content: &[u8]) -> Result<PathBuf> {
        let stem = name.strip_suffix(&format!(".{extension}")).unwrap_or(name);
        check_name(stem)?;
        let path = self.subfolder(subfolder)?.join(format!("{stem}.{extension}"));
        let _confinement = luxel_io::confine(&self.0).map_err(|error| Error::new(error.to_string()))?;
        // Takes the name, which fails if it is there, be it as a link.
        std::fs::File::create_new(&path).map_err(|error| refusal(&path, &error))?;
        let written = luxel_app::files::write_bytes(&path, content);
        if written.is_err() {
            let _ = std::fs::remove_file(&path);
        }
        written.map(|()| path)
    }

    /// Makes a new folder `name` in `subfolder`, and returns its path.
    ///
    /// # Errors
    /// A name that is not plain or taken; the file system's refusal.
    pub(crate) fn new_folder(&self, subfolder: &str, name: &str) -> Result<Self> {
        check_name(name)?;
        let path = self.subfolder(subfolder)?.join(name);
        std::fs::create_dir(&path).map_err(|error| refusal(&path, &error))?;
        Ok(Self(path))
    }

    /// Returns where it is.
    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    /// Returns a subfolder, which is made if it is missing.
    fn subfolder(&self, name: &str) -> Result<PathBuf> {
        if name.is_empty() {
            return Ok(self.0.clone());
        }
        let path = self.0.join(name);
        match std::fs::create_dir(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => return Err(refusal(&path, &error)),
            _ => {}
        }
        let real = std::fs::canonicalize(&path).map_err(|error| refusal(&path, &error))?;
        if !real.is_dir() || real != path {
            return Err(Error::new(format!("{}: is a file or a link, expected a folder of this place", path.display())));
        }
        Ok(real)
    }
}

/// Checks a name: letters, digits, `-`, `_` and `.` in between.
///
/// # Errors
/// Another name, with what is expected.
pub(crate) fn check_name(name: &str) -> Result<()> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    let device = name.split('.').next().unwrap_or_default().to_ascii_lowercase();
    let is_device = RESERVED.contains(&device.trim_end_matches(|c: char| c.is_ascii_digit()));
    if !name.is_empty()
        && name.len() <= MAX_NAME
        && name.chars().all(is_plain)
        && !name.starts_with('.')
        && !name.ends_with('.')
        && !is_device
    {
        return Ok(());
    }
    let shown: String = name.chars().take(MAX_NAME).collect();
    Err(Error::new(format!(
        "the name \"{}\" cannot be used, expected 1 to {MAX_NAME} of A-Z, a-z, 0-9, \"-\", \"_\" and, in between, \".\"",
        shown.escape_default()
    )))
}

/// Returns whether the error is that a name is taken.
pub(crate) fn is_taken(error: &Error) -> bool {
    error.remedy() == Some(&Remedy::advice(TAKEN))
}

fn refusal(path: &Path, error: &std::io::Error) -> Error {
    match error.kind() {
        std::io::ErrorKind::AlreadyExists => Error::new(format!("{}: exists already", path.display())).with_remedy(Remedy::advice(TAKEN)),
        _ => Error::new(format!("{}: cannot write: {error}", path.display())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_new_and_nothing_is_replaced() {
        let place = tempfile::tempdir().unwrap();
        let folder = Folder::new(place.path()).unwrap();
        let path = folder.new_file("probes", "cup", "exr", b"one").unwrap();
        assert!(path.ends_with("probes/cup.exr"));
        let error = folder.new_file("probes", "cup.exr", "exr", b"two").unwrap_err();
        assert!(error.to_string().contains("cup.exr: exists already") && is_taken(&error), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), b"one");
        let frames = folder.new_folder("paths", "turn").unwrap();
        assert!(frames.path().is_dir() && folder.new_folder("paths", "turn").is_err());
        assert!(folder.new_file("", "top", "ply", b"").unwrap().ends_with("top.ply"));
    }

    #[test]
    fn names_are_plain() {
        for name in ["a", "shot-1_v2.3", &"n".repeat(80)] {
            check_name(name).unwrap();
        }
        for name in ["", ".", "..", "../a", "a/b", "a\\b", ".hidden", "a.", "con", "NUL.x", "com1", "a b", "é", "a\0", &"n".repeat(81)] {
            assert!(check_name(name).is_err(), "{name}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn links_are_not_followed() {
        let (place, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let folder = Folder::new(place.path()).unwrap();
        std::os::unix::fs::symlink(elsewhere.path(), place.path().join("paths")).unwrap();
        assert!(folder.new_folder("paths", "a").unwrap_err().to_string().contains("a link"));
        std::os::unix::fs::symlink(elsewhere.path().join("missing.exr"), place.path().join("b.exr")).unwrap();
        assert!(folder.new_file("", "b", "exr", b"x").unwrap_err().to_string().contains("exists already"));
        assert_eq!(std::fs::read_dir(elsewhere.path()).unwrap().count(), 0);
    }
}
