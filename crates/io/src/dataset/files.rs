//! How images are named and found.

use std::path::{Path, PathBuf};

/// Image extensions in the order they are tried where a name comes without one: radiance before display values.
const IMAGE_EXTENSIONS: [&str; 7] = ["exr", "hdr", "tif", "tiff", "png", "jpg", "jpeg"];

/// Whether the name ends in an extension of an image format.
fn image_extension(name: &str) -> Option<&str> {
    let (stem, extension) = name.rsplit_once('.')?;
    let known = IMAGE_EXTENSIONS.iter().any(|e| e.eq_ignore_ascii_case(extension));
    (known && !stem.is_empty() && !stem.ends_with('/')).then_some(extension)
}

/// Whether a file of this name is an image.
pub(super) fn is_image(name: &str) -> bool {
    image_extension(name).is_some()
}

/// The name without an image extension; other dots belong to the name (`r_0.5`).
pub(super) fn without_extension(name: &str) -> &str {
    image_extension(name).map_or(name, |extension| &name[..name.len() - extension.len() - 1])
}

/// Name of a view: folders and stem of `file_path`, `/`-separated, without `.`, `..` and the image extension.
pub(super) fn view_name(file_path: &str) -> String {
    let slashed = file_path.replace('\\', "/");
    let parts: Vec<&str> = slashed.split('/').filter(|part| !matches!(*part, "" | "." | "..")).collect();
    without_extension(&parts.join("/")).to_owned()
}

/// Whether an image of the same stem but another format may stand in for the named one.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Substitute {
    /// COLMAP reads no HDR: it ran on 8-bit copies of the images.
    Allowed,
    /// The description names the image itself.
    No,
}

/// The image that `file_path` (with or without extension, relative to `folder`) names, if there is one.
pub(super) fn find_image(folder: &Path, file_path: &str, substitute: Substitute) -> Option<PathBuf> {
    let slashed = file_path.replace('\\', "/");
    let exact = folder.join(&slashed);
    if exact.is_file() {
        return Some(exact);
    }
    let stem = match (image_extension(&slashed), substitute) {
        (Some(_), Substitute::No) => return None,
        (Some(_), Substitute::Allowed) => without_extension(&slashed),
        (None, _) => &slashed,
    };
    IMAGE_EXTENSIONS
        .iter()
        .flat_map(|e| [(*e).to_owned(), e.to_ascii_uppercase()])
        .map(|extension| folder.join(format!("{stem}.{extension}")))
        .find(|path| path.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

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
