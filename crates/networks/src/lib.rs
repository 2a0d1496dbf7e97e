//! Small dense networks over sixteen samples at a time, shared by radiance fields and by decoders
//! of anchors, and networks of one input as tables, shared by fields and by the second colours of
//! splats. Gradients are exact and written by hand; sums have one fixed order.

mod lanes;
mod network;
pub mod relu_line;

pub use lanes::{LANES, Lanes, resize, sum};
pub use network::{Activations, Network};

/// The example of the crate's README, compiled as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct CrateReadmeExample;
