//! The length of a data set's unit in metres, where something states it.
//!
//! In: the data set's path and folder. Out: metres, from the report of its preparation
//! (`prepare.json`: GPS or a known distance) or the key `metres_per_unit` of its `transforms.json`.
//! Degenerate: a report that cannot be read states nothing; a `transforms.json` with another value
//! is an error.

use std::path::Path;

use serde_json::Value;

use super::developed::prepare_report;
use crate::IoError;
use crate::read_file::read_file;
use crate::validity::is_length;

/// Key of `transforms.json`.
const KEY: &str = "metres_per_unit";

/// Returns the length in metres of one unit of the data set in `folder`, by the report of its
/// preparation; `None` where it is unknown, or was not prepared by this program.
pub fn prepared_metres_per_unit(folder: &Path) -> Option<f64> {
    prepare_report(folder)?.pointer("/world/metres_per_unit").and_then(Value::as_f64).filter(is_length)
}

/// Returns the length in metres of one unit of the data set at `path`, whose images lie below
/// `folder`.
pub(super) fn metres_per_unit(path: &Path, folder: &Path) -> Result<Option<f64>, IoError> {
    let json = if path.is_dir() { path.join("transforms.json") } else { path.to_owned() };
    let is_json = json.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json")) && json.is_file();
    // Its reader reports what else is wrong with the file.
    let stated = is_json.then(|| serde_json::from_slice::<Value>(&read_file(&json).ok()?).ok()).flatten();
    match stated.as_ref().and_then(|stated| stated.get(KEY)) {
        None => Ok(prepared_metres_per_unit(folder)),
        Some(value) => match value.as_f64().filter(is_length) {
            Some(metres) => Ok(Some(metres)),
            None => Err(IoError::invalid(&json, format!("\"{KEY}\" is {value}, expected a number above 0"))),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_or_a_file_of_transforms_states_it() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        let found = || metres_per_unit(folder.path(), folder.path());
        assert_eq!(found().unwrap(), None);
        write("prepare.json", r#"{"world": {"metres_per_unit": null}}"#);
        assert_eq!(found().unwrap(), None);
        write("prepare.json", r#"{"world": {"metres_per_unit": 1.0}}"#);
        assert_eq!(found().unwrap(), Some(1.0));
        // A file of transforms goes first: it is the data set.
        write("transforms.json", r#"{"metres_per_unit": 0.25, "frames": []}"#);
        assert_eq!((found().unwrap(), prepared_metres_per_unit(folder.path())), (Some(0.25), Some(1.0)));
        write("transforms.json", r#"{"metres_per_unit": "long"}"#);
        let error = found().unwrap_err().to_string();
        assert!(
            error.contains("transforms.json") && error.contains("\"metres_per_unit\" is \"long\", expected a number above 0"),
            "{error}"
        );
    }
}
