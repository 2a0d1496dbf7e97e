//! The engine's parameters: sixteen splats side by side, so that every pass reads whole vectors.
//!
//! A block holds 16 splats; a row of a block is one parameter of all 16 ([`Lanes`]). Rows, in order: position 3, rotation 4, log scale 3,
//! opacity logit 1, harmonics 3K (m-major, then channel), raw luminance M. Lanes beyond the last splat mean nothing and
//! are never read as splats.

use luxel_core::{ColorModel, Moments, Splats};

use crate::lanes::LANES;
use crate::memory::Buffer;

/// Which row of a block holds what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Layout {
    pub(crate) color_model: ColorModel,
}

impl Layout {
    pub(crate) const POSITION: usize = 0;
    pub(crate) const ROTATION: usize = 3;
    pub(crate) const LOG_SCALE: usize = 7;
    pub(crate) const OPACITY: usize = 10;
    pub(crate) const SH: usize = 11;

    pub(crate) fn luminance(self) -> usize {
        Self::SH + 3 * self.color_model.sh_coefficients()
    }

    /// Rows of a block: parameters of a splat.
    pub(crate) fn rows(self) -> usize {
        self.luminance() + self.color_model.luminance_coefficients()
    }
}

/// Number of blocks that hold `count` splats.
pub(crate) fn blocks(count: usize) -> usize {
    count.div_ceil(LANES)
}

/// Splats (or their moments, or gradients) in blocks: `[blocks, rows, 16]`.
pub(crate) struct Store {
    pub(crate) layout: Layout,
    pub(crate) count: usize,
    pub(crate) lanes: Buffer,
}

impl Store {
    pub(crate) fn zeros(layout: Layout, count: usize) -> Self {
        Self { layout, count, lanes: Buffer::zeros(blocks(count) * layout.rows()) }
    }

    pub(crate) fn from_splats(splats: &Splats) -> Self {
        let layout = Layout { color_model: splats.color_model };
        let mut store = Self::zeros(layout, splats.len());
        let rows = layout.rows();
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
        let rows = self.layout.rows();
        let k = 3 * self.layout.color_model.sh_coefficients();
        let m = self.layout.color_model.luminance_coefficients();
        for i in 0..self.count {
            let block = &self.lanes[i / LANES * rows..][..rows];
            let lane = i % LANES;
            let at = |row: usize| block[row].0[lane];
            splats.position[i] = std::array::from_fn(|c| at(Layout::POSITION + c));
            splats.rotation[i] = std::array::from_fn(|c| at(Layout::ROTATION + c));
            splats.log_scale[i] = std::array::from_fn(|c| at(Layout::LOG_SCALE + c));
            splats.opacity_logit[i] = at(Layout::OPACITY);
            for (c, value) in splats.sh[i * k..(i + 1) * k].iter_mut().enumerate() {
                *value = at(Layout::SH + c);
            }
            for (c, value) in splats.raw_luminance[i * m..(i + 1) * m].iter_mut().enumerate() {
                *value = at(self.layout.luminance() + c);
            }
        }
        splats
    }

    /// Parameter `row` of splat `i`.
    pub(crate) fn at(&self, row: usize, i: usize) -> f32 {
        self.lanes[i / LANES * self.layout.rows() + row].0[i % LANES]
    }
}
