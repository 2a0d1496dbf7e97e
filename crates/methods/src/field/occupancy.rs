//! The occupancy grid: which cells of the cube a ray must look at.
//!
//! Each cell holds a density, at least the last one found in it times a decay, and is occupied
//! where the opacity of a shortest interval at that density is above a threshold (Mueller et al.
//! 2022). Cells that no training camera sees stay empty for good.

use glam::DVec3;
use luxel_core::Camera;
use rayon::prelude::*;

use crate::field::space::{MIN_LENGTH, Space};
use luxel_core::random;

/// Cells a side.
pub(crate) const SIDE: usize = 64;
/// Factor on the densities at each update.
const DECAY: f32 = 0.95;
/// Optical thickness of a shortest interval from which a cell is occupied, once the mean is
/// higher.
const THRESHOLD: f32 = 0.01;
/// Part of the mean optical thickness from which a cell is occupied while the field is thin. All
/// cells have about the same density at first, and none must be lost for being below the mean.
const MEAN_SHARE: f32 = 0.5;
/// Value of a cell that no camera sees.
const UNSEEN: f32 = -1.0;

/// The cells of the cube.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Occupancy {
    side: usize,
    /// Densities, x fastest; [`UNSEEN`] for cells that stay empty.
    densities: Vec<f32>,
    /// Shortest intervals after which light is dimmed by [`THRESHOLD`] at each density: 0 for cells
    /// that are not occupied, 1 where one interval dims it so much.
    stretches: Vec<u8>,
}

/// A cell to look at again.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Probe {
    cell: usize,
    pub(crate) position: [f32; 3],
}

impl Occupancy {
    /// Returns cells of which all are occupied.
    pub(crate) fn full(side: usize) -> Self {
        Self { side, densities: vec![0.0; side.pow(3)], stretches: vec![u8::MAX; side.pow(3)] }
    }

    /// Returns the cells that at least one camera sees, as occupied.
    pub(crate) fn seen_by<'a>(cameras: impl Iterator<Item = &'a Camera>, space: &Space) -> Self {
        let cameras: Vec<&Camera> = cameras.collect();
        let corners = SIDE + 1;
        let is_seen = |index: usize| {
            let [x, y, z] = [index % corners, index / corners % corners, index / (corners * corners)].map(|c| c as f64 / SIDE as f64);
            let point = space.local(DVec3::new(x, y, z));
            cameras.iter().any(|camera| {
                let size = camera.size_px.map(f64::from);
                camera.project(point).is_some_and(|(at, _)| at.x >= 0.0 && at.y >= 0.0 && at.x <= size[0] && at.y <= size[1])
            })
        };
        let seen: Vec<bool> = (0..corners.pow(3)).into_par_iter().map(is_seen).collect();
        let mut cells = Self::full(SIDE);
        cells.keep(|[x, y, z]| {
            (0..8).any(|corner| seen[(x + (corner & 1)) + corners * ((y + (corner >> 1 & 1)) + corners * (z + (corner >> 2)))])
        });
        cells
    }

    /// Returns the cells with these densities; `None` unless they are a cube's.
    pub(crate) fn from_densities(densities: Vec<f32>) -> Option<Self> {
        let is_usable = densities.iter().all(|d| *d == UNSEEN || (d.is_finite() && *d >= 0.0));
        let mut cells =
            (densities.len() == SIDE.pow(3) && is_usable).then(|| Self { stretches: vec![0; densities.len()], side: SIDE, densities })?;
        cells.decide();
        Some(cells)
    }

    /// Empties for good all cells but those for which `is_kept` holds.
    pub(crate) fn keep(&mut self, is_kept: impl Fn([usize; 3]) -> bool) {
        for index in 0..self.densities.len() {
            if !is_kept(self.place(index)) {
                self.densities[index] = UNSEEN;
                self.stretches[index] = 0;
            }
        }
    }

    pub(crate) fn densities(&self) -> &[f32] {
        &self.densities
    }

    pub(crate) fn side(&self) -> usize {
        self.side
    }

    /// Returns the part of the cells that are occupied.
    pub(crate) fn occupied_part(&self) -> f64 {
        self.stretches.iter().filter(|stretch| **stretch > 0).count() as f64 / self.stretches.len() as f64
    }

    /// Returns the cell of a position; the nearest one for a position outside of the cube.
    #[inline]
    pub(crate) fn cell(&self, position: [f32; 3]) -> [usize; 3] {
        position.map(|p| ((p * self.side as f32).max(0.0) as usize).min(self.side - 1))
    }

    /// Returns how many shortest intervals one sample may stand for in a cell, 0 in one that is not
    /// occupied. More than 1 only while the field is thin.
    #[inline]
    pub(crate) fn stretch(&self, [x, y, z]: [usize; 3]) -> u8 {
        self.stretches[x + self.side * (y + self.side * z)]
    }

    fn place(&self, index: usize) -> [usize; 3] {
        [index % self.side, index / self.side % self.side, index / (self.side * self.side)]
    }

    /// Chooses the cells of an update: all, or a quarter at random and a quarter of the occupied.
    /// Returns a position in each, drawn with `seed`.
    pub(crate) fn probes(&self, seed: u64, all: bool) -> Vec<Probe> {
        let count = self.densities.len();
        let draw = |i: usize, among: usize| (random::bits(seed, i as u64) % among as u64) as usize;
        let chosen: Vec<usize> = if all {
            (0..count).collect()
        } else {
            let occupied: Vec<usize> = (0..count).filter(|i| self.stretches[*i] > 0).collect();
            let anywhere = (0..count / 4).map(|i| draw(i, count));
            let among = (0..occupied.len().min(count) / 4).map(|i| occupied[draw(count + i, occupied.len())]);
            anywhere.chain(among).collect()
        };
        let probe = |cell: usize| {
            let (place, side) = (self.place(cell), self.side as f32);
            let at = |axis: usize| (place[axis] as f32 + random::uniform(!seed, (3 * cell + axis) as u64)) / side;
            Probe { cell, position: [at(0), at(1), at(2)] }
        };
        chosen.into_iter().filter(|cell| self.densities[*cell] != UNSEEN).map(probe).collect()
    }

    /// Takes the densities found at probes, in their order, and decides again which cells are
    /// occupied.
    pub(crate) fn update(&mut self, probes: &[Probe], densities: &[f32]) {
        for density in self.densities.iter_mut().filter(|density| **density != UNSEEN) {
            *density *= DECAY;
        }
        for (Probe { cell, .. }, density) in probes.iter().zip(densities) {
            self.densities[*cell] = self.densities[*cell].max(*density);
        }
        self.decide();
    }

    fn decide(&mut self) {
        let seen = self.densities.iter().filter(|density| **density != UNSEEN);
        let (sum, count) = seen.fold((0f64, 0u32), |(sum, count), density| (sum + f64::from(*density), count + 1));
        let mean = (sum / f64::from(count.max(1))) as f32 * MIN_LENGTH;
        let threshold = THRESHOLD.min(MEAN_SHARE * mean);
        for (stretch, density) in self.stretches.iter_mut().zip(&self.densities) {
            let thickness = *density * MIN_LENGTH;
            let is_occupied = *density >= 0.0 && thickness >= threshold;
            *stretch = if is_occupied { (THRESHOLD / thickness).clamp(1.0, 255.0) as u8 } else { 0 };
        }
    }
}
