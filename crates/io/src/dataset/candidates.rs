//! Files of a folder that may hold a data set's cameras: found by extension and beginning.

use std::io::Read;
use std::path::{Path, PathBuf};

use crate::IoError;
use crate::read_file::open_regular;

/// Bytes at the beginning of a file by which its format is recognised.
const HEAD_BYTES: u64 = 16 << 10;

/// Returns the files of a folder with this extension whose beginning, as text, is as it should be;
/// sorted.
pub(super) fn files_with(folder: &Path, extension: &str, is_one: impl Fn(&str) -> bool) -> Vec<PathBuf> {
    let head = |path: &Path| {
        let mut head = Vec::new();
        open_regular(path).ok()?.0.take(HEAD_BYTES).read_to_end(&mut head).ok()?;
        Some(String::from_utf8_lossy(&head).into_owned())
    };
    let paths = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let of_extension = paths.filter(|path| path.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension)));
    let mut found: Vec<PathBuf> = of_extension.filter(|path| head(path).is_some_and(|head| is_one(&head))).collect();
    found.sort();
    found
}

/// Returns the error about several files of which one is expected.
pub(super) fn several(folder: &Path, what: &str, files: &[PathBuf]) -> IoError {
    let names: Vec<String> = files.iter().filter_map(|file| Some(file.file_name()?.to_string_lossy().into_owned())).collect();
    IoError::invalid(
        folder,
        format!("{} {what} ({}), expected one; name the file itself instead of the folder", files.len(), names.join(", ")),
    )
}
