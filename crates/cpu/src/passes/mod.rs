//! The passes of a training step, one file each. `color` runs within `project`, `color_backward` within `project_backward`: their
//! time is counted there. Two are none of a step's: `contribute` tells which splats a painted mask means, `evaluations` what there is to blend;
//! both `walk` through a block as `rasterize` does. `picks` is what `rasterize` finds a block's splats with, `changes`
//! what it leaves for `rasterize_backward`, `sums` how that adds up over a block's pixels.

pub(crate) mod adam;
pub(crate) mod bin;
pub(crate) mod blend;
pub(crate) mod changes;
pub(crate) mod color;
pub(crate) mod color_backward;
pub(crate) mod contribute;
pub(crate) mod densify;
pub(crate) mod evaluations;
pub(crate) mod loss;
pub(crate) mod picks;
pub(crate) mod project;
pub(crate) mod project_backward;
pub(crate) mod rasterize;
pub(crate) mod rasterize_backward;
pub(crate) mod samples;
pub(crate) mod shares;
pub(crate) mod sort;
pub(crate) mod sums;
pub(crate) mod update;
pub(crate) mod walk;
