//! Files in, files out: images, data sets, scenes, checkpoints.
//!
//! Every file read is hostile: truncated, huge, cyclic, NaN. The answer is an [`IoError`] that names file, place, expectation and
//! remedy; no panic, no unbounded allocation.

mod atomic;
mod error;

pub use atomic::{WriteSeek, write_atomically};
pub use error::{IoError, IoErrorKind};
