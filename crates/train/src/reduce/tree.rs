//! The tree by which gradients are added, so that their sum has the same bits wherever its parts
//! are computed.

use std::ops::Range;

use luxel_core::engine::SparsePart;
use rayon::prelude::*;

use super::lost;
use super::slots::middle;
use crate::TrainError;

/// The gradients of a node of the tree.
pub(super) struct Node<'a> {
    pub(super) slots: Range<usize>,
    pub(super) gradients: SparsePart<'a>,
}

/// The tree of a sum, with the gradients of some of its nodes as leaves.
pub(super) enum Tree<'a> {
    Leaf(SparsePart<'a>),
    Pair(Box<Tree<'a>>, Box<Tree<'a>>),
}

impl<'a> Tree<'a> {
    /// Returns the tree of a node; `None` if a slot is among no leaf.
    pub(super) fn of(node: Range<usize>, leaves: &[Node<'a>]) -> Option<Self> {
        if let Some(leaf) = leaves.iter().find(|leaf| leaf.slots == node) {
            return Some(Self::Leaf(leaf.gradients));
        }
        if node.len() < 2 {
            return None;
        }
        let middle = middle(&node);
        Some(Self::Pair(Self::of(node.start..middle, leaves)?.into(), Self::of(middle..node.end, leaves)?.into()))
    }

    /// Returns the numbers of the blocks of any leaf, ascending.
    pub(super) fn blocks(&self) -> Vec<u32> {
        let mut blocks = Vec::new();
        self.collect_blocks(&mut blocks);
        blocks.sort_unstable();
        blocks.dedup();
        blocks
    }

    fn collect_blocks(&self, blocks: &mut Vec<u32>) {
        match self {
            Self::Leaf(gradients) => blocks.extend_from_slice(gradients.blocks()),
            Self::Pair(left, right) => {
                left.collect_blocks(blocks);
                right.collect_blocks(blocks);
            }
        }
    }

    /// Writes the sum of a block and returns true, or leaves `out` alone if no leaf has the block.
    fn write_block(&self, block: u32, out: &mut [f32]) -> bool {
        match self {
            Self::Leaf(gradients) => gradients.values_of(block).is_some_and(|values| {
                out.copy_from_slice(values);
                true
            }),
            Self::Pair(left, right) if !left.write_block(block, out) => right.write_block(block, out),
            Self::Pair(_, right) => {
                let mut own = Vec::new();
                let values = match &**right {
                    Self::Leaf(gradients) => gradients.values_of(block),
                    pair => {
                        own.resize(out.len(), 0.0);
                        pair.write_block(block, &mut own).then_some(&*own)
                    }
                };
                for (out, value) in out.iter_mut().zip(values.unwrap_or_default()) {
                    *out += value;
                }
                true
            }
        }
    }

    /// Writes the sum of each of these blocks, and finishes it.
    pub(super) fn write_blocks(&self, blocks: &[u32], block_len: usize, out: &mut [f32], finish: impl Fn(&mut [f32]) + Sync) {
        out.par_chunks_exact_mut(block_len).zip(blocks).with_min_len(64).for_each(|(out, block)| {
            self.write_block(*block, out);
            finish(out);
        });
    }
}

/// Returns the tree of a node over these leaves.
pub(super) fn tree_of<'a>(node: Range<usize>, leaves: &[Node<'a>]) -> Result<Tree<'a>, TrainError> {
    Tree::of(node, leaves).ok_or_else(|| lost("a slot of the batch"))
}
