//! The networks of a field, and their evaluation at samples of rays.
//!
//! In: blocks of positions and the directions of their rays. Out: density, and the raw colours that
//! [`crate::head`] reads. The density network maps the grid's features to 16 numbers, of which the
//! first is ln density; the colour network maps those and the harmonics of the direction to
//! colours.

use std::ops::Range;

use fearless_simd::Simd;
use luxel_core::sh;

use crate::grid::Grid;
use crate::lanes::{LANES, Lanes, resize};
use crate::network::{Activations, Network};

/// Units of a hidden layer.
const HIDDEN: usize = 32;
/// Outputs of the density network.
const GEOMETRY: usize = 16;
/// Degree of the harmonics of the direction.
const SH_DEGREE: usize = 3;
/// Numbers that describe a direction.
pub(crate) const DIRECTION: usize = sh::coefficients(SH_DEGREE);
/// Largest ln density: the exponential and its gradient stay in range.
pub(crate) const MAX_LOG_DENSITY: f32 = 15.0;
/// Raw colours of a sample.
pub(crate) const RAW: usize = 3;

/// The shapes of a field's networks.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Networks {
    density: Network,
    color: Network,
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
    /// Harmonics of each ray's direction.
    pub(crate) directions: Vec<[f32; DIRECTION]>,
}

/// Memory for the evaluation of samples.
#[derive(Debug, Default)]
pub(crate) struct Room {
    density: Activations,
    color: Activations,
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
        let mut basis = [0f32; sh::MAX_COEFFICIENTS];
        sh::basis(SH_DEGREE, direction, &mut basis);
        let mut harmonics = [0.0; DIRECTION];
        harmonics.copy_from_slice(&basis[..DIRECTION]);
        self.directions.push(harmonics);
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
    /// Returns networks for a grid with `features` features.
    pub(crate) fn new(features: usize) -> Self {
        Self { density: Network::new(&[features, HIDDEN, GEOMETRY]), color: Network::new(&[GEOMETRY + DIRECTION, HIDDEN, HIDDEN, RAW]) }
    }

    /// Returns the number of weights and biases.
    pub(crate) fn len(&self) -> usize {
        self.density.len() + self.color.len()
    }

    pub(crate) fn initial(&self, seed: u64) -> Vec<f32> {
        let mut weights = self.density.initial(seed);
        weights.extend(self.color.initial(!seed));
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
        let blocks = positions.len() / 3;
        grid.encode(simd, parameters.table, positions, self.density.inputs(blocks, &mut room.density));
        self.density.forward(simd, &parameters.weights[..self.density.len()], &mut room.density);
        densities.clear();
        let logs = room.density.outputs().chunks_exact(GEOMETRY).flat_map(|block| block[0].0);
        densities.extend(logs.map(|log| log.min(MAX_LOG_DENSITY).exp()));
    }

    /// Computes the raw colours of samples whose densities were computed last in `room`: `[blocks,
    /// 3]`.
    #[inline(always)]
    pub(crate) fn colors<'a, S: Simd>(&self, simd: S, parameters: Parameters<'_>, samples: &Samples, room: &'a mut Room) -> &'a [Lanes] {
        let width = GEOMETRY + DIRECTION;
        let inputs = self.color.inputs(samples.blocks(), &mut room.color);
        for (input, geometry) in inputs.chunks_exact_mut(width).zip(room.density.outputs().chunks_exact(GEOMETRY)) {
            input[..GEOMETRY].copy_from_slice(geometry);
        }
        for (ray, direction) in samples.directions.iter().enumerate() {
            for sample in samples.of_ray(ray) {
                let rows = &mut inputs[sample / LANES * width + GEOMETRY..][..DIRECTION];
                for (row, value) in rows.iter_mut().zip(direction) {
                    row.0[sample % LANES] = *value;
                }
            }
        }
        self.color.forward(simd, &parameters.weights[self.density.len()..self.len()], &mut room.color);
        room.color.outputs()
    }

    /// Adds the gradient by the weights, given that by densities and raw colours (in
    /// [`Room::by_raw`]), and returns the gradient by the grid's features `[blocks, features]`.
    #[inline(always)]
    pub(crate) fn backward<'a, S: Simd>(
        &self,
        simd: S,
        parameters: Parameters<'_>,
        by_density: &[f32],
        room: &'a mut Room,
        gradient: &mut [f32],
    ) -> &'a [Lanes] {
        let split = self.density.len();
        let (of_density, of_color) = gradient.split_at_mut(split);
        self.color.backward(simd, &parameters.weights[split..self.len()], &mut room.color, &mut of_color[..self.color.len()]);
        let by_inputs = room.color.by_inputs().chunks_exact(GEOMETRY + DIRECTION);
        let logs: Vec<Lanes> = room.density.outputs().iter().step_by(GEOMETRY).copied().collect();
        let by_outputs = room.density.by_outputs().chunks_exact_mut(GEOMETRY);
        for (block, (by_output, by_input)) in by_outputs.zip(by_inputs).enumerate() {
            by_output.copy_from_slice(&by_input[..GEOMETRY]);
            for lane in 0..LANES {
                let log = logs[block].0[lane];
                // Behind the limit there is no gradient but that of the limit itself, so that a
                // density can come back.
                let slope = log.min(MAX_LOG_DENSITY).exp();
                by_output[0].0[lane] += by_density.get(block * LANES + lane).copied().unwrap_or(0.0) * slope;
            }
        }
        self.density.backward(simd, &parameters.weights[..split], &mut room.density, of_density);
        room.density.by_inputs()
    }
}

impl Room {
    /// Returns the place for the gradient by the raw colours, `[blocks, 3]`.
    pub(crate) fn by_raw(&mut self) -> &mut [Lanes] {
        self.color.by_outputs()
    }
}

/// The numbers of a field that training changes.
#[derive(Clone, Copy)]
pub(crate) struct Parameters<'a> {
    /// Features of the grid.
    pub(crate) table: &'a [f32],
    /// Weights and biases of the networks.
    pub(crate) weights: &'a [f32],
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
    resize(blocks, 3 * positions.len().div_ceil(LANES));
    for (i, position) in positions.iter().enumerate() {
        for axis in 0..3 {
            blocks[3 * (i / LANES) + axis].0[i % LANES] = position[axis];
        }
    }
}
