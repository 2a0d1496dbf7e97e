//! The engine's parameters: sixteen splats side by side, so that every pass reads whole vectors.
//!
//! A block holds 16 splats; a row of a block is one parameter of all 16 ([`crate::lanes::Lanes`]).
//! Rows are in the order of [`ParameterRows`]. Lanes beyond the last splat mean nothing and are
//! never read as splats.

use luxel_core::engine::ParameterRows;
use luxel_core::{Moments, Splats};

use crate::lanes::LANES;
use crate::memory::Buffer;

/// Number of blocks that hold `count` splats.
pub(crate) fn blocks(count: usize) -> usize {
    count.div_ceil(LANES)
}

/// Splats (or their moments, or gradients) in blocks: `[blocks, rows, 16]`.
pub(crate) struct Store {
    pub(crate) layout: ParameterRows,
    pub(crate) count: usize,
    pub(crate) lanes: Buffer,
}

impl Store {
    pub(crate) fn zeros(layout: ParameterRows, count: usize) -> Self {
        Self { layout, count, lanes: Buffer::zeros(blocks(count) * layout.count()) }
    }

    pub(crate) fn from_splats(splats: &Splats) -> Self {
        let layout = ParameterRows { color_model: splats.color_model };
        let mut store = Self::zeros(layout, splats.len());
        let rows = layout.count();
        for i in 0..splats.len() {
            let block = &mut store.lanes[i / LANES * rows..][..rows];
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
        store
    }

    pub(crate) fn to_splats(&self) -> Splats {
        let mut splats = Moments::zeros(self.layout.color_model, self.count).first;
        let rows = self.layout.count();
        let k = 3 * self.layout.color_model.sh_coefficients();
        let m = self.layout.color_model.luminance_coefficients();
        for i in 0..self.count {
            let block = &self.lanes[i / LANES * rows..][..rows];
            let lane = i % LANES;
            let at = |row: usize| block[row].0[lane];
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

    /// Parameter `row` of splat `i`.
    pub(crate) fn at(&self, row: usize, i: usize) -> f32 {
        self.lanes[i / LANES * self.layout.count() + row].0[i % LANES]
    }
}
