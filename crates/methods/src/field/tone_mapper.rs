//! The tone mappers of a field of log radiance: from radiance and exposure to captured values.
//!
//! In: radiance x of rays in normalised units, exposure t of their images. Out: captured values
//! y = logistic(u(ln x + ln t)), where u is a network of one hidden layer for each channel and t is
//! in seconds times the radiance of a normalised unit; and the exact gradient by radiance and
//! weights. A tone mapper cannot be told from a factor on radiance: a loss draws the value at the
//! unit exposure, ln x + ln t = 0, towards a given one (HDR-NeRF, Huang et al. 2022). Degenerate:
//! black has no logarithm; radiance below [`DARKEST`] counts as that and has no gradient.

use fearless_simd::Simd;
use luxel_core::response::exposure_of_knot;
use luxel_core::{Knots, RESPONSE_KNOTS, sigmoid};
use luxel_lanes::LANES;

use crate::field::adam::{Moving, Rate};
use crate::field::head::{ColorHead, Head, fill_inputs};
use crate::field::radiance_field::Field;
use crate::field::raw::RAW;
use crate::networks::Activations;

/// Normalised radiance that black counts as.
const DARKEST: f32 = 1e-12;
/// Weight of the loss of the value at the unit exposure.
const UNIT_WEIGHT: f64 = 0.5;
/// Exponent of the curve that tone mappers begin with: `unit x^(1/2.2)`.
const START_GAMMA: f64 = 2.2;
/// Largest value of that curve; a logistic reaches no more.
const START_WHITE: f64 = 0.98;
/// Logarithms of exposure at which the first curve is fitted, and their number.
const START_RANGE: [f64; 2] = [-7.0, 2.0];
const START_POINTS: usize = 96;
/// Steps of the fit, and its learning rate.
const START_STEPS: u32 = 600;
const START_RATE: f32 = 5e-3;

impl Head {
    /// Computes the captured values of rays, `[rays, 3]`, given their radiance, `[rays, 3]`, and
    /// the logarithms of their exposures.
    #[inline(always)]
    pub(crate) fn record<S: Simd>(
        &self,
        simd: S,
        weights: &[f32],
        radiance: &[f32],
        log_exposures: &[f32],
        room: &mut [Activations; RAW],
        values: &mut Vec<f32>,
    ) {
        values.clear();
        values.resize(radiance.len(), 0.0);
        let Some(network) = self.network() else { return };
        for c in 0..RAW {
            let room = &mut room[c];
            let inputs = log_exposures.iter().enumerate().map(|(ray, exposure)| radiance[RAW * ray + c].max(DARKEST).ln() + exposure);
            fill_inputs(network, inputs, room);
            network.forward(simd, &weights[c * network.len()..][..network.len()], room);
            for ray in 0..log_exposures.len() {
                values[RAW * ray + c] = sigmoid(room.outputs()[ray / LANES].0[ray % LANES]);
            }
        }
    }

    /// Writes the gradient by radiance, given that by captured values, and adds that by the
    /// weights. `room` is as [`Self::record`] left it.
    #[inline(always)]
    pub(crate) fn backward_record<S: Simd>(
        &self,
        simd: S,
        weights: &[f32],
        [radiance, values, by_values]: [&[f32]; 3],
        room: &mut [Activations; RAW],
        by_radiance: &mut [f32],
        gradient: &mut [f32],
    ) {
        let Some(network) = self.network() else { return };
        let rays = radiance.len() / RAW;
        for c in 0..RAW {
            let (at, room) = (c * network.len()..(c + 1) * network.len(), &mut room[c]);
            for ray in 0..rays.next_multiple_of(LANES) {
                let (i, is_ray) = (RAW * ray + c, ray < rays);
                let by = if is_ray { by_values[i] * values[i] * (1.0 - values[i]) } else { 0.0 };
                room.by_outputs()[ray / LANES].0[ray % LANES] = by;
            }
            network.backward(simd, &weights[at.clone()], room, &mut gradient[at]);
            for ray in 0..rays {
                let (i, by_log) = (RAW * ray + c, room.by_inputs()[ray / LANES].0[ray % LANES]);
                by_radiance[i] = if radiance[i] > DARKEST { by_log / radiance[i] } else { 0.0 };
            }
        }
    }

    /// Returns the loss of the values at the unit exposure, and adds its gradient by the weights.
    pub(crate) fn unit_loss(&self, weights: &[f32], unit_value: f32, gradient: &mut [f32]) -> f64 {
        let (count, mut loss) = (self.of_channel(), 0.0);
        for (own, gradient) in weights.chunks_exact(count).zip(gradient.chunks_exact_mut(count)) {
            let curve = Curve(own);
            let difference = curve.value(0.0) - f64::from(unit_value);
            loss += UNIT_WEIGHT * difference * difference / RAW as f64;
            curve.add_gradient(0.0, 2.0 * UNIT_WEIGHT * difference / RAW as f64, gradient);
        }
        loss
    }

    /// Moves tone mappers, which are random, to `unit x^(1/2.2)`.
    pub(crate) fn start_curves(&self, weights: &mut [f32], unit_value: f32) {
        let count = self.of_channel();
        if self.kind != ColorHead::Log {
            return;
        }
        let level = luxel_lanes::Level::best();
        for own in weights.chunks_exact_mut(count) {
            let (mut first, mut second) = (vec![0.0; count], vec![0.0; count]);
            for step in 1..=START_STEPS {
                let mut gradient = vec![0.0; count];
                for point in 0..START_POINTS {
                    let part = point as f64 / (START_POINTS - 1) as f64;
                    let s = START_RANGE[0] + part * (START_RANGE[1] - START_RANGE[0]);
                    let aim = (f64::from(unit_value) * (s / START_GAMMA).exp()).min(START_WHITE);
                    let curve = Curve(own);
                    curve.add_gradient(s, 2.0 * (curve.value(s) - aim) / START_POINTS as f64, &mut gradient);
                }
                let moving = Moving { parameters: own, first: &mut first, second: &mut second };
                let rate = Rate::new(START_RATE * (1.0 - f64::from(step - 1) as f32 / START_STEPS as f32), step);
                luxel_lanes::dispatch!(level, simd => rate.update(simd, moving, &gradient));
            }
        }
    }
}

impl Field {
    /// Returns the values that a camera records by the tone mappers, at the exposures of a
    /// response's knots; `None` for a field without tone mappers.
    pub fn response(&self) -> Option<Knots> {
        let head = &self.networks.head;
        if head.kind != ColorHead::Log {
            return None;
        }
        let (weights, count) = (self.networks.of_head(&self.weights), head.of_channel());
        let of_channel = |c: usize| -> [f32; RESPONSE_KNOTS] {
            let curve = Curve(&weights[c * count..(c + 1) * count]);
            std::array::from_fn(|knot| curve.value(exposure_of_knot(knot).max(f64::from(DARKEST)).ln()) as f32)
        };
        Some([0, 1, 2].map(of_channel))
    }
}

/// The weights of a tone mapper: those of the hidden units, their biases, the outgoing weights, the
/// bias.
#[derive(Clone, Copy)]
struct Curve<'a>(&'a [f32]);

impl Curve<'_> {
    fn units(self) -> impl Iterator<Item = [f64; 3]> {
        let units = self.0.len() / 3;
        (0..units).map(move |j| [0, 1, 2].map(|k| f64::from(self.0[k * units + j])))
    }

    /// Returns the captured value at the logarithm of an exposure.
    fn value(self, s: f64) -> f64 {
        let bias = self.0.last().copied().unwrap_or(0.0);
        let u = self.units().fold(f64::from(bias), |u, [weight, bias, outgoing]| u + outgoing * (weight * s + bias).max(0.0));
        (1.0 + (-u).exp()).recip()
    }

    /// Adds the gradient by the weights, given that by the value at `s`.
    fn add_gradient(self, s: f64, by_value: f64, gradient: &mut [f32]) {
        let (y, units) = (self.value(s), self.0.len() / 3);
        let by = by_value * y * (1.0 - y);
        for (j, [weight, bias, outgoing]) in self.units().enumerate() {
            let hidden = weight * s + bias;
            if hidden > 0.0 {
                gradient[j] += (by * outgoing * s) as f32;
                gradient[units + j] += (by * outgoing) as f32;
                gradient[2 * units + j] += (by * hidden) as f32;
            }
        }
        if let Some(last) = gradient.last_mut() {
            *last += by as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head() -> (Head, Vec<f32>) {
        let head = Head::new(ColorHead::Log);
        let weights = head.initial(3);
        (head, weights)
    }

    #[test]
    fn curves_begin_as_power_laws() {
        let (head, mut weights) = head();
        head.start_curves(&mut weights, 0.5);
        for own in weights.chunks_exact(head.of_channel()) {
            for x in [0.003f64, 0.02, 0.1, 0.5, 1.0, 2.0] {
                let (found, expected) = (Curve(own).value(x.ln()), 0.5 * x.powf(1.0 / 2.2));
                assert!((found - expected).abs() < 0.02, "{x}: {found} {expected}");
            }
        }
    }

    #[test]
    fn the_loss_of_the_unit_exposure_has_the_gradient_of_differences() {
        let (head, weights) = head();
        let mut gradient = vec![0.0; weights.len()];
        head.unit_loss(&weights, 0.73, &mut gradient);
        for i in (0..weights.len()).step_by(37) {
            let at = |h: f32| {
                let mut moved = weights.clone();
                moved[i] += h;
                (head.unit_loss(&moved, 0.73, &mut vec![0.0; weights.len()]), moved[i])
            };
            let ((high, a), (low, b)) = (at(1e-3), at(-1e-3));
            let expected = (high - low) / f64::from(a - b);
            assert!((expected - f64::from(gradient[i])).abs() < 1e-5, "{i}: {expected} {}", gradient[i]);
        }
    }
}
