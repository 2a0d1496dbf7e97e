//! The luminance of a splat from its raw parameter, and how a factor on the luminance changes the
//! parameters.
//!
//! In: raw parameters, any finite number. Out: luminances >= 0 in normalised units, their
//! derivatives, and the parameters of a given luminance. Source: LCD-GS, "g". Degenerate: black has
//! no logarithm, so it is [`DARKEST`].

use serde::{Deserialize, Serialize};

use crate::Real;

/// Map from the raw luminance parameter to a positive luminance (LCD-GS, "g").
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Activation {
    /// ln(1 + e^l), the paper's choice: multiplicative steps for dark splats, additive steps for
    /// bright ones.
    #[default]
    Softplus,
    /// e^l.
    Exp,
    /// max(l, 0): its gradient vanishes below zero.
    Relu,
}

/// Largest argument of the exponential activation: e^60 = 1.1e26 leaves room for products within
/// f32.
pub const MAX_EXP_ARGUMENT: f32 = 60.0;

/// Luminance that represents black, since the logarithm of 0 is not a valid parameter. It is far
/// below every cut-off.
const DARKEST: f32 = 1e-8;

/// Returns ln(1 + e^x), as max(x, 0) + ln(1 + e^-|x|), which neither overflows nor loses the small
/// values of very negative x.
#[inline(always)]
pub fn softplus<R: Real>(x: R) -> R {
    x.max(x.lift(0.0)) + (-(x.max(-x))).exp().ln_1p()
}

impl Activation {
    /// Returns the luminance of the raw parameter.
    #[inline(always)]
    pub fn apply<R: Real>(self, raw: R) -> R {
        let zero = raw.lift(0.0);
        match self {
            Self::Softplus => softplus(raw),
            Self::Exp => raw.min(raw.lift(MAX_EXP_ARGUMENT)).exp(),
            Self::Relu => raw.max(zero),
        }
    }

    /// Returns the derivative of [`Self::apply`].
    #[inline(always)]
    pub fn derivative<R: Real>(self, raw: R) -> R {
        let (zero, one) = (raw.lift(0.0), raw.lift(1.0));
        match self {
            Self::Softplus => {
                let e = (-(raw.max(-raw))).exp();
                raw.if_positive(one, e) / (one + e)
            }
            Self::Exp => {
                let limit = raw.lift(MAX_EXP_ARGUMENT);
                (limit - raw).if_positive(raw.min(limit).exp(), zero)
            }
            Self::Relu => raw.if_positive(one, zero),
        }
    }

    /// Returns the raw parameter of a luminance.
    ///
    /// Luminances below 1e-8 count as 1e-8, except for [`Self::Relu`].
    pub fn inverse(self, luminance: f32) -> f32 {
        let l = luminance.max(DARKEST);
        match self {
            // ln(e^L - 1), written so that it neither overflows nor cancels.
            Self::Softplus => l + (-(-l).exp_m1()).ln(),
            Self::Exp => l.ln(),
            Self::Relu => luminance.max(0.0),
        }
    }
}

/// Changes `raw [M]` so that the activated luminance is multiplied by `factor`.
pub(super) fn scale_luminance(activation: Activation, raw: &mut [f32], factor: f32) {
    let Some((constant, rest)) = raw.split_first_mut() else { return };
    let before = *constant;
    let rest_factor;
    (*constant, rest_factor) = match activation {
        // Homogeneous: all coefficients scale, and so do values below zero.
        Activation::Relu => (before * factor, factor),
        // Black has no logarithm and is the same in every direction.
        _ if factor <= 0.0 => (before.min(activation.inverse(0.0)), 0.0),
        // The caller detects the overflow.
        Activation::Exp if (factor * activation.apply(before)).is_infinite() => (f32::INFINITY, 1.0),
        // A factor shifts the constant term.
        Activation::Exp => (before.min(MAX_EXP_ARGUMENT) + factor.ln(), 1.0),
        Activation::Softplus => scaled_softplus(before, factor),
    };
    for value in rest {
        *value *= rest_factor;
    }
}

/// Returns the constant term of a softplus `factor` times that of `before`, and the factor of the
/// view-dependent terms.
///
/// g(l') = f g(l) at the constant term, and f g'(l) dl = g'(l') dl' near it. Below [`DARKEST`], g
/// equals e^l to rounding and is its own derivative.
fn scaled_softplus(before: f32, factor: f32) -> (f32, f32) {
    let softplus = Activation::Softplus;
    let luminance = softplus.apply(before);
    if factor * luminance >= DARKEST {
        let after = softplus.inverse(factor * luminance);
        (after, factor * softplus.derivative(before) / softplus.derivative(after))
    } else if luminance >= DARKEST {
        (luminance.ln() + factor.ln(), softplus.derivative(before) / luminance)
    } else {
        (before + factor.ln(), 1.0)
    }
}
