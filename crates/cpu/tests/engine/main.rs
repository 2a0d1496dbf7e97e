//! The engine against an f64 oracle, against itself, and against the contract of
//! `luxel_core::Engine`.

// A test binary has no outside to be reached from.
#![allow(unreachable_pub)]
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod contract;
mod curves;
mod edits;
mod fixture;
mod gradients;
mod image;
mod layers;
mod number;
mod oracle;
mod probe;
mod update;
