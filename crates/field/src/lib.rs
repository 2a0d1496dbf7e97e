//! Radiance fields: a multi-resolution hash grid and small networks, or a deep network alone, give
//! density and radiance at any place, in any direction; rays are marched through the occupied cells
//! and rendered. Gradients are exact and written by hand; results are the same bits for any number
//! of threads.

mod adam;
mod compare;
mod engine;
mod error;
mod field;
mod frequencies;
mod grid;
mod head;
mod lift;
mod loss;
mod march;
mod memory;
mod networks;
mod objective;
mod occupancy;
mod options;
mod raw;
mod render;
mod sampling;
mod space;
mod task;
#[cfg(test)]
mod tests;
mod threads;
mod tone_mapper;
mod trainer;
mod trunk;
mod views;
mod volume;

pub use engine::FieldEngine;
pub use error::FieldError;
pub use field::{Field, FieldArrays, FieldShape};
pub use grid::GridShape;
pub use head::ColorHead;
pub use loss::PixelLoss;
pub use objective::Objective;
pub use options::FieldConfig;
pub use space::Space;
pub use trainer::{FieldSnapshot, FieldState, FieldStep, FieldTrainer};
pub use trunk::FieldNetwork;

/// The example of the crate's README, compiled as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct CrateReadmeExample;
