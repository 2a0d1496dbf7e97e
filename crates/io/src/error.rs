//! The one error of all readers and writers: file, place, expected, found, and a remedy.

use std::fmt;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use luxel_core::Remedy;

/// Explains why a file could not be read or written. Displays as `path: place: message`.
#[derive(Debug)]
pub struct IoError {
    /// File or folder.
    pub path: PathBuf,
    /// Kind of fault.
    pub kind: IoErrorKind,
    /// Place within the file and what is wrong there: expected and found, and what to do about the
    /// file. Lower case, no full stop, no command-line flag.
    pub message: String,
    /// Remedy where an option helps. `Display` leaves it out: a front end words it.
    pub remedy: Option<Remedy>,
}

/// The kind of fault: the file's, the system's, or a limit of this crate.
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
    /// Returns an error about wrong content: `message` names place, expected and found.
    pub fn invalid(path: impl AsRef<Path>, message: impl fmt::Display) -> Self {
        Self { path: path.as_ref().into(), kind: IoErrorKind::Invalid, message: shortened(message.to_string()), remedy: None }
    }

    /// Returns an error about content that may be right but is not supported: `message` names what
    /// and the remedy.
    pub fn unsupported(path: impl AsRef<Path>, message: impl fmt::Display) -> Self {
        Self { path: path.as_ref().into(), kind: IoErrorKind::Unsupported, message: shortened(message.to_string()), remedy: None }
    }

    /// Returns an error about what the operating system refused: to `action` ("read", "write",
    /// "create folder").
    pub fn system(path: impl AsRef<Path>, action: &str, error: &std::io::Error) -> Self {
        let kind = match error.kind() {
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => IoErrorKind::NoRoom,
            _ => IoErrorKind::System,
        };
        Self { path: path.as_ref().into(), kind, message: format!("cannot {action}: {error}"), remedy: None }
    }

    /// Returns the error with a remedy, an option that helps.
    ///
    /// ```
    /// use luxel_core::Remedy;
    /// use luxel_io::IoError;
    ///
    /// let error = IoError::unsupported("a.png", "no transfer curve");
    /// let error = error.with_remedy(Remedy::give("transfer"));
    /// assert_eq!(error.to_string(), "a.png: no transfer curve");
    /// assert_eq!(error.remedy, Some(Remedy::give("transfer")));
    /// ```
    #[must_use]
    pub fn with_remedy(self, remedy: Remedy) -> Self {
        Self { remedy: Some(remedy), ..self }
    }
}

/// Characters of a message that are kept from its beginning and from its end: texts of a file may
/// be of any length.
const KEPT: [usize; 2] = [1500, 500];

/// Returns a message without its middle if it is very long.
fn shortened(message: String) -> String {
    let count = message.chars().count();
    let [start, end] = KEPT;
    if count <= start + end {
        return message;
    }
    let left_out = count - start - end;
    let (first, last): (String, String) = (message.chars().take(start).collect(), message.chars().skip(count - end).collect());
    format!("{first} ... ({left_out} characters left out) ... {last}")
}

impl fmt::Display for IoError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.path.display(), self.message)
    }
}

impl std::error::Error for IoError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_of_a_file_do_not_flood_a_message() {
        let error = IoError::invalid("a.usda", format!("unknown type \"{}\", expected a float", "é".repeat(1 << 20)));
        assert!(error.message.len() < 5000, "{}", error.message.len());
        assert!(error.message.starts_with("unknown type \"é") && error.message.ends_with("é\", expected a float"));
        assert!(error.message.contains("(1046609 characters left out)"), "{}", error.message);
    }
}
