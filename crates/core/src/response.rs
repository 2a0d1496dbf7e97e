//! Tone curves of the loss: the mu-law for radiance, and camera responses for captured LDR images.
//!
//! In: normalised radiance p >= 0 (negative counts as 0). Out: the value that the loss compares,
//! and its derivatives by p and by the knots.
//!
//! A response is piecewise linear between [`RESPONSE_KNOTS`] knots over
//! `u = ln(1 + 1023 x) / STEP`, where x is p times the exposure of the channel. Knots are half a
//! stop apart where x is far above 1/1023, and begin at x = 0, so that black has a finite position
//! and slope. x = 1 is exactly knot [`UNIT_KNOT`]: the unit-exposure constraint of HDR-NeRF (Huang
//! et al. 2022), which fixes the common scale of radiance and curve, sets the value of that knot.
//! The last piece continues beyond the last knot.
//!
//! A captured value at either end of its range is only a bound: there was at least (or at most) so
//! much light. [`Response::against`] treats a prediction beyond the bound as equal: value and
//! derivatives are those of an ignored pixel.

use serde::{Deserialize, Serialize};

use crate::tone::MuLaw;

/// Number of knots of a response curve: 31 pieces of half a stop, from black to 45 times the unit
/// exposure.
pub const RESPONSE_KNOTS: usize = 32;
/// Index of the knot at x = 1.
pub const UNIT_KNOT: usize = 20;
/// Constant of the knots' spacing: ln(1 + 1023 x) has 20 pieces between x = 0 and x = 1.
const RESPONSE_MU: f32 = 1023.0;
/// Smallest captured value that counts as saturated: half a code below the largest of 8 bits.
pub const SATURATED: f32 = 1.0 - 0.5 / 255.0;
/// Largest captured value that counts as black: half a code above the smallest of 8 bits.
pub const BLACK: f32 = 0.5 / 255.0;

/// The values of a response's knots, by channel.
pub type Knots = [[f32; RESPONSE_KNOTS]; 3];

/// The tone curve under which the loss compares images.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[expect(clippy::large_enum_variant, reason = "400 bytes a step, and a step's description stays free of allocations")]
pub enum ToneCurve {
    /// The mu-law ln(1 + mu p) / ln(1 + mu) of prediction and target; the view's image is radiance.
    MuLaw {
        /// Parameter of the mu-law; above 0.
        mu: f32,
    },
    /// A camera's response, of the prediction alone; the view's image is the captured LDR image.
    Response(Response),
}

/// A camera's response to the exposure of one view.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Response {
    /// Captured values at the knots; they never decrease.
    pub knots: Knots,
    /// Exposure x of normalised radiance 1, by channel; above 0.
    pub exposure: [f32; 3],
}

/// An evaluation of a [`Response`] at one radiance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recorded {
    /// LDR value; not clamped.
    pub value: f32,
    /// Derivative of the value by normalised radiance.
    pub by_radiance: f32,
    /// Position on the curve, in knots: the value lies on the line through the two knots beside it.
    pub position: f32,
    /// Weight of value and derivatives: 0 where the captured value is only a bound and the
    /// prediction satisfies it.
    pub weight: f32,
}

/// Returns the piece of the curve at `position`: its first knot, and the fraction along it (above 1
/// beyond the last knot).
#[inline]
pub fn piece(position: f32) -> (usize, f32) {
    let k = (position as usize).min(RESPONSE_KNOTS - 2);
    (k, position - k as f32)
}

/// Returns the exposure x of knot `k`.
pub fn exposure_of_knot(k: usize) -> f64 {
    let mu = f64::from(RESPONSE_MU);
    (k as f64 / UNIT_KNOT as f64 * mu.ln_1p()).exp_m1() / mu
}

impl Response {
    /// Evaluates the response to radiance `p` in channel `channel`.
    #[inline]
    pub fn apply(&self, channel: usize, p: f32) -> Recorded {
        let (knots, exposure) = (&self.knots[channel], self.exposure[channel]);
        let x = p.max(0.0) * exposure;
        let position = UNIT_KNOT as f32 * MuLaw::new(RESPONSE_MU).apply(x);
        let (k, along) = piece(position);
        let rise = knots[k + 1] - knots[k];
        let log = RESPONSE_MU.ln_1p();
        let by_x = rise * (UNIT_KNOT as f32 / log) * RESPONSE_MU / RESPONSE_MU.mul_add(x, 1.0);
        Recorded { value: along.mul_add(rise, knots[k]), by_radiance: by_x * exposure, position, weight: 1.0 }
    }

    /// Evaluates [`Self::apply`] for comparison with a captured value: beyond a saturated or black
    /// one the value is that one, without derivatives.
    #[inline]
    pub fn against(&self, channel: usize, p: f32, recorded: f32) -> Recorded {
        let found = self.apply(channel, p);
        if (recorded >= SATURATED && found.value > recorded) || (recorded <= BLACK && found.value < recorded) {
            return Recorded { value: recorded, by_radiance: 0.0, weight: 0.0, ..found };
        }
        found
    }

    /// Returns the exposure x at which the curve of `knots` gives `value`.
    ///
    /// A flat piece gives its middle; a value beyond the first or last knot gives that knot's
    /// exposure.
    pub fn exposure_at(knots: &[f32; RESPONSE_KNOTS], value: f32) -> f64 {
        let k = (0..RESPONSE_KNOTS - 2).find(|k| knots[k + 1] >= value).unwrap_or(RESPONSE_KNOTS - 2);
        let rise = knots[k + 1] - knots[k];
        let along = if rise > f32::EPSILON { ((value - knots[k]) / rise).clamp(0.0, 1.0) } else { 0.5 };
        let mu = f64::from(RESPONSE_MU);
        ((k as f64 + f64::from(along)) / UNIT_KNOT as f64 * mu.ln_1p()).exp_m1() / mu
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gamma() -> Response {
        let knots: [f32; RESPONSE_KNOTS] = std::array::from_fn(|k| (0.5 * exposure_of_knot(k).powf(1.0 / 2.2)) as f32);
        Response { knots: [knots; 3], exposure: [1.0, 2.0, 0.25] }
    }

    #[test]
    fn the_unit_exposure_is_a_knot() {
        assert!((exposure_of_knot(UNIT_KNOT) - 1.0).abs() < 1e-12 && exposure_of_knot(0) == 0.0);
        assert!((gamma().apply(0, 1.0).value - 0.5).abs() < 1e-6);
        // A channel's exposure is radiance times the factor of the channel.
        assert!((gamma().apply(1, 0.5).value - 0.5).abs() < 1e-6 && (gamma().apply(2, 4.0).value - 0.5).abs() < 1e-6);
    }

    #[test]
    fn a_smooth_curve_is_followed_between_the_knots() {
        for i in 0..400 {
            let x = 0.005 * 1.02f64.powi(i);
            let (found, expected) = (f64::from(gamma().apply(0, x as f32).value), 0.5 * x.powf(1.0 / 2.2));
            assert!(x > 45.0 || (found - expected).abs() < 4e-3 * expected.max(0.2), "{x}: {found} {expected}");
        }
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        let response = gamma();
        for (channel, p) in [(0, 0.0), (0, 0.013), (1, 0.7), (2, 3.3), (0, 44.0), (1, 60.0)] {
            let at = response.apply(channel, p);
            let h = (p * 1e-3).max(1e-6);
            let numeric = (response.apply(channel, p + h).value - at.value) / h;
            assert!((numeric - at.by_radiance).abs() < 2e-3 * at.by_radiance, "{p}: {numeric} {}", at.by_radiance);
            let (k, along) = piece(at.position);
            let by_hand = response.knots[channel][k] * (1.0 - along) + response.knots[channel][k + 1] * along;
            assert!((by_hand - at.value).abs() < 1e-5 * at.value.max(0.1));
        }
    }

    #[test]
    fn clipped_pixels_ask_for_at_least_or_at_most_what_they_show() {
        let response = gamma();
        let bright = response.against(0, 30.0, 1.0);
        assert_eq!((bright.value, bright.by_radiance, bright.weight), (1.0, 0.0, 0.0));
        // Below white the gradient pulls up; a pixel that is not clipped pulls down from beyond 1.
        assert!(response.against(0, 0.1, 1.0).by_radiance > 0.0);
        assert!(response.against(0, 30.0, 0.9).by_radiance > 0.0 && response.against(0, 30.0, 0.9).value > 1.0);
        let mut lifted = response;
        lifted.knots[0][0] = -0.1;
        assert_eq!(lifted.against(0, 0.0, 0.0).weight, 0.0);
        assert_eq!(response.against(0, 0.5, 0.0).weight, 1.0);
    }

    #[test]
    fn the_inverse_finds_the_exposure() {
        let response = gamma();
        for x in [0.01f32, 0.2, 1.0, 3.7, 20.0] {
            let value = response.apply(0, x).value;
            let found = Response::exposure_at(&response.knots[0], value);
            assert!((found / f64::from(x) - 1.0).abs() < 1e-3, "{x} {found}");
        }
        assert_eq!(Response::exposure_at(&response.knots[0], -1.0), 0.0);
        assert!((Response::exposure_at(&response.knots[0], 9.0) - exposure_of_knot(RESPONSE_KNOTS - 1)).abs() < 1e-9);
        assert!(Response::exposure_at(&[0.5; RESPONSE_KNOTS], 0.5).is_finite());
    }

    #[test]
    fn curves_survive_json_bit_for_bit() {
        for curve in [ToneCurve::MuLaw { mu: 5000.0 }, ToneCurve::Response(gamma())] {
            let json = serde_json::to_string(&curve).unwrap();
            assert_eq!(serde_json::from_str::<ToneCurve>(&json).unwrap(), curve);
        }
    }
}
