//! The loss of one band of rows: a sweep down the image, one group of rows at a time.
//!
//! In: [`LossInputs`]. Out: [`BandSums`], and the gradient by the radiance of the band's blocks.
//!
//! For each channel, three stages go down the image, one group of [`GROUP`] rows behind the other:
//! [`values`](super::values) loads a group; [`similarity`](super::similarity) processes the group
//! above it, whose windows these rows complete; [`gradient`](super::gradient) processes the group
//! above that. Each stage reads a group with its two neighbours, so only three groups of values and
//! of derivatives are kept, and they stay in a core's cache.
//!
//! If a thread has just processed the band above, it continues with the groups that are kept. If
//! not, it evaluates the rows above the band again, by the same operations: the bits do not depend
//! on which thread does what.

use luxel_core::RESPONSE_KNOTS;
use luxel_lanes::Level;

use super::convolution::{GROUP, RowStack};
use super::gradient::{ChannelRows, GradientScratch, differentiate_values};
use super::plan::{LossInputs, LossPlan};
use super::rows::{BAND_GROUPS, BAND_PX, RING, RowGroup};
use super::similarity::{DERIVATIVES, SimilarityScratch, differentiate_similarity};
use super::strips::write_blocks;
use super::values::{Differences, ValueScratch, load_values};
use crate::lanes::with_simd;
use crate::passes::rasterize_backward::BlockGradient;
use crate::view::{BLOCK_PX, TILE_BLOCKS};

/// The sums over a band, in f64. They are added in the order of the bands, whichever thread
/// computed them.
#[derive(Clone)]
pub(super) struct BandSums {
    pub(super) differences: Differences,
    pub(super) ssim: f64,
    pub(super) by_knots: [[f64; RESPONSE_KNOTS]; 3],
}

impl BandSums {
    pub(super) const ZERO: Self =
        Self { differences: Differences { absolute: 0.0, squared: 0.0 }, ssim: 0.0, by_knots: [[0.0; RESPONSE_KNOTS]; 3] };
}

/// The state of a thread, kept between steps.
#[derive(Default)]
pub(super) struct Sweep {
    /// Group whose gradient comes next, if the sweep goes on.
    next: Option<RowGroup>,
    /// Planes of values in strips: `[RING, 3, strip, planes]`.
    values: Vec<RowStack>,
    /// Derivatives of SSIM, convolved along the rows: `[RING, 3, strip, DERIVATIVES]`.
    derivatives: Vec<RowStack>,
    sums: [GroupSums; RING],
    loading: ValueScratch,
    similarity: SimilarityScratch,
    gradient: GradientScratch,
}

/// The sums over a group's rows.
#[derive(Clone, Copy, Default)]
struct GroupSums {
    differences: Differences,
    ssim: f64,
}

impl Sweep {
    /// Begins a view: groups of another view must not be used.
    pub(super) fn begin(&mut self) {
        self.next = None;
    }

    /// Resizes the buffers for a plan.
    fn resize(&mut self, plan: &LossPlan) {
        self.values.resize(RING * 3 * plan.strip * plan.planes.count(), RowStack::default());
        self.derivatives.resize(RING * 3 * plan.strip * DERIVATIVES, RowStack::default());
        self.loading.resize(plan);
        self.similarity.resize(plan);
        self.gradient.resize(plan);
    }

    /// Loads the group below `group`, and then computes the similarity of `group`, whose windows
    /// are now complete.
    fn advance(&mut self, level: Level, plan: &LossPlan, inputs: LossInputs<'_>, group: RowGroup) {
        self.load(level, plan, inputs, group.next());
        let (values, derivatives) = (3 * plan.strip * plan.planes.count(), 3 * plan.strip * DERIVATIVES);
        let rows = group.window().map(|group| &self.values[group.slot() * values..][..values]);
        let out = &mut self.derivatives[group.slot() * derivatives..][..derivatives];
        self.sums[group.slot()].ssim = 0.0;
        for (channel, out) in out.chunks_exact_mut(plan.strip * DERIVATIVES).enumerate() {
            let length = plan.strip * plan.planes.count();
            let rows = rows.map(|rows| &rows[channel * length..][..length]);
            let similarity = &mut self.similarity;
            self.sums[group.slot()].ssim += with_simd!(level, simd => differentiate_similarity(simd, plan, rows, group, similarity, out));
        }
    }

    /// Loads the values of a group.
    fn load(&mut self, level: Level, plan: &LossPlan, inputs: LossInputs<'_>, group: RowGroup) {
        let length = 3 * plan.strip * plan.planes.count();
        let values = &mut self.values[group.slot() * length..][..length];
        let loading = &mut self.loading;
        self.sums[group.slot()].differences = with_simd!(level, simd => load_values(simd, plan, inputs, group, loading, values));
    }

    /// Writes the gradient of a group to the scratch, from row `first_row` of the band on.
    fn differentiate(
        &mut self,
        level: Level,
        plan: &LossPlan,
        group: RowGroup,
        first_row: usize,
        by_knots: &mut [[f64; RESPONSE_KNOTS]; 3],
    ) {
        let (values, derivatives) = (plan.strip * plan.planes.count(), plan.strip * DERIVATIVES);
        for (channel, by_knots) in by_knots.iter_mut().enumerate() {
            let slot = |group: RowGroup| group.slot() * 3 + channel;
            let rows = ChannelRows {
                group,
                values: &self.values[slot(group) * values..][..values],
                derivatives: group.window().map(|group| &self.derivatives[slot(group) * derivatives..][..derivatives]),
            };
            let (scratch, first_row) = (&mut self.gradient, channel * BAND_PX + first_row);
            with_simd!(level, simd => differentiate_values(simd, plan, rows, scratch, first_row, by_knots));
        }
    }
}

/// Computes the sums of a band, and writes the gradient by its radiance to its blocks, row by row.
pub(super) fn differentiate_band(
    level: Level,
    plan: &LossPlan,
    inputs: LossInputs<'_>,
    band: usize,
    sweep: &mut Sweep,
    blocks: &mut [BlockGradient],
) -> BandSums {
    let first = RowGroup::of_band(band, 0);
    if sweep.next != Some(first) {
        sweep.resize(plan);
        sweep.loading.begin();
        // The band's first gradient depends on the group above, whose windows reach one group
        // further.
        sweep.load(level, plan, inputs, RowGroup::of_band(band, 2));
        sweep.load(level, plan, inputs, RowGroup::of_band(band, 1));
        sweep.advance(level, plan, inputs, RowGroup::of_band(band, 1));
        sweep.advance(level, plan, inputs, first);
    }
    let mut sums = BandSums::ZERO;
    let mut group = first;
    for n in 0..BAND_GROUPS {
        sweep.advance(level, plan, inputs, group.next());
        let GroupSums { differences, ssim } = sweep.sums[group.slot()];
        sums.differences.absolute += differences.absolute;
        sums.differences.squared += differences.squared;
        sums.ssim += ssim;
        sweep.differentiate(level, plan, group, n * GROUP, &mut sums.by_knots);
        group = group.next();
    }
    sweep.next = Some(group);
    let linear = sweep.gradient.linear();
    let stride = linear.len() / (3 * BAND_PX);
    for (row, blocks) in blocks.chunks_exact_mut(plan.across * TILE_BLOCKS).enumerate() {
        write_blocks(blocks, &linear[row * BLOCK_PX * stride..], stride, BAND_PX);
    }
    sums
}
