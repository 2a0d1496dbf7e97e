//! Exposures from a list in place of those in EXIF; values that a line leaves out stay EXIF's.

use std::collections::BTreeMap;

use luxel_core::text::plural;

use super::{Photograph, PrepareError, PrepareNote};
use crate::Exposure;

/// Names that a message lists.
const MAX_LISTED: usize = 3;

/// Gives photographs the exposures that a list has for their names, with or without extension.
/// Returns a note on lines without a photograph.
///
/// # Errors
/// A list that names no photograph.
pub fn apply_exposure_list(listed: &BTreeMap<String, Exposure>, photos: &mut [Photograph]) -> Result<Option<PrepareNote>, PrepareError> {
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
        let name = photos.first().map(Photograph::file_name).unwrap_or_default();
        return Err(PrepareError::new(format!("none of its names is that of a photograph, expected names such as {name}")));
    }
    let names: Vec<&str> = unused.keys().take(MAX_LISTED).map(String::as_str).collect();
    let more = if unused.len() > MAX_LISTED { ", ..." } else { "" };
    let note = || PrepareNote::new(format!("no photograph for {} of it ({}{more})", plural(unused.len(), "line"), names.join(", ")));
    Ok((!unused.is_empty()).then(note))
}
