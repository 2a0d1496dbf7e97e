//! Which rank computes which slot of a batch, and adds up which blocks of the scene.

use std::ops::Range;

use luxel_core::engine::{ParameterRows, SPLATS_PER_BLOCK, STATISTICS_ROWS};

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
    pub(super) fn nodes(self, rank: usize) -> Vec<Range<usize>> {
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
pub(super) fn middle(node: &Range<usize>) -> usize {
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

/// The blocks of a scene's gradients.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlockShape {
    pub(crate) rows: ParameterRows,
    /// Number of blocks of the scene.
    pub(crate) blocks: u32,
}

impl BlockShape {
    pub(super) fn block_len(self) -> usize {
        (self.rows.count() + STATISTICS_ROWS) * SPLATS_PER_BLOCK
    }

    /// Returns the blocks that a rank adds up.
    pub(super) fn share(self, slots: Slots, rank: usize) -> Range<u32> {
        let start = |rank: usize| (u64::from(self.blocks) * rank as u64 / slots.ranks as u64) as u32;
        start(rank)..start(rank + 1)
    }

    /// Returns which of these blocks, ascending, lie in a rank's share.
    pub(super) fn part(self, slots: Slots, rank: usize, blocks: &[u32]) -> Range<usize> {
        let share = self.share(slots, rank);
        let [start, end] = [share.start, share.end].map(|edge| blocks.partition_point(|block| *block < edge));
        start..end
    }
}
