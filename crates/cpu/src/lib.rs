//! The native engine: the eleven passes with SIMD over tiles, on all cores, and the same bits for any number of threads.

mod engine;
mod lanes;
mod memory;
mod passes;
mod prefetch;
mod store;
mod view;

pub use engine::{CpuEngine, InstructionSet};
