//! The mean of a batch's gradients over slots, within a process and over ranks.
//!
//! In: the gradients of the slots that this rank computes. Out: their mean over all slots, on every
//! rank. Sums follow a binary tree over the slots: of `n` slots, the largest power of two below `n`
//! is one half. Which rank adds two numbers does not change them, so the sum has the same bits for
//! any number of ranks, and for one process.
//!
//! A rank first adds up whatever the tree adds among its own slots. Then all ranks learn which
//! blocks of splats the others have gradients of, and share out the scene's blocks: each receives
//! the others' gradients of its blocks, adds them up, and sends the result to all. Every rank thus
//! sends and receives its gradients about twice, however many ranks there are; splats that no view
//! of the batch shows are never sent. Gradients of a single slot are sent from where they are, and
//! sums arrive where they are used. Degenerate: ranks without a slot add up their share all the
//! same.

use std::ops::Range;

use luxel_core::engine::{ParameterRows, SPLATS_PER_BLOCK, STATISTICS_ROWS, SparseGradients, SparsePart};
use luxel_core::{Exchange, ExchangeError};
use rayon::prelude::*;

use crate::TrainError;

/// The slots of a batch, and which of them each rank computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Slots {
    pub(crate) batch: usize,
    pub(crate) ranks: usize,
}

impl Slots {
    /// Returns the slots of a rank; neighbours, so that the tree adds them first.
    pub(crate) fn of_rank(self, rank: usize) -> Range<usize> {
        let start = |rank: usize| (rank * self.batch).div_ceil(self.ranks);
        start(rank)..start(rank + 1)
    }

    /// Returns the largest nodes of the tree within a rank's slots, from left to right.
    fn nodes(self, rank: usize) -> Vec<Range<usize>> {
        let mut nodes = Vec::new();
        collect_nodes(0..self.batch, &self.of_rank(rank), &mut nodes);
        nodes
    }
}

/// The views that a rank of a distributed run trains on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RankViews {
    /// Views a step.
    pub batch: u32,
    /// Number of ranks.
    pub ranks: usize,
    /// This rank.
    pub rank: usize,
}

impl RankViews {
    /// Returns whether the rank trains on this training view: all others belong to other slots of a
    /// batch.
    ///
    /// ```
    /// use luxel_train::RankViews;
    ///
    /// let of = |rank| RankViews { batch: 4, ranks: 2, rank };
    /// let views = |rank| (0..9).filter(|view| of(rank).contain(*view)).collect::<Vec<_>>();
    /// assert_eq!((views(0), views(1)), (vec![0, 1, 4, 5, 8], vec![2, 3, 6, 7]));
    /// ```
    pub fn contain(self, view: usize) -> bool {
        let batch = self.batch.max(1) as usize;
        Slots { batch, ranks: self.ranks }.of_rank(self.rank).contains(&(view % batch))
    }

    /// Returns whether the rank has any view to train on.
    pub fn are_any(self) -> bool {
        !Slots { batch: self.batch.max(1) as usize, ranks: self.ranks }.of_rank(self.rank).is_empty()
    }
}

/// Returns the slot at which the tree divides a node of at least two.
fn middle(node: &Range<usize>) -> usize {
    node.start + (node.len().next_power_of_two() / 2)
}

fn collect_nodes(node: Range<usize>, own: &Range<usize>, nodes: &mut Vec<Range<usize>>) {
    if own.start <= node.start && node.end <= own.end {
        nodes.push(node);
    } else if own.start < node.end && node.start < own.end {
        let middle = middle(&node);
        collect_nodes(node.start..middle, own, nodes);
        collect_nodes(middle..node.end, own, nodes);
    }
}

/// The gradients of a node of the tree.
struct Node<'a> {
    slots: Range<usize>,
    gradients: SparsePart<'a>,
}

/// The tree of a sum, with the gradients of some of its nodes as leaves.
enum Tree<'a> {
    Leaf(SparsePart<'a>),
    Pair(Box<Tree<'a>>, Box<Tree<'a>>),
}

impl<'a> Tree<'a> {
    /// Returns the tree of a node; `None` if a slot is among no leaf.
    fn of(node: Range<usize>, leaves: &[Node<'a>]) -> Option<Self> {
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
    fn blocks(&self) -> Vec<u32> {
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
    fn write_blocks(&self, blocks: &[u32], block_len: usize, out: &mut [f32], finish: impl Fn(&mut [f32]) + Sync) {
        out.par_chunks_exact_mut(block_len).zip(blocks).with_min_len(64).for_each(|(out, block)| {
            self.write_block(*block, out);
            finish(out);
        });
    }
}

/// The mean of a batch's gradients, with the memory that sums and messages take from step to step.
pub(crate) struct BatchMean {
    /// Sums of this rank's nodes, where they are not gradients of a single slot: by receiving rank
    /// and by node.
    sums: Vec<f32>,
    received: Vec<u32>,
    /// The mean of this rank's share of the blocks.
    share: Vec<f32>,
    mean: SparseGradients,
}

impl BatchMean {
    pub(crate) fn new(rows: ParameterRows) -> Self {
        Self { sums: Vec::new(), received: Vec::new(), share: Vec::new(), mean: SparseGradients::none(rows) }
    }

    /// Returns the mean of the gradients of all slots; statistics are summed. `own` has those of
    /// this rank's slots, in their order.
    ///
    /// # Errors
    /// Ranks that cannot exchange data.
    pub(crate) fn of(
        &mut self,
        exchange: &mut dyn Exchange,
        slots: Slots,
        own: &[SparseGradients],
        shape: BlockShape,
    ) -> Result<&SparseGradients, TrainError> {
        let (parameters_len, factor) = (shape.rows.count() * SPLATS_PER_BLOCK, 1.0 / slots.batch as f32);
        let divide = |block: &mut [f32]| block.iter_mut().take(parameters_len).for_each(|value| *value *= factor);
        let block_len = shape.block_len();
        let own_rank = exchange.rank();
        // Gradients of this rank's slots in a range of blocks.
        let own_leaves = |range: &Range<u32>| -> Vec<Node<'_>> {
            let slots = slots.of_rank(own_rank).zip(own);
            slots.map(|(slot, gradients)| Node { slots: slot..slot + 1, gradients: gradients.part(range) }).collect()
        };
        let leaves = own_leaves(&(0..shape.blocks));
        if slots.ranks == 1 {
            let tree = tree_of(0..slots.batch, &leaves)?;
            let blocks = tree.blocks();
            self.mean.restart(shape.rows, &blocks);
            tree.write_blocks(&blocks, block_len, self.mean.values_mut(), divide);
            return Ok(&self.mean);
        }
        let trees: Vec<Tree<'_>> = slots.nodes(own_rank).into_iter().map(|node| tree_of(node, &leaves)).collect::<Result<_, _>>()?;
        let seen = SeenBlocks::exchange(exchange, slots, shape, &trees)?;
        let sent = match &trees[..] {
            [Tree::Leaf(part)] => part.values(),
            trees => sums_by_share(trees, &seen, own_rank, &mut self.sums),
        };
        let (spans, lengths) = (seen.spans(own_rank), seen.lengths_to(own_rank));
        self.received.resize(lengths.iter().sum(), 0);
        exchange.all_to_all(bytemuck::cast_slice(sent), &spans, &mut self.received, &lengths)?;

        let mut leaves = own_leaves(&shape.share(slots, own_rank));
        let mut rest: &[f32] = bytemuck::cast_slice(&self.received);
        for node in seen.nodes.iter().filter(|node| node.rank != own_rank) {
            let blocks = &node.blocks[shape.part(slots, own_rank, &node.blocks)];
            let (values, after) = rest.split_at_checked(blocks.len() * block_len).ok_or_else(|| lost("gradients"))?;
            let gradients = SparsePart::new(shape.rows, blocks, values).ok_or_else(|| lost("gradients"))?;
            leaves.push(Node { slots: node.slots.clone(), gradients });
            rest = after;
        }
        let blocks = seen.blocks_of_any();
        let own_blocks = &blocks[shape.part(slots, own_rank, &blocks)];
        self.share.resize(own_blocks.len() * block_len, 0.0);
        tree_of(0..slots.batch, &leaves)?.write_blocks(own_blocks, block_len, &mut self.share, divide);

        self.mean.restart(shape.rows, &blocks);
        let lengths: Vec<usize> = (0..slots.ranks).map(|rank| shape.part(slots, rank, &blocks).len() * block_len).collect();
        let sums = bytemuck::cast_slice_mut(self.mean.values_mut());
        exchange.all_gather_into(bytemuck::cast_slice(&self.share), sums, &lengths)?;
        let received_words = self.received.len() + lengths.iter().sum::<usize>() - self.share.len();
        tracing::trace!(received_bytes = 4 * received_words, "gradients exchanged");
        Ok(&self.mean)
    }
}

/// Writes the sums of this rank's nodes to `sums`: for each other rank, for each node, those of its
/// share of the blocks.
fn sums_by_share<'a>(trees: &[Tree<'_>], seen: &SeenBlocks, own_rank: usize, sums: &'a mut Vec<f32>) -> &'a [f32] {
    let (slots, shape) = (seen.slots, seen.shape);
    let len = seen.spans(own_rank).iter().map(Range::len).sum();
    sums.resize(len, 0.0);
    let mut rest = &mut sums[..];
    for rank in (0..slots.ranks).filter(|rank| *rank != own_rank) {
        for (tree, node) in trees.iter().zip(seen.nodes_of(own_rank)) {
            let blocks = &node.blocks[shape.part(slots, rank, &node.blocks)];
            let (out, after) = rest.split_at_mut(blocks.len() * shape.block_len());
            tree.write_blocks(blocks, shape.block_len(), out, |_| ());
            rest = after;
        }
    }
    sums
}

/// The blocks that a node of the tree has gradients of.
struct NodeBlocks {
    rank: usize,
    slots: Range<usize>,
    blocks: Vec<u32>,
}

/// The blocks that all nodes of all ranks have gradients of, in the order of slots.
struct SeenBlocks {
    slots: Slots,
    shape: BlockShape,
    nodes: Vec<NodeBlocks>,
}

impl SeenBlocks {
    /// Tells all ranks the blocks of this rank's trees, one for each of its nodes.
    fn exchange(exchange: &mut dyn Exchange, slots: Slots, shape: BlockShape, trees: &[Tree<'_>]) -> Result<Self, TrainError> {
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

    fn nodes_of(&self, rank: usize) -> impl Iterator<Item = &NodeBlocks> {
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
    fn spans(&self, rank: usize) -> Vec<Range<usize>> {
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
    fn lengths_to(&self, rank: usize) -> Vec<usize> {
        (0..self.slots.ranks).map(|from| self.length(from, rank)).collect()
    }

    /// Returns the blocks that any node has gradients of, ascending.
    fn blocks_of_any(&self) -> Vec<u32> {
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

/// Returns the tree of a node over these leaves.
fn tree_of<'a>(node: Range<usize>, leaves: &[Node<'a>]) -> Result<Tree<'a>, TrainError> {
    Tree::of(node, leaves).ok_or_else(|| lost("a slot of the batch"))
}

/// The blocks of a scene's gradients.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlockShape {
    pub(crate) rows: ParameterRows,
    /// Number of blocks of the scene.
    pub(crate) blocks: u32,
}

impl BlockShape {
    fn block_len(self) -> usize {
        (self.rows.count() + STATISTICS_ROWS) * SPLATS_PER_BLOCK
    }

    /// Returns the blocks that a rank adds up.
    fn share(self, slots: Slots, rank: usize) -> Range<u32> {
        let start = |rank: usize| (u64::from(self.blocks) * rank as u64 / slots.ranks as u64) as u32;
        start(rank)..start(rank + 1)
    }

    /// Returns which of these blocks, ascending, lie in a rank's share.
    fn part(self, slots: Slots, rank: usize, blocks: &[u32]) -> Range<usize> {
        let share = self.share(slots, rank);
        let [start, end] = [share.start, share.end].map(|edge| blocks.partition_point(|block| *block < edge));
        start..end
    }
}

/// Returns the error of ranks that are not in step.
pub(crate) fn lost(what: &str) -> TrainError {
    ExchangeError(format!("{what}: {}", ExchangeError::out_of_step())).into()
}

#[cfg(test)]
mod tests {
    use luxel_core::{Alone, ColorModel};

    use super::*;
    use crate::testing::on_ranks;

    const SCENE: BlockShape = BlockShape { rows: ParameterRows { color_model: ColorModel::Sh { degree: 0 } }, blocks: 9 };

    /// Gradients of a slot, of numbers whose sum depends on the order.
    fn of_slot(slot: usize) -> SparseGradients {
        let mut gradients = SparseGradients::none(SCENE.rows);
        for block in (0..SCENE.blocks).filter(|block| !(*block as usize + slot).is_multiple_of(3)) {
            let values = gradients.push(block);
            values.iter_mut().enumerate().for_each(|(i, value)| *value = (1.0 + i as f32 * 0.37) * 1.7f32.powi(3 * slot as i32 - 7));
        }
        gradients
    }

    fn mean(exchange: &mut dyn Exchange, slots: Slots, own: &[SparseGradients]) -> SparseGradients {
        BatchMean::new(SCENE.rows).of(exchange, slots, own, SCENE).unwrap().clone()
    }

    #[test]
    fn slots_are_divided_without_gaps() {
        for (batch, ranks) in [(1, 1), (1, 3), (2, 2), (5, 2), (4, 8), (7, 3)] {
            let slots = Slots { batch, ranks };
            let all: Vec<usize> = (0..ranks).flat_map(|rank| slots.of_rank(rank)).collect();
            assert!(all.iter().copied().eq(0..batch), "{batch} {ranks}: {all:?}");
            assert_eq!(slots.of_rank(0).start, 0);
            assert!(!slots.of_rank(0).is_empty(), "{batch} {ranks}");
        }
    }

    #[test]
    fn a_sum_has_the_same_bits_for_any_number_of_ranks() {
        for batch in [1, 2, 3, 4, 6, 7] {
            let all: Vec<SparseGradients> = (0..batch).map(of_slot).collect();
            let alone = mean(&mut Alone, Slots { batch, ranks: 1 }, &all);
            for ranks in [2, 3, 5] {
                let slots = Slots { batch, ranks };
                let sums = on_ranks(ranks, |mut exchange| {
                    let own: Vec<SparseGradients> = slots.of_rank(exchange.rank()).map(of_slot).collect();
                    let mut of = BatchMean::new(SCENE.rows);
                    of.of(&mut exchange, slots, &own, SCENE).unwrap();
                    // Memory of a step before changes nothing.
                    of.of(&mut exchange, slots, &own, SCENE).unwrap().clone()
                });
                assert!(sums.iter().all(|sum| *sum == alone), "{batch} views on {ranks} ranks");
            }
        }
    }

    #[test]
    fn the_tree_adds_pairs_first() {
        let value = |slot: usize| of_slot(slot).values_of(4).map(|values| values[5]).unwrap_or(0.0);
        let all: Vec<SparseGradients> = (0..5).map(of_slot).collect();
        let mean = mean(&mut Alone, Slots { batch: 5, ranks: 1 }, &all);
        let expected = ((value(0) + value(1)) + (value(2) + value(3))) + value(4);
        assert_eq!(mean.values_of(4).unwrap()[5], expected * 0.2);
        // Statistics are summed.
        let last = |slot: usize| of_slot(slot).values_of(4).and_then(|values| values.last().copied()).unwrap_or(0.0);
        let expected = ((last(0) + last(1)) + (last(2) + last(3))) + last(4);
        assert_eq!(mean.values_of(4).unwrap().last(), Some(&expected));
    }

    #[test]
    fn a_message_that_is_cut_short_is_an_error() {
        let errors = on_ranks(2, |mut exchange| {
            if exchange.rank() == 0 {
                let own = [of_slot(0)];
                return BatchMean::new(SCENE.rows).of(&mut exchange, Slots { batch: 2, ranks: 2 }, &own, SCENE).unwrap_err().to_string();
            }
            // A list of three blocks that has one.
            exchange.all_gather(&[3, 0]).unwrap();
            String::new()
        });
        assert!(errors[0].contains("not in step"), "{errors:?}");
    }
}
