//! The options of training a field.

use luxel_core::RadianceScale;
use serde::{Deserialize, Serialize};

use crate::grid::GridShape;
use crate::loss::PixelLoss;

/// Options of training a field.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldConfig {
    /// Number of steps.
    pub iterations: u32,
    /// Seed of everything random.
    pub seed: u64,
    /// The loss.
    pub loss: PixelLoss,
    /// mu of the mu-law.
    pub mu: f32,
    /// Radiance of one normalised unit, data-set units.
    pub radiance_scale: RadianceScale,
    /// Size of the hash grid.
    pub grid: GridShape,
}
