//! The engine against an f64 oracle, against itself, and against the contract of `luxel_core::Engine`.

mod fixture;
mod number;
mod oracle;
mod gradients;
