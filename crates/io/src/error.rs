//! The one error of all readers and writers: where, what, and what to do.

use std::fmt;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Why a file could not be read or written. Displays as `path: place: message`.
#[derive(Debug)]
pub struct IoError {
    /// File or folder.
    pub path: PathBuf,
    /// Whose fault it is.
    pub kind: IoErrorKind,
    /// Place within the file and what is wrong there: expected, found, remedy. Lower case, no full stop.
    pub message: String,
}

/// Whose fault it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IoErrorKind {
    /// The operating system refused (missing, permissions, a broken disk).
    System,
    /// There is no room: a full disk, a quota, a limit on files' sizes.
    NoRoom,
    /// The content is wrong.
    Invalid,
    /// The content may be right, but is not supported.
    Unsupported,
}

impl IoError {
    /// The content is wrong: `message` names place, expected and found.
    pub fn invalid(path: impl AsRef<Path>, message: impl fmt::Display) -> Self {
        Self { path: path.as_ref().into(), kind: IoErrorKind::Invalid, message: message.to_string() }
    }

    /// The content may be right but is not supported: `message` names what and the remedy.
    pub fn unsupported(path: impl AsRef<Path>, message: impl fmt::Display) -> Self {
        Self { path: path.as_ref().into(), kind: IoErrorKind::Unsupported, message: message.to_string() }
    }

    /// The operating system refused to `action` ("read", "write", "create folder").
    pub fn system(path: impl AsRef<Path>, action: &str, error: &std::io::Error) -> Self {
        let kind = match error.kind() {
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => IoErrorKind::NoRoom,
            _ => IoErrorKind::System,
        };
        Self { path: path.as_ref().into(), kind, message: format!("cannot {action}: {error}") }
    }
}

impl fmt::Display for IoError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.path.display(), self.message)
    }
}

impl std::error::Error for IoError {}
