//! The GPU engine: the passes as WGSL compute shaders, through wgpu on Vulkan, Metal and DirectX
//! 12. Its results are tested against those of the CPU engine.
//!
//! [`adapters`] lists the GPUs, [`Gpu::open`] opens one, and [`GpuEngine`] runs on it. Everything
//! from the upload of images to the update of the parameters and the application of densification
//! plans runs on the device; a step returns 32 bytes and its timestamps, some steps later. Sums
//! have fixed orders, and no two threads add to the same number, so equal inputs give equal bits on
//! one adapter.
//!
//! ```no_run
//! use luxel_core::{Engine, RenderOptions, synthetic};
//! use luxel_gpu::{DeviceChoice, Gpu, GpuEngine};
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let gpu = Gpu::open(&DeviceChoice::Best)?;
//! let mut engine = GpuEngine::new(&gpu)?;
//! engine.load(&synthetic::room(10_000, 1), None)?;
//! let image = engine.render(&synthetic::room_camera([640, 480]), &RenderOptions::default())?;
//! # Ok(())
//! # }
//! ```

mod adapter;
mod block_on;
mod commands;
mod constants;
mod densify;
mod device;
mod engine;
mod forward;
mod frame;
mod image_copy;
mod inspect;
mod kernels;
mod layout;
mod pending;
mod scene;
mod screen;
mod step;
mod targets;

pub use adapter::{AdapterFacts, AdapterKind, DeviceChoice, adapters};
pub use device::Gpu;
pub use engine::work::Work;
pub use engine::{GpuEngine, Traffic};
pub use inspect::ForwardPasses;
pub use layout::Footprint;

/// The example of the crate's README, compiled as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct CrateReadmeExample;
