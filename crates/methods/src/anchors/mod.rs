//! Anchors: a scene whose splats small networks decode for each view (Scaffold-GS, Lu et al. 2024).
//!
//! In: a data set, options, an engine of splats. Out: anchors on a voxel grid, each with ten
//! offsets, a feature and sizes, and the networks that make ten splats of an anchor as seen from a
//! camera. The engine renders the decoded splats and returns gradients by their parameters, which
//! go back through the networks. Sums over anchors are made in chunks of constant size, in order:
//! the same bits for any number of threads. Deviations from what was published:
//! `docs/src/guide/published-methods.md`. Degenerate: a camera that sees no anchor sees the
//! background.

mod decode;
mod decoders;
mod engine;
mod files;
mod gradients;
mod groups;
mod grow;
mod numbers;
mod run;
mod saved;
mod scene;
mod start;
mod statistics;
#[cfg(test)]
mod tests;
mod trainer;
mod visible;

pub use self::engine::AnchorEngine;
pub use self::files::{AnchorCheckpoint, AnchorFile, read_anchor_run, read_anchors};
pub use self::run::AnchorRun;
pub use self::saved::{AnchorArray, AnchorSnapshot};
pub use self::scene::{AnchorScene, Anchors};
pub use self::trainer::AnchorTrainer;

/// Splats of an anchor.
pub const SPLATS_PER_ANCHOR: usize = 10;
/// Numbers of an anchor's feature.
const FEATURE: usize = 32;
/// Log scales of an anchor: three of its offsets, three of its splats.
const SCALES: usize = 6;
/// Numbers of the offsets of an anchor.
const OFFSETS: usize = 3 * SPLATS_PER_ANCHOR;
