//! How an engine holds Adam's moments.

use serde::{Deserialize, Serialize};

/// Format of the moments of Adam's steps in an engine's memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MomentFormat {
    /// Single precision: eight bytes a parameter for both moments.
    #[default]
    F32,
    /// Sixteen bits each, so four bytes a parameter: the exponent of single precision, and seven
    /// bits of the mantissa for the first moment, eight for the second, which has no sign. Each
    /// step rounds them up or down at random, so that their means are right; the random numbers
    /// depend on the step and the parameter alone.
    Bf16,
}
