//! A run that is trained once for all tests of a build of the program, whichever process they run
//! in, and copied to each that begins with it.

use std::fs::File;
use std::path::{Path, PathBuf};

use super::{Workplace, write_dataset};

/// Copies the run, and returns what its training printed; `None` if the place's data set is not the
/// one that the run was trained on.
pub(super) fn copy(place: &Workplace) -> Option<String> {
    let shared = shared();
    if !is_equal(&shared.join("data"), &place.path("data")) {
        return None;
    }
    copy_folder(&shared.join("run"), &place.path("run"));
    // The run knows its data set by an absolute path.
    let trained_on = std::fs::read_to_string(shared.join("dataset.txt")).unwrap();
    let here = std::fs::canonicalize(place.path("data")).unwrap();
    for name in ["config.toml", "metrics.json", "eval/step_40/metrics.json"] {
        let path = place.path("run").join(name);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(&trained_on), "{name}: no {trained_on} in\n{text}");
        std::fs::write(&path, text.replace(&trained_on, here.to_str().unwrap())).unwrap();
    }
    Some(std::fs::read_to_string(shared.join("stdout.txt")).unwrap())
}

/// Returns the folder with the run, its data set and output, and trains if this build has not.
fn shared() -> PathBuf {
    let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join("shared-run");
    std::fs::create_dir_all(&root).unwrap();
    let lock = File::create(root.join("lock")).unwrap();
    lock.lock().unwrap();
    let program = std::fs::metadata(env!("CARGO_BIN_EXE_luxel")).unwrap();
    let built = program.modified().unwrap().duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos();
    let folder = root.join(format!("build-{built}-{}", program.len()));
    if !folder.is_dir() {
        for entry in std::fs::read_dir(&root).unwrap().flatten().filter(|entry| entry.path().is_dir()) {
            std::fs::remove_dir_all(entry.path()).unwrap();
        }
        let place = Workplace::within(&root);
        write_dataset(&place.path("data"));
        let stdout = place.train_anew("run", &[]);
        std::fs::write(place.path("stdout.txt"), stdout).unwrap();
        let dataset = std::fs::canonicalize(place.path("data")).unwrap();
        std::fs::write(place.path("dataset.txt"), dataset.to_str().unwrap()).unwrap();
        std::fs::rename(place.path(""), &folder).unwrap();
    }
    folder
}

/// Returns whether two folders have the same files.
fn is_equal(a: &Path, b: &Path) -> bool {
    let [in_a, in_b] = [a, b].map(files);
    in_a == in_b && in_a.iter().all(|name| std::fs::read(a.join(name)).unwrap() == std::fs::read(b.join(name)).unwrap())
}

/// Returns the paths of the files below a folder, sorted.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![PathBuf::new()];
    while let Some(below) = folders.pop() {
        for entry in std::fs::read_dir(folder.join(&below)).into_iter().flatten().flatten() {
            let name = below.join(entry.file_name());
            if entry.path().is_dir() { folders.push(name) } else { found.push(name) }
        }
    }
    found.sort();
    found
}

fn copy_folder(from: &Path, to: &Path) {
    for name in files(from) {
        let target = to.join(&name);
        std::fs::create_dir_all(target.parent().unwrap()).unwrap();
        std::fs::copy(from.join(&name), target).unwrap();
    }
}
