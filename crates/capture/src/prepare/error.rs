//! The error and the notes of preparing a capture: a text without flags, and a structured remedy.

use std::fmt;

use luxel_core::Remedy;

/// Explains why a capture cannot be prepared. `Display` leaves the remedy out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PrepareError {
    /// Place, expected and found; lower case, no full stop.
    pub message: String,
    /// Remedy, if an option or a change to the capture helps.
    pub remedy: Option<Remedy>,
}

impl PrepareError {
    /// Returns an error without a remedy.
    pub fn new(message: impl fmt::Display) -> Self {
        Self { message: message.to_string(), remedy: None }
    }

    /// Returns the error with a remedy.
    #[must_use]
    pub fn with_remedy(self, remedy: Remedy) -> Self {
        Self { remedy: Some(remedy), ..self }
    }
}

impl fmt::Display for PrepareError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for PrepareError {}

/// A remark for the user about a capture, which stops nothing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PrepareNote {
    /// Finding, in a form for people.
    pub text: String,
    /// Remedy, if an option or a change to the capture helps.
    pub remedy: Option<Remedy>,
}

impl PrepareNote {
    /// Returns a note without a remedy.
    pub fn new(text: impl Into<String>) -> Self {
        Self { text: text.into(), remedy: None }
    }

    /// Returns the note with a remedy.
    #[must_use]
    pub fn with_remedy(self, remedy: Remedy) -> Self {
        Self { remedy: Some(remedy), ..self }
    }
}
