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

mod seen;
mod slots;
mod tree;

use std::ops::Range;

use luxel_core::engine::{ParameterRows, SPLATS_PER_BLOCK, SparseGradients, SparsePart};
use luxel_core::{Exchange, ExchangeError};

use self::seen::SeenBlocks;
pub use self::slots::RankViews;
pub(crate) use self::slots::{BlockShape, Slots};
use self::tree::{Node, Tree, tree_of};
use crate::TrainError;

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

/// Returns the error of ranks that are not in step.
pub(crate) fn lost(what: &str) -> TrainError {
    ExchangeError(format!("{what}: {}", ExchangeError::out_of_step())).into()
}

#[cfg(test)]
mod tests {
    use luxel_core::{ColorModel, SingleProcess};

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
            let alone = mean(&mut SingleProcess, Slots { batch, ranks: 1 }, &all);
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
        let mean = mean(&mut SingleProcess, Slots { batch: 5, ranks: 1 }, &all);
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
