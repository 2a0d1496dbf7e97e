//! Tone curves: the mu-law of the loss and the metrics.

/// mu of the mu-law, as in LCD-GS and its predecessors.
pub const MU: f32 = 5000.0;

/// ln(1 + mu p) / ln(1 + mu), for p >= 0.
#[inline]
pub fn mu_law(p: f32, mu: f32) -> f32 {
    (mu * p).ln_1p() / mu.ln_1p()
}

/// p of a mu-law value.
#[inline]
pub fn mu_law_inverse(t: f32, mu: f32) -> f32 {
    (t * mu.ln_1p()).exp_m1() / mu
}
