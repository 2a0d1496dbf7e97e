//! The input of decoders: bytes, and the name of the file that they are from.
//!
//! Checks of sizes against the length of the bytes are in `image/guard.rs`.

use std::fmt::Display;
use std::path::Path;

use crate::IoError;

/// A file's bytes, and the name that errors about them give.
#[derive(Clone, Copy)]
pub(crate) struct Input<'a> {
    pub(crate) name: &'a Path,
    pub(crate) bytes: &'a [u8],
}

impl<'a> Input<'a> {
    pub(crate) fn new(name: &'a (impl AsRef<Path> + ?Sized), bytes: &'a [u8]) -> Self {
        Self { name: name.as_ref(), bytes }
    }

    /// Returns a part of the file, or what it holds compressed.
    pub(crate) fn with_bytes(self, bytes: &'a [u8]) -> Self {
        Self { bytes, ..self }
    }

    /// Returns the number of bytes.
    pub(crate) fn length(self) -> u64 {
        self.bytes.len() as u64
    }

    /// Returns an error about wrong content, see [`IoError::invalid`].
    pub(crate) fn invalid(self, message: impl Display) -> IoError {
        IoError::invalid(self.name, message)
    }

    /// Returns an error about content that is not supported, see [`IoError::unsupported`].
    pub(crate) fn unsupported(self, message: impl Display) -> IoError {
        IoError::unsupported(self.name, message)
    }
}
