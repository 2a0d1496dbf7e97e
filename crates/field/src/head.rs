//! From raw colours to radiance.
//!
//! `softplus(raw)`: never negative, unbounded above, with a gradient everywhere.

/// Returns ln(1 + e^x).
#[inline]
pub(crate) fn softplus(x: f32) -> f32 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// Returns the derivative of [`softplus`]: 1 / (1 + e^-x).
#[inline]
pub(crate) fn logistic(x: f32) -> f32 {
    (1.0 + (-x).exp()).recip()
}
