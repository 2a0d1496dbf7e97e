//! The folder of photographs: its files, their headers, and which of them are left out.
//!
//! In: a folder. Out: [`Selection`], files sorted by name. Degenerate: a file that cannot be read
//! is left out with its error, and so are the second of two equal files and the picture beside a
//! RAW file of the same name; the rest is taken. A folder without a photograph is an error.

use std::path::{Path, PathBuf};

use luxel::error::{Context, bail};
use luxel::{Error, Remedy, Result};
use luxel_capture::Exposure;
use luxel_capture::prepare::{LeftOut, Photograph, PrepareError, Selection, select};
use luxel_core::photo::PhotoKind;
use luxel_io::{Transfer, is_photo_name, photo_info};
use rayon::prelude::*;

use crate::text::{self, plural};

fn file_name(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Extensions of pictures that are not supported.
const UNREAD: [&str; 9] = ["heic", "heif", "hif", "avif", "webp", "jxl", "jp2", "gif", "bmp"];

/// Returns whether a file is a photograph by its name, supported or not.
fn is_picture(path: &Path) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    is_photo_name(path) || UNREAD.contains(&ending.as_str())
}

/// Lists the photographs of a folder, and the first folder in it that has photographs of its own.
fn list(folder: &Path) -> Result<(Vec<PathBuf>, Option<PathBuf>)> {
    if folder.is_file() {
        bail!("{}: is a file, expected the folder of photographs that it lies in", folder.display());
    }
    let cannot = || format!("{}: cannot list it, expected a folder of photographs", folder.display());
    let mut paths: Vec<PathBuf> = Vec::new();
    let mut folders: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(cannot)? {
        let path = entry.with_context(cannot)?.path();
        match path.is_dir() {
            _ if file_name(&path).starts_with('.') => {}
            true => folders.push(path),
            false if is_picture(&path) => paths.push(path),
            false => {}
        }
    }
    paths.sort();
    folders.sort();
    let has_some = |folder: &PathBuf| std::fs::read_dir(folder).is_ok_and(|entries| entries.flatten().any(|e| is_picture(&e.path())));
    Ok((paths, folders.into_iter().find(has_some)))
}

/// Reads the headers of all photographs of `folder`, which are light if `transfer` is their curve.
pub(super) fn scan(folder: &Path, transfer: Option<Transfer>) -> Result<Selection> {
    let (paths, below) = list(folder)?;
    if paths.is_empty() {
        let remedy = below.map(|below| format!("; there are some in {}: give that folder", below.display())).unwrap_or_default();
        bail!("{}: no photographs in it, expected DNG, JPEG, PNG, TIFF, DPX, OpenEXR or Radiance HDR files{remedy}", folder.display());
    }
    let read: Vec<Result<Photograph, LeftOut>> = paths.par_iter().map(|path| read_headers(path, transfer)).collect();
    let mut scan = Selection::default();
    scan.left_out.extend(below.map(|below| LeftOut {
        file: format!("{}/", file_name(&below)),
        reason: "a folder in the folder; its files are not part of the set".to_owned(),
    }));
    for result in read {
        match result {
            Ok(photo) => scan.photos.push(photo),
            Err(left_out) => scan.left_out.push(left_out),
        }
    }
    check_transfer(folder, &paths, transfer)?;
    let one_kind = select(&mut scan);
    if scan.photos.is_empty() {
        let first = scan.left_out.first().map(|l| format!("{}: {}", l.file, l.reason)).unwrap_or_default();
        bail!("{}: none of {} can be read; {first}", folder.display(), plural(paths.len(), "photograph"));
    }
    one_kind.map_err(|e| in_folder(folder, e))?;
    Ok(scan)
}

/// Refuses a curve for files that all hold light.
fn check_transfer(folder: &Path, paths: &[PathBuf], transfer: Option<Transfer>) -> Result<()> {
    match transfer.filter(|transfer| transfer.plate_primaries().is_none()) {
        Some(transfer) if paths.par_iter().all(|path| luxel_io::holds_radiance(path)) => {
            let message =
                format!("{}: the curve {transfer} has no effect: all files hold floats, which are light already", folder.display());
            Err(Error::new(message).with_remedy(Remedy::leave_out("transfer")))
        }
        _ => Ok(()),
    }
}

/// Returns an error that begins with the folder, with the remedy of the error below.
fn in_folder(folder: &Path, error: PrepareError) -> Error {
    let whole = Error::new(format!("{}: {error}", folder.display()));
    match error.remedy {
        Some(remedy) => whole.with_remedy(remedy),
        None => whole,
    }
}

/// Reads a photograph's headers, or says why it is left out.
fn read_headers(path: &Path, transfer: Option<Transfer>) -> Result<Photograph, LeftOut> {
    let name = Path::new(path.file_name().unwrap_or(path.as_os_str()));
    let left_out = |reason: String| LeftOut { file: text::one_line(&file_name(path)).into_owned(), reason };
    if !path.is_file() {
        return Err(left_out("not a regular file".to_owned()));
    }
    // Lists of names that COLMAP reads have one a line.
    if file_name(path).contains(char::is_control) {
        return Err(left_out("its name holds a line feed or another control character; rename it".to_owned()));
    }
    if !is_photo_name(path) {
        return Err(left_out("not a supported kind of picture; export it as JPEG, PNG or TIFF, or RAW as DNG".to_owned()));
    }
    let bytes = luxel_io::read_file(path).map_err(|e| left_out(e.message))?;
    let mut info = photo_info(name, &bytes).map_err(|e| left_out(e.message))?;
    if transfer.is_some() {
        if info.kind == PhotoKind::Raw {
            return Err(left_out("a RAW file among files with a curve; prepare it apart, without --transfer".to_owned()));
        }
        // The curve says what the samples are.
        (info.kind, info.profile, info.primaries) = (PhotoKind::Radiance, None, None);
    }
    let exif = &info.exif;
    let exposure = exif.seconds.map(|seconds| Exposure { seconds, iso: exif.iso, f_number: exif.f_number }).filter(Exposure::is_valid);
    let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(Photograph { path: path.to_owned(), stem, digest: blake3::hash(&bytes).to_hex().to_string(), info, exposure })
}
