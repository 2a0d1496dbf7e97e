//! The update of the splats in two halves, for batches: gradients of the splats that a view shows
//! ([`sparse_gradients`]), and Adam with the sum of several views' ([`sparse_adam`]).
//!
//! In and out: [`SparseGradients`], whose blocks are the store's. The arithmetic of a splat is that
//! of [`super::update`], so a batch of one view makes the same update, to the bit. Degenerate: with
//! regularisers every block has a gradient; without entries none has.

use std::ops::Range;

use luxel_core::engine::{DensifyStats, SPLATS_PER_BLOCK, STATISTICS_ROWS, SparseGradients, StatsCollection, StepConfig};
use luxel_lanes::Level;
use rayon::prelude::*;

use super::adam::{Optimizer, Step, update};
use super::project_backward::{BlockStats, BlockSums, Inputs, project_backward};
use super::update::{CHUNK, stats_chunks};
use crate::lanes::{LANES, Lanes, with_simd};
use crate::store::{Block, blocks};
use crate::view::ScreenCamera;

const _: () = assert!(LANES == SPLATS_PER_BLOCK);

/// Differentiates the blocks in which the view shows a splat, into the memory of `gradients`.
/// `parameters` are `[blocks, rows, 16]`.
pub(crate) fn sparse_gradients(
    level: Level,
    camera: &ScreenCamera,
    inputs: &Inputs<'_>,
    parameters: &[Lanes],
    collection: StatsCollection,
    mut gradients: SparseGradients,
) -> SparseGradients {
    let rows = inputs.shape.layout.count();
    let seen = seen_blocks(inputs);
    gradients.restart(inputs.shape.layout, &seen);
    let block_len = gradients.block_len();
    let chunks = (seen.par_chunks(CHUNK), gradients.values_mut().par_chunks_mut(CHUNK * block_len));
    chunks.into_par_iter().for_each(|(seen, values)| {
        let mut gradient = vec![Lanes::ZERO; rows];
        with_simd!(level, simd => {
            for (block, values) in seen.iter().zip(values.chunks_exact_mut(block_len)) {
                let index = *block as usize;
                let mut sums = BlockSums::ZERO;
                sums.gather(simd, inputs, index);
                let block = Block { index, rows: &parameters[index * rows..][..rows] };
                let len = splats_of(index, inputs.shape.count).len();
                let (mut norm, mut absolute, mut views) = ([0.0; LANES], [0.0; LANES], [0; LANES]);
                let stats = BlockStats { norm: &mut norm[..len], absolute: &mut absolute[..len], views: &mut views[..len] };
                let stats = (collection != StatsCollection::Off).then_some(stats);
                project_backward(simd, camera, inputs, block, &sums, &mut gradient, stats);
                let (parameters, statistics) = values.split_at_mut(rows * LANES);
                parameters.copy_from_slice(bytemuck::cast_slice(&gradient));
                // What lies beyond the last splat is no gradient.
                parameters.chunks_exact_mut(LANES).for_each(|row| row[len..].fill(0.0));
                for (row, found) in statistics.chunks_exact_mut(LANES).zip([norm, absolute, views.map(|views: u32| views as f32)]) {
                    row.copy_from_slice(&found);
                }
            }
        });
    });
    gradients
}

/// Returns the numbers of the blocks that have a gradient.
fn seen_blocks(inputs: &Inputs<'_>) -> Vec<u32> {
    let count = inputs.shape.count;
    let is_seen = |block: &u32| {
        let splats = splats_of(*block as usize, count);
        inputs.is_regularised() || inputs.bins.entries(splats.start, splats.len()).any(|entries| !entries.is_empty())
    };
    (0..blocks(count) as u32).filter(is_seen).collect()
}

/// Returns the splats of a block.
fn splats_of(block: usize, count: usize) -> Range<usize> {
    block * LANES..count.min((block + 1) * LANES)
}

/// Updates all splats: those without a gradient by their moments alone.
pub(crate) fn sparse_adam(
    level: Level,
    gradients: &SparseGradients,
    optimizer: Optimizer<'_>,
    config: &StepConfig,
    stats: &mut DensifyStats,
) {
    let step = Step::new(optimizer.parameters.shape(), config);
    let rows = optimizer.parameters.layout.count();
    let collect = config.stats != StatsCollection::Off;
    let chunks = (optimizer.parameters.lanes.par_chunks_mut(CHUNK * rows), optimizer.moments.chunks(CHUNK), stats_chunks(stats));
    chunks.into_par_iter().enumerate().for_each(|(chunk, (parameters, mut moments, mut stats))| {
        let mut gradient = vec![Lanes::ZERO; rows];
        with_simd!(level, simd => {
            for (n, parameters) in parameters.chunks_mut(rows).enumerate() {
                let index = chunk * CHUNK + n;
                let values = gradients.values_of(index as u32);
                if let Some(values) = values {
                    let (by_parameters, statistics) = values.split_at(rows * LANES);
                    bytemuck::cast_slice_mut(&mut gradient).copy_from_slice(by_parameters);
                    if collect {
                        add_statistics(statistics, stats.block(n));
                    }
                }
                update(simd, &step, index, parameters, moments.block(n, rows), values.map(|_| &*gradient));
            }
        });
    });
}

/// Adds `[STATISTICS_ROWS, 16]` to the statistics of a block.
fn add_statistics(rows: &[f32], stats: BlockStats<'_>) {
    let [norm, absolute, views]: [&[f32]; STATISTICS_ROWS] = std::array::from_fn(|row| &rows[row * LANES..][..LANES]);
    for lane in 0..stats.views.len() {
        stats.norm[lane] += norm[lane];
        stats.absolute[lane] += absolute[lane];
        stats.views[lane] += views[lane] as u32;
    }
}
