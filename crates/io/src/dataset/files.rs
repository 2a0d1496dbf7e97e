//! How images are named and found.

use std::path::{Path, PathBuf};

/// Image extensions in the order they are tried where a name comes without one: radiance before
/// display values.
pub(super) const IMAGE_EXTENSIONS: [&str; 7] = ["exr", "hdr", "tif", "tiff", "png", "jpg", "jpeg"];

/// How many of them are of formats that hold radiance alone.
const RADIANCE_EXTENSIONS: usize = 2;

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

/// Returns the image that `file_path` (with or without extension, relative to `folder`) names, if
/// there is one.
pub(super) fn find_image(folder: &Path, file_path: &str, substitute: Substitute) -> Option<PathBuf> {
    let slashed = file_path.replace('\\', "/");
    let exact = || Some(folder.join(&slashed)).filter(|path| path.is_file());
    let stem = without_extension(&slashed);
    let of_stem = |extensions: &[&str]| {
        let spelled = extensions.iter().flat_map(|e| [(*e).to_owned(), e.to_ascii_uppercase()]);
        spelled.map(|extension| folder.join(format!("{stem}.{extension}"))).find(|path| path.is_file())
    };
    let has_extension = stem.len() < slashed.len();
    match substitute {
        Substitute::No if has_extension => exact(),
        Substitute::No | Substitute::Allowed => exact().or_else(|| of_stem(&IMAGE_EXTENSIONS)),
        Substitute::Radiance => of_stem(&IMAGE_EXTENSIONS[..RADIANCE_EXTENSIONS]).or_else(exact).or_else(|| of_stem(&IMAGE_EXTENSIONS)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn radiance_goes_before_the_copy_that_colmap_ran_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let found = |name: &str, substitute| find_image(folder.path(), name, substitute);
        ["000.jpg", "000.EXR", "001.jpg", "002.png"].iter().for_each(|name| std::fs::write(path(name), "").unwrap());
        assert_eq!(found("000.jpg", Substitute::Radiance), Some(path("000.EXR")));
        assert_eq!(found("001.jpg", Substitute::Radiance), Some(path("001.jpg")));
        assert_eq!(found("002.jpg", Substitute::Radiance), Some(path("002.png")));
        assert_eq!(found("000.jpg", Substitute::Allowed), Some(path("000.jpg")));
        assert_eq!(found("002.jpg", Substitute::No), None);
        assert_eq!(found("002", Substitute::No), Some(path("002.png")));
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
