//! Output to the terminal: progress, tables, trees of facts.

pub(crate) mod console;
pub(crate) mod metrics_table;
pub(crate) mod profile;
pub(crate) mod tree;
