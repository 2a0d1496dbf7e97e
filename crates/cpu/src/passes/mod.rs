//! The passes of a training step, one file each, and their helpers.
//!
//! `color` runs within `project`, and `color_backward` within `project_backward`; their time is
//! counted there. `camera_backward` runs only in steps that ask for it, and `vignetting` only where
//! the target has it; its time is counted with `loss`. Passes that are not part of a step:
//! `contribute` measures which splats a painted mask selects, and `evaluations` counts how many
//! splats are blended; `deep` lists what pixels are blended from, and `surface` finds their depths.
//! All go through a block's splats with `visit_block`, in the order of `rasterize`. `normals`
//! writes normals in place of radiance, which are then blended alike. `gain` is the light of edits,
//! which scenes in training do not have.
//!
//! Helpers: `picks` finds the splats of a block for `rasterize`; `changes` records which splats
//! changed which pixels, for `rasterize_backward`; `sums` adds gradients up over the pixels of a
//! block, and `screen_gradients` keeps them; `more_channels` blends more than three channels;
//! `samples` averages supersamples; `tile_records` keeps what passes know about tiles; `pass_times`
//! measures passes that run together.

pub(crate) mod activated;
pub(crate) mod adam;
pub(crate) mod bin;
pub(crate) mod blend;
pub(crate) mod camera_backward;
pub(crate) mod changes;
pub(crate) mod channel_planes;
pub(crate) mod color;
pub(crate) mod color_backward;
pub(crate) mod contribute;
pub(crate) mod deep;
pub(crate) mod densify;
pub(crate) mod directional;
pub(crate) mod dropout;
pub(crate) mod ellipse_backward;
pub(crate) mod encoding;
pub(crate) mod evaluations;
pub(crate) mod gain;
pub(crate) mod loss;
pub(crate) mod more_channels;
pub(crate) mod more_channels_backward;
pub(crate) mod normals;
pub(crate) mod pass_times;
pub(crate) mod picks;
pub(crate) mod project;
pub(crate) mod project_all;
pub(crate) mod project_backward;
pub(crate) mod project_backward_rays;
pub(crate) mod project_rays;
pub(crate) mod rasterize;
pub(crate) mod rasterize_backward;
pub(crate) mod samples;
pub(crate) mod screen_gradients;
pub(crate) mod sort;
pub(crate) mod sort_and_rasterize;
pub(crate) mod sparse_update;
pub(crate) mod splat_channels;
pub(crate) mod sums;
pub(crate) mod surface;
pub(crate) mod tile_records;
pub(crate) mod update;
pub(crate) mod vignetting;
pub(crate) mod visit_block;
