//! Panoramas for structure from motion that knows only pinhole cameras: pictures cut out of them,
//! and the pose of a panorama from the poses of its cut-outs.
//!
//! A cut-out shows one of six directions at right angles, 100 degrees across, so that neighbours
//! overlap by ten. Axes of the panorama's camera: x right, y down, z towards the middle of the
//! image, as `luxel_core::Camera::panorama` has them.

mod cutout;
mod pose;

pub use cutout::{CutoutLens, Face, cut_out};
pub use pose::{CutoutPose, PanoramaPose, panorama_pose};
