//! The update of the splats: `project_backward` (with `color_backward`), `adam` and the next view's
//! `project`, over chunks of splats.
//!
//! In: gradients by the screen ([`Inputs`]). In, out: parameters, moments, statistics. Out:
//! footprints in the next view, if it is known.
//!
//! A chunk's gradients are computed and consumed while they are in the cache: in training they
//! never exist all at once. The next projection also uses the chunk's parameters while they are in
//! the cache. [`gradients`] keeps all gradients instead, for tests; [`super::sparse_update`] has
//! the two halves apart, for batches.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use luxel_core::engine::{DensifyStats, StatsCollection, StepConfig};
use luxel_lanes::Level;
use rayon::prelude::*;

use super::adam::{Optimizer, Step, update};
use super::pass_times::PassTimes;
use super::project::Footprint;
use super::project_all::project_block;
use super::project_backward::{BlockStats, BlockSums, Inputs, project_backward};
use crate::lanes::{LANES, Lanes, with_simd};
use crate::memory::Buffer;
use crate::moments::MomentRows;
use crate::prefetch::fetch;
use crate::store::Block;
use crate::view::ScreenCamera;

/// Blocks of splats per chunk: parameters, moments and gradients fit in a core's own cache.
pub(crate) const CHUNK: usize = 16;
/// Chunks that a thread takes at once. Few, so that no thread waits long for another at the end:
/// chunks with visible splats take longer.
const CHUNKS_AT_A_TIME: usize = 4;

/// Buffers that are kept between steps: the gradients of one chunk for each thread.
#[derive(Default)]
pub(crate) struct Scratch {
    gradients: Vec<Mutex<Vec<Lanes>>>,
}

/// The statistics of a chunk's splats.
pub(crate) struct ChunkStats<'a> {
    norm: &'a mut [f32],
    absolute: &'a mut [f32],
    views: &'a mut [u32],
}

impl ChunkStats<'_> {
    /// Returns the statistics of block `n` of the chunk.
    pub(crate) fn block(&mut self, n: usize) -> BlockStats<'_> {
        let range = n * LANES..((n + 1) * LANES).min(self.views.len());
        BlockStats { norm: &mut self.norm[range.clone()], absolute: &mut self.absolute[range.clone()], views: &mut self.views[range] }
    }
}

/// The slices that a chunk reads and writes.
struct Chunk<'a> {
    /// Number of the chunk.
    index: usize,
    parameters: &'a mut [Lanes],
    moments: MomentRows<'a>,
    stats: ChunkStats<'a>,
    /// Footprints in the next view, if it is known.
    footprints: Option<&'a mut [Footprint]>,
}

/// Returns the statistics chunk by chunk.
pub(crate) fn stats_chunks(stats: &mut DensifyStats) -> impl IndexedParallelIterator<Item = ChunkStats<'_>> {
    const SPLATS: usize = CHUNK * LANES;
    (stats.gradient.par_chunks_mut(SPLATS), stats.abs_gradient.par_chunks_mut(SPLATS), stats.views.par_chunks_mut(SPLATS))
        .into_par_iter()
        .map(|(norm, absolute, views)| ChunkStats { norm, absolute, views })
}

/// The next view of the updated splats.
pub(crate) struct NextView<'a> {
    pub(crate) camera: &'a ScreenCamera,
    /// Receives one footprint per splat, N rounded up to whole blocks.
    pub(crate) footprints: &'a mut [Footprint],
}

/// The buffers that an update writes besides parameters and moments.
pub(crate) struct UpdateBuffers<'a> {
    pub(crate) stats: &'a mut DensifyStats,
    pub(crate) scratch: &'a mut Scratch,
    /// The next view, if it is known.
    pub(crate) next: Option<NextView<'a>>,
}

/// Differentiates and updates all splats, and projects them for the next view, if it is known.
/// Returns the time spent in `project_backward`, in `adam` and in `project`, summed over threads.
pub(crate) fn backward_and_adam(
    level: Level,
    camera: &ScreenCamera,
    inputs: &Inputs<'_>,
    optimizer: Optimizer<'_>,
    config: &StepConfig,
    UpdateBuffers { stats, scratch, next }: UpdateBuffers<'_>,
) -> [Duration; 3] {
    let rows = inputs.shape.layout.count();
    let step = Step::new(inputs.shape, config);
    let collect = config.stats != StatsCollection::Off;
    scratch.gradients.resize_with(rayon::current_num_threads(), Mutex::default);
    let scratch = &scratch.gradients;
    let times = PassTimes::default();
    let chunks = (optimizer.parameters.lanes.par_chunks_mut(CHUNK * rows), optimizer.moments.chunks(CHUNK), stats_chunks(stats));
    let chunks = chunks.into_par_iter().enumerate().with_max_len(CHUNKS_AT_A_TIME);
    let (next_camera, footprints) = next.map(|next| (next.camera, next.footprints)).unzip();
    let update_chunk = |chunk: Chunk<'_>| {
        let Chunk { index: chunk, parameters, mut moments, mut stats, footprints } = chunk;
        let start = Instant::now();
        // Each thread has a buffer of its own. If it is locked or poisoned, a new one serves as
        // well.
        let mut kept = rayon::current_thread_index().and_then(|thread| scratch.get(thread)?.try_lock().ok());
        let mut fresh = Vec::new();
        let gradients: &mut Vec<Lanes> = kept.as_deref_mut().unwrap_or(&mut fresh);
        gradients.resize(CHUNK * rows, Lanes::ZERO);
        let mut written = [false; CHUNK];
        fetch(parameters);
        // Gathered for the whole chunk at once: these loads come from scattered places, and do not
        // wait for arithmetic in between.
        let mut sums = [const { BlockSums::ZERO }; CHUNK];
        with_simd!(level, simd => {
            for (n, sums) in sums.iter_mut().enumerate().take(parameters.len() / rows) {
                sums.gather(simd, inputs, chunk * CHUNK + n);
            }
            for (n, (rows, sums)) in parameters.chunks(rows).zip(&sums).enumerate() {
                let block = Block { index: chunk * CHUNK + n, rows };
                let gradient = &mut gradients[n * rows.len()..][..rows.len()];
                written[n] = project_backward(simd, camera, inputs, block, sums, gradient, collect.then(|| stats.block(n)));
            }
        });
        let backward_done = Instant::now();
        with_simd!(level, simd => {
            for (n, parameters) in parameters.chunks_mut(rows).enumerate() {
                let gradient = written[n].then_some(&gradients[n * rows..][..rows]);
                update(simd, &step, chunk * CHUNK + n, parameters, moments.block(n, rows), gradient);
            }
        });
        let adam_done = Instant::now();
        if let (Some(camera), Some(footprints)) = (next_camera, footprints) {
            with_simd!(level, simd => {
                for (n, (rows, footprints)) in parameters.chunks(rows).zip(footprints.chunks_mut(LANES)).enumerate() {
                    let block = Block { index: chunk * CHUNK + n, rows };
                    project_block(simd, camera, inputs.shape, block, inputs.smoothing, footprints);
                }
            });
        }
        times.add([start, backward_done, adam_done]);
    };
    match footprints {
        Some(footprints) => {
            chunks.zip(footprints.par_chunks_mut(CHUNK * LANES)).for_each(|((index, (parameters, moments, stats)), footprints)| {
                update_chunk(Chunk { index, parameters, moments, stats, footprints: Some(footprints) });
            });
        }
        None => chunks.for_each(|(index, (parameters, moments, stats))| {
            update_chunk(Chunk { index, parameters, moments, stats, footprints: None });
        }),
    }
    times.totals()
}

/// Differentiates all splats and returns the gradients: `[blocks, rows, 16]`, zero for splats that
/// are not visible.
pub(crate) fn gradients(
    level: Level,
    camera: &ScreenCamera,
    inputs: &Inputs<'_>,
    parameters: &[Lanes],
    stats: Option<&mut DensifyStats>,
) -> Buffer {
    let rows = inputs.shape.layout.count();
    let mut gradients = Buffer::zeros(parameters.len());
    let mut unused = DensifyStats::zeros(inputs.shape.count);
    let collect = stats.is_some();
    let stats = stats.unwrap_or(&mut unused);
    let chunks = (gradients.par_chunks_mut(CHUNK * rows), parameters.par_chunks(CHUNK * rows), stats_chunks(stats));
    chunks.into_par_iter().enumerate().for_each(|(chunk, (gradients, parameters, mut stats))| {
        with_simd!(level, simd => {
            for (n, (gradient, rows)) in gradients.chunks_mut(rows).zip(parameters.chunks(rows)).enumerate() {
                let block = Block { index: chunk * CHUNK + n, rows };
                let mut sums = BlockSums::ZERO;
                sums.gather(simd, inputs, block.index);
                project_backward(simd, camera, inputs, block, &sums, gradient, collect.then(|| stats.block(n)));
            }
        });
    });
    gradients
}
