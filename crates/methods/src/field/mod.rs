//! Radiance fields: a multi-resolution hash grid and small networks, or a deep network alone, give
//! density and radiance at any place, in any direction; rays are marched through the occupied cells
//! and rendered. Gradients are exact and written by hand; results are the same bits for any number
//! of threads.

mod adam;
mod compare;
mod engine;
mod error;
mod files;
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
mod radiance_field;
mod raw;
mod render;
mod run;
mod run_options;
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

pub use self::engine::FieldEngine;
pub use self::error::FieldError;
pub use self::files::{FieldCheckpoint, read_field, read_field_run};
pub use self::grid::GridShape;
pub use self::head::ColorHead;
pub use self::loss::PixelLoss;
pub use self::objective::Objective;
pub use self::options::FieldConfig;
pub use self::radiance_field::{Field, FieldArrays, FieldShape};
pub use self::run::FieldRun;
pub use self::run_options::{check_exposures, field_network};
pub use self::space::Space;
pub use self::trainer::{FieldSnapshot, FieldState, FieldStep, FieldTrainer};
pub use self::trunk::FieldNetwork;
