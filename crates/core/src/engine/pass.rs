//! The passes of a training step, in order, and their names.

use std::time::Duration;

use serde::{Deserialize, Serialize};

/// A pass of a training step. Files, timings, benches and tests use its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pass {
    /// Projects splats to screen-space ellipses.
    Project,
    /// Evaluates radiance towards the camera.
    Color,
    /// Assigns splats to tiles.
    Bin,
    /// Sorts each tile's splats from front to back.
    Sort,
    /// Blends splats into pixels, front to back.
    Rasterize,
    /// Computes the loss and its gradient by the pixels.
    Loss,
    /// Computes the gradient by the ellipses and colours.
    RasterizeBackward,
    /// Computes the gradient by the colour model's coefficients and the viewing direction.
    ColorBackward,
    /// Computes the gradient by position, rotation, scale and opacity.
    ProjectBackward,
    /// Updates the parameters.
    Adam,
    /// Adds and removes splats.
    Densify,
}

/// The time spent in a pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PassTime {
    /// The pass.
    pub pass: Pass,
    /// The time, summed over steps.
    pub time: Duration,
}

impl Pass {
    /// All passes, in order.
    pub const ALL: [Self; 11] = [
        Self::Project,
        Self::Color,
        Self::Bin,
        Self::Sort,
        Self::Rasterize,
        Self::Loss,
        Self::RasterizeBackward,
        Self::ColorBackward,
        Self::ProjectBackward,
        Self::Adam,
        Self::Densify,
    ];

    /// Returns the pass's name in snake case, such as `rasterize_backward`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Project => "project",
            Self::Color => "color",
            Self::Bin => "bin",
            Self::Sort => "sort",
            Self::Rasterize => "rasterize",
            Self::Loss => "loss",
            Self::RasterizeBackward => "rasterize_backward",
            Self::ColorBackward => "color_backward",
            Self::ProjectBackward => "project_backward",
            Self::Adam => "adam",
            Self::Densify => "densify",
        }
    }
}
