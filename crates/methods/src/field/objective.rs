//! The images that a field learns from.
//!
//! Sources: NeRF (Mildenhall et al. 2020), HDR-NeRF (Huang et al. 2022), Mono-HDR-NeRF;
//! `docs/src/guide/radiance-fields.md` has what differs.

use serde::{Deserialize, Serialize};

use crate::field::head::ColorHead;
use crate::field::loss::PixelLoss;

/// The images that a field learns from, and how it is compared with them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Objective {
    /// Radiance.
    Radiance {
        /// The values that are compared.
        loss: PixelLoss,
    },
    /// Captured images of several exposures. Radiance is learned as its logarithm, beside a tone
    /// mapper for each channel.
    Captured {
        /// Value that is recorded at the unit exposure, which fixes the scale of radiance.
        unit_value: f32,
    },
    /// Radiance and a captured image of the same pose, all of one exposure. The captured value of a
    /// sample is learned, and a network that makes radiance of it.
    Pairs {
        /// Weight of the squared difference of captured values.
        captured_weight: f32,
        /// Weight of the squared difference of radiance under the mu-law.
        radiance_weight: f32,
    },
}

impl Objective {
    /// Returns the meaning of the raw colours of a field with this objective.
    pub fn head(self) -> ColorHead {
        match self {
            Self::Radiance { .. } => ColorHead::Softplus,
            Self::Captured { .. } => ColorHead::Log,
            Self::Pairs { .. } => ColorHead::Lifted,
        }
    }
}
