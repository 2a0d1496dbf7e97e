//! The record of what is finished, on disk: `work/state.json`.
//!
//! In: keys, which are digests of inputs and settings. Out: whether a view or structure from motion
//! is finished: it is if its key is recorded. The file is written whole or not at all, at most
//! every few seconds: killing the program loses only the views finished since.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use luxel::Result;
use luxel_capture::prepare::ViewRecord;
use serde::{Deserialize, Serialize};

use crate::files::{read_text, write_json};
use crate::schema;

/// Room for a hundred thousand views.
const MAX_BYTES: u64 = 1 << 30;
const INTERVAL: Duration = Duration::from_secs(2);

/// The content of the file.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct State {
    views: BTreeMap<String, ViewRecord>,
    /// Key of the structure from motion that is in `work/sparse`.
    #[serde(default)]
    pub(super) sfm_key: Option<String>,
    /// Key of each picture that the model in `work/sparse` is or will be made of, by view.
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
    /// Returns whether an earlier call has left a state, readable or not.
    pub(super) fn is_in(work: &Path) -> bool {
        work.join(NAME).is_file()
    }

    /// Reads the state of an earlier call. It is empty if there is none or it is damaged.
    pub(super) fn open(work: &Path) -> Self {
        let path = work.join(NAME);
        let read = read_text(&path, MAX_BYTES).ok().and_then(|text| serde_json::from_str::<Self>(&text).ok());
        Self { path, ..read.unwrap_or_default() }
    }

    /// Returns the record of a view that was finished with this key.
    pub(super) fn view(&self, name: &str, key: &str) -> Option<&ViewRecord> {
        self.views.get(name).filter(|record| record.key == key)
    }

    /// Removes the records of these views, on disk too: their files are about to be written over.
    pub(super) fn forget<'a>(&mut self, names: impl Iterator<Item = &'a str>) -> Result<()> {
        names.for_each(|name| drop(self.views.remove(name)));
        self.save()
    }

    /// Adds the record of a finished view.
    pub(super) fn insert(&mut self, record: ViewRecord) -> Result<()> {
        self.views.insert(record.name.clone(), record);
        if self.saved.is_none_or(|at| at.elapsed() > INTERVAL) { self.save() } else { Ok(()) }
    }

    /// Writes the file.
    pub(super) fn save(&mut self) -> Result<()> {
        self.saved = Some(Instant::now());
        write_json(&self.path, schema::PREPARE_STATE, self)
    }
}

/// Returns a digest of parts, in order.
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
    fn keys_depend_on_the_borders_of_parts() {
        assert_ne!(key(["ab", "c"]), key(["a", "bc"]));
        assert_eq!(key(["a"]), key(["a"]));
    }

    #[test]
    fn a_damaged_file_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("state.json"), "{ broken").unwrap();
        assert!(State::open(folder.path()).sfm_key.is_none());
        let mut state = State::open(folder.path());
        state.sfm_key = Some("k".into());
        state.save().unwrap();
        assert_eq!(State::open(folder.path()).sfm_key.as_deref(), Some("k"));
    }
}
