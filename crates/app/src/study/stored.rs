//! The lists of an earlier call, as `matrix.toml` holds them: a report covers what that call made,
//! too.
//!
//! In: the file. Out: data sets, methods and seeds. Degenerate: a study that is new has none.

use std::path::{Path, PathBuf};

use luxel::error::Context;
use luxel::{Error, Result};
use serde::Deserialize;

use super::method::StudyMethod;
use super::{StudyDataset, parse_method};
use crate::files;

/// The file has a line per data set and option.
const LIMIT_BYTES: u64 = 16 << 20;

/// Data sets, methods and seeds.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Stored {
    /// Their paths are absolute.
    pub(super) datasets: Vec<StudyDataset>,
    pub(super) methods: Vec<StudyMethod>,
    pub(super) seeds: Vec<u64>,
}

/// A call that was stopped early leaves a file without lists.
#[derive(Default, Deserialize)]
#[serde(default)]
struct File {
    datasets: Vec<PathBuf>,
    /// Their names, in order; studies of earlier versions have none.
    dataset_names: Vec<String>,
    methods: Vec<String>,
    seeds: Vec<String>,
}

impl Stored {
    /// Reads the file at `path`.
    pub(super) fn read(path: &Path) -> Result<Self> {
        if !path.is_file() {
            return Ok(Self::default());
        }
        let text = files::read_text(path, LIMIT_BYTES)?;
        let wrong = || format!("{}: not the lists of a study; restore it, or choose another folder", path.display());
        let file: File = toml::from_str(&text).with_context(wrong)?;
        let methods = file.methods.iter().map(|name| parse_method(name).ok()).collect::<Option<_>>().with_context(wrong)?;
        let seeds = file.seeds.iter().map(|seed| seed.parse().ok()).collect::<Option<_>>().with_context(wrong)?;
        let mut names = file.dataset_names.into_iter();
        let datasets: Vec<StudyDataset> = file.datasets.into_iter().map(|path| StudyDataset { name: names.next(), path }).collect();
        // Names are parts of paths.
        let is_part = |name: &str| !["", ".", ".."].contains(&name) && !name.contains(['/', '\\']);
        if !datasets.iter().filter_map(|dataset| dataset.name.as_deref()).all(is_part) {
            return Err(Error::new(wrong()));
        }
        Ok(Self { datasets, methods, seeds })
    }
}

/// Returns the stored values with the asked ones that are new behind them; the order that is asked
/// for where all stored values are asked for again.
pub(super) fn union<T: PartialEq + Clone>(stored: &[T], asked: &[T]) -> Vec<T> {
    if stored.iter().all(|value| asked.contains(value)) {
        return asked.to_vec();
    }
    let new = asked.iter().filter(|value| !stored.contains(value));
    stored.iter().chain(new).cloned().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_without_lists_has_none_and_another_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("matrix.toml");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            Stored::read(&path)
        };
        assert_eq!(read("").unwrap(), Stored::default());
        let found = read("datasets = [\"/a/room\"]\nmethods = [\"lcd\"]\nseeds = [\"7\"]\n[train]\n").unwrap();
        assert_eq!(
            (found.datasets, found.methods, found.seeds),
            (vec![StudyDataset::from("/a/room")], vec![parse_method("lcd").unwrap()], vec![7])
        );
        let named = read("datasets = [\"/a/data\", \"/b/data\"]\ndataset_names = [\"a\", \"b\"]\n").unwrap().datasets;
        assert_eq!(named.iter().map(|dataset| dataset.name.as_deref()).collect::<Vec<_>>(), [Some("a"), Some("b")]);
        for text in ["methods = [\"nerf\"]", "datasets = [\"/a\"]\ndataset_names = [\"../../a\"]", "seeds = [\"x\"]", "datasets = 3", "="] {
            assert!(read(text).unwrap_err().to_string().contains("not the lists of a study"), "{text}");
        }
    }

    #[test]
    fn what_is_new_comes_behind_unless_all_is_asked_for_in_another_order() {
        assert_eq!(union(&[1, 2], &[3, 2]), [1, 2, 3]);
        assert_eq!(union(&[1, 2], &[2, 3, 1]), [2, 3, 1]);
        assert_eq!(union(&[], &[2, 1]), [2, 1]);
        assert_eq!(union(&[2, 1], &[]), [2, 1]);
    }
}
