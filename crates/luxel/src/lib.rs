//! Luxel for programs: data sets, training, rendering, editing and export of scenes in scene-linear radiance.
//!
//! This crate does what the program `luxel` does. It prints nothing and parses no arguments: long tasks report to an [`Observer`],
//! and errors carry a message, their causes and a remedy.

mod dataset;
mod error;
mod events;
pub mod files;
pub mod machine;
pub mod memory;
pub mod text;

pub use dataset::Dataset;
pub use error::{Error, Result};
pub use events::{Event, Observer, Silent, StopFlag};
