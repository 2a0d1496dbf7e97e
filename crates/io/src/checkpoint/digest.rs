//! The digest of a checkpoint, which tells whether the file is whole: of its metadata and arrays.

use std::collections::BTreeMap;

/// The digest of a checkpoint's content, every part preceded by its length.
pub(super) struct Digest(blake3::Hasher);

impl Digest {
    pub(super) fn of_metadata<K: AsRef<str>>(metadata: &BTreeMap<K, String>) -> Self {
        let mut digest = Self(blake3::Hasher::new());
        for (key, value) in metadata {
            digest.text(key.as_ref());
            digest.text(value);
        }
        digest
    }

    pub(super) fn text(&mut self, text: &str) {
        self.0.update(&(text.len() as u64).to_le_bytes());
        self.0.update(text.as_bytes());
    }

    pub(super) fn tensor(&mut self, name: &str, shape: &[usize]) {
        self.text(name);
        self.0.update(&(shape.len() as u64).to_le_bytes());
        for side in shape {
            self.0.update(&(*side as u64).to_le_bytes());
        }
    }

    pub(super) fn bytes(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    pub(super) fn finish(&self) -> String {
        self.0.finalize().to_hex().to_string()
    }
}
