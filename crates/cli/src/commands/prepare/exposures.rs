//! `--exposures`: a list of exposures for files that do not say theirs, put in the place of what EXIF says; what a line leaves out stays EXIF's.

use std::path::Path;

use anyhow::{Result, anyhow, bail};
use luxel::files::read_text;
use luxel::text::plural;
use luxel_capture::{Exposure, parse_exposure_list};

use super::scan::PhotoFile;

/// A list of a million photographs.
const MAX_BYTES: u64 = 64 << 20;
/// Names that a message lists.
const MAX_LISTED: usize = 3;

/// Puts the exposures of the list at `path` in the place of what EXIF says. Returns what is odd about the list.
pub(super) fn apply(path: &Path, photos: &mut [PhotoFile]) -> Result<Option<String>> {
    let listed = parse_exposure_list(&read_text(path, MAX_BYTES)?).map_err(|e| anyhow!("{}: {e}", path.display()))?;
    let mut unused = listed.clone();
    for photo in photos.iter_mut() {
        let name = [photo.file_name(), photo.stem.clone()].into_iter().find(|name| listed.contains_key(name));
        if let Some((name, exposure)) = name.and_then(|name| listed.get_key_value(&name)) {
            let exif = &photo.info.exif;
            let whole = Exposure { iso: exposure.iso.or(exif.iso), f_number: exposure.f_number.or(exif.f_number), ..*exposure };
            photo.exposure = Some(if whole.is_valid() { whole } else { *exposure });
            unused.remove(name);
        }
    }
    if unused.len() == listed.len() {
        let name = photos.first().map(PhotoFile::file_name).unwrap_or_default();
        bail!("{}: none of its names is that of a photograph, expected names such as {name}", path.display());
    }
    let names: Vec<&str> = unused.keys().take(MAX_LISTED).map(String::as_str).collect();
    let more = if unused.len() > MAX_LISTED { ", ..." } else { "" };
    let odd = || format!("{}: no photograph for {} of it ({}{more})", path.display(), plural(unused.len(), "line"), names.join(", "));
    Ok((!unused.is_empty()).then(odd))
}
