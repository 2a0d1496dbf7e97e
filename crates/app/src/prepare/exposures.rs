//! Reads the list of exposures for files that do not state theirs.

use std::path::Path;

use luxel::{Error, Result};
use luxel_capture::parse_exposure_list;
use luxel_capture::prepare::{Photograph, apply_exposure_list};

use crate::files::read_text;

/// Room for a list of a million photographs.
const MAX_BYTES: u64 = 64 << 20;

/// Gives photographs the exposures of the list at `path`. Returns what is odd about the list.
pub(super) fn apply(path: &Path, photos: &mut [Photograph]) -> Result<Option<String>> {
    let in_list = |message: String| Error::new(format!("{}: {message}", path.display()));
    let listed = parse_exposure_list(&read_text(path, MAX_BYTES)?).map_err(|e| in_list(e.to_string()))?;
    let note = apply_exposure_list(&listed, photos).map_err(|e| in_list(e.message))?;
    Ok(note.map(|note| format!("{}: {}", path.display(), note.text)))
}
