//! Errors of training and loading fields.

use thiserror::Error;

/// Why a field cannot be trained or loaded.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum FieldError {
    /// No training views.
    #[error("no training views: at least one is needed")]
    NoTrainViews,
    /// A view that cannot be used.
    #[error(transparent)]
    View(#[from] luxel_core::ViewError),
    /// An image that cannot be read again.
    #[error(transparent)]
    Read(#[from] luxel_core::ReadError),
    /// A view of other values than the objective reads.
    #[error("view {view}: {found}, expected {expected}")]
    Values {
        /// Name of the view.
        view: String,
        /// Its values.
        found: &'static str,
        /// Those that are read.
        expected: &'static str,
    },
    /// No pixel takes part.
    #[error("no training view has a valid pixel")]
    NoPixels,
    /// Arrays that are no field's.
    #[error("not a field: {0}")]
    Arrays(String),
    /// The loss is not a number any more.
    #[error("step {step}: the loss is not finite")]
    NotFinite {
        /// The step.
        step: u32,
    },
    /// Threads that the system refuses.
    #[error("cannot start {threads} threads: {message}")]
    Threads {
        /// Number of threads.
        threads: usize,
        /// The system's message.
        message: String,
    },
}
