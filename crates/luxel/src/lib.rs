//! Luxel for programs: data sets, training, rendering, editing and export of scenes in scene-linear radiance.
//!
//! This crate does what the program `luxel` does. It prints nothing and parses no arguments: long tasks report to an [`Observer`],
//! and errors carry a message, their causes and a remedy.

pub mod colormap;
mod dataset;
mod device;
mod error;
mod events;
pub mod files;
pub mod machine;
pub mod memory;
pub mod preview;
mod radiance;
mod renderer;
pub mod report;
pub mod run;
mod scene;
pub mod synthetic;
pub mod text;
mod training;

pub use dataset::{Dataset, bad_pixel_lines};
pub use device::{Device, DeviceOptions, SelectedEngine};
pub use error::{Error, Result};
pub use events::{Event, Listening, Observer, Silent, StopFlag};
pub use luxel_core::tone::Tonemap;
pub use luxel_core::{Camera, ColorSpace, Edit, View};
pub use luxel_cpu::InstructionSet;
pub use luxel_io::{LoadOptions, Supervision};
pub use luxel_train::{Method, Preset, SplitMetrics, TrainConfig};
pub use radiance::Radiance;
pub use renderer::Renderer;
pub use scene::Scene;
pub use training::{Progress, Training, TrainingBuilder};

/// Version of this crate, which run folders and metrics note.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
