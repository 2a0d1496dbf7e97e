//! The split of views: those that are trained on and those that are held out.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::files::{composed, view_name, without_extension};
use super::json_fields::{kind_of, parse_json, string_list};
use crate::IoError;

/// Interval of held-out views among the sorted ones, where the data set states no split (3D
/// Gaussian splatting's habit).
const HOLD_OUT_EVERY: usize = 8;

/// Side of the split.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    /// Trained on.
    Train,
    /// Held out.
    Test,
}

/// Names on both sides, from a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SplitLists {
    /// For messages.
    pub(super) path: PathBuf,
    /// Names of training images, with or without folders and extension.
    pub train: Vec<String>,
    /// Names of held-out images.
    pub test: Vec<String>,
}

impl SplitLists {
    /// Returns which of the views with these names a list names, from 0.
    pub(super) fn named<'a>(&self, names: impl IntoIterator<Item = &'a str>) -> HashSet<usize> {
        let index = NameIndex::new(names);
        self.train.iter().chain(&self.test).filter_map(|name| index.find(name).flatten()).collect()
    }
}

/// How views are split.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum SplitRule {
    /// Each frame states its side; those that do not are left out.
    Frames,
    /// By lists of names.
    Lists(SplitLists),
    /// Index % 8 == 0 is held out.
    EveryEighth,
}

/// Parses the content of a `split.json`: an object with lists "train" and "test"; other keys are
/// ignored. `path` is for messages.
///
/// ```
/// use std::path::Path;
///
/// let json = br#"{"train": ["000", "001"], "test": ["002"]}"#;
/// let split = luxel_io::parse_split(Path::new("split.json"), json)?;
/// assert_eq!((split.train.len(), split.test.len()), (2, 1));
///
/// let error = luxel_io::parse_split(Path::new("split.json"), b"[]").unwrap_err();
/// assert!(error.to_string().starts_with("split.json: "));
/// # Ok::<(), luxel_io::IoError>(())
/// ```
///
/// # Errors
/// [`crate::IoErrorKind::Invalid`].
pub fn parse_split(path: &Path, bytes: &[u8]) -> Result<SplitLists, IoError> {
    let root = parse_json(path, bytes)?;
    let Value::Object(root) = &root else {
        let found = kind_of(&root);
        return Err(IoError::invalid(path, format!("the file holds {found}, expected an object with lists \"train\" and \"test\"")));
    };
    let list = |key: &str| match root.get(key) {
        None => Err(IoError::invalid(path, format!("\"{key}\" is missing, expected a list of image names"))),
        Some(value) => string_list(value).map_err(|found| IoError::invalid(path, format!("\"{key}\" {found}"))),
    };
    Ok(SplitLists { path: path.into(), train: list("train")?, test: list("test")? })
}

/// Returns the side of each of the sorted `names`; `None` is left out. `frames` are the sides that
/// the frames state themselves.
pub(super) fn assign(rule: &SplitRule, names: &[&str], frames: &[Option<Part>]) -> Result<Vec<Option<Part>>, IoError> {
    match rule {
        SplitRule::Frames => Ok(frames.to_vec()),
        SplitRule::Lists(lists) => by_lists(lists, names),
        // A single image is trained on.
        SplitRule::EveryEighth if names.len() == 1 => Ok(vec![Some(Part::Train)]),
        SplitRule::EveryEighth => {
            Ok((0..names.len()).map(|i| Some(if i % HOLD_OUT_EVERY == 0 { Part::Test } else { Part::Train })).collect())
        }
    }
}

/// Finds views by their name or the end of it.
pub(super) struct NameIndex {
    /// Full names and their ends behind each `/`; `None` where several views share one.
    by_end: HashMap<String, Option<usize>>,
}

impl NameIndex {
    pub(super) fn new<'a>(names: impl IntoIterator<Item = &'a str>) -> Self {
        let mut by_end = HashMap::new();
        let mut full = Vec::new();
        for (i, name) in names.into_iter().enumerate() {
            let name = composed(name);
            full.push((name.clone(), i));
            for (slash, _) in name.match_indices('/') {
                by_end.entry(name[slash + 1..].to_owned()).and_modify(|e| *e = None).or_insert(Some(i));
            }
        }
        // A full name takes precedence over the end of another.
        by_end.extend(full.into_iter().map(|(name, i)| (name, Some(i))));
        Self { by_end }
    }

    /// Finds the view that a name means. `None`: no view; `Some(None)`: several.
    pub(super) fn find(&self, name: &str) -> Option<Option<usize>> {
        let exact = composed(&view_name(name));
        self.by_end.get(&exact).or_else(|| self.by_end.get(without_extension(&exact))).copied()
    }
}

fn by_lists(lists: &SplitLists, names: &[&str]) -> Result<Vec<Option<Part>>, IoError> {
    let index = NameIndex::new(names.iter().copied());
    let mut parts = vec![None; names.len()];
    for (list, part, key) in [(&lists.train, Part::Train, "train"), (&lists.test, Part::Test, "test")] {
        for name in list {
            let error = |message: String| IoError::invalid(&lists.path, format!("\"{key}\": {name:?} {message}"));
            let found = index.find(name).ok_or_else(|| error("is not an image of the data set".to_owned()))?;
            let Some(slot) = found.and_then(|found| parts.get_mut(found)) else {
                return Err(error("names several images, expected their folder with it".to_owned()));
            };
            match slot {
                Some(other) if *other != part => return Err(error("is in both lists, expected one".to_owned())),
                _ => *slot = Some(part),
            }
        }
    }
    Ok(parts)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn split(train: &[&str], test: &[&str], names: &[&str]) -> Result<Vec<Option<Part>>, String> {
        let own = |list: &[&str]| list.iter().map(|s| (*s).to_owned()).collect();
        let lists = SplitLists { path: "split.json".into(), train: own(train), test: own(test) };
        assign(&SplitRule::Lists(lists), names, &[]).map_err(|e| e.to_string())
    }

    #[test]
    fn lists_name_images_with_or_without_folder_and_extension() {
        let names = ["images/a", "images/b", "images/c", "images/d"];
        let parts = split(&["images/a.exr", "b"], &["c.png"], &names).unwrap();
        assert_eq!(parts, [Some(Part::Train), Some(Part::Train), Some(Part::Test), None]);
    }

    #[test]
    fn lists_that_contradict_are_refused() {
        let names = ["x/a", "y/a", "x/b"];
        assert_eq!(
            split(&["a"], &[], &names).unwrap_err(),
            "split.json: \"train\": \"a\" names several images, expected their folder with it"
        );
        assert_eq!(split(&["x/a"], &["x/a.exr"], &names).unwrap_err(), "split.json: \"test\": \"x/a.exr\" is in both lists, expected one");
        assert_eq!(split(&["q"], &[], &names).unwrap_err(), "split.json: \"train\": \"q\" is not an image of the data set");
    }

    #[test]
    fn every_eighth_is_held_out_but_a_single_image_is_trained_on() {
        let names: Vec<String> = (0..17).map(|i| format!("{i:02}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let parts = assign(&SplitRule::EveryEighth, &names, &[]).unwrap();
        let test: Vec<usize> = (0..17).filter(|i| parts[*i] == Some(Part::Test)).collect();
        assert_eq!(test, [0, 8, 16]);
        assert_eq!(assign(&SplitRule::EveryEighth, &["a"], &[]).unwrap(), [Some(Part::Train)]);
    }

    #[test]
    fn split_files_that_are_none_are_refused() {
        let parse = |text: &str| parse_split(Path::new("split.json"), text.as_bytes()).unwrap_err().to_string();
        assert!(parse("[]").contains("a list, expected an object"));
        assert!(parse("{\"train\": []}").contains("\"test\" is missing"));
        assert!(parse("{\"train\": [1], \"test\": []}").contains("\"train\" item 0 is a number, expected a name"));
        assert!(parse("{\"train\": {}, \"test\": []}").contains("\"train\" is an object, expected a list"));
        assert!(parse("{\"train\": [").contains("not JSON"));
    }
}
