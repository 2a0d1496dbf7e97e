//! What is finished, on disk: `work/state.json`. A view is done if its key is that of its inputs and settings; so is structure from motion.
//!
//! The file is written whole or not at all, at most every few seconds: killing the program loses no more than the views finished since.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::Result;
use crate::files::{read_text, write_json};
use luxel_capture::prepare::ViewRecord;
use serde::{Deserialize, Serialize};

/// State files of a hundred thousand views.
const MAX_BYTES: u64 = 1 << 30;
const INTERVAL: Duration = Duration::from_secs(2);

/// The file's content.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct State {
    views: BTreeMap<String, ViewRecord>,
    /// Key of the structure from motion that is in `work/sparse`.
    #[serde(default)]
    pub(super) sfm_key: Option<String>,
    /// Key of each picture that the model in `work/sparse` is made of, or will be, by view.
    #[serde(default)]
    pub(super) pictures: BTreeMap<String, String>,
    /// Key of everything, once the data set is whole.
    #[serde(default)]
    pub(super) finished_key: Option<String>,
    #[serde(skip)]
    path: PathBuf,
    #[serde(skip)]
    saved: Option<Instant>,
}

/// The file's name.
const NAME: &str = "state.json";

impl State {
    /// Whether an earlier run has left one, readable or not.
    pub(super) fn is_in(work: &Path) -> bool {
        work.join(NAME).is_file()
    }

    /// Of an earlier run, or empty; a file that is none is begun anew.
    pub(super) fn open(work: &Path) -> Self {
        let path = work.join(NAME);
        let read = read_text(&path, MAX_BYTES).ok().and_then(|text| serde_json::from_str::<Self>(&text).ok());
        Self { path, ..read.unwrap_or_default() }
    }

    pub(super) fn view(&self, name: &str, key: &str) -> Option<&ViewRecord> {
        self.views.get(name).filter(|record| record.key == key)
    }

    /// Drops the records of these views, on disk too: their files are about to be written over.
    pub(super) fn forget<'a>(&mut self, names: impl Iterator<Item = &'a str>) -> Result<()> {
        names.for_each(|name| drop(self.views.remove(name)));
        self.save()
    }

    pub(super) fn insert(&mut self, record: ViewRecord) -> Result<()> {
        self.views.insert(record.name.clone(), record);
        if self.saved.is_none_or(|at| at.elapsed() > INTERVAL) { self.save() } else { Ok(()) }
    }

    pub(super) fn save(&mut self) -> Result<()> {
        self.saved = Some(Instant::now());
        write_json(&self.path, self)
    }
}

/// Digest of parts, in order.
pub(super) fn key<'a>(parts: impl IntoIterator<Item = &'a str>) -> String {
    let mut hasher = blake3::Hasher::new();
    for part in parts {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part.as_bytes());
    }
    hasher.finalize().to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_tell_parts_apart() {
        assert_ne!(key(["ab", "c"]), key(["a", "bc"]));
        assert_eq!(key(["a"]), key(["a"]));
    }

    #[test]
    fn a_file_that_is_none_is_begun_anew() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("state.json"), "{ broken").unwrap();
        assert!(State::open(folder.path()).sfm_key.is_none());
        let mut state = State::open(folder.path());
        state.sfm_key = Some("k".into());
        state.save().unwrap();
        assert_eq!(State::open(folder.path()).sfm_key.as_deref(), Some("k"));
    }
}
