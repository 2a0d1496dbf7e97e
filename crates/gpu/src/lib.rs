//! The GPU engine: the passes as WGSL compute shaders, through wgpu on Vulkan, Metal and DirectX 12. The CPU engine is its oracle.
//!
//! [`adapters`] lists what there is, [`Gpu::open`] takes one of them, [`GpuEngine`] works on it. Everything from the images' upload to the update of
//! the parameters and the application of densification plans runs on the device; a step hands back 32 bytes and its timestamps, some steps
//! later. Sums are made in fixed orders and no two threads add to one number, so equal inputs give equal bits on one adapter.

mod adapter;
mod commands;
mod constants;
mod densify;
mod device;
mod engine;
mod frame;
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
pub use engine::{GpuEngine, Traffic};
pub use inspect::ForwardPasses;
pub use layout::Footprint;

/// The example of the crate's README, compiled as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct CrateReadmeExample;
