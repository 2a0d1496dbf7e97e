//! Photographs by their headers, and which of them take part.
//!
//! In: [`Photograph`]s of one folder, sorted by name. Out: [`Selection`]: the second of two equal
//! files and the picture beside a RAW file of its name are left out, with the reason. Degenerate:
//! files of more than one kind have no common scale and are an error.

use std::collections::BTreeMap;
use std::path::PathBuf;

use luxel_core::photo::{PhotoInfo, PhotoKind};
use serde::{Deserialize, Serialize};

use super::PrepareError;
use crate::Exposure;

/// A photograph by its headers.
#[derive(Clone, Debug, PartialEq)]
pub struct Photograph {
    /// Path of its file.
    pub path: PathBuf,
    /// File name without extension.
    pub stem: String,
    /// Digest of the file's bytes: equal for equal files.
    pub digest: String,
    /// Facts from its headers.
    pub info: PhotoInfo,
    /// Exposure, from EXIF or from a list.
    pub exposure: Option<Exposure>,
}

impl Photograph {
    /// Returns the name of its file, with extension.
    pub fn file_name(&self) -> String {
        self.path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
    }
}

/// A file that takes no part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Name of the file.
    pub file: String,
    /// Why it is left out, in a form for people.
    pub reason: String,
}

/// The photographs of a folder that take part, and the files that do not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Selection {
    /// Photographs that take part.
    pub photos: Vec<Photograph>,
    /// Files that are left out.
    pub left_out: Vec<LeftOut>,
}

/// Leaves out duplicates and pictures beside a RAW file, and appends them to those left out
/// already.
///
/// # Errors
/// Photographs of more than one kind.
pub fn select(selection: &mut Selection) -> Result<(), PrepareError> {
    leave_out_duplicates(selection);
    leave_out_pictures_beside_raw(selection);
    check_one_kind(&selection.photos)
}

fn leave_out_duplicates(selection: &mut Selection) {
    let mut first: BTreeMap<String, String> = BTreeMap::new();
    let Selection { photos, left_out } = selection;
    photos.retain(|photo| match first.get(&photo.digest) {
        Some(other) => {
            left_out.push(LeftOut { file: photo.file_name(), reason: format!("the same file as {other}, byte by byte") });
            false
        }
        None => {
            first.insert(photo.digest.clone(), photo.file_name());
            true
        }
    });
}

/// Keeps the RAW file of two files of one name, else the first.
fn leave_out_pictures_beside_raw(selection: &mut Selection) {
    let mut best: BTreeMap<String, (bool, String)> = BTreeMap::new();
    for photo in &selection.photos {
        let is_raw = photo.info.kind == PhotoKind::Raw;
        let slot = best.entry(photo.stem.clone()).or_insert_with(|| (is_raw, photo.file_name()));
        if is_raw && !slot.0 {
            *slot = (true, photo.file_name());
        }
    }
    let Selection { photos, left_out } = selection;
    photos.retain(|photo| {
        let chosen = best.get(&photo.stem).map(|(_, name)| name.clone()).unwrap_or_default();
        let is_chosen = chosen == photo.file_name();
        if !is_chosen {
            left_out.push(LeftOut { file: photo.file_name(), reason: format!("{chosen} of the same name is used") });
        }
        is_chosen
    });
}

/// Refuses mixed kinds: radiance has a scale of its own, and a developer's curve is not a sensor's.
fn check_one_kind(photos: &[Photograph]) -> Result<(), PrepareError> {
    let count = |kind| photos.iter().filter(|p| p.info.kind == kind).count();
    let kinds = [(PhotoKind::Raw, "RAW"), (PhotoKind::Developed, "JPEG, PNG or TIFF"), (PhotoKind::Radiance, "OpenEXR or HDR")];
    let found: Vec<String> =
        kinds.iter().filter(|(kind, _)| count(*kind) > 0).map(|(kind, name)| format!("{} {name}", count(*kind))).collect();
    if found.len() > 1 {
        let message = format!("{} files, expected one kind: they have no common scale; leave the others out", found.join(" and "));
        return Err(PrepareError::new(message));
    }
    Ok(())
}

/// Returns the first name of the files of a view; unique, because each file belongs to one view.
pub(super) fn view_name(photos: &[Photograph], frames: &[usize]) -> String {
    frames.iter().filter_map(|i| photos.get(*i)).map(|p| p.stem.as_str()).min().unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use luxel_core::photo::Exif;

    use super::*;

    fn photo(name: &str, digest: &str, kind: PhotoKind) -> Photograph {
        let info = PhotoInfo {
            kind,
            size_px: [6, 4],
            exif: Exif::default(),
            raw: None,
            profile: None,
            primaries: None,
            curve: None,
            has_gain_map: false,
        };
        let stem = name.split('.').next().unwrap_or_default().to_owned();
        Photograph { path: name.into(), stem, digest: digest.into(), info, exposure: None }
    }

    #[test]
    fn equal_files_and_pictures_beside_raw_are_left_out() {
        let photos = vec![
            photo("a.dng", "1", PhotoKind::Raw),
            photo("a.jpg", "2", PhotoKind::Developed),
            photo("b.dng", "3", PhotoKind::Raw),
            photo("c.dng", "1", PhotoKind::Raw),
        ];
        let mut selection = Selection { photos, left_out: Vec::new() };
        select(&mut selection).unwrap();
        assert_eq!(selection.photos.iter().map(Photograph::file_name).collect::<Vec<_>>(), ["a.dng", "b.dng"]);
        let files: Vec<&str> = selection.left_out.iter().map(|l| l.file.as_str()).collect();
        assert_eq!(files, ["c.dng", "a.jpg"]);
        assert!(selection.left_out[0].reason.contains("a.dng") && selection.left_out[1].reason.contains("a.dng"));
    }

    #[test]
    fn kinds_of_light_are_not_mixed() {
        let photos = vec![photo("a.dng", "1", PhotoKind::Raw), photo("b.exr", "2", PhotoKind::Radiance)];
        let error = select(&mut Selection { photos, left_out: Vec::new() }).unwrap_err();
        assert!(error.message.starts_with("1 RAW and 1 OpenEXR or HDR files"), "{error}");
    }
}
