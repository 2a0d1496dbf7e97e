//! The options of training a field.

use luxel_core::RadianceScale;
use serde::{Deserialize, Serialize};

use crate::grid::GridShape;
use crate::loss::FieldLoss;

/// Options of training a field.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldOptions {
    /// Number of steps.
    pub iterations: u32,
    /// Seed of everything random.
    pub seed: u64,
    /// The loss.
    pub loss: FieldLoss,
    /// mu of the mu-law.
    pub mu: f32,
    /// Background radiance, normalised units.
    pub background: [f32; 3],
    /// Radiance of one normalised unit, data-set units.
    pub radiance_scale: RadianceScale,
    /// Size of the hash grid.
    pub grid: GridShape,
}
