//! The gradients of one view or of a batch: of the splats that were seen, in blocks, so that sums
//! and exchanges between processes leave the others out.
//!
//! In: gradients of blocks of [`SPLATS_PER_BLOCK`] splats. Out: the same by block, and parts of
//! them. Degenerate: no blocks are the gradients of a view that shows no splat.

use std::ops::Range;

use super::{EngineError, ParameterRows};

/// Splats of a block.
pub const SPLATS_PER_BLOCK: usize = 16;

/// Rows of a block's statistics, after those of its parameters: sum of |dL/dmean| and of its
/// absolute parts in NDC units, number of views that saw the splat, exact up to 2^24.
pub const STATISTICS_ROWS: usize = 3;

/// Gradients by the parameters of some blocks of splats, with their densification statistics.
///
/// ```
/// use luxel_core::ColorModel;
/// use luxel_core::engine::{ParameterRows, SparseGradients};
///
/// let rows = ParameterRows { color_model: ColorModel::Sh { degree: 0 } };
/// let mut gradients = SparseGradients::none(rows);
/// gradients.push(7).fill(0.5);
/// gradients.scale(0.5);
/// assert_eq!(gradients.blocks(), [7]);
/// assert_eq!(gradients.values_of(7).unwrap()[0], 0.25);
/// assert!(gradients.values_of(2).is_none());
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct SparseGradients {
    rows: ParameterRows,
    /// Numbers of the blocks, ascending.
    blocks: Vec<u32>,
    /// `[blocks, rows + STATISTICS_ROWS, SPLATS_PER_BLOCK]`.
    values: Vec<f32>,
}

impl SparseGradients {
    /// Returns the gradients of no splat.
    pub fn none(rows: ParameterRows) -> Self {
        Self { rows, blocks: Vec::new(), values: Vec::new() }
    }

    /// Makes room for `blocks` blocks.
    pub fn reserve(&mut self, blocks: usize) {
        self.blocks.reserve_exact(blocks);
        self.values.reserve_exact(blocks * self.block_len());
    }

    /// Returns the numbers of a block: its rows of parameters and statistics.
    pub fn block_len(&self) -> usize {
        Self::block_len_of(self.rows)
    }

    fn block_len_of(rows: ParameterRows) -> usize {
        (rows.count() + STATISTICS_ROWS) * SPLATS_PER_BLOCK
    }

    /// Returns how many of a block's numbers are gradients; the statistics follow them.
    pub fn parameters_len(&self) -> usize {
        self.rows.count() * SPLATS_PER_BLOCK
    }

    /// Returns the parameters' rows.
    pub fn rows(&self) -> ParameterRows {
        self.rows
    }

    /// Returns the numbers of the blocks, ascending.
    pub fn blocks(&self) -> &[u32] {
        &self.blocks
    }

    /// Returns the values of all blocks, `[blocks, rows + STATISTICS_ROWS, SPLATS_PER_BLOCK]`.
    pub fn values_mut(&mut self) -> &mut [f32] {
        &mut self.values
    }

    /// Returns block by block its number and its values, `[rows + STATISTICS_ROWS, 16]`.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &[f32])> {
        self.blocks.iter().copied().zip(self.values.chunks_exact(self.block_len()))
    }

    /// Returns the values of a block, if it has any.
    pub fn values_of(&self, block: u32) -> Option<&[f32]> {
        let at = self.blocks.binary_search(&block).ok()?;
        let len = self.block_len();
        self.values.get(at * len..(at + 1) * len)
    }

    /// Appends a block of zeros and returns its values.
    ///
    /// # Panics
    /// If `block` is not behind the last one.
    pub fn push(&mut self, block: u32) -> &mut [f32] {
        assert!(self.blocks.last().is_none_or(|last| *last < block), "blocks come in ascending order");
        self.blocks.push(block);
        let at = self.values.len();
        self.values.resize(at + self.block_len(), 0.0);
        &mut self.values[at..]
    }

    /// Multiplies the gradients by `factor`; the statistics stay.
    pub fn scale(&mut self, factor: f32) {
        let (len, parameters) = (self.block_len(), self.parameters_len());
        for block in self.values.chunks_exact_mut(len) {
            block[..parameters].iter_mut().for_each(|value| *value *= factor);
        }
    }

    /// Becomes gradients of these blocks, in ascending order, with these rows; the values are
    /// arbitrary.
    pub fn restart(&mut self, rows: ParameterRows, blocks: &[u32]) {
        self.rows = rows;
        self.blocks.clear();
        self.blocks.extend_from_slice(blocks);
        self.values.resize(blocks.len() * Self::block_len_of(rows), 0.0);
    }

    /// Returns the blocks whose numbers lie in `range`.
    pub fn part(&self, range: &Range<u32>) -> SparsePart<'_> {
        let [from, to] = [range.start, range.end].map(|block| self.blocks.partition_point(|found| *found < block));
        let len = self.block_len();
        SparsePart { blocks: &self.blocks[from..to], values: &self.values[from * len..to * len], block_len: len }
    }

    /// Checks that these are gradients of a scene of `count` splats with these rows.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] if they are not.
    pub fn check(&self, rows: ParameterRows, count: usize) -> Result<(), EngineError> {
        let last = self.blocks.last().map_or(0, |last| *last as usize + 1);
        if self.rows == rows && last <= count.div_ceil(SPLATS_PER_BLOCK) {
            return Ok(());
        }
        Err(EngineError::invalid(format!(
            "gradients by {} parameters of up to {} splats, the scene has {count} of {}",
            self.rows.count(),
            last * SPLATS_PER_BLOCK,
            rows.count()
        )))
    }
}

/// Some blocks of gradients, borrowed: of [`SparseGradients`], or of a message.
#[derive(Clone, Copy, Debug)]
pub struct SparsePart<'a> {
    blocks: &'a [u32],
    values: &'a [f32],
    block_len: usize,
}

impl<'a> SparsePart<'a> {
    /// Returns the numbers of the blocks, ascending.
    pub fn blocks(self) -> &'a [u32] {
        self.blocks
    }

    /// Returns the values of a block, if it has any.
    pub fn values_of(self, block: u32) -> Option<&'a [f32]> {
        let at = self.blocks.binary_search(&block).ok()?;
        self.values.get(at * self.block_len..(at + 1) * self.block_len)
    }

    /// Returns the values of all blocks, `[blocks, rows + STATISTICS_ROWS, SPLATS_PER_BLOCK]`.
    pub fn values(self) -> &'a [f32] {
        self.values
    }

    /// Returns gradients of these blocks with these values; `None` if the blocks are not in
    /// ascending order or the number of values is another.
    pub fn new(rows: ParameterRows, blocks: &'a [u32], values: &'a [f32]) -> Option<Self> {
        let block_len = SparseGradients::block_len_of(rows);
        let fits = blocks.len().checked_mul(block_len) == Some(values.len());
        (fits && blocks.is_sorted_by(|a, b| a < b)).then_some(Self { blocks, values, block_len })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ColorModel;

    const ROWS: ParameterRows = ParameterRows { color_model: ColorModel::Sh { degree: 0 } };

    fn gradients(blocks: &[(u32, f32)]) -> SparseGradients {
        let mut gradients = SparseGradients::none(ROWS);
        for (block, value) in blocks {
            gradients.push(*block).iter_mut().zip(0u16..).for_each(|(out, i)| *out = value * f32::from(i + 1));
        }
        gradients
    }

    #[test]
    fn statistics_are_not_scaled() {
        let mut scaled = gradients(&[(2, 1.0)]);
        scaled.scale(0.5);
        let (values, len) = (scaled.values_of(2).unwrap(), scaled.parameters_len());
        assert_eq!((values[0], values[len - 1], values[len]), (0.5, 0.5 * len as f32, (len + 1) as f32));
        assert_eq!(scaled.values_of(1), None);
    }

    #[test]
    fn parts_are_made_of_what_they_hold() {
        let all = gradients(&[(0, 1.0), (3, -0.0), (9, f32::MIN_POSITIVE)]);
        for (range, blocks) in [(0..3, &[0][..]), (3..10, &[3, 9]), (4..9, &[])] {
            let part = all.part(&range);
            assert_eq!(part.blocks(), blocks);
            let again = SparsePart::new(ROWS, part.blocks(), part.values()).unwrap();
            assert_eq!([0, 3, 9].map(|block| again.values_of(block)), [0, 3, 9].map(|block| part.values_of(block)));
        }
        let values = all.part(&(0..10)).values();
        assert!(SparsePart::new(ROWS, &[0, 3], values).is_none());
        assert!(SparsePart::new(ROWS, &[3, 0, 9], values).is_none());
    }

    #[test]
    fn gradients_fit_their_scene() {
        let of_four_blocks = gradients(&[(3, 1.0)]);
        assert!(of_four_blocks.check(ROWS, 49).is_ok());
        assert!(of_four_blocks.check(ROWS, 48).unwrap_err().to_string().contains("up to 64 splats, the scene has 48"));
        let other = ParameterRows { color_model: ColorModel::Sh { degree: 1 } };
        assert!(of_four_blocks.check(other, 64).is_err());
    }
}
