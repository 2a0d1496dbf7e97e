//! The part of a field that depends on positions alone: density, and what the colour is made of.
//!
//! In: blocks of positions `[blocks, 3]` in the unit cube. Out: `[blocks, outputs]`, of which the
//! first is ln density. On a hash grid a network of one hidden layer reads the grid's features.
//! [`FieldNetwork::Layers`] is NeRF's network (Mildenhall et al. 2020): layers of equal width with
//! ReLU on the [frequencies](super::frequencies) of the position, which are joined to the input of
//! a layer past the middle, too.

use std::ops::RangeInclusive;

use fearless_simd::Simd;
use luxel_core::sh;
use luxel_lanes::{LANES, Lanes};
use serde::{Deserialize, Serialize};

use crate::field::frequencies;
use crate::field::grid::{Grid, GridShape};
use crate::networks::{Activations, Network};

/// Units of a hidden layer on a grid.
const HIDDEN: usize = 32;
/// Outputs of the network on a grid.
const GEOMETRY: usize = 16;
/// Degree of the harmonics that describe a direction beside a grid.
const SH_DEGREE: usize = 3;
/// Numbers of a direction beside a grid.
const HARMONICS: usize = sh::coefficients(SH_DEGREE);

/// The map from a position to density and colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FieldNetwork {
    /// A hash grid with small networks.
    Grid(GridShape),
    /// NeRF's network, without a grid.
    Layers {
        /// Number of hidden layers; 8 in the publication.
        layers: u32,
        /// Units of a layer; 256 in the publication.
        units: u32,
    },
}

impl Default for FieldNetwork {
    fn default() -> Self {
        Self::Grid(GridShape::default())
    }
}

impl FieldNetwork {
    /// Numbers of layers that a network without a grid can have.
    pub const LAYERS: RangeInclusive<u32> = 2..=16;
    /// Numbers of units that its layers can have.
    pub const UNITS: RangeInclusive<u32> = 8..=512;

    /// Returns whether the sizes are in range.
    pub fn is_valid(self) -> bool {
        match self {
            Self::Grid(GridShape { levels, log2_entries, coarsest, finest }) => {
                (1..=32).contains(&levels) && (4..=26).contains(&log2_entries) && coarsest >= 2 && finest >= coarsest && finest <= 1 << 16
            }
            Self::Layers { layers, units } => Self::LAYERS.contains(&layers) && Self::UNITS.contains(&units),
        }
    }

    /// Returns the grid; one without levels if there is none.
    pub(crate) fn grid(self) -> Grid {
        match self {
            Self::Grid(shape) => Grid::new(shape),
            Self::Layers { .. } => Grid::new(GridShape { levels: 0, ..GridShape::default() }),
        }
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

/// The networks of positions.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Trunk {
    Grid(Network),
    /// Layers in front of the place where the position is joined, and those behind it.
    Layers([Network; 2]),
}

/// Memory for the evaluation of positions.
#[derive(Debug, Default)]
pub(crate) struct TrunkRoom {
    front: Activations,
    pub(crate) last: Activations,
}

impl Trunk {
    pub(crate) fn new(network: FieldNetwork, grid: &Grid) -> Self {
        match network {
            FieldNetwork::Grid(_) => Self::Grid(Network::new(&[grid.width(), HIDDEN, GEOMETRY])),
            FieldNetwork::Layers { layers, units } => {
                // The sixth of eight layers is the first behind.
                let (layers, units) = (layers as usize, units as usize);
                let in_front = layers / 2 + 1;
                let mut front = vec![units; in_front + 1];
                front[0] = frequencies::POSITION;
                let mut behind = vec![units; layers - in_front + 2];
                behind[0] = frequencies::POSITION + units;
                behind[layers - in_front + 1] = 1 + units;
                Self::Layers([Network::ending_in_relu(&front), Network::new(&behind)])
            }
        }
    }

    /// Returns the sizes of the colour network on these outputs.
    pub(crate) fn color_sizes(&self) -> Vec<usize> {
        let inputs = self.colors_read() + self.direction_len();
        match self {
            Self::Grid(_) => vec![inputs, HIDDEN, HIDDEN, 3],
            Self::Layers(_) => vec![inputs, (self.outputs() - 1) / 2, 3],
        }
    }

    /// Returns the number of outputs.
    pub(crate) fn outputs(&self) -> usize {
        match self {
            Self::Grid(network) | Self::Layers([_, network]) => network.outputs(),
        }
    }

    /// Returns the number of outputs, the last ones, that the colour network reads.
    pub(crate) fn colors_read(&self) -> usize {
        match self {
            Self::Grid(_) => self.outputs(),
            Self::Layers(_) => self.outputs() - 1,
        }
    }

    /// Returns how many numbers describe a direction.
    pub(crate) fn direction_len(&self) -> usize {
        match self {
            Self::Grid(_) => HARMONICS,
            Self::Layers(_) => frequencies::DIRECTION,
        }
    }

    /// Writes the numbers that describe a direction.
    pub(crate) fn describe_direction(&self, direction: [f32; 3], numbers: &mut Vec<f32>) {
        numbers.clear();
        match self {
            Self::Grid(_) => {
                let mut basis = [0f32; sh::MAX_COEFFICIENTS];
                sh::basis(SH_DEGREE, direction, &mut basis);
                numbers.extend_from_slice(&basis[..HARMONICS]);
            }
            Self::Layers(_) => numbers.extend_from_slice(&frequencies::direction(direction)),
        }
    }

    /// Returns the number of weights and biases.
    pub(crate) fn len(&self) -> usize {
        match self {
            Self::Grid(network) => network.len(),
            Self::Layers(parts) => parts.iter().map(Network::len).sum(),
        }
    }

    pub(crate) fn initial(&self, seed: u64) -> Vec<f32> {
        match self {
            Self::Grid(network) => network.initial(seed),
            Self::Layers([front, behind]) => {
                let mut weights = front.initial(seed);
                weights.extend(behind.initial(seed.rotate_left(32)));
                weights
            }
        }
    }

    /// Computes the outputs of positions; they are in [`TrunkRoom::last`].
    #[inline(always)]
    pub(crate) fn forward<S: Simd>(&self, simd: S, grid: &Grid, parameters: Parameters<'_>, positions: &[Lanes], room: &mut TrunkRoom) {
        let (blocks, weights) = (positions.len() / 3, parameters.weights);
        match self {
            Self::Grid(network) => {
                grid.encode(simd, parameters.table, positions, network.inputs(blocks, &mut room.last));
                network.forward(simd, &weights[..network.len()], &mut room.last);
            }
            Self::Layers([front, behind]) => {
                describe_positions(positions, front.inputs(blocks, &mut room.front));
                front.forward(simd, &weights[..front.len()], &mut room.front);
                let (position, hidden) = (frequencies::POSITION, front.outputs());
                let joined = behind.inputs(blocks, &mut room.last).chunks_exact_mut(position + hidden);
                let parts = room.front.inputs().chunks_exact(position).zip(room.front.outputs().chunks_exact(hidden));
                for (joined, (of_position, of_hidden)) in joined.zip(parts) {
                    joined[..position].copy_from_slice(of_position);
                    joined[position..].copy_from_slice(of_hidden);
                }
                behind.forward(simd, &weights[front.len()..self.len()], &mut room.last);
            }
        }
    }

    /// Adds the gradient by the weights, given that by the outputs in `room`, and returns that by
    /// the grid's features, `[blocks, features]`; none without a grid.
    #[inline(always)]
    pub(crate) fn backward<'r, S: Simd>(&self, simd: S, weights: &[f32], room: &'r mut TrunkRoom, gradient: &mut [f32]) -> &'r [Lanes] {
        match self {
            Self::Grid(network) => {
                network.backward(simd, weights, &mut room.last, gradient);
                room.last.by_inputs()
            }
            Self::Layers([front, behind]) => {
                let (of_front, of_behind) = gradient.split_at_mut(front.len());
                behind.backward(simd, &weights[front.len()..], &mut room.last, of_behind);
                let (position, hidden) = (frequencies::POSITION, front.outputs());
                let by_joined = room.last.by_inputs().chunks_exact(position + hidden);
                for (by_output, by_joined) in room.front.by_outputs().chunks_exact_mut(hidden).zip(by_joined) {
                    by_output.copy_from_slice(&by_joined[position..]);
                }
                front.backward(simd, &weights[..front.len()], &mut room.front, of_front);
                &[]
            }
        }
    }
}

/// Writes the frequencies of blocks of positions.
fn describe_positions(positions: &[Lanes], inputs: &mut [Lanes]) {
    for (block, rows) in positions.chunks_exact(3).zip(inputs.chunks_exact_mut(frequencies::POSITION)) {
        for lane in 0..LANES {
            let numbers = frequencies::position([0, 1, 2].map(|axis| block[axis].0[lane]));
            rows.iter_mut().zip(numbers).for_each(|(row, number)| row.0[lane] = number);
        }
    }
}
