//! The length of a data set's unit in metres, where something states it.
//!
//! In: the data set's path and folder. Out: metres, from the report of its preparation
//! (`prepare.json`: GPS or a known distance) or the key `metres_per_unit` of its `transforms.json`,
//! or of its `transforms_train.json` where the former is missing or does not state it.
//! Degenerate: a report that cannot be read states nothing; a file of transforms with another value
//! is an error.

use std::path::Path;

use serde_json::Value;

use super::developed::prepare_report;
use crate::IoError;
use crate::read_file::read_file;
use crate::validity::is_length;

/// Key of `transforms.json`.
const KEY: &str = "metres_per_unit";
/// Files of transforms in a folder, the first that states the length first.
const FILES: [&str; 2] = ["transforms.json", "transforms_train.json"];

/// Returns the length in metres of one unit of the data set in `folder`, by the report of its
/// preparation; `None` where it is unknown, or was not prepared by this program.
pub fn prepared_metres_per_unit(folder: &Path) -> Option<f64> {
    prepare_report(folder)?.pointer("/world/metres_per_unit").and_then(Value::as_f64).filter(is_length)
}

/// Returns the length in metres of one unit of the data set at `path`, whose images lie below
/// `folder`.
pub(super) fn metres_per_unit(path: &Path, folder: &Path) -> Result<Option<f64>, IoError> {
    let files = if path.is_dir() { FILES.map(|name| path.join(name)).to_vec() } else { vec![path.to_owned()] };
    for json in files {
        if let Some(value) = stated(&json) {
            let metres = value.as_f64().filter(is_length);
            return metres.map(Some).ok_or_else(|| IoError::invalid(&json, format!("\"{KEY}\" is {value}, expected a number above 0")));
        }
    }
    Ok(prepared_metres_per_unit(folder))
}

/// Returns the value of the key in a file of transforms; `None` without the key. What else is wrong
/// with the file is for its reader to report.
fn stated(json: &Path) -> Option<Value> {
    let is_json = json.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json")) && json.is_file();
    let bytes = is_json.then(|| read_file(json).ok()).flatten()?;
    serde_json::from_slice::<Value>(&bytes).ok()?.get(KEY).cloned()
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
        // Sets of Blender have a file for each split.
        write("transforms_train.json", r#"{"metres_per_unit": 0.5, "frames": []}"#);
        assert_eq!(found().unwrap(), Some(0.25));
        write("transforms.json", r#"{"frames": []}"#);
        assert_eq!(found().unwrap(), Some(0.5));
        write("transforms.json", r#"{"metres_per_unit": "long"}"#);
        let error = found().unwrap_err().to_string();
        assert!(
            error.contains("transforms.json") && error.contains("\"metres_per_unit\" is \"long\", expected a number above 0"),
            "{error}"
        );
    }
}
