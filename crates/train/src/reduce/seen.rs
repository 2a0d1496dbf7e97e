//! The blocks of splats that each rank has gradients of, which all ranks know: so that each knows
//! the lengths of all messages.
//!
//! In: the trees of a rank's nodes. Out: the blocks of all nodes, where in its memory a rank has
//! the words for another, and how many it receives. Degenerate: a rank without slots has no node.

use std::ops::Range;

use luxel_core::Exchange;

use super::lost;
use super::slots::{BlockShape, Slots};
use super::tree::Tree;
use crate::TrainError;

/// The blocks that a node of the tree has gradients of.
pub(super) struct NodeBlocks {
    pub(super) rank: usize,
    pub(super) slots: Range<usize>,
    pub(super) blocks: Vec<u32>,
}

/// The blocks that all nodes of all ranks have gradients of, in the order of slots.
pub(super) struct SeenBlocks {
    pub(super) slots: Slots,
    pub(super) shape: BlockShape,
    pub(super) nodes: Vec<NodeBlocks>,
}

impl SeenBlocks {
    /// Tells all ranks the blocks of this rank's trees, one for each of its nodes.
    pub(super) fn exchange(exchange: &mut dyn Exchange, slots: Slots, shape: BlockShape, trees: &[Tree<'_>]) -> Result<Self, TrainError> {
        let mut message = Vec::new();
        for tree in trees {
            let blocks = tree.blocks();
            message.push(blocks.len() as u32);
            message.extend_from_slice(&blocks);
        }
        let mut nodes = Vec::new();
        for (rank, mut message) in exchange.all_gather(&message)?.iter().enumerate() {
            for node in slots.nodes(rank) {
                let blocks = read_blocks(&mut message, shape.blocks).ok_or_else(|| lost("blocks of gradients"))?;
                nodes.push(NodeBlocks { rank, slots: node, blocks });
            }
        }
        Ok(Self { slots, shape, nodes })
    }

    pub(super) fn nodes_of(&self, rank: usize) -> impl Iterator<Item = &NodeBlocks> {
        self.nodes.iter().filter(move |node| node.rank == rank)
    }

    /// Returns how many words a rank sends to another.
    fn length(&self, from: usize, to: usize) -> usize {
        if from == to {
            return 0;
        }
        self.nodes_of(from).map(|node| self.shape.part(self.slots, to, &node.blocks).len()).sum::<usize>() * self.shape.block_len()
    }

    /// Returns where a rank has the words for each rank: in order, without those for itself where
    /// it has sums, and with them where it has the gradients of a single slot.
    pub(super) fn spans(&self, rank: usize) -> Vec<Range<usize>> {
        let single = match &self.nodes_of(rank).collect::<Vec<_>>()[..] {
            [node] if node.slots.len() == 1 => Some(*node),
            _ => None,
        };
        let mut end = 0;
        let spans = (0..self.slots.ranks).map(|to| match single {
            Some(node) => {
                let part = self.shape.part(self.slots, to, &node.blocks);
                let [start, end] = [part.start, part.end].map(|block| block * self.shape.block_len());
                start..if to == rank { start } else { end }
            }
            None => {
                end += self.length(rank, to);
                end - self.length(rank, to)..end
            }
        });
        spans.collect()
    }

    /// Returns how many words each rank sends to this one.
    pub(super) fn lengths_to(&self, rank: usize) -> Vec<usize> {
        (0..self.slots.ranks).map(|from| self.length(from, rank)).collect()
    }

    /// Returns the blocks that any node has gradients of, ascending.
    pub(super) fn blocks_of_any(&self) -> Vec<u32> {
        let mut is_seen = vec![false; self.shape.blocks as usize];
        self.nodes.iter().flat_map(|node| &node.blocks).for_each(|block| is_seen[*block as usize] = true);
        (0..self.shape.blocks).filter(|block| is_seen[*block as usize]).collect()
    }
}

/// Reads a list of blocks from the start of a message, and moves on behind it; `None` if it is
/// something else than blocks of the scene in ascending order.
fn read_blocks(message: &mut &[u32], of_scene: u32) -> Option<Vec<u32>> {
    let (count, rest) = message.split_first()?;
    let (blocks, rest) = rest.split_at_checked(*count as usize)?;
    *message = rest;
    let fits = blocks.is_sorted_by(|a, b| a < b) && blocks.last().is_none_or(|last| *last < of_scene);
    fits.then(|| blocks.to_vec())
}
