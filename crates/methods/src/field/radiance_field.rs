//! A radiance field: its shape, parameters and occupied cells.

use luxel_core::Dataset;
use luxel_lanes::Level;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::field::error::FieldError;
use crate::field::grid::Grid;
use crate::field::head::ColorHead;
use crate::field::networks::{Networks, Room, position_blocks};
use crate::field::objective::Objective;
use crate::field::occupancy::Occupancy;
use crate::field::options::FieldConfig;
use crate::field::space::Space;
use crate::field::trunk::{FieldNetwork, Parameters};
use luxel_core::random;

/// Bound of the features at the start.
const INITIAL_FEATURE: f32 = 1e-4;
/// Positions that a thread evaluates at a time.
const CHUNK: usize = 2048;

/// The shape and the place of a field, without its parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldShape {
    /// The map from positions to density and colour.
    pub network: FieldNetwork,
    /// The meaning of raw colours.
    pub head: ColorHead,
    /// The cube that the field fills.
    pub space: Space,
}

/// The arrays of a field, for files.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldArrays {
    /// Features of the hash grid, level by level; none without a grid.
    pub table: Vec<f32>,
    /// Weights and biases of the networks.
    pub weights: Vec<f32>,
    /// Densities of the cells of the occupancy grid.
    pub occupancy: Vec<f32>,
}

/// A field of density and radiance in normalised units.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    shape: FieldShape,
    pub(crate) grid: Grid,
    pub(crate) networks: Networks,
    pub(crate) table: Vec<f32>,
    pub(crate) weights: Vec<f32>,
    pub(crate) occupancy: Occupancy,
}

impl Field {
    /// Returns a field around the cameras and points of a data set, with random parameters.
    pub(crate) fn initial(dataset: &Dataset, options: &FieldConfig) -> Self {
        let (network, head, seed) = (options.network, options.objective.head(), options.seed);
        let space = Space::around(dataset);
        let (grid, occupancy) = (network.grid(), Occupancy::seen_by(dataset.train.iter().map(|view| &view.camera), &space));
        let networks = Networks::new(network, &grid, head);
        let feature = |index: usize| INITIAL_FEATURE * (2.0 * random::uniform(seed, index as u64) - 1.0);
        let table = (0..grid.len()).into_par_iter().map(feature).collect();
        let mut weights = networks.initial(random::bits(seed, u64::MAX));
        if let Objective::Captured { unit_value } = options.objective {
            networks.head.start_curves(&mut weights[networks.before_head()..], unit_value);
        }
        Self { shape: FieldShape { network, head, space }, grid, networks, table, weights, occupancy }
    }

    /// Returns the field with these arrays.
    ///
    /// # Errors
    /// [`FieldError::Arrays`] if a shape is out of range, or an array of another length or not
    /// finite.
    pub fn from_arrays(shape: FieldShape, arrays: FieldArrays) -> Result<Self, FieldError> {
        let FieldShape { network, head, space } = shape;
        if !network.is_valid() {
            return Err(FieldError::Arrays(format!("sizes out of range: {network:?}")));
        }
        let Space { center, side, near } = space;
        if !(side.is_finite() && side > 0.0 && near.is_finite() && near >= 0.0 && center.iter().all(|c| c.is_finite())) {
            return Err(FieldError::Arrays(format!("cube of side {side}, expected a finite number above 0")));
        }
        let grid = network.grid();
        let networks = Networks::new(network, &grid, head);
        for (name, array, expected) in [("table", &arrays.table, grid.len()), ("weights", &arrays.weights, networks.len())] {
            if array.len() != expected {
                return Err(FieldError::Arrays(format!("{name} has {} numbers, expected {expected}", array.len())));
            }
            if let Some(at) = array.iter().position(|value| !value.is_finite()) {
                return Err(FieldError::Arrays(format!("{name}: number {at} is {}, expected a finite one", array[at])));
            }
        }
        let cells = arrays.occupancy.len();
        let occupancy = Occupancy::from_densities(arrays.occupancy)
            .ok_or_else(|| FieldError::Arrays(format!("occupancy has {cells} cells, expected 64^3 with finite densities")))?;
        Ok(Self { shape, grid, networks, table: arrays.table, weights: arrays.weights, occupancy })
    }

    /// Returns the shape and the place of the field.
    pub fn shape(&self) -> FieldShape {
        self.shape
    }

    /// Returns a copy of the arrays.
    pub fn arrays(&self) -> FieldArrays {
        FieldArrays { table: self.table.clone(), weights: self.weights.clone(), occupancy: self.occupancy.densities().to_vec() }
    }

    /// Returns the number of parameters: features, weights and biases.
    pub fn parameter_count(&self) -> usize {
        self.table.len() + self.weights.len()
    }

    /// Returns the part of the cube that rays look at, 0 to 1.
    pub fn occupied_part(&self) -> f64 {
        self.occupancy.occupied_part()
    }

    pub(crate) fn parameters(&self) -> Parameters<'_> {
        Parameters { table: &self.table, weights: &self.weights }
    }

    /// Returns the densities at positions in the cube, per side of the cube.
    pub(crate) fn densities(&self, level: Level, positions: &[[f32; 3]]) -> Vec<f32> {
        let chunk = |positions: &[[f32; 3]]| {
            let (mut blocks, mut room, mut densities) = (Vec::new(), Room::default(), Vec::new());
            position_blocks(positions, &mut blocks);
            luxel_lanes::dispatch!(level, simd => self.networks.densities(simd, &self.grid, self.parameters(), &blocks, &mut room, &mut densities));
            densities.truncate(positions.len());
            densities
        };
        positions.par_chunks(CHUNK).flat_map_iter(chunk).collect()
    }

    /// Looks again at the densities of cells, of all or of some.
    pub(crate) fn update_occupancy(&mut self, level: Level, seed: u64, all: bool) {
        let probes = self.occupancy.probes(seed, all);
        let positions: Vec<[f32; 3]> = probes.iter().map(|probe| probe.position).collect();
        let densities = self.densities(level, &positions);
        self.occupancy.update(&probes, &densities);
    }
}
