//! The rule for paths that files are written to; number format and attributes of OpenEXR files.
//!
//! - A file has the extension of its format.
//! - A file that exists is replaced only if that is asked for.
//! - A file that is read is never written over.

use std::path::Path;

use luxel_core::{Image, Remedy, text};
use luxel_io::ExrSample;

use crate::error::bail;
use crate::{Error, Result};

/// Attribute of an OpenEXR file with the recipe of the frame.
pub const MADE_BY: &str = "luxel:made_by";
/// Attribute of an OpenEXR file with the recipe of the preview beside it.
pub const PREVIEW_MADE_BY: &str = "luxel:preview_made_by";
/// Attribute of an OpenEXR file with the recipe of the deep image beside it.
pub const DEEP_MADE_BY: &str = "luxel:deep_made_by";

/// Attribute of an OpenEXR file with the exposure of the preview beside it, stops.
pub const PREVIEW_EXPOSURE: &str = "luxel:preview_exposure_ev";

/// Refuses an output path that is a folder, or an existing file unless `overwrite` is set.
///
/// # Errors
/// The path is taken.
pub fn check_free(path: &Path, overwrite: bool) -> Result<()> {
    if path.is_dir() {
        bail!("{}: is a folder, expected a name for a file", path.display());
    }
    if path.exists() && !overwrite {
        let remedy = Remedy::advice("give another name").or(Remedy::set("overwrite", "true"));
        return Err(Error::new(format!("{}: exists already", path.display())).with_remedy(remedy));
    }
    Ok(())
}

/// Refuses a file name whose extension is not one of `expected`, of which there is at least one.
///
/// ```
/// use std::path::Path;
///
/// use luxel::output::check_extension;
///
/// assert!(check_extension(Path::new("a.PLY"), &["ply"]).is_ok());
/// let error = check_extension(Path::new("a.glb"), &["ply"]).unwrap_err();
/// assert_eq!(error.to_string(), "a.glb: found the extension .glb, expected .ply");
/// ```
///
/// # Errors
/// Another extension, or none.
pub fn check_extension(path: &Path, expected: &[&str]) -> Result<()> {
    let found = extension(path);
    if expected.contains(&found.as_str()) {
        return Ok(());
    }
    let found = if found.is_empty() { "no extension".to_owned() } else { format!("the extension .{found}") };
    bail!("{}: found {found}, expected {}", path.display(), text::alternatives(expected.iter().map(|name| format!(".{name}"))))
}

/// Refuses an output path that leads to one of `inputs`.
///
/// # Errors
/// It does.
pub fn check_no_input<'a>(path: &Path, inputs: impl IntoIterator<Item = &'a Path>) -> Result<()> {
    let Ok(real) = std::fs::canonicalize(path) else { return Ok(()) };
    if inputs.into_iter().any(|input| std::fs::canonicalize(input).is_ok_and(|input| input == real)) {
        bail!("{}: is read by this command, so it is not written over; give another name", path.display());
    }
    Ok(())
}

/// Returns the extension of a path in lower case; empty where there is none.
pub fn extension(path: &Path) -> String {
    path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// The number format of an OpenEXR file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ExrType {
    /// Half floats, or 32 bits where a value exceeds their range.
    #[default]
    Auto,
    /// Half floats; larger values become the largest.
    Half,
    /// 32 bits.
    Float,
}

impl ExrType {
    /// Returns the precision of an image's file.
    pub fn sample(self, image: &Image) -> ExrSample {
        match self {
            Self::Auto => ExrSample::smallest_for(image),
            Self::Half => ExrSample::Half,
            Self::Float => ExrSample::Float,
        }
    }
}
