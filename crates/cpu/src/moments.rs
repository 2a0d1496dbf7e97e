//! Adam's moments in memory, beside the parameters: in single precision, or sixteen bits each.
//!
//! In sixteen bits, both moments of a parameter share one number of the parameters' layout: the
//! upper half is the first moment's (sign, exponent, seven bits of the mantissa), the lower half
//! the second's (exponent, eight bits). A step unpacks, moves and packs them
//! ([`crate::lanes::V::pack_moments`]). Zero is zero in either form, so pass `densify` moves both
//! alike.

use std::ops::Range;

use luxel_core::Moments;
use luxel_core::engine::{DensifyPlan, MomentFormat, ParameterRows};

use crate::lanes::Lanes;
use crate::memory::Buffer;
use crate::passes::densify;
use crate::store::Store;

/// The moments of all splats.
pub(crate) enum MomentStore {
    Full { first: Store, second: Store },
    Packed(Store),
}

/// Rows of the moments of some blocks, `[blocks, rows, 16]`.
pub(crate) enum MomentRows<'a> {
    Full { first: &'a mut [Lanes], second: &'a mut [Lanes] },
    Packed(&'a mut [Lanes]),
}

impl MomentRows<'_> {
    /// Returns the rows of block `n`, of `rows` rows.
    #[inline(always)]
    pub(crate) fn block(&mut self, n: usize, rows: usize) -> MomentRows<'_> {
        let range = n * rows..(n + 1) * rows;
        match self {
            Self::Full { first, second } => MomentRows::Full { first: &mut first[range.clone()], second: &mut second[range] },
            Self::Packed(packed) => MomentRows::Packed(&mut packed[range]),
        }
    }
}

/// Packs the moments of one parameter, whose lower bits are cut off.
fn packed(first: f32, second: f32) -> f32 {
    f32::from_bits(first.to_bits() & 0xffff_0000 | second.to_bits() >> 15 & 0xffff)
}

/// Returns the moments of one parameter.
fn unpacked(packed: f32) -> [f32; 2] {
    [f32::from_bits(packed.to_bits() & 0xffff_0000), f32::from_bits((packed.to_bits() & 0xffff) << 15)]
}

impl MomentStore {
    /// Makes moments of `count` splats that are all zero.
    pub(crate) fn zeros(format: MomentFormat, layout: ParameterRows, count: usize) -> Self {
        let zeros = || Store::zeros(layout, count);
        match format {
            MomentFormat::F32 => Self::Full { first: zeros(), second: zeros() },
            MomentFormat::Bf16 => Self::Packed(zeros()),
        }
    }

    /// Copies moments into blocks.
    pub(crate) fn from_moments(format: MomentFormat, moments: &Moments) -> Self {
        let (first, second) = (Store::from_splats(&moments.first), Store::from_splats(&moments.second));
        match format {
            MomentFormat::F32 => Self::Full { first, second },
            MomentFormat::Bf16 => {
                let mut both = first;
                for (to, second) in both.lanes.iter_mut().zip(second.lanes.iter()) {
                    *to = Lanes(std::array::from_fn(|lane| packed(to.0[lane], second.0[lane])));
                }
                Self::Packed(both)
            }
        }
    }

    /// Copies the blocks back to moments.
    pub(crate) fn to_moments(&self) -> Moments {
        match self {
            Self::Full { first, second } => Moments { first: first.to_splats(), second: second.to_splats() },
            Self::Packed(both) => {
                let [first, second] = [0, 1].map(|which| both.to_splats_by(|value| unpacked(value)[which]));
                Moments { first, second }
            }
        }
    }

    /// Returns rows of the first or the second moments of some splats, splat by splat.
    pub(crate) fn rows_of(&self, is_second: bool, rows: Range<usize>, splats: Range<usize>) -> Vec<f32> {
        match self {
            Self::Full { first, second } => if is_second { second } else { first }.rows_of(rows, splats, |value| value),
            Self::Packed(both) => both.rows_of(rows, splats, |value| unpacked(value)[usize::from(is_second)]),
        }
    }

    /// Returns the moments in parts of `blocks` blocks.
    pub(crate) fn chunks(&mut self, blocks: usize) -> Vec<MomentRows<'_>> {
        match self {
            Self::Full { first, second } => {
                let len = blocks * first.layout.count();
                let parts = first.lanes.chunks_mut(len).zip(second.lanes.chunks_mut(len));
                parts.map(|(first, second)| MomentRows::Full { first, second }).collect()
            }
            Self::Packed(both) => {
                let len = blocks * both.layout.count();
                both.lanes.chunks_mut(len).map(MomentRows::Packed).collect()
            }
        }
    }

    /// Applies a plan ([`densify::apply_to_moments`]).
    pub(crate) fn densify(&mut self, parameters: &Store, plan: &DensifyPlan, spare: &mut Buffer) {
        match self {
            Self::Full { first, second } => {
                for moments in [first, second] {
                    densify::apply_to_moments(moments, parameters, plan, spare);
                }
            }
            Self::Packed(both) => densify::apply_to_moments(both, parameters, plan, spare),
        }
    }
}
