//! The images that several methods train on: checks of the data, a step on a pair of a captured
//! image and radiance, and the losses of both.

pub(super) mod checks;
pub(super) mod image_loss;
pub(super) mod pair_channels;
pub(super) mod radiance_loss;
