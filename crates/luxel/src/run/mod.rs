//! Training with a folder: what is saved when, how a run is resumed, and what it measured.
//!
//! [`launch`] starts or resumes a run, [`Session`] is its loop, [`RunFolder`] says what lies where, [`RunConfig`] is its `config.toml`.

mod captures;
mod clock;
mod config;
pub mod evaluation;
mod explicit;
mod folder;
mod inapplicable;
mod launch;
pub mod log;
pub mod report;
mod session;
pub mod state;

pub use captures::Captures;
pub use config::{Difference, MadeBy, RunConfig, RunOptions};
pub use evaluation::{Metrics, Rendering};
pub use explicit::ExplicitArgs;
pub use folder::{LOCK, Occupant, RunFolder, RunLock};
pub use inapplicable::{Choice, Inapplicable};
pub use launch::{Launch, TrainedRun, fresh, resume};
pub use log::LogRecord;
pub use session::{Outcome, Session};
