//! A part of a training step: some rays, forwards and backwards.
//!
//! In: rays with what they should show, the field. Out: the positions of their samples with the
//! gradient by the grid's features, the gradient by the networks' weights, and the loss.
//! Degenerate: a part without rays has no samples and no gradient.

use fearless_simd::Simd;

use crate::field::Field;
use crate::head::{logistic, softplus};
use crate::lanes::Lanes;
use crate::networks::{Room, Samples, from_blocks, into_blocks};
use crate::options::FieldConfig;
use crate::sampling::{Sampling, TrainingRay};
use crate::volume::{Composited, Intervals, composite};

/// A part of a step, with memory for it.
#[derive(Default)]
pub(crate) struct Task {
    pub(crate) samples: Samples,
    sampling: Sampling,
    room: Room,
    densities: Vec<f32>,
    raw: Vec<f32>,
    colors: Vec<f32>,
    weights: Vec<f32>,
    transmittance: Vec<f32>,
    by_density: Vec<f32>,
    by_colors: Vec<f32>,
    /// Gradient by the grid's features, `[blocks, features]`.
    pub(crate) by_features: Vec<Lanes>,
    /// Gradient by the networks' weights.
    pub(crate) gradient: Vec<f32>,
    /// Sum over the rays, without the distortion loss.
    pub(crate) loss: f64,
}

/// Everything that the tasks of a step share.
#[derive(Clone, Copy)]
pub(crate) struct StepContext<'a> {
    pub(crate) field: &'a Field,
    pub(crate) options: &'a FieldConfig,
    /// Factor of a ray's loss in that of the step.
    pub(crate) share: f32,
    /// Weight of the distortion loss.
    pub(crate) distortion_weight: f32,
}

impl Task {
    #[inline(always)]
    pub(crate) fn run<S: Simd>(&mut self, simd: S, context: StepContext<'_>, rays: &[TrainingRay]) {
        let StepContext { field, options, share, distortion_weight } = context;
        let (networks, parameters) = (&field.networks, field.parameters());
        self.sampling.find(simd, field, rays, &mut self.room, &mut self.samples);
        let count = self.samples.len();
        networks.densities(simd, &field.grid, parameters, &self.samples.positions, &mut self.room, &mut self.densities);
        let raw = networks.colors(simd, parameters, &self.samples, &mut self.room);
        from_blocks(raw, count, &mut self.raw);
        self.colors.clear();
        self.colors.extend(self.raw.iter().map(|raw| softplus(*raw)));
        for room in [&mut self.weights, &mut self.transmittance, &mut self.by_density] {
            room.resize(count, 0.0);
        }
        self.by_colors.resize(3 * count, 0.0);
        self.loss = 0.0;
        for (number, ray) in rays.iter().enumerate() {
            let of_ray = self.samples.of_ray(number);
            let of_colors = 3 * of_ray.start..3 * of_ray.end;
            let intervals = Intervals {
                density: &self.densities[of_ray.clone()],
                length: &self.samples.lengths[of_ray.clone()],
                middle: &self.samples.middles[of_ray.clone()],
                colors: &self.colors[of_colors.clone()],
            };
            let (weights, transmittance) = (&mut self.weights[of_ray.clone()], &mut self.transmittance[of_ray.clone()]);
            let (mut color, mut by_color) = ([0.0; 3], [0.0; 3]);
            composite(intervals, &ray.background, weights, transmittance, &mut color);
            let loss = options.loss.pixel(&color, ray.target, options.mu, &mut by_color);
            self.loss += f64::from(ray.weight * loss);
            let factor = ray.weight * share;
            let by_color = by_color.map(|by| by * factor);
            let composited = Composited { intervals, background: &ray.background, weights, transmittance };
            composited.backward(&by_color, factor * distortion_weight, &mut self.by_density[of_ray], &mut self.by_colors[of_colors]);
        }
        for (by, raw) in self.by_colors.iter_mut().zip(&self.raw) {
            *by *= logistic(*raw);
        }
        into_blocks(&self.by_colors, self.room.by_raw());
        self.gradient.clear();
        self.gradient.resize(networks.len(), 0.0);
        let by_features = networks.backward(simd, parameters, &self.by_density, &mut self.room, &mut self.gradient);
        self.by_features.clear();
        self.by_features.extend_from_slice(by_features);
    }
}
