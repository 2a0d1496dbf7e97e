//! The networks of a field, and their evaluation at samples of rays.
//!
//! In: blocks of positions and the directions of their rays. Out: density, and the raw colours that
//! [`super::head`] reads. The [trunk](super::trunk) maps a position to ln density and more numbers;
//! the colour network maps those and the direction to colours. Weights are those of the trunk, of
//! the colour network and of the head.

use std::ops::Range;

use fearless_simd::Simd;
use luxel_lanes::{LANES, Lanes};

use crate::field::grid::Grid;
use crate::field::head::{ColorHead, Head};
use crate::field::raw::RAW;
use crate::field::trunk::{FieldNetwork, Parameters, Trunk, TrunkRoom};
use crate::networks::{Activations, Network};

/// Largest ln density: the exponential and its gradient stay in range.
pub(crate) const MAX_LOG_DENSITY: f32 = 15.0;

/// The shapes of a field's networks.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Networks {
    trunk: Trunk,
    color: Network,
    pub(crate) head: Head,
}

/// The samples of some rays.
#[derive(Debug, Default)]
pub(crate) struct Samples {
    /// `[blocks, 3]`.
    pub(crate) positions: Vec<Lanes>,
    pub(crate) lengths: Vec<f32>,
    pub(crate) middles: Vec<f32>,
    /// Number of the first sample of each ray, and the number of all.
    pub(crate) starts: Vec<usize>,
    /// Direction of each ray, a unit vector.
    pub(crate) directions: Vec<[f32; 3]>,
}

/// Memory for the evaluation of samples.
#[derive(Debug, Default)]
pub(crate) struct Room {
    trunk: TrunkRoom,
    color: Activations,
    direction: Vec<f32>,
}

impl Samples {
    pub(crate) fn clear(&mut self) {
        self.positions.clear();
        self.lengths.clear();
        self.middles.clear();
        self.starts.clear();
        self.directions.clear();
    }

    /// Begins a ray.
    pub(crate) fn begin(&mut self, direction: [f32; 3]) {
        self.starts.push(self.len());
        self.directions.push(direction);
    }

    /// Adds a sample to the ray that was begun last.
    pub(crate) fn push(&mut self, position: [f32; 3], middle: f32, length: f32) {
        let (block, lane) = (self.len() / LANES, self.len() % LANES);
        if lane == 0 {
            // What fills the last block lies in the cube.
            self.positions.extend([Lanes::ZERO; 3]);
        }
        for (axis, coordinate) in position.into_iter().enumerate() {
            self.positions[3 * block + axis].0[lane] = coordinate;
        }
        self.middles.push(middle);
        self.lengths.push(length);
    }

    /// Ends the last ray.
    pub(crate) fn end(&mut self) {
        self.starts.push(self.len());
    }

    pub(crate) fn len(&self) -> usize {
        self.lengths.len()
    }

    pub(crate) fn blocks(&self) -> usize {
        self.len().div_ceil(LANES)
    }

    /// Returns the samples of ray `ray`.
    pub(crate) fn of_ray(&self, ray: usize) -> Range<usize> {
        self.starts[ray]..self.starts[ray + 1]
    }
}

impl Networks {
    /// Returns networks for a grid, which has no levels where the trunk needs none.
    pub(crate) fn new(network: FieldNetwork, grid: &Grid, head: ColorHead) -> Self {
        let trunk = Trunk::new(network, grid);
        let color = Network::new(&trunk.color_sizes());
        Self { trunk, color, head: Head::new(head) }
    }

    /// Returns the number of weights and biases.
    pub(crate) fn len(&self) -> usize {
        self.before_head() + self.head.len()
    }

    /// Returns the number of weights and biases in front of those of the head.
    pub(crate) fn before_head(&self) -> usize {
        self.trunk.len() + self.color.len()
    }

    /// Returns those of the head among all weights.
    pub(crate) fn of_head<'a>(&self, weights: &'a [f32]) -> &'a [f32] {
        &weights[self.before_head()..self.len()]
    }

    pub(crate) fn initial(&self, seed: u64) -> Vec<f32> {
        let mut weights = self.trunk.initial(seed);
        weights.extend(self.color.initial(!seed));
        weights.extend(self.head.initial(seed.rotate_left(16)));
        weights
    }

    /// Computes the densities of blocks of positions.
    #[inline(always)]
    pub(crate) fn densities<S: Simd>(
        &self,
        simd: S,
        grid: &Grid,
        parameters: Parameters<'_>,
        positions: &[Lanes],
        room: &mut Room,
        densities: &mut Vec<f32>,
    ) {
        self.trunk.forward(simd, grid, parameters, positions, &mut room.trunk);
        densities.clear();
        let logs = room.trunk.last.outputs().chunks_exact(self.trunk.outputs()).flat_map(|block| block[0].0);
        densities.extend(logs.map(|log| log.min(MAX_LOG_DENSITY).exp()));
    }

    /// Computes the raw colours of samples whose densities were computed last in `room`: `[blocks,
    /// 3]`.
    #[inline(always)]
    pub(crate) fn colors<'a, S: Simd>(&self, simd: S, parameters: Parameters<'_>, samples: &Samples, room: &'a mut Room) -> &'a [Lanes] {
        let Room { trunk, color, direction, .. } = room;
        let (outputs, read) = (self.trunk.outputs(), self.trunk.colors_read());
        let width = read + self.trunk.direction_len();
        let inputs = self.color.inputs(samples.blocks(), color);
        for (input, geometry) in inputs.chunks_exact_mut(width).zip(trunk.last.outputs().chunks_exact(outputs)) {
            input[..read].copy_from_slice(&geometry[outputs - read..]);
        }
        for (ray, toward) in samples.directions.iter().enumerate() {
            self.trunk.describe_direction(*toward, direction);
            for sample in samples.of_ray(ray) {
                let rows = &mut inputs[sample / LANES * width + read..][..direction.len()];
                for (row, value) in rows.iter_mut().zip(&*direction) {
                    row.0[sample % LANES] = *value;
                }
            }
        }
        self.color.forward(simd, &parameters.weights[self.trunk.len()..self.before_head()], color);
        color.outputs()
    }

    /// Adds the gradient by the weights in front of the head, given that by densities and raw
    /// colours (in [`Room::by_raw`]), and returns the gradient by the grid's features `[blocks,
    /// features]`.
    #[inline(always)]
    pub(crate) fn backward<'a, S: Simd>(
        &self,
        simd: S,
        parameters: Parameters<'_>,
        by_density: &[f32],
        room: &'a mut Room,
        gradient: &mut [f32],
    ) -> &'a [Lanes] {
        let split = self.trunk.len();
        let (of_trunk, of_color) = gradient.split_at_mut(split);
        self.color.backward(simd, &parameters.weights[split..self.before_head()], &mut room.color, &mut of_color[..self.color.len()]);
        let (outputs, read) = (self.trunk.outputs(), self.trunk.colors_read());
        let by_inputs = room.color.by_inputs().chunks_exact(read + self.trunk.direction_len());
        let logs: Vec<Lanes> = room.trunk.last.outputs().iter().step_by(outputs).copied().collect();
        let by_outputs = room.trunk.last.by_outputs().chunks_exact_mut(outputs);
        for (block, (by_output, by_input)) in by_outputs.zip(by_inputs).enumerate() {
            by_output[0] = Lanes::ZERO;
            by_output[outputs - read..].copy_from_slice(&by_input[..read]);
            for lane in 0..LANES {
                let log = logs[block].0[lane];
                // Behind the limit there is no gradient but that of the limit itself, so that a
                // density can come back.
                let slope = log.min(MAX_LOG_DENSITY).exp();
                by_output[0].0[lane] += by_density.get(block * LANES + lane).copied().unwrap_or(0.0) * slope;
            }
        }
        self.trunk.backward(simd, &parameters.weights[..split], &mut room.trunk, of_trunk)
    }
}

impl Room {
    /// Returns the place for the gradient by the raw colours, `[blocks, 3]`.
    pub(crate) fn by_raw(&mut self) -> &mut [Lanes] {
        self.color.by_outputs()
    }
}

/// Spreads numbers by sample, `[samples, 3]`, over blocks, `[blocks, 3]`, with 0 after the last.
pub(crate) fn into_blocks(by_sample: &[f32], blocks: &mut [Lanes]) {
    blocks.fill(Lanes::ZERO);
    for (sample, values) in by_sample.chunks_exact(RAW).enumerate() {
        for (channel, value) in values.iter().enumerate() {
            blocks[sample / LANES * RAW + channel].0[sample % LANES] = *value;
        }
    }
}

/// Gathers numbers by sample, `[samples, 3]`, from blocks.
pub(crate) fn from_blocks(blocks: &[Lanes], samples: usize, by_sample: &mut Vec<f32>) {
    by_sample.clear();
    by_sample.extend((0..samples * RAW).map(|i| blocks[i / RAW / LANES * RAW + i % RAW].0[i / RAW % LANES]));
}

/// Writes positions into blocks, the rest of the last of which is 0.
pub(crate) fn position_blocks(positions: &[[f32; 3]], blocks: &mut Vec<Lanes>) {
    blocks.clear();
    blocks.resize(3 * positions.len().div_ceil(LANES), Lanes::ZERO);
    for (i, position) in positions.iter().enumerate() {
        for axis in 0..3 {
            blocks[3 * (i / LANES) + axis].0[i % LANES] = position[axis];
        }
    }
}
