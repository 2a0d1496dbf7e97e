//! The room that the tests of training learn, and runs of methods on it.

#[path = "../../../train/tests/common/mod.rs"]
mod room;
pub(crate) mod runs;

pub(crate) use room::{config, dataset, engine};
