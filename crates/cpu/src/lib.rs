//! The CPU engine: the eleven passes of training, with SIMD over tiles, on all cores. Results are
//! the same bits for any number of threads.
//!
//! ```
//! use luxel_core::{Engine, RenderOptions, synthetic};
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // A synthetic room of 500 splats, seen by its own camera.
//! let mut engine = luxel_cpu::CpuEngine::new(2)?;
//! engine.load(&synthetic::room(500, 1), None)?;
//! let image = engine.render(&synthetic::room_camera([32, 24]), &RenderOptions::default())?;
//! assert_eq!((image.width, image.height), (32, 24));
//! assert!(image.pixels.iter().flatten().any(|radiance| *radiance > 0.0));
//! # Ok(())
//! # }
//! ```

mod engine;
mod lanes;
mod memory;
mod moments;
mod passes;
mod prefetch;
mod rays;
mod store;
mod tiles;
mod view;

pub use engine::{CpuEngine, InstructionSet};

/// The example of the crate's README, compiled as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct CrateReadmeExample;
