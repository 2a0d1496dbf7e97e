//! Per-pixel weights of an image: how much each pixel counts.
//!
//! In: weights `[H*W]`, row-major, 0 to 1. Out: which pixels are valid, and their weights. Without
//! a mask all pixels count fully; pixels outside a mask do not count.

/// A weight for each pixel in the loss: 0 excludes it, 1 counts it fully. Row-major, `[H*W]`.
/// Metrics count every pixel above 0 fully.
///
/// ```
/// use luxel_core::{Mask, mask};
///
/// let half = Mask::from_valid([true, false]);
/// assert_eq!((half.is_valid(0), half.is_valid(1), half.is_valid(2)), (true, false, false));
/// assert_eq!(half.total(), Some(1.0));
/// assert!(mask::is_valid(None, 7) && !mask::is_valid(Some(&half), 1));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Mask {
    /// One weight per pixel, 0 to 1.
    pub weights: Vec<f32>,
}

impl Mask {
    /// Returns the mask of pixels that count fully or not at all.
    pub fn from_valid(valid: impl IntoIterator<Item = bool>) -> Self {
        Self { weights: valid.into_iter().map(|valid| f32::from(u8::from(valid))).collect() }
    }

    /// Returns whether pixel `i` counts; pixels outside the mask do not.
    #[inline]
    pub fn is_valid(&self, i: usize) -> bool {
        self.weights.get(i).is_some_and(|weight| *weight > 0.0)
    }

    /// Returns the sum of the weights; `None` if one is not a number from 0 to 1.
    pub fn total(&self) -> Option<f64> {
        let mut total = 0.0;
        for weight in &self.weights {
            if !(0.0..=1.0).contains(weight) {
                return None;
            }
            total += f64::from(*weight);
        }
        Some(total)
    }
}

/// Returns whether pixel `i` counts under an optional mask.
#[inline]
pub fn is_valid(mask: Option<&Mask>, i: usize) -> bool {
    mask.is_none_or(|mask| mask.is_valid(i))
}

/// Returns the weight of pixel `i` under an optional mask, 0 to 1.
#[inline]
pub fn weight(mask: Option<&Mask>, i: usize) -> f32 {
    mask.map_or(1.0, |mask| mask.weights.get(i).copied().unwrap_or(0.0))
}
