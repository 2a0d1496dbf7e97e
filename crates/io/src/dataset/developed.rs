//! Whether the images of a data set are single photographs that were developed for display.
//!
//! In: what the files of the images are, and the report of a preparation (`prepare.json`). Out:
//! whether a display curve, and whatever else a camera or a program did to each photograph, lies
//! between its numbers and light. Floats, linear integers and the plates of cinema cameras are
//! light; merged exposures are taken for it, too.

use std::path::Path;

use serde_json::Value;

use super::load::LoadedView;
use crate::read_file::read_file;

/// Length of a report that is read, bytes.
const MAX_REPORT_BYTES: u64 = 64 << 20;

/// Returns whether all images of the data set in `folder` are single developed photographs.
pub(super) fn is_developed(folder: &Path, loaded: &[LoadedView]) -> bool {
    !loaded.is_empty() && (loaded.iter().all(|view| view.is_display_coded) || is_prepared_of_pictures(folder))
}

/// Returns the report of the preparation of the data set in `folder`; `None` if it was not prepared
/// by this program.
pub(super) fn prepare_report(folder: &Path) -> Option<Value> {
    let report = folder.join("prepare.json");
    let is_usual = std::fs::metadata(&report).is_ok_and(|found| found.is_file() && found.len() <= MAX_REPORT_BYTES);
    serde_json::from_slice(&read_file(&report).ok().filter(|_| is_usual)?).ok()
}

/// Returns whether radiance was made of developed photographs, one for each view.
fn is_prepared_of_pictures(folder: &Path) -> bool {
    let Some(report) = prepare_report(folder) else { return false };
    let is_single = |view: &Value| view.pointer("/files").and_then(Value::as_array).is_some_and(|files| files.len() == 1);
    let views = report.pointer("/views").and_then(Value::as_array);
    report.pointer("/response").is_some_and(Value::is_string) && views.is_some_and(|views| views.iter().all(is_single))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_of_single_pictures_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let of = |text: &str| {
            std::fs::write(folder.path().join("prepare.json"), text).unwrap();
            is_prepared_of_pictures(folder.path())
        };
        assert!(!is_prepared_of_pictures(folder.path()));
        assert!(of(r#"{"response": "sRGB", "views": [{"files": ["a.jpg"]}, {"files": ["b.jpg"]}]}"#));
        assert!(!of(r#"{"response": "recovered", "views": [{"files": ["a.jpg", "b.jpg"]}]}"#));
        assert!(!of(r#"{"response": null, "views": [{"files": ["a.dng"]}]}"#));
        assert!(!of("[]") && !of("damaged"));
    }
}
