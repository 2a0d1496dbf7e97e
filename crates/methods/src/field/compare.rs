//! The comparison of the rays of a step with what they should show.
//!
//! In: the composited channels of rays, captured values and radiance of their pixels. Out: the
//! loss, its gradient by the channels and by the weights of the head. Degenerate: rays of weight 0
//! have no loss and no gradient.

use fearless_simd::Simd;

use crate::field::head::Head;
use crate::field::loss::PixelLoss;
use crate::field::objective::Objective;
use crate::field::options::FieldConfig;
use crate::field::raw::RAW;
use crate::field::sampling::TrainingRay;
use crate::networks::Activations;

/// Memory for comparing rays.
#[derive(Debug, Default)]
pub(crate) struct CompareRoom {
    log_exposures: Vec<f32>,
    values: Vec<f32>,
    by_values: Vec<f32>,
    tone: [Activations; RAW],
}

/// The comparison of the rays of a step with what they should show.
#[derive(Clone, Copy)]
pub(crate) struct Comparison<'a> {
    pub(crate) options: &'a FieldConfig,
    pub(crate) head: &'a Head,
    /// Weights of the head.
    pub(crate) weights: &'a [f32],
    /// Factor of a ray's loss in that of the step.
    pub(crate) share: f32,
}

impl Comparison<'_> {
    /// Returns the sum of the rays' losses. Writes the gradient by their channels, `[rays,
    /// channels]`, of the loss times the step's share, and adds that by the weights of the head.
    #[inline(always)]
    pub(crate) fn rays<S: Simd>(
        self,
        simd: S,
        rays: &[TrainingRay],
        channels: &[f32],
        room: &mut CompareRoom,
        by_channels: &mut [f32],
        gradient: &mut [f32],
    ) -> f64 {
        let (count, mu) = (self.options.objective.head().channels(), self.options.mu);
        let rows = channels.chunks_exact(count).zip(by_channels.chunks_exact_mut(count));
        match self.options.objective {
            Objective::Radiance { loss } => {
                let mut total = 0.0;
                for (ray, (found, by)) in rays.iter().zip(rows) {
                    let value = loss.pixel(found, ray.radiance, mu, by);
                    total += f64::from(ray.weight * value);
                    let factor = ray.weight * self.share;
                    by.iter_mut().for_each(|by| *by *= factor);
                }
                total
            }
            Objective::Pairs { captured_weight, radiance_weight } => {
                let mut total = 0.0;
                for (ray, (found, by)) in rays.iter().zip(rows) {
                    let (of_radiance, of_captured) = by.split_at_mut(RAW);
                    let parts = [
                        (radiance_weight * ray.weight, PixelLoss::Mulaw.pixel(&found[..RAW], ray.radiance, mu, of_radiance)),
                        (captured_weight * ray.captured_weight, PixelLoss::Linear.pixel(&found[RAW..], ray.captured, mu, of_captured)),
                    ];
                    for (by, (weight, value)) in [of_radiance, of_captured].into_iter().zip(parts) {
                        total += f64::from(weight * value);
                        by.iter_mut().for_each(|by| *by *= weight * self.share);
                    }
                }
                total
            }
            Objective::Captured { .. } => {
                let CompareRoom { log_exposures, values, by_values, tone } = room;
                log_exposures.clear();
                log_exposures.extend(rays.iter().map(|ray| ray.log_exposure));
                self.head.record(simd, self.weights, channels, log_exposures, tone, values);
                by_values.clear();
                by_values.resize(values.len(), 0.0);
                let mut total = 0.0;
                for (ray, (value, by)) in rays.iter().zip(values.chunks_exact(RAW).zip(by_values.chunks_exact_mut(RAW))) {
                    let loss = PixelLoss::Linear.pixel(value, ray.captured, mu, by);
                    total += f64::from(ray.weight * loss);
                    let factor = ray.weight * self.share;
                    by.iter_mut().for_each(|by| *by *= factor);
                }
                self.head.backward_record(simd, self.weights, [channels, values, by_values], tone, by_channels, gradient);
                total
            }
        }
    }
}
