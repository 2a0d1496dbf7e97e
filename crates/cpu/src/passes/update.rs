//! The way back from the screen to the parameters and on to the next screen: `project_backward` (with `color_backward`), `adam` and the next
//! view's `project`, over chunks of splats.
//!
//! A chunk's gradients are made and used up while they are in the cache: in training they never exist as a whole. Nor do its parameters leave it
//! between two steps' use of them, if the engine knows what comes next. [`gradients`] keeps all gradients instead, for who wants to look at them or to
//! reduce them over machines.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use fearless_simd::Level;
use luxel_core::engine::{DensifyStats, StatsCollection, StepConfig};
use rayon::prelude::*;

use super::adam::{Optimizer, Step, update};
use super::project::{Footprint, project_block};
use super::project_backward::{BlockStats, BlockSums, Inputs, project_backward};
use super::shares::Shares;
use crate::lanes::{LANES, Lanes, with_simd};
use crate::memory::Buffer;
use crate::prefetch::fetch;
use crate::view::ScreenCamera;

/// Blocks of splats in a chunk: parameters, moments and gradients fit in the core's own cache.
const CHUNK: usize = 16;
/// Chunks that a thread takes up at once, so that no thread waits long for another at the end. Chunks of what is seen take longer.
const CHUNKS_AT_A_TIME: usize = 4;

/// Buffers, kept between steps: one chunk's gradients for each thread.
#[derive(Default)]
pub(crate) struct Scratch {
    gradients: Vec<Mutex<Vec<Lanes>>>,
}

/// A chunk's share of the statistics.
struct ChunkStats<'a> {
    norm: &'a mut [f32],
    absolute: &'a mut [f32],
    views: &'a mut [u32],
}

impl ChunkStats<'_> {
    fn block(&mut self, n: usize) -> BlockStats<'_> {
        let range = n * LANES..((n + 1) * LANES).min(self.views.len());
        BlockStats { norm: &mut self.norm[range.clone()], absolute: &mut self.absolute[range.clone()], views: &mut self.views[range] }
    }
}

/// A chunk's number, parameters, moments and statistics.
type Chunk<'a> = (usize, (&'a mut [Lanes], &'a mut [Lanes], &'a mut [Lanes], ChunkStats<'a>));

fn stats_chunks(stats: &mut DensifyStats) -> impl IndexedParallelIterator<Item = ChunkStats<'_>> {
    const SPLATS: usize = CHUNK * LANES;
    (stats.gradient.par_chunks_mut(SPLATS), stats.abs_gradient.par_chunks_mut(SPLATS), stats.views.par_chunks_mut(SPLATS))
        .into_par_iter()
        .map(|(norm, absolute, views)| ChunkStats { norm, absolute, views })
}

/// What the updated splats are seen from, and where their footprints go: one per splat, N rounded up to whole blocks.
pub(crate) type Next<'a> = (&'a ScreenCamera, &'a mut [Footprint]);

/// Differentiates and updates all splats, and projects them for the next view, if that is known. Returns the time spent in `project_backward`, in
/// `adam` and in `project`, summed over threads.
pub(crate) fn backward_and_adam(
    level: Level,
    camera: &ScreenCamera,
    inputs: &Inputs<'_>,
    optimizer: Optimizer<'_>,
    config: &StepConfig,
    (stats, scratch, next): (&mut DensifyStats, &mut Scratch, Option<Next<'_>>),
) -> [Duration; 3] {
    let rows = inputs.layout.count();
    let step = Step::new(inputs.layout, inputs.count, config);
    let collect = config.stats != StatsCollection::Off;
    scratch.gradients.resize_with(rayon::current_num_threads(), Mutex::default);
    let scratch = &scratch.gradients;
    let shares = Shares::default();
    let chunks = (
        optimizer.parameters.lanes.par_chunks_mut(CHUNK * rows),
        optimizer.first.lanes.par_chunks_mut(CHUNK * rows),
        optimizer.second.lanes.par_chunks_mut(CHUNK * rows),
        stats_chunks(stats),
    );
    let chunks = chunks.into_par_iter().enumerate().with_max_len(CHUNKS_AT_A_TIME);
    let (next_camera, footprints) = next.unzip();
    let work = |((chunk, (parameters, first, second, mut stats)), footprints): (Chunk<'_>, Option<&mut [Footprint]>)| {
        let start = Instant::now();
        // A thread has one place of its own; should it be taken or poisoned, a new buffer does as well.
        let own = rayon::current_thread_index().and_then(|thread| scratch.get(thread)?.try_lock().ok());
        let (mut own, mut other) = (own, Vec::new());
        let gradients: &mut Vec<Lanes> = own.as_deref_mut().unwrap_or(&mut other);
        gradients.resize(CHUNK * rows, Lanes::ZERO);
        let mut written = [false; CHUNK];
        fetch(parameters);
        // Gathered for the whole chunk at once: fetches from all over memory that don't wait for the mathematics in between.
        let mut sums = [const { BlockSums::ZERO }; CHUNK];
        with_simd!(level, simd => {
            for (n, sums) in sums.iter_mut().enumerate().take(parameters.len() / rows) {
                sums.gather(simd, inputs, chunk * CHUNK + n);
            }
            for (n, (rows, sums)) in parameters.chunks(rows).zip(&sums).enumerate() {
                let (block, gradient) = (chunk * CHUNK + n, &mut gradients[n * rows.len()..][..rows.len()]);
                written[n] = project_backward(simd, camera, inputs, (block, rows), sums, gradient, collect.then(|| stats.block(n)));
            }
        });
        let backward_done = Instant::now();
        with_simd!(level, simd => {
            let blocks = parameters.chunks_mut(rows).zip(first.chunks_mut(rows)).zip(second.chunks_mut(rows)).enumerate();
            for (n, ((parameters, first), second)) in blocks {
                let gradient = written[n].then_some(&gradients[n * rows..][..rows]);
                update(simd, &step, chunk * CHUNK + n, parameters, (first, second), gradient);
            }
        });
        let adam_done = Instant::now();
        if let (Some(camera), Some(footprints)) = (next_camera, footprints) {
            with_simd!(level, simd => {
                for (n, (rows, footprints)) in parameters.chunks(rows).zip(footprints.chunks_mut(LANES)).enumerate() {
                    project_block(simd, camera, (inputs.layout, inputs.count), (chunk * CHUNK + n, rows), inputs.smoothing, footprints);
                }
            });
        }
        shares.add([start, backward_done, adam_done]);
    };
    match footprints {
        Some(footprints) => chunks.zip(footprints.par_chunks_mut(CHUNK * LANES).map(Some)).for_each(work),
        None => chunks.map(|chunk| (chunk, None)).for_each(work),
    }
    shares.totals()
}

/// Differentiates all splats and keeps the gradients: `[blocks, rows, 16]`, zero where nothing was seen.
pub(crate) fn gradients(
    level: Level,
    camera: &ScreenCamera,
    (inputs, parameters): (&Inputs<'_>, &[Lanes]),
    stats: Option<&mut DensifyStats>,
) -> Buffer {
    let rows = inputs.layout.count();
    let mut gradients = Buffer::zeros(parameters.len());
    let mut unused = DensifyStats::zeros(inputs.count);
    let collect = stats.is_some();
    let stats = stats.unwrap_or(&mut unused);
    let chunks = (gradients.par_chunks_mut(CHUNK * rows), parameters.par_chunks(CHUNK * rows), stats_chunks(stats));
    chunks.into_par_iter().enumerate().for_each(|(chunk, (gradients, parameters, mut stats))| {
        with_simd!(level, simd => {
            for (n, (gradient, rows)) in gradients.chunks_mut(rows).zip(parameters.chunks(rows)).enumerate() {
                let block = chunk * CHUNK + n;
                let mut sums = BlockSums::ZERO;
                sums.gather(simd, inputs, block);
                project_backward(simd, camera, inputs, (block, rows), &sums, gradient, collect.then(|| stats.block(n)));
            }
        });
    });
    gradients
}
