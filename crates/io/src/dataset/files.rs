//! How images are named and found.
//!
//! A name is first taken as it is written. Where no such file exists, a file is taken whose name is
//! the same in another Unicode form (macOS writes names decomposed) or in another case (Windows and
//! macOS do not tell `a.EXR` from `a.exr`), if it is the only one; other cases are reported.

use std::cell::RefCell;
use std::collections::{BTreeSet, HashMap};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use luxel_core::text::plural;
use unicode_normalization::UnicodeNormalization;

use crate::image::holds_radiance;

/// Image extensions in the order they are tried where a name comes without one: radiance before
/// display values.
pub(super) const IMAGE_EXTENSIONS: [&str; 8] = ["exr", "hdr", "tif", "tiff", "png", "jpg", "jpeg", "dpx"];

/// Extensions of formats that hold radiance, always or among other things, in the order they are
/// tried.
const RADIANCE_EXTENSIONS: [&str; 6] = ["exr", "hdr", "tif", "tiff", "npy", "dpx"];

/// Deepest nesting of folders of images.
const MAX_DEPTH: usize = 8;

/// Returns whether the name ends in an extension of an image format.
fn image_extension(name: &str) -> Option<&str> {
    let (stem, extension) = name.rsplit_once('.')?;
    let known = IMAGE_EXTENSIONS.iter().any(|e| e.eq_ignore_ascii_case(extension));
    (known && !stem.is_empty() && !stem.ends_with('/')).then_some(extension)
}

/// Returns whether a file of this name is an image.
pub(super) fn is_image(name: &str) -> bool {
    image_extension(name).is_some()
}

/// Returns the name without an image extension; other dots belong to the name (`r_0.5`).
pub(super) fn without_extension(name: &str) -> &str {
    image_extension(name).map_or(name, |extension| &name[..name.len() - extension.len() - 1])
}

/// Returns the name of a view: folders and stem of `file_path`, `/`-separated, without `.`, `..`
/// and the image extension.
pub(super) fn view_name(file_path: &str) -> String {
    let slashed = file_path.replace('\\', "/");
    let parts: Vec<&str> = slashed.split('/').filter(|part| !matches!(*part, "" | "." | "..")).collect();
    without_extension(&parts.join("/")).to_owned()
}

/// Returns a name in the form that equal names share, however they are composed (NFC): macOS writes
/// the names of files decomposed.
///
/// ```
/// assert_eq!(luxel_io::composed("Bu\u{308}ro"), "B\u{fc}ro");
/// ```
pub fn composed(name: &str) -> String {
    if name.is_ascii() { name.to_owned() } else { name.nfc().collect() }
}

/// Returns a name in the form that names equal but for composition and case share.
fn folded(name: &str) -> String {
    composed(&composed(name).to_lowercase())
}

/// The rule for images of the same stem but another format than the named one.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Substitute {
    /// A file of another format may stand in for a missing one: masks.
    Allowed,
    /// Radiance takes precedence over the named one, other formats only where it is missing: COLMAP
    /// reads no HDR, it ran on 8-bit copies of the images.
    Radiance,
    /// The description names the image itself.
    No,
}

/// Finds files by the names that a data set's description gives.
#[derive(Debug, Default)]
pub(super) struct Finder {
    /// Names of a folder's entries by their folded form.
    listings: RefCell<HashMap<PathBuf, HashMap<String, Vec<OsString>>>>,
    /// Files found under a name in another case, and that name.
    other_case: RefCell<Vec<(String, PathBuf)>>,
}

impl Finder {
    /// Returns the file that `name` means, relative to `folder`, if there is one.
    pub(super) fn find(&self, folder: &Path, name: &str) -> Option<PathBuf> {
        let slashed = name.replace('\\', "/");
        let exact = folder.join(&slashed);
        if exact.is_file() { Some(exact) } else { self.find_folded(folder, &slashed) }
    }

    /// Returns the image that `file_path` (with or without extension, relative to `folder`) names,
    /// if there is one.
    pub(super) fn find_image(&self, folder: &Path, file_path: &str, substitute: Substitute) -> Option<PathBuf> {
        let slashed = file_path.replace('\\', "/");
        let as_written = |name: &str| Some(folder.join(name)).filter(|path| path.is_file());
        by_rule(&slashed, substitute, as_written).or_else(|| by_rule(&slashed, substitute, |name| self.find_folded(folder, name)))
    }

    /// Returns the radiance beside an image of another format, of the same stem.
    pub(super) fn radiance_beside(&self, folder: &Path, file_path: &str) -> Option<PathBuf> {
        radiance(without_extension(&file_path.replace('\\', "/")), |name| Some(folder.join(name)).filter(|path| path.is_file()))
    }

    /// Returns what a user should know about names that were found in another form.
    pub(super) fn warnings(&self) -> Vec<String> {
        let found = self.other_case.borrow();
        let line = |(name, path): &(String, PathBuf)| {
            let count = plural(found.len(), "file");
            format!("found under names of another case: {count}, such as {} for {name}", path.display())
        };
        found.first().map(line).into_iter().collect()
    }

    /// Finds a file whose path is equal but for composition and case, part by part.
    fn find_folded(&self, folder: &Path, slashed: &str) -> Option<PathBuf> {
        if Path::new(slashed).is_absolute() {
            return None;
        }
        let (mut at, mut is_other_case) = (folder.to_path_buf(), false);
        for part in slashed.split('/').filter(|part| !matches!(*part, "" | ".")) {
            let exact = at.join(part);
            if part == ".." || exact.exists() {
                at = exact;
                continue;
            }
            let name = self.only_entry(&at, part)?;
            is_other_case |= composed(&name.to_string_lossy()) != composed(part);
            at.push(name);
        }
        let found = at.is_file().then_some(at)?;
        if is_other_case {
            self.other_case.borrow_mut().push((slashed.to_owned(), found.clone()));
        }
        Some(found)
    }

    /// Returns the only entry of a folder whose name folds to that of `part`.
    fn only_entry(&self, folder: &Path, part: &str) -> Option<OsString> {
        let mut listings = self.listings.borrow_mut();
        let entries = listings.entry(folder.to_path_buf()).or_insert_with(|| {
            let mut names: HashMap<String, Vec<OsString>> = HashMap::new();
            for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
                let name = entry.file_name();
                names.entry(folded(&name.to_string_lossy())).or_default().push(name);
            }
            names
        });
        match entries.get(&folded(part)).map(Vec::as_slice) {
            Some([one]) => Some(one.clone()),
            _ => None,
        }
    }
}

/// Returns the first of the files that a name may mean.
fn by_rule(slashed: &str, substitute: Substitute, existing: impl Fn(&str) -> Option<PathBuf>) -> Option<PathBuf> {
    let stem = without_extension(slashed);
    let of_stem = || spelled(&IMAGE_EXTENSIONS).find_map(|extension| existing(&format!("{stem}.{extension}")));
    let has_extension = stem.len() < slashed.len();
    match substitute {
        Substitute::No if has_extension => existing(slashed),
        Substitute::No | Substitute::Allowed => existing(slashed).or_else(of_stem),
        Substitute::Radiance => radiance(stem, &existing).or_else(|| existing(slashed)).or_else(of_stem),
    }
}

/// Returns the file of this stem that holds radiance.
fn radiance(stem: &str, existing: impl Fn(&str) -> Option<PathBuf>) -> Option<PathBuf> {
    spelled(&RADIANCE_EXTENSIONS).filter_map(|extension| existing(&format!("{stem}.{extension}"))).find(|path| holds_radiance(path))
}

/// Returns extensions as they are and in capitals.
fn spelled(extensions: &[&'static str]) -> impl Iterator<Item = String> {
    extensions.iter().flat_map(|e| [(*e).to_owned(), e.to_ascii_uppercase()]).collect::<Vec<_>>().into_iter()
}

/// Adds the names of views in a folder and in those below it; `prefix` is the folder's name in
/// them.
pub(super) fn list_images(folder: &Path, prefix: &str, out: &mut BTreeSet<String>) {
    list_below(folder, prefix, 0, out);
}

fn list_below(folder: &Path, prefix: &str, depth: usize, out: &mut BTreeSet<String>) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let (name, path) = (entry.file_name().to_string_lossy().into_owned(), entry.path());
        let below = format!("{prefix}/{name}");
        if path.is_dir() && depth < MAX_DEPTH {
            list_below(&path, &below, depth + 1, out);
        } else if is_image(&name) && !name.starts_with('.') {
            out.insert(view_name(&below));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// First bytes of OpenEXR.
    const EXR: &[u8] = &[0x76, 0x2f, 0x31, 0x01];

    #[test]
    fn radiance_goes_before_the_copy_that_colmap_ran_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let found = |name: &str, substitute| Finder::default().find_image(folder.path(), name, substitute);
        ["000.jpg", "000.EXR", "001.jpg", "002.png", "003.jpg", "003.npy"].iter().for_each(|name| std::fs::write(path(name), EXR).unwrap());
        assert_eq!(found("000.jpg", Substitute::Radiance), Some(path("000.EXR")));
        assert_eq!(found("001.jpg", Substitute::Radiance), Some(path("001.jpg")));
        assert_eq!(found("002.jpg", Substitute::Radiance), Some(path("002.png")));
        assert_eq!(found("003.jpg", Substitute::Radiance), Some(path("003.npy")));
        assert_eq!(found("000.jpg", Substitute::Allowed), Some(path("000.jpg")));
        assert_eq!(found("002.jpg", Substitute::No), None);
        assert_eq!(found("002", Substitute::No), Some(path("002.png")));
    }

    #[test]
    fn names_are_found_in_other_unicode_forms_and_cases() {
        let folder = tempfile::tempdir().unwrap();
        let decomposed = "Bu\u{308}ro_000.exr";
        std::fs::create_dir(folder.path().join("Images")).unwrap();
        ["a.Exr", decomposed, "Twice.exr", "TWICE.exr"]
            .iter()
            .for_each(|name| std::fs::write(folder.path().join("Images").join(name), EXR).unwrap());
        let finder = Finder::default();
        let found = |name: &str| finder.find_image(folder.path(), name, Substitute::No);
        assert_eq!(found("Images/B\u{fc}ro_000.exr"), Some(folder.path().join("Images").join(decomposed)));
        assert!(finder.warnings().is_empty());
        assert_eq!(found("images/A.exr"), Some(folder.path().join("Images/a.Exr")));
        assert!(finder.warnings()[0].starts_with("found under names of another case: 1 file, such as"), "{:?}", finder.warnings());
        assert_eq!(found("Images/twice.exr"), None);
        assert_eq!(found("Images/b.exr"), None);
    }

    #[test]
    fn view_names_keep_folders_and_lose_image_extensions() {
        assert_eq!(view_name("./train/r_0.exr"), "train/r_0");
        assert_eq!(view_name("../images\\000.PNG"), "images/000");
        assert_eq!(view_name("./images/r_0.5"), "images/r_0.5");
        assert_eq!(view_name("/abs/a.tiff"), "abs/a");
        assert_eq!(view_name(".png"), ".png");
        assert_eq!(view_name("images/.png"), "images/.png");
    }
}
