//! The order of a splat's parameters where an engine stores them one row per parameter.
//!
//! Position 3, rotation 4, log scale 3, opacity logit 1, harmonics 3K (coefficient by coefficient,
//! then channel), raw luminance M. The 3D smoothing filter is no parameter and has no row.

use crate::ColorModel;

/// The rows of a splat's parameters under a colour model.
///
/// ```
/// use luxel_core::ColorModel;
/// use luxel_core::engine::ParameterRows;
///
/// let rows = ParameterRows { color_model: ColorModel::Sh { degree: 3 } };
/// assert_eq!(rows.count(), 11 + 3 * 16);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ParameterRows {
    /// Colour model, which determines the number of colour rows.
    pub color_model: ColorModel,
}

impl ParameterRows {
    /// First of the position's three rows.
    pub const POSITION: usize = 0;
    /// First of the rotation's four rows: w, x, y, z.
    pub const ROTATION: usize = 3;
    /// First of the log scale's three rows.
    pub const LOG_SCALE: usize = 7;
    /// Row of the opacity logit.
    pub const OPACITY: usize = 10;
    /// First row of the harmonics.
    pub const SH: usize = 11;

    /// Returns the first row of the raw luminance.
    #[inline]
    pub fn luminance(self) -> usize {
        Self::SH + 3 * self.color_model.sh_coefficients()
    }

    /// Returns the number of rows: the parameters of a splat.
    #[inline]
    pub fn count(self) -> usize {
        self.luminance() + self.color_model.luminance_coefficients()
    }
}
