//! Other programs that commands start.
//!
//! In: a program's name or path, as it is typed. Out: the file that would be started. Nothing is
//! started here.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};

/// Returns the file of a program: of a name without a folder by the folders of PATH.
pub(crate) fn find(program: &Path) -> Option<PathBuf> {
    if program.components().count() > 1 {
        return Some(program.to_owned()).filter(|path| is_program(path));
    }
    let folders = std::env::var_os("PATH")?;
    let name = program.file_name()?;
    let with_suffix = format!("{}{}", name.to_string_lossy(), std::env::consts::EXE_SUFFIX);
    let names = [PathBuf::from(name), PathBuf::from(with_suffix)];
    std::env::split_paths(&folders).flat_map(|folder| names.clone().map(|name| folder.join(name))).find(|path| is_program(path))
}

/// Refuses a program that is not there; `option` names it.
pub(crate) fn require(program: &Path, option: &str, install: &str) -> Result<()> {
    if find(program).is_none() {
        bail!("{}: no such program; {install}, or name it with {option}", program.display());
    }
    Ok(())
}

#[cfg(unix)]
fn is_program(path: &Path) -> bool {
    use std::os::unix::fs::PermissionsExt;
    std::fs::metadata(path).is_ok_and(|metadata| metadata.is_file() && metadata.permissions().mode() & 0o111 != 0)
}

#[cfg(not(unix))]
fn is_program(path: &Path) -> bool {
    path.is_file()
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn programs_are_found_by_name_and_by_path() {
        let shell = find(Path::new("sh")).unwrap();
        assert!(shell.is_absolute());
        assert_eq!(find(&shell), Some(shell));
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tool");
        std::fs::write(&file, "").unwrap();
        // A file that cannot be run, a folder and a missing one are no programs.
        for path in [file.as_path(), folder.path(), Path::new("no-such-program-of-this-name")] {
            assert_eq!(find(path), None, "{}", path.display());
        }
    }
}
