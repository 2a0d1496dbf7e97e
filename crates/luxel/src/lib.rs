//! Luxel for programs: data sets, training, rendering, editing and export of scenes in scene-linear
//! radiance.
//!
//! This crate is what a program embeds. It prints nothing and parses no arguments: long tasks
//! report to an [`Observer`], and errors carry a message and their causes.
//!
//! - [`Dataset`] reads posed images.
//! - [`Training`] makes a [`Scene`] of them, step by step, in memory. The crate `luxel-app` does it
//!   in a folder, with checkpoints, metrics and a report.
//! - [`Renderer`] turns a scene and a camera into [`Radiance`], an image in the units of the data
//!   set.
//! - [`Device`] chooses what computes: the processor or a GPU.
//!
//! The feature `methods`, off by default, adds published methods to compare with.
//!
//! Two mistakes are impossible: a scene renders with its own raster settings, and images in
//! normalised units stay inside of the crate.
//!
//! ```standalone_crate
//! use luxel::{Dataset, Device, Edit, Preset, Renderer, Result, Training, synthetic};
//!
//! fn main() -> Result<()> {
//! #   let folder = tempfile::tempdir().unwrap();
//! #   std::env::set_current_dir(folder.path()).unwrap();
//!     // In place of a data set of yours.
//!     synthetic::write_dataset("my-images", synthetic::BallsOptions::default())?;
//!     let dataset = Dataset::open("my-images")?; // the layout is recognised
//!
//!     let mut training = Training::builder(&dataset)
//!         .preset(Preset::Fast)
//!         .steps(20)
//!         .device(Device::Cpu)
//!         .start()?;
//!     for step in training.by_ref() {
//!         let step = step?;
//!         if step.number % 10 == 0 {
//!             println!("{:>6}  loss {:.4}  {} splats", step.number, step.loss, step.splats);
//!         }
//!     }
//!     let metrics = training.evaluate(&dataset.test)?;
//!     println!("{:.2} dB (scene)", metrics.mean.psnr_scene);
//!
//!     let mut scene = training.into_scene()?;
//!     scene.edit(&"where L > p95 ~2; compress-above 2:4".parse::<Edit>()?)?;
//!     scene.save("balls.ply")?;
//!
//!     let mut renderer = Renderer::new(&scene, Device::Cpu)?;
//!     for view in &dataset.test {
//!         renderer.render(&view.camera)?.save_exr(format!("{}.exr", view.stem()))?;
//!     }
//!     Ok(())
//! }
//! ```

pub mod aov;
pub mod camera_path;
pub mod compare;
mod dataset;
mod device;
pub mod display_lut;
pub mod edit;
pub mod error;
mod events;
pub mod export;
pub mod lens;
pub mod lights;
mod live;
mod log_record;
pub mod memory;
pub mod mesh;
pub mod mix;
pub mod output;
pub mod photograph;
pub mod preview;
pub mod probe;
mod radiance;
pub mod refined_views;
mod renderer;
mod scene;
pub mod step_methods;
pub mod synthetic;
mod training;
mod up;
pub mod video;
mod visibility;

/// Vectors and matrices of cameras, similarities and lamps.
pub use glam;

pub use dataset::{Dataset, ImageLimits, bad_pixel_lines, reduction_line};
pub use device::{Device, DeviceOptions, MAX_THREADS, SelectedEngine, processor_name, start_threads};
pub use error::{Error, Result, remedy_of};
pub use events::{Event, FrameProgress, ItemKind, Observer, Silent, StopFlag, StopListener, VisitAction};
pub use export::{Bake, ExportOptions};
pub use live::LiveRun;
pub use log_record::LogRecord;
pub use luxel_core::tone::Tonemap;
pub use luxel_core::{Camera, ColorSpace, Edit, Remedy, View};
pub use luxel_cpu::InstructionSet;
pub use luxel_io::{Downscale, ImageMemory, LoadOptions, PathCamera, Supervision};
pub use luxel_metrics::SplitMetrics;
pub use luxel_train::{LensVignetting, Method, PoseChange, PoseReport, Preset, TrainConfig};
pub use probe::{Probe, ProbeOptions};
pub use radiance::{FAR_DEPTH, RADIANCE_SCALE, Radiance, RadianceLayers};
pub use renderer::Renderer;
pub use scene::{Scene, decode_cameras, read_cameras};
pub use training::{Progress, Training, TrainingBuilder};

/// Version of this crate, which run folders and metrics note.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The examples of the guide's page on the library, compiled as doc tests.
#[cfg(doctest)]
#[doc = include_str!("../../../docs/src/guide/library.md")]
struct GuideExamples;

/// The example of the crate's README, compiled as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct CrateReadmeExample;
