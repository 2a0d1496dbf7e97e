//! Tests of the engine: compared with an f64 oracle, with itself, and with the contract of
//! `luxel_core::Engine`.

// A test binary exports nothing.
#![allow(unreachable_pub, reason = "modules of a test share their items")]
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod batch;
mod blend_reference;
mod blending;
mod camera;
mod channels;
mod contract;
mod curves;
mod deep;
mod dropout;
mod edits;
mod fixture;
mod gradients;
mod image;
mod layers;
mod mix;
mod number;
mod oracle;
mod packed_moments;
mod probe;
mod ray_reference;
mod surface;
mod tile_memory;
mod update;
mod vignetting;
mod wide;
