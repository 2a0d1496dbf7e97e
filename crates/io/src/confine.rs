//! Folders that writing must not leave.
//!
//! A folder may come from somebody else and hold links, as archives can. A command that writes into
//! it by names of its own, such as `metrics.json`, must not change what such a link leads to. A
//! file that the user names is another matter: there links are followed.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::IoError;

/// The folders that are confined now, as they were given (absolute) and where they are.
static CONFINED: Mutex<Vec<Place>> = Mutex::new(Vec::new());

#[derive(Clone, Debug, PartialEq, Eq)]
struct Place {
    given: PathBuf,
    real: PathBuf,
}

/// Keeps [`crate::write_atomically`] within a folder while it lives. See [`confine`].
#[derive(Debug)]
pub struct Confinement(Place);

/// Confines writing to a folder, which must exist: below it, a link in the place of a file is
/// replaced, and a folder that a link leads to is written into only if it is in the folder, too.
/// The folder itself may be a link.
///
/// # Errors
/// A folder that is missing or cannot be read.
pub fn confine(folder: &Path) -> Result<Confinement, IoError> {
    let system = |e: std::io::Error| IoError::system(folder, "read folder", &e);
    let given = std::path::absolute(folder).map_err(system)?;
    let place = Place { real: std::fs::canonicalize(folder).map_err(system)?, given };
    CONFINED.lock().unwrap_or_else(PoisonError::into_inner).push(place.clone());
    Ok(Confinement(place))
}

impl Drop for Confinement {
    fn drop(&mut self) {
        let mut places = CONFINED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(at) = places.iter().rposition(|place| *place == self.0) {
            places.swap_remove(at);
        }
    }
}

/// Returns whether a file to be written is in a confined folder.
///
/// # Errors
/// It is by its name, but a link leads out of the folder.
pub(crate) fn check_file(path: &Path) -> Result<bool, IoError> {
    let Ok(absolute) = std::path::absolute(path) else { return Ok(false) };
    let places: Vec<Place> = CONFINED.lock().unwrap_or_else(PoisonError::into_inner).clone();
    let mut is_confined = false;
    for place in places.iter().filter(|place| absolute.starts_with(&place.given)) {
        is_confined = true;
        if let Some(folder) = absolute.parent() {
            check_real(&place.real, folder)?;
        }
    }
    Ok(is_confined)
}

/// Refuses a folder, existing or not, that is below `root` by its name, but to which a link out of
/// `root` leads.
///
/// # Errors
/// It is such a folder, or `root` is missing.
pub fn check_within(root: &Path, folder: &Path) -> Result<(), IoError> {
    let real = std::fs::canonicalize(root).map_err(|e| IoError::system(root, "read folder", &e))?;
    check_real(&real, folder)
}

fn check_real(root: &Path, folder: &Path) -> Result<(), IoError> {
    let Some((existing, real)) = folder.ancestors().find_map(|folder| Some((folder, std::fs::canonicalize(folder).ok()?))) else {
        return Ok(());
    };
    if real.starts_with(root) {
        return Ok(());
    }
    let message = format!(
        "leads out of the folder {}, to {}; nothing is written there: remove the link, or move here what it leads to",
        root.display(),
        real.display()
    );
    Err(IoError::invalid(existing, message))
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;
    use crate::write_atomically;

    fn write(path: &Path) -> Result<(), IoError> {
        write_atomically(path, |out| out.write_all(b"new").map_err(|e| IoError::system(path, "write", &e)))
    }

    #[test]
    fn links_do_not_lead_out_of_a_confined_folder() {
        let folder = tempfile::tempdir().unwrap();
        let (run, elsewhere) = (folder.path().join("run"), folder.path().join("home"));
        let secret = elsewhere.join("profile");
        for folder in [&run, &elsewhere, &run.join("eval")] {
            std::fs::create_dir(folder).unwrap();
        }
        std::fs::write(&secret, "old").unwrap();
        symlink(&secret, run.join("report.html")).unwrap();
        symlink(&elsewhere, run.join("eval/renders")).unwrap();
        symlink(elsewhere.join("new"), run.join("log.jsonl")).unwrap();
        symlink(&elsewhere, run.join("checkpoints")).unwrap();
        symlink("eval", run.join("inside")).unwrap();
        symlink("..", run.join("above")).unwrap();
        symlink(&run, folder.path().join("by_link")).unwrap();
        for given in [run.clone(), folder.path().join("by_link")] {
            let confined = confine(&given).unwrap();
            for name in ["eval/renders/000.exr", "checkpoints/step_1", "checkpoints/deep/step_1", "above/new", "eval/renders/../profile"] {
                let error = write(&given.join(name)).unwrap_err();
                assert!(error.message.starts_with("leads out of the folder"), "{name}: {error}");
            }
            for name in ["report.html", "log.jsonl", "inside/metrics.json", "eval/step_1/metrics.json"] {
                write(&given.join(name)).unwrap();
                assert_eq!(std::fs::read_to_string(given.join(name)).unwrap(), "new", "{name}");
            }
            drop(confined);
        }
        assert!(!run.join("report.html").is_symlink());
        assert_eq!(std::fs::read_to_string(&secret).unwrap(), "old");
        assert_eq!(std::fs::read_dir(&elsewhere).unwrap().count(), 1);
        assert!(check_within(&run, &run.join("checkpoints/seed_1")).is_err());
        check_within(&run, &run.join("runs/new/seed_1")).unwrap();
        // A file that the user names is written where its link leads.
        symlink(&secret, run.join("scene.ply")).unwrap();
        write(&run.join("scene.ply")).unwrap();
        assert_eq!(std::fs::read_to_string(&secret).unwrap(), "new");
    }
}
