//! Policies that add and remove splats. They look at statistics and geometry, and answer with the rows of the scene to be; the
//! engine's `densify` pass applies them.

pub mod adc;
pub mod mcmc;
