//! The engine's parameters in memory: sixteen splats side by side, so that every pass reads whole
//! vectors.
//!
//! A block holds 16 splats; a row of a block is one parameter of all 16 ([`Lanes`]). Rows, in
//! order: position 3, rotation 4, log scale 3, opacity logit 1, harmonics 3K (m-major, then
//! channel), raw luminance M. Lanes beyond the last splat hold arbitrary values and are never read
//! as splats.

use std::ops::Range;

use luxel_core::engine::ParameterRows;
use luxel_core::{Moments, Splats};

use crate::lanes::{LANES, Lanes};
use crate::memory::Buffer;

/// Returns the number of blocks that hold `count` splats.
pub(crate) fn blocks(count: usize) -> usize {
    count.div_ceil(LANES)
}

/// The layout and the number of splats of a [`Store`].
#[derive(Clone, Copy)]
pub(crate) struct StoreShape {
    pub(crate) layout: ParameterRows,
    /// Number of splats.
    pub(crate) count: usize,
}

/// A block of a [`Store`]: sixteen splats.
#[derive(Clone, Copy)]
pub(crate) struct Block<'a> {
    /// Number of the block within the store.
    pub(crate) index: usize,
    /// Parameters, `[rows, 16]`.
    pub(crate) rows: &'a [Lanes],
}

/// Splats (or their moments, or gradients) in blocks: `[blocks, rows, 16]`.
pub(crate) struct Store {
    pub(crate) layout: ParameterRows,
    pub(crate) count: usize,
    pub(crate) lanes: Buffer,
}

impl Store {
    /// Makes a store of `count` splats whose values are all zero.
    pub(crate) fn zeros(layout: ParameterRows, count: usize) -> Self {
        Self { layout, count, lanes: Buffer::zeros(blocks(count) * layout.count()) }
    }

    /// Copies splats into blocks.
    pub(crate) fn from_splats(splats: &Splats) -> Self {
        let mut store = Self::zeros(ParameterRows { color_model: splats.color_model }, splats.len());
        store.fill_from(splats);
        store
    }

    /// Copies splats of this number and colour model into the blocks.
    pub(crate) fn fill_from(&mut self, splats: &Splats) {
        let rows = self.layout.count();
        for i in 0..self.count {
            let block = &mut self.lanes[i / LANES * rows..][..rows];
            let lane = i % LANES;
            let parameters = splats.position[i]
                .iter()
                .chain(&splats.rotation[i])
                .chain(&splats.log_scale[i])
                .chain([&splats.opacity_logit[i]])
                .chain(splats.sh_of(i))
                .chain(splats.raw_luminance_of(i));
            for (row, value) in block.iter_mut().zip(parameters) {
                row.0[lane] = *value;
            }
        }
    }

    /// Copies the blocks back to splats, without the 3D filter.
    pub(crate) fn to_splats(&self) -> Splats {
        self.to_splats_by(|value| value)
    }

    /// Copies the blocks back to splats, without the 3D filter, with each number mapped by `map`.
    pub(crate) fn to_splats_by(&self, map: impl Fn(f32) -> f32) -> Splats {
        let mut splats = Moments::zeros(self.layout.color_model, self.count).first;
        let rows = self.layout.count();
        let k = 3 * self.layout.color_model.sh_coefficients();
        let m = self.layout.color_model.luminance_coefficients();
        for i in 0..self.count {
            let block = &self.lanes[i / LANES * rows..][..rows];
            let lane = i % LANES;
            let at = |row: usize| map(block[row].0[lane]);
            splats.position[i] = std::array::from_fn(|c| at(ParameterRows::POSITION + c));
            splats.rotation[i] = std::array::from_fn(|c| at(ParameterRows::ROTATION + c));
            splats.log_scale[i] = std::array::from_fn(|c| at(ParameterRows::LOG_SCALE + c));
            splats.opacity_logit[i] = at(ParameterRows::OPACITY);
            for (c, value) in splats.sh[i * k..(i + 1) * k].iter_mut().enumerate() {
                *value = at(ParameterRows::SH + c);
            }
            for (c, value) in splats.raw_luminance[i * m..(i + 1) * m].iter_mut().enumerate() {
                *value = at(self.layout.luminance() + c);
            }
        }
        splats
    }

    /// Returns rows of some splats, splat by splat, with each number mapped by `map`.
    pub(crate) fn rows_of(&self, rows: Range<usize>, splats: Range<usize>, map: impl Fn(f32) -> f32) -> Vec<f32> {
        let mut values = Vec::with_capacity(rows.len() * splats.len());
        let blocks = self.lanes.chunks_exact(self.layout.count()).enumerate();
        for (n, block) in blocks.take(self::blocks(splats.end)).skip(splats.start / LANES) {
            let rows = &block[rows.clone()];
            for lane in (0..LANES).filter(|lane| splats.contains(&(n * LANES + lane))) {
                values.extend(rows.iter().map(|row| map(row.0[lane])));
            }
        }
        values
    }

    /// Returns the layout and the number of splats.
    pub(crate) fn shape(&self) -> StoreShape {
        StoreShape { layout: self.layout, count: self.count }
    }

    /// Returns parameter `row` of splat `i`.
    pub(crate) fn at(&self, row: usize, i: usize) -> f32 {
        self.lanes[i / LANES * self.layout.count() + row].0[i % LANES]
    }
}
