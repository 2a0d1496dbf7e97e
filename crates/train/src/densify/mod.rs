//! Policies that add and remove splats. They map statistics and geometry to the rows of the new
//! scene; the engine's `densify` pass applies them.

pub mod adc;
pub mod mcmc;
