//! A part of a training step: some rays, forwards and backwards.
//!
//! In: rays with what they should show, the field. Out: the positions of their samples with the
//! gradient by the grid's features, the gradient by the networks' weights, and the loss.
//! Degenerate: a part without rays has no samples and no gradient.

use fearless_simd::Simd;
use luxel_lanes::Lanes;

use crate::field::compare::{CompareRoom, Comparison};
use crate::field::head::MAX_CHANNELS;
use crate::field::lift::Lifts;
use crate::field::networks::{Room, Samples, from_blocks, into_blocks};
use crate::field::options::FieldConfig;
use crate::field::radiance_field::Field;
use crate::field::raw::ColoredSamples;
use crate::field::sampling::{Sampling, TrainingRay};
use crate::field::volume::{Composited, Intervals, composite};

/// Parts of a step.
pub(crate) const TASKS: usize = 64;

/// The results of a part of a step.
#[derive(Default)]
pub(crate) struct Task {
    pub(crate) samples: Samples,
    /// Gradient by the grid's features, `[blocks, features]`.
    pub(crate) by_features: Vec<Lanes>,
    /// Gradient by the networks' weights.
    pub(crate) gradient: Vec<f32>,
    /// Sum over the rays, without the distortion loss.
    pub(crate) loss: f64,
}

/// Memory for a part of a step, which any part can use after another.
#[derive(Default)]
pub(crate) struct TaskRoom {
    sampling: Sampling,
    room: Room,
    compare: CompareRoom,
    densities: Vec<f32>,
    raw: Vec<f32>,
    /// Pieces of the lifts' tables.
    pieces: Vec<usize>,
    colors: Vec<f32>,
    weights: Vec<f32>,
    transmittance: Vec<f32>,
    by_density: Vec<f32>,
    by_colors: Vec<f32>,
    by_raw: Vec<f32>,
    /// Composited channels of each ray, and the gradient by them.
    of_rays: Vec<f32>,
    by_rays: Vec<f32>,
}

/// Everything that the tasks of a step share.
#[derive(Clone, Copy)]
pub(crate) struct StepContext<'a> {
    pub(crate) field: &'a Field,
    pub(crate) options: &'a FieldConfig,
    pub(crate) lifts: Option<&'a Lifts>,
    /// Factor of a ray's loss in that of the step.
    pub(crate) share: f32,
    /// Weight of the distortion loss.
    pub(crate) distortion_weight: f32,
}

impl Task {
    #[inline(always)]
    pub(crate) fn run<S: Simd>(&mut self, simd: S, context: StepContext<'_>, rays: &[TrainingRay], room: &mut TaskRoom) {
        let StepContext { field, options, lifts, share, distortion_weight } = context;
        let (networks, parameters) = (&field.networks, field.parameters());
        let (head, of_head) = (&networks.head, networks.of_head(&field.weights));
        let channels = head.kind.channels();
        room.sampling.find(simd, field, rays, &mut room.room, &mut self.samples);
        let count = self.samples.len();
        networks.densities(simd, &field.grid, parameters, &self.samples.positions, &mut room.room, &mut room.densities);
        from_blocks(networks.colors(simd, parameters, &self.samples, &mut room.room), count, &mut room.raw);
        head.forward(lifts, &room.raw, &mut room.pieces, &mut room.colors);
        for numbers in [&mut room.weights, &mut room.transmittance, &mut room.by_density] {
            numbers.resize(count, 0.0);
        }
        room.by_colors.resize(channels * count, 0.0);
        for numbers in [&mut room.of_rays, &mut room.by_rays] {
            numbers.resize(channels * rays.len(), 0.0);
        }
        self.gradient.clear();
        self.gradient.resize(networks.len(), 0.0);
        let (in_front, by_head) = self.gradient.split_at_mut(networks.before_head());
        for (number, (ray, color)) in rays.iter().zip(room.of_rays.chunks_exact_mut(channels)).enumerate() {
            let of_ray = self.samples.of_ray(number);
            let intervals = intervals(&self.samples, &room.densities, &room.colors, number, channels);
            let (weights, transmittance) = (&mut room.weights[of_ray.clone()], &mut room.transmittance[of_ray]);
            composite(intervals, &ray.background[..channels], weights, transmittance, color);
        }
        let comparison = Comparison { options, head, weights: of_head, share };
        self.loss = comparison.rays(simd, rays, &room.of_rays, &mut room.compare, &mut room.by_rays, by_head);
        for (number, (ray, by_color)) in rays.iter().zip(room.by_rays.chunks_exact(channels)).enumerate() {
            let of_ray = self.samples.of_ray(number);
            let of_colors = channels * of_ray.start..channels * of_ray.end;
            let composited = Composited {
                intervals: intervals(&self.samples, &room.densities, &room.colors, number, channels),
                background: &ray.background[..channels],
                weights: &room.weights[of_ray.clone()],
                transmittance: &room.transmittance[of_ray.clone()],
            };
            let distortion_weight = ray.weight * share * distortion_weight;
            composited.backward(by_color, distortion_weight, &mut room.by_density[of_ray], &mut room.by_colors[of_colors]);
        }
        let TaskRoom { raw, pieces, colors, by_colors, by_raw, .. } = room;
        let colored = ColoredSamples { raw, pieces, channels: colors, by_channels: by_colors };
        head.backward(lifts, colored, by_raw, by_head);
        into_blocks(&room.by_raw, room.room.by_raw());
        let by_features = networks.backward(simd, parameters, &room.by_density, &mut room.room, in_front);
        self.by_features.clear();
        self.by_features.extend_from_slice(by_features);
    }
}

/// Returns the intervals of a ray.
fn intervals<'a>(samples: &'a Samples, densities: &'a [f32], colors: &'a [f32], ray: usize, channels: usize) -> Intervals<'a> {
    let of_ray = samples.of_ray(ray);
    debug_assert!(channels <= MAX_CHANNELS);
    Intervals {
        density: &densities[of_ray.clone()],
        length: &samples.lengths[of_ray.clone()],
        middle: &samples.middles[of_ray.clone()],
        colors: &colors[channels * of_ray.start..channels * of_ray.end],
    }
}
