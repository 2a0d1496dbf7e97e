//! `--exposures`: a list of exposures for files that do not say theirs.
//!
//! In: text, a line for each photograph: name (with or without extension), seconds (`0.01` or `1/100`), ISO and f-number if known, separated by
//! spaces, tabs or commas. Lines that begin with # are notes. Out: exposures by name; a line that is none is an error with its number.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Result, bail};
use luxel_capture::Exposure;

use super::scan::PhotoFile;
use crate::files::read_text;

/// A list of a million photographs.
const MAX_BYTES: u64 = 64 << 20;

/// Puts the exposures of the list at `path` in the place of what EXIF says.
pub(super) fn apply(path: &Path, photos: &mut [PhotoFile]) -> Result<()> {
    let listed = parse(path, &read_text(path, MAX_BYTES)?)?;
    let mut used = 0;
    for photo in photos.iter_mut() {
        if let Some(exposure) = listed.get(&photo.file_name()).or_else(|| listed.get(&photo.stem)) {
            photo.exposure = Some(*exposure);
            used += 1;
        }
    }
    if used == 0 {
        let name = photos.first().map(PhotoFile::file_name).unwrap_or_default();
        bail!("{}: none of its names is that of a photograph, expected names such as {name}", path.display());
    }
    Ok(())
}

fn parse(path: &Path, text: &str) -> Result<BTreeMap<String, Exposure>> {
    let mut out = BTreeMap::new();
    for (number, line) in (1..).zip(text.lines()) {
        let words: Vec<&str> = line.split([' ', '\t', ',', ';']).filter(|w| !w.is_empty()).collect();
        let [name, rest @ ..] = words.as_slice() else { continue };
        if name.starts_with('#') {
            continue;
        }
        let numbers: Option<Vec<f64>> = rest.iter().map(|w| fraction(w)).collect();
        let exposure = match numbers.as_deref() {
            Some(&[seconds]) => Some(Exposure { seconds, iso: None, f_number: None }),
            Some(&[seconds, iso]) => Some(Exposure { seconds, iso: Some(iso), f_number: None }),
            Some(&[seconds, iso, f_number]) => Some(Exposure { seconds, iso: Some(iso), f_number: Some(f_number) }),
            _ => None,
        };
        match exposure.filter(Exposure::is_valid) {
            Some(exposure) => drop(out.insert((*name).to_owned(), exposure)),
            None => bail!(
                "{}: line {number}: \"{line}\", expected a name, seconds such as 0.01 or 1/100, and perhaps ISO and f-number, all above 0",
                path.display()
            ),
        }
    }
    Ok(out)
}

fn fraction(word: &str) -> Option<f64> {
    match word.split_once('/') {
        Some((a, b)) => Some(a.parse::<f64>().ok()? / b.parse::<f64>().ok()?),
        None => word.parse().ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_hold_seconds_iso_and_aperture() {
        let list = parse(Path::new("e.txt"), "# name s\na.jpg 1/100\nb 0.5, 200\n\nc\t2 100 5.6\n").unwrap();
        assert_eq!(list["a.jpg"], Exposure { seconds: 0.01, iso: None, f_number: None });
        assert_eq!(list["c"], Exposure { seconds: 2.0, iso: Some(100.0), f_number: Some(5.6) });
        assert_eq!(list.len(), 3);
    }

    #[test]
    fn lines_that_are_none_are_named() {
        for bad in ["a", "a x", "a 0", "a 1/0", "a -1", "a 1 2 3 4", "a 1 nan"] {
            let error = parse(Path::new("e.txt"), &format!("ok 1\n{bad}")).unwrap_err().to_string();
            assert!(error.starts_with("e.txt: line 2: "), "{bad}: {error}");
        }
    }
}
