//! From arguments to what commands work on: scenes, data sets, engines.

pub(crate) mod data;
pub(crate) mod engine;
pub(crate) mod masks;
pub(crate) mod programs;
pub(crate) mod scene_source;
