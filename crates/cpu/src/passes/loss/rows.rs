//! Bands and groups of rows, in which the loss goes down the image.
//!
//! A band is the work of one task; a group is as many rows as one convolution computes. Out:
//! numbers of rows and slots of the ring that keeps groups.

use super::convolution::GROUP;
use super::plan::LossPlan;
use crate::view::BLOCK_PX;

/// Rows of a band: whole blocks, and whole groups.
pub(super) const BAND_PX: usize = 20;
/// Groups of a band.
pub(super) const BAND_GROUPS: usize = BAND_PX / GROUP;
/// Groups that are kept: a group's window reaches into both of its neighbours.
pub(super) const RING: usize = 3;
/// Groups above the image, so that groups above the first row have numbers, too.
const ABOVE: usize = 2;

const _: () = assert!(BAND_PX.is_multiple_of(BLOCK_PX) && BAND_PX.is_multiple_of(GROUP));

/// A group of rows, counted from [`ABOVE`] the image.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct RowGroup(usize);

impl RowGroup {
    /// Returns the group that lies `above` groups above the first group of a band.
    pub(super) fn of_band(band: usize, above: usize) -> Self {
        Self(ABOVE + band * BAND_GROUPS - above)
    }

    /// Returns the image's row of row `j` of the group, if it is within the image.
    pub(super) fn row(self, plan: &LossPlan, j: usize) -> Option<usize> {
        (self.0 * GROUP + j).checked_sub(ABOVE * GROUP).filter(|y| *y < plan.height)
    }

    /// Returns the slot of the ring that keeps the group.
    pub(super) fn slot(self) -> usize {
        self.0 % RING
    }

    /// Returns the group above, itself and the group below.
    pub(super) fn window(self) -> [Self; 3] {
        [Self(self.0 - 1), self, Self(self.0 + 1)]
    }

    /// Returns the group below.
    pub(super) fn next(self) -> Self {
        Self(self.0 + 1)
    }
}
