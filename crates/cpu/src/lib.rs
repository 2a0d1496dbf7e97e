//! The native engine: the eleven passes with SIMD over tiles, on all cores, and the same bits for any number of threads.

mod engine;
mod lanes;
mod memory;
mod passes;
mod prefetch;
mod store;
mod view;

pub use engine::{CpuEngine, InstructionSet};

/// The example of the crate's README, compiled as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct CrateReadmeExample;
