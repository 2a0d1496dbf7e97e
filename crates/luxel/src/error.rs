//! The one error of this crate: a message, what caused it, and what to do about it.
//!
//! In: errors of the libraries below, or a message; out: [`Error`], whose text names file, place,
//! expected and found, and no command-line flag. [`Error::remedy`] is structured, so that a front
//! end words it in its own terms.

use std::error::Error as StdError;
use std::fmt;

use luxel_capture::prepare::PrepareError;
use luxel_core::Remedy;

/// The result of a fallible call of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

type Boxed = Box<dyn StdError + Send + Sync + 'static>;

/// Explains why something could not be done.
///
/// `{}` displays the message alone, `{:#}` the message and its causes in one line.
/// [`std::error::Error::source`] leads from cause to cause.
///
/// ```
/// let error = luxel::Dataset::open("no/such/folder").unwrap_err();
/// assert_eq!(error.to_string(), "cannot read the data set");
/// assert!(format!("{error:#}").contains("no/such/folder"));
/// ```
pub struct Error {
    content: Box<Content>,
}

struct Content {
    kind: Kind,
    remedy: Option<Remedy>,
}

enum Kind {
    /// A message of this crate, and its cause.
    Message { text: String, source: Option<Boxed> },
    /// An error of a library below, as it is.
    Other(Boxed),
}

impl Error {
    /// Returns an error with a message and no cause.
    pub fn new(message: impl Into<String>) -> Self {
        Self::with(Kind::Message { text: message.into(), source: None })
    }

    /// Returns this error as the cause of a new one with `message`.
    #[must_use]
    pub fn context(self, message: impl Into<String>) -> Self {
        Self::with(Kind::Message { text: message.into(), source: Some(self.into()) })
    }

    /// Returns this error with what to do about it.
    #[must_use]
    pub fn with_remedy(mut self, remedy: Remedy) -> Self {
        self.content.remedy = Some(remedy);
        self
    }

    /// Returns what to do about the error, by the outermost of its causes that has a remedy.
    ///
    /// ```
    /// use luxel::{Error, Remedy};
    ///
    /// let remedy = Remedy::advice("give another name");
    /// let error = Error::new("a.ply: exists already").with_remedy(remedy.clone());
    /// assert_eq!(error.context("cannot export").remedy(), Some(&remedy));
    /// ```
    pub fn remedy(&self) -> Option<&Remedy> {
        self.chain().find_map(remedy_of)
    }

    /// Returns the error itself and its causes, outermost first.
    pub fn chain(&self) -> impl Iterator<Item = &(dyn StdError + 'static)> {
        std::iter::successors(Some(self as &(dyn StdError + 'static)), |&error| error.source())
    }

    /// Returns the outermost error of type `E` in the chain.
    pub fn find<E: StdError + 'static>(&self) -> Option<&E> {
        self.chain().find_map(|error| match error.downcast_ref::<Self>() {
            Some(Self { content }) => match &content.kind {
                Kind::Other(other) => other.downcast_ref(),
                Kind::Message { .. } => None,
            },
            None => error.downcast_ref(),
        })
    }

    fn with(kind: Kind) -> Self {
        Self { content: Box::new(Content { kind, remedy: None }) }
    }

    /// Wraps an error of a library below, whose message becomes that of this one.
    pub fn wrap(error: impl Into<Boxed>) -> Self {
        Self::with(Kind::Other(error.into()))
    }
}

/// Returns the remedy that one error of a chain carries, be it of this crate or of a library below.
///
/// ```
/// use luxel::{Remedy, remedy_of};
///
/// let error = luxel_core::EngineError::device("gpu: out of memory");
/// let error = error.with_remedy(Remedy::lower("max_splats"));
/// assert_eq!(remedy_of(&error), Some(&Remedy::lower("max_splats")));
/// ```
pub fn remedy_of<'a>(error: &'a (dyn StdError + 'static)) -> Option<&'a Remedy> {
    if let Some(Error { content }) = error.downcast_ref() {
        let below = match &content.kind {
            Kind::Other(below) => remedy_of(&**below),
            Kind::Message { .. } => None,
        };
        return content.remedy.as_ref().or(below);
    }
    let engine = error.downcast_ref::<luxel_core::EngineError>().and_then(luxel_core::EngineError::remedy);
    engine
        .or_else(|| error.downcast_ref::<luxel_train::TrainError>()?.remedy())
        .or_else(|| error.downcast_ref::<luxel_metrics::EvaluationError>()?.remedy())
        .or_else(|| error.downcast_ref::<luxel_io::IoError>()?.remedy.as_ref())
        .or_else(|| error.downcast_ref::<luxel_core::ReadError>()?.remedy.as_ref())
        .or_else(|| error.downcast_ref::<PrepareError>()?.remedy.as_ref())
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.content.kind {
            Kind::Message { text, .. } => f.write_str(text)?,
            Kind::Other(error) => write!(f, "{error}")?,
        }
        if f.alternate() {
            for cause in self.chain().skip(1) {
                write!(f, ": {cause}")?;
            }
        }
        Ok(())
    }
}

impl fmt::Debug for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")?;
        self.chain().skip(1).try_for_each(|cause| write!(f, "\n  caused by: {cause}"))
    }
}

impl StdError for Error {
    fn source(&self) -> Option<&(dyn StdError + 'static)> {
        match &self.content.kind {
            Kind::Message { source, .. } => source.as_ref().map(|source| &**source as &(dyn StdError + 'static)),
            Kind::Other(error) => error.source(),
        }
    }
}

/// Errors that become this crate's own by `?`, with their text unchanged.
macro_rules! wrapped {
    ($($error:ty),+ $(,)?) => {
        $(impl From<$error> for Error {
            fn from(error: $error) -> Self {
                Self::wrap(error)
            }
        })+
    };
}

wrapped!(
    std::io::Error,
    std::num::TryFromIntError,
    serde_json::Error,
    luxel_core::EngineError,
    luxel_core::ReadError,
    luxel_core::EditError,
    luxel_core::edit::EditTextError,
    luxel_io::IoError,
    luxel_metrics::EvaluationError,
    luxel_metrics::LpipsError,
    luxel_metrics::MetricsError,
    PrepareError,
    luxel_capture::FrameError,
    luxel_train::TrainError,
);

/// Adds a message to an error, which becomes its cause; or makes an error of a missing value.
///
/// ```
/// use luxel::error::Context;
///
/// let read = std::fs::read("no/such/file").context("cannot read the notes");
/// assert_eq!(read.unwrap_err().to_string(), "cannot read the notes");
/// ```
pub trait Context<T> {
    /// Adds `message`.
    ///
    /// # Errors
    /// The error with its message, or that of a missing value.
    fn context(self, message: impl Into<String>) -> Result<T>;

    /// Adds the message that `message` makes.
    ///
    /// # Errors
    /// As [`Self::context`].
    fn with_context<M: Into<String>>(self, message: impl FnOnce() -> M) -> Result<T>;
}

impl<T, E: Into<Boxed>> Context<T> for Result<T, E> {
    fn context(self, message: impl Into<String>) -> Result<T> {
        self.with_context(|| message)
    }

    fn with_context<M: Into<String>>(self, message: impl FnOnce() -> M) -> Result<T> {
        self.map_err(|source| Error::with(Kind::Message { text: message().into(), source: Some(source.into()) }))
    }
}

impl<T> Context<T> for Option<T> {
    fn context(self, message: impl Into<String>) -> Result<T> {
        self.ok_or_else(|| Error::new(message))
    }

    fn with_context<M: Into<String>>(self, message: impl FnOnce() -> M) -> Result<T> {
        self.ok_or_else(|| Error::new(message()))
    }
}

/// Returns from the function with an [`Error`] of a formatted message.
#[macro_export]
macro_rules! bail {
    ($($message:tt)+) => {
        return Err($crate::Error::new(format!($($message)+)))
    };
}

/// Returns from the function with an [`Error`] of a formatted message unless the condition holds.
#[macro_export]
macro_rules! ensure {
    ($condition:expr, $($message:tt)+) => {
        if !$condition {
            $crate::bail!($($message)+);
        }
    };
}

pub use {bail, ensure};

#[cfg(test)]
mod tests {
    use super::*;

    fn fails() -> Result<()> {
        let missing = Err::<(), _>(std::io::Error::from(std::io::ErrorKind::NotFound));
        missing.context("a.exr: cannot read").with_context(|| format!("step {}", 3))
    }

    #[test]
    fn a_message_stands_before_its_causes() {
        let error = fails().unwrap_err();
        assert_eq!(error.to_string(), "step 3");
        assert_eq!(format!("{error:#}"), "step 3: a.exr: cannot read: entity not found");
        assert_eq!(error.chain().count(), 3);
        assert_eq!(error.find::<std::io::Error>().map(std::io::Error::kind), Some(std::io::ErrorKind::NotFound));
    }

    #[test]
    fn an_error_from_below_keeps_its_text() {
        let below = luxel_io::IoError::invalid("a.exr", "row 3: not finite");
        let text = below.to_string();
        let error = Error::from(below);
        assert_eq!((error.to_string(), error.chain().count()), (text, 1));
        assert!(error.find::<luxel_io::IoError>().is_some());
    }

    #[test]
    fn an_error_from_below_keeps_its_remedy() {
        let below = luxel_io::IoError::unsupported("a.png", "no transfer curve").with_remedy(Remedy::give("transfer"));
        assert_eq!(Error::from(below).context("cannot read").remedy(), Some(&Remedy::give("transfer")));
    }

    #[test]
    fn a_missing_value_and_a_broken_condition_are_errors() {
        fn checked(n: u32) -> Result<u32> {
            ensure!(n > 1, "{n} is too small");
            if n > 3 {
                bail!("{n} is too large");
            }
            Some(n).filter(|n| *n == 2).context("not two")
        }
        assert_eq!(
            [1, 2, 3, 4].map(|n| checked(n).map_or_else(|e| e.to_string(), |n| n.to_string())),
            ["1 is too small", "2", "not two", "4 is too large"]
        );
    }

    #[test]
    fn errors_cross_threads() {
        fn is_send<T: Send + Sync + 'static>() {}
        is_send::<Error>();
    }
}
