//! The samples of a training step's rays: the occupied intervals in front of what a ray ends at.
//!
//! In: rays, the field as it stands. Out: [`Samples`]. What lies behind a surface takes no part in
//! the image and gets no gradient, so a ray is marched in rounds, and ends where its transmittance
//! falls below [`MIN_TRANSMITTANCE`]. Degenerate: a ray past everything has no samples.

use fearless_simd::Simd;
use luxel_lanes::Lanes;

use crate::field::head::MAX_CHANNELS;
use crate::field::march::{Interval, March, Spacing};
use crate::field::networks::{Room, Samples, position_blocks};
use crate::field::radiance_field::Field;
use crate::field::space::Ray;

/// Transmittance at which a ray ends.
pub(crate) const MIN_TRANSMITTANCE: f32 = 1e-4;
/// Intervals of a ray that are evaluated at a time.
const ROUND: usize = 16;

/// A ray with what it should show. What the objective does not read is 0.
#[derive(Clone, Copy, Default)]
pub(crate) struct TrainingRay {
    pub(crate) ray: Ray,
    pub(crate) shift: f32,
    /// Normalised units.
    pub(crate) radiance: [f32; 3],
    /// Captured values.
    pub(crate) captured: [f32; 3],
    /// ln of the exposure of one normalised unit, radiance times seconds.
    pub(crate) log_exposure: f32,
    /// Weight of the pixel of the view.
    pub(crate) weight: f32,
    /// Weight of the pixel of the captured image beside the view's radiance.
    pub(crate) captured_weight: f32,
    /// Channels behind everything: radiance in normalised units, captured values.
    pub(crate) background: [f32; MAX_CHANNELS],
}

/// Memory for finding samples.
#[derive(Default)]
pub(crate) struct Sampling {
    /// Intervals of each ray.
    intervals: Vec<Vec<Interval>>,
    active: Vec<ActiveRay>,
    positions: Vec<[f32; 3]>,
    blocks: Vec<Lanes>,
    densities: Vec<f32>,
}

/// A ray that has not ended.
struct ActiveRay {
    number: usize,
    march: March,
    transmittance: f32,
    /// Intervals of this round.
    added: usize,
}

impl Sampling {
    /// Replaces `samples` by those of rays.
    #[inline(always)]
    pub(crate) fn find<S: Simd>(&mut self, simd: S, field: &Field, rays: &[TrainingRay], room: &mut Room, samples: &mut Samples) {
        self.intervals.resize_with(rays.len().max(self.intervals.len()), Vec::new);
        self.intervals.iter_mut().for_each(Vec::clear);
        let near = field.shape().space.near;
        self.active.clear();
        self.active.extend(rays.iter().enumerate().map(|(number, ray)| ActiveRay {
            number,
            march: March::new(ray.ray, near, ray.shift),
            transmittance: 1.0,
            added: 0,
        }));
        while !self.active.is_empty() {
            self.positions.clear();
            for ray in &mut self.active {
                ray.added = 0;
                while ray.added < ROUND
                    && let Some(interval) = ray.march.next(&field.occupancy, Spacing::Even)
                {
                    self.intervals[ray.number].push(interval);
                    self.positions.push(interval.position);
                    ray.added += 1;
                }
            }
            position_blocks(&self.positions, &mut self.blocks);
            field.networks.densities(simd, &field.grid, field.parameters(), &self.blocks, room, &mut self.densities);
            let (mut first, densities, intervals) = (0, &self.densities, &mut self.intervals);
            self.active.retain_mut(|ray| {
                let of_ray = &mut intervals[ray.number];
                let before = of_ray.len() - ray.added;
                for i in 0..ray.added {
                    ray.transmittance *= (-densities[first + i] * of_ray[before + i].length).exp();
                    if ray.transmittance < MIN_TRANSMITTANCE {
                        of_ray.truncate(before + i + 1);
                        break;
                    }
                }
                first += ray.added;
                ray.added == ROUND && ray.transmittance >= MIN_TRANSMITTANCE
            });
        }
        samples.clear();
        for (ray, intervals) in rays.iter().zip(&self.intervals) {
            samples.begin(ray.ray.direction);
            intervals.iter().for_each(|interval| samples.push(interval.position, interval.middle, interval.length));
        }
        samples.end();
    }
}
