//! The response of the camera that captured the training images, learned with the scene.
//!
//! In: the gradient of the loss with respect to the knots of the curve ([`luxel_core::Response`])
//! at each step. Out: the knots for the next step. All images share one curve per channel. Each
//! piece rises by `exp(raw)`, so curves never fall. The knot at the unit exposure is fixed: x = 1
//! gives `unit` in every channel. Otherwise the curve could undo any factor on radiance, and any
//! colour cast.
//!
//! Priors: `raw` is drawn towards a straight line, as a power law has it, and black towards 0. The
//! priors decide where no image has data, and where noise does. Exposure brackets separate the
//! curve from the scene, and so do single images of different exposures, because they capture the
//! same radiance twice. If all images have the same exposure, nothing separates them, and the curve
//! stays at its start, `unit x^(1/2.2)`, which is close to the curve of cameras that encode for
//! displays.
//!
//! The curve is fixed while the scene forms ([`WARM_UP`]); otherwise the grey of the first steps
//! would be mistaken for a response.

use luxel_core::engine::{ADAM_BETA1, ADAM_BETA2, NumberAdam};
use luxel_core::response::{UNIT_KNOT, exposure_of_knot};
use luxel_core::{Knots, PixelValues, RESPONSE_KNOTS, View};
use serde::{Deserialize, Serialize};

use crate::TrainError;

/// Fraction of the steps in which the curve is fixed.
const WARM_UP: f64 = 0.03;
/// Learning rates of the logarithms of the rises, at the start and at the end.
const LEARNING_RATES: [f64; 2] = [1e-2, 5e-4];
/// Weight of the squared second differences of the logarithms.
const SMOOTHNESS: f64 = 2e-4;
/// Weight of the squared value of black.
const BLACK_AT_ZERO: f64 = 1e-2;
/// Epsilon of Adam, far below typical gradients of knots.
const EPSILON: f64 = 1e-9;
/// Smallest ratio of the longest to the shortest exposure from which the curve is learned: half a
/// stop.
const LEAST_RATIO: f32 = std::f32::consts::SQRT_2;
/// Number of pieces of the curve.
const PIECES: usize = RESPONSE_KNOTS - 1;

/// The curve and the state of its optimiser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CameraResponse {
    /// Value at the unit exposure.
    unit: f32,
    /// Whether the exposures of the images differ enough to separate the curve from the scene.
    is_learned: bool,
    /// Logarithms of the pieces' rises.
    raw: [[f32; PIECES]; 3],
    first: [[f32; PIECES]; 3],
    second: [[f32; PIECES]; 3],
    /// Number of updates made.
    updates: u32,
}

impl CameraResponse {
    /// Returns the initial curve for these views.
    pub(crate) fn new(unit: f32, train: &[View]) -> Self {
        let exposures = || train.iter().filter_map(exposure_of);
        let (shortest, longest) = exposures().fold((f32::INFINITY, 0.0f32), |(a, b), t| (a.min(t), b.max(t)));
        let is_learned = longest >= LEAST_RATIO * shortest;
        if !is_learned {
            tracing::warn!("all images have the same exposure: the camera's response cannot be learned, {unit} x^(1/2.2) is assumed");
        }
        let value = |k: usize| f64::from(unit) * exposure_of_knot(k).powf(1.0 / 2.2);
        let raw = std::array::from_fn(|k| (value(k + 1) - value(k)).ln() as f32);
        let zeros = [[0.0; PIECES]; 3];
        Self { unit, is_learned, raw: [raw; 3], first: zeros, second: zeros, updates: 0 }
    }

    /// Returns the values at the knots.
    pub(crate) fn knots(&self) -> Knots {
        self.raw.map(|raw| {
            let rise = raw.map(|raw| f64::from(raw).exp());
            let mut knots = [f64::from(self.unit); RESPONSE_KNOTS];
            for k in UNIT_KNOT + 1..RESPONSE_KNOTS {
                knots[k] = knots[k - 1] + rise[k - 1];
            }
            for k in (0..UNIT_KNOT).rev() {
                knots[k] = knots[k + 1] - rise[k];
            }
            knots.map(|value| value as f32)
        })
    }

    /// Updates the curve by the gradient of a step; `progress` is the fraction of the run's steps
    /// that are done.
    pub(crate) fn update(&mut self, by_knots: &Knots, progress: f64) {
        if !self.is_learned || progress < WARM_UP {
            return;
        }
        self.updates = self.updates.saturating_add(1);
        let rate = LEARNING_RATES[0] * (LEARNING_RATES[1] / LEARNING_RATES[0]).powf(progress.min(1.0));
        let adam = NumberAdam::new([ADAM_BETA1, ADAM_BETA2].map(f64::from), [self.updates; 2], EPSILON);
        let knots = self.knots();
        for channel in 0..3 {
            let gradient = gradient(&self.raw[channel], &knots[channel], &by_knots[channel]);
            for (j, gradient) in gradient.into_iter().enumerate() {
                let moved = adam.update_f32(&mut self.first[channel][j], &mut self.second[channel][j], gradient);
                let raw = &mut self.raw[channel][j];
                *raw = (f64::from(*raw) - rate * moved.mean / moved.deviation).clamp(-20.0, 2.0) as f32;
            }
        }
    }

    /// Checks a curve read from a file.
    pub(crate) fn validate(&self) -> Result<(), TrainError> {
        let arrays = [&self.raw, &self.first, &self.second];
        let is_finite = arrays.iter().flat_map(|array| array.as_flattened()).all(|value| value.is_finite());
        if is_finite && self.unit > 0.0 && self.unit < 1.0 {
            return Ok(());
        }
        Err(TrainError::State("the camera's response holds numbers that make no curve".to_owned()))
    }
}

/// Returns the gradient of the loss and of the priors with respect to `raw`, given the loss's
/// gradient with respect to the knots.
fn gradient(raw: &[f32; PIECES], knots: &[f32; RESPONSE_KNOTS], by_knots: &[f32; RESPONSE_KNOTS]) -> [f64; PIECES] {
    let mut by_value = by_knots.map(f64::from);
    by_value[0] += 2.0 * BLACK_AT_ZERO * f64::from(knots[0]);
    let mut gradient = [0.0; PIECES];
    // A rise moves all knots beyond it, seen from the unit exposure: up above it, down below it.
    let mut beyond = 0.0;
    for j in (UNIT_KNOT..PIECES).rev() {
        beyond += by_value[j + 1];
        gradient[j] = beyond * f64::from(raw[j]).exp();
    }
    beyond = 0.0;
    for j in 0..UNIT_KNOT {
        beyond -= by_value[j];
        gradient[j] = beyond * f64::from(raw[j]).exp();
    }
    for j in 1..PIECES - 1 {
        let bend = f64::from(raw[j - 1]) - 2.0 * f64::from(raw[j]) + f64::from(raw[j + 1]);
        for (at, factor) in [(j - 1, 1.0), (j, -2.0), (j + 1, 1.0)] {
            gradient[at] += 2.0 * SMOOTHNESS * factor * bend;
        }
    }
    gradient
}

/// Returns the exposure of a view of captured values in seconds, or `None` if the view is radiance.
pub(crate) fn exposure_of(view: &View) -> Option<f32> {
    match view.values {
        PixelValues::Radiance => None,
        PixelValues::Recorded { exposure_s } => Some(exposure_s),
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::{Image, Response};

    use super::*;
    use crate::testing::{camera_at, view_of};

    fn exposed(exposure_s: f32) -> View {
        let view = view_of("a", camera_at([0.0; 3], [4, 4]), Image::filled(4, 4, [0.5; 3]));
        View { values: PixelValues::Recorded { exposure_s }, ..view }
    }

    #[test]
    fn the_curve_starts_as_a_power_law_through_the_unit_exposure() {
        let knots = CameraResponse::new(0.5, &[exposed(1.0), exposed(4.0)]).knots();
        for (k, value) in knots[1].iter().enumerate() {
            let expected = 0.5 * exposure_of_knot(k).powf(1.0 / 2.2);
            assert!((f64::from(*value) - expected).abs() < 1e-5, "{k}: {value} {expected}");
        }
    }

    #[test]
    fn gradients_by_rises_are_those_of_differences() {
        let response = CameraResponse::new(0.5, &[exposed(1.0), exposed(4.0)]);
        let by_knots: [f32; RESPONSE_KNOTS] = std::array::from_fn(|k| 1e-3 * (k as f32 * 0.7).sin());
        let value = |raw: [f32; PIECES]| {
            let moved = CameraResponse { raw: [raw; 3], ..response.clone() };
            let knots = moved.knots()[0];
            let loss: f64 = knots.iter().zip(by_knots).map(|(k, g)| f64::from(*k) * f64::from(g)).sum();
            let bends = raw.windows(3).map(|w| f64::from(w[0] - 2.0 * w[1] + w[2]).powi(2)).sum::<f64>();
            loss + BLACK_AT_ZERO * f64::from(knots[0]).powi(2) + SMOOTHNESS * bends
        };
        let exact = gradient(&response.raw[0], &response.knots()[0], &by_knots);
        for j in [0, 5, UNIT_KNOT - 1, UNIT_KNOT, PIECES - 1] {
            let moved = |h: f32| {
                let mut raw = response.raw[0];
                raw[j] += h;
                value(raw)
            };
            let numeric = (moved(0.02) - moved(-0.02)) / 0.04;
            assert!((numeric - exact[j]).abs() < 2e-6 + 1e-2 * exact[j].abs(), "{j}: {numeric:e} {:e}", exact[j]);
        }
    }

    #[test]
    fn a_response_is_found_from_known_exposures() {
        // The gradient of the squared error over all exposures, without a scene.
        let truth = |x: f64| (x / (x + 1.0)).powf(1.0 / 2.2);
        let mut response = CameraResponse::new(0.73, &[exposed(1.0), exposed(8.0)]);
        for step in 0..1500u32 {
            let curve = Response { knots: response.knots(), exposure: [1.0; 3] };
            let mut by_knots = [[0.0; RESPONSE_KNOTS]; 3];
            for i in 0..120 {
                let x = 2f64.powf(-9.0 + 0.11 * f64::from(i));
                let found = curve.against(0, x as f32, truth(x) as f32);
                let (k, along) = luxel_core::response::piece(found.position);
                let by_value = (found.value - truth(x) as f32).signum() / 120.0;
                for channel in &mut by_knots {
                    channel[k] += by_value * (1.0 - along);
                    channel[k + 1] += by_value * along;
                }
            }
            response.update(&by_knots, 0.05 + f64::from(step) / 1600.0);
        }
        let curve = Response { knots: response.knots(), exposure: [1.0; 3] };
        for x in [0.01, 0.1, 0.5, 1.0, 3.0, 10.0] {
            let found = f64::from(curve.apply(1, x as f32).value);
            assert!((found - truth(x)).abs() < 0.015, "{x}: {found} {}", truth(x));
        }
        assert!(response.knots().iter().all(|knots| knots.windows(2).all(|pair| pair[1] >= pair[0])));
    }

    #[test]
    fn one_exposure_for_all_images_leaves_the_curve_as_it_is() {
        let mut response = CameraResponse::new(0.5, &[exposed(0.01), exposed(0.01)]);
        let start = response.clone();
        response.update(&[[1e-3; RESPONSE_KNOTS]; 3], 0.5);
        assert_eq!(response, start);
    }

    #[test]
    fn the_state_survives_json_bit_for_bit() {
        let mut response = CameraResponse::new(0.5, &[exposed(1.0), exposed(4.0)]);
        (0..9).for_each(|i| response.update(&[[1e-3 * i as f32; RESPONSE_KNOTS]; 3], 0.5));
        let json = serde_json::to_string(&response).unwrap();
        assert_eq!(serde_json::from_str::<CameraResponse>(&json).unwrap(), response);
        assert!(response.validate().is_ok());
        response.first[1][2] = f32::NAN;
        assert!(response.validate().is_err());
    }
}
