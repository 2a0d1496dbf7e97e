//! The multi-resolution hash grid (Mueller et al. 2022): features of a position.
//!
//! In: positions in the unit cube. Out: [`FEATURES`] features per level, interpolated trilinearly
//! between the eight grid points around the position. Level l has `16 b^l - 1` cells a side (b from
//! the coarsest to the finest); a level whose grid points fit into the table is stored densely, and
//! the points of others share entries by a hash. Degenerate: positions outside of the cube count as
//! its nearest border.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, u32x16};
use luxel_lanes::{LANES, Lanes};
use serde::{Deserialize, Serialize};

/// Features of a grid point.
pub(crate) const FEATURES: usize = 2;

/// Size of a hash grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct GridShape {
    /// Number of levels.
    pub levels: u32,
    /// Base-2 logarithm of the largest number of entries of a level.
    pub log2_entries: u32,
    /// Grid points a side of the coarsest level.
    pub coarsest: u32,
    /// Grid points a side of the finest level.
    pub finest: u32,
}

impl Default for GridShape {
    /// A grid whose levels fit into the cache of a processor's core.
    fn default() -> Self {
        Self { levels: 12, log2_entries: 17, coarsest: 16, finest: 1024 }
    }
}

/// One level of a grid.
#[derive(Clone, Debug, PartialEq)]
struct Level {
    /// Cells a side.
    scale: f32,
    /// Grid points a side.
    side: u32,
    is_dense: bool,
    /// Entries of the table.
    entries: Range<usize>,
}

/// The geometry of a hash grid; its features are parameters, kept elsewhere.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Grid {
    levels: Vec<Level>,
}

/// The grid points around sixteen positions, and their weights.
struct Corners<S: Simd> {
    entries: [[u32; LANES]; 8],
    weights: [f32x16<S>; 8],
}

impl Grid {
    pub(crate) fn new(shape: GridShape) -> Self {
        let (coarsest, finest) = (f64::from(shape.coarsest), f64::from(shape.finest));
        let growth = if shape.levels > 1 { (finest / coarsest).powf(1.0 / f64::from(shape.levels - 1)) } else { 1.0 };
        let mut start = 0;
        let mut level = |l: u32| {
            // Rounding must not turn a whole number into the next larger one.
            let scale = coarsest * growth.powi(l as i32) - 1.0;
            let side = (scale - 1e-6).ceil() as u32 + 1;
            let points = (side as usize).pow(3);
            let is_dense = points <= 1 << shape.log2_entries;
            // A multiple of 8 entries fills whole vectors.
            let count = if is_dense { points.next_multiple_of(8) } else { 1 << shape.log2_entries };
            let entries = start..start + count;
            start += count;
            Level { scale: scale as f32, side, is_dense, entries }
        };
        Self { levels: (0..shape.levels).map(&mut level).collect() }
    }

    pub(crate) fn levels(&self) -> usize {
        self.levels.len()
    }

    /// Returns the number of features of a position.
    pub(crate) fn width(&self) -> usize {
        FEATURES * self.levels.len()
    }

    /// Returns the numbers of level `level` in the table.
    pub(crate) fn numbers(&self, level: usize) -> Range<usize> {
        let Range { start, end } = self.levels[level].entries;
        FEATURES * start..FEATURES * end
    }

    /// Returns the length of the table.
    pub(crate) fn len(&self) -> usize {
        self.levels.last().map_or(0, |level| FEATURES * level.entries.end)
    }

    /// Writes the features of blocks of positions `[blocks, 3]` into `features` `[blocks, width]`.
    #[inline(always)]
    pub(crate) fn encode<S: Simd>(&self, simd: S, table: &[f32], positions: &[Lanes], features: &mut [Lanes]) {
        let width = self.width();
        for (number, level) in self.levels.iter().enumerate() {
            let entries: &[[f32; FEATURES]] = bytemuck::cast_slice(&table[self.numbers(number)]);
            for (position, out) in positions.chunks_exact(3).zip(features.chunks_exact_mut(width)) {
                let corners = level.corners(simd, position);
                let mut sums = [f32x16::splat(simd, 0.0); FEATURES];
                for (places, weight) in corners.entries.iter().zip(corners.weights) {
                    let mut found = [[0f32; FEATURES]; LANES];
                    for (found, place) in found.iter_mut().zip(places) {
                        *found = entries[*place as usize];
                    }
                    let flat: &[f32; FEATURES * LANES] = bytemuck::cast_ref(&found);
                    let low = f32x16::from_slice(simd, &flat[..LANES]);
                    let (first, second) = low.deinterleave(f32x16::from_slice(simd, &flat[LANES..]));
                    sums[0] = weight.mul_add(first, sums[0]);
                    sums[1] = weight.mul_add(second, sums[1]);
                }
                out[FEATURES * number].store(sums[0]);
                out[FEATURES * number + 1].store(sums[1]);
            }
        }
    }

    /// Adds to `gradient`, of the numbers of one level, what the gradient by its features of blocks
    /// of positions contributes, sample by sample in order. `by_features` is `[blocks, width]`.
    #[inline(always)]
    pub(crate) fn scatter<S: Simd>(&self, simd: S, level: usize, positions: &[Lanes], by_features: &[Lanes], gradient: &mut [f32]) {
        let (geometry, width) = (&self.levels[level], self.width());
        let gradient: &mut [[f32; FEATURES]] = bytemuck::cast_slice_mut(gradient);
        for (position, by_features) in positions.chunks_exact(3).zip(by_features.chunks_exact(width)) {
            let by = [by_features[FEATURES * level].load(simd), by_features[FEATURES * level + 1].load(simd)];
            let corners = geometry.corners(simd, position);
            for (places, weight) in corners.entries.iter().zip(corners.weights) {
                let (low, high) = (weight * by[0]).interleave(weight * by[1]);
                let mut added = [[0f32; FEATURES]; LANES];
                let flat: &mut [f32; FEATURES * LANES] = bytemuck::cast_mut(&mut added);
                low.store_slice(&mut flat[..LANES]);
                high.store_slice(&mut flat[LANES..]);
                for (added, place) in added.iter().zip(places) {
                    let entry = &mut gradient[*place as usize];
                    entry[0] += added[0];
                    entry[1] += added[1];
                }
            }
        }
    }
}

impl Level {
    #[inline(always)]
    fn corners<S: Simd>(&self, simd: S, position: &[Lanes]) -> Corners<S> {
        let last = u32x16::splat(simd, self.side - 1);
        // Factors of a dense index, or of the hash.
        let factors = if self.is_dense { [1, self.side, self.side * self.side] } else { [1, 2_654_435_761, 805_459_861] };
        let zero = f32x16::splat(simd, 0.0);
        let mut parts = [[u32x16::splat(simd, 0); 2]; 3];
        let mut shares = [[zero; 2]; 3];
        for axis in 0..3 {
            // Half a cell of shift keeps the points of different levels apart.
            let inside = position[axis].load(simd).max(zero).min(f32x16::splat(simd, 1.0));
            let scaled = inside.mul_add(f32x16::splat(simd, self.scale), f32x16::splat(simd, 0.5));
            let whole = scaled.floor();
            let fraction = scaled - whole;
            let low: u32x16<S> = whole.to_int();
            let high = (low + u32x16::splat(simd, 1)).min(last);
            parts[axis] = [low.min(last) * factors[axis], high * factors[axis]];
            shares[axis] = [f32x16::splat(simd, 1.0) - fraction, fraction];
        }
        let mask = u32x16::splat(simd, (self.entries.len() as u32).wrapping_sub(1));
        let mut entries = [[0u32; LANES]; 8];
        let mut weights = [zero; 8];
        for corner in 0..8 {
            let [x, y, z] = [corner & 1, (corner >> 1) & 1, corner >> 2];
            let [a, b, c] = [parts[0][x], parts[1][y], parts[2][z]];
            let index = if self.is_dense { a + b + c } else { (a ^ b ^ c) & mask };
            index.store_array(&mut entries[corner]);
            weights[corner] = shares[0][x] * shares[1][y] * shares[2][z];
        }
        Corners { entries, weights }
    }
}
