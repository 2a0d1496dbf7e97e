//! The options of training a field.

use luxel_core::RadianceScale;
use serde::{Deserialize, Serialize};

use crate::field::objective::Objective;
use crate::field::trunk::FieldNetwork;

/// Options of training a field.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldConfig {
    /// Number of steps.
    pub iterations: u32,
    /// Seed of everything random.
    pub seed: u64,
    /// The images that the field learns from, and how it is compared.
    pub objective: Objective,
    /// mu of the mu-law.
    pub mu: f32,
    /// Radiance of one normalised unit, data-set units.
    pub radiance_scale: RadianceScale,
    /// The map from positions to density and colour.
    pub network: FieldNetwork,
}
