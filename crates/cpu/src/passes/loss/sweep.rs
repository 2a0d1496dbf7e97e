//! The loss of one band of rows: the sweep down the image, a group of rows at a time.
//!
//! Per channel, three stages follow each other down the image, a group of [`GROUP`] rows apart: [`values`](super::values) of a group of rows; the group above it, whose
//! windows these rows complete, to [`similarity`](super::similarity); the one above that to [`gradient`](super::gradient). Each needs of what it reads the group's own
//! rows and those of the groups above and below, so three groups of values and of derivatives are all that is kept: they stay in a core's cache.
//!
//! A band begins with what the one above has left, if the same thread did that one before. If not, it evaluates the rows above it again, by the same
//! operations: bits do not depend on who does what.

use fearless_simd::Level;
use luxel_core::{RESPONSE_KNOTS, View};

use super::convolution::{GROUP, Stack};
use super::gradient::{GradientScratch, differentiate_values};
use super::similarity::{DERIVATIVES, SimilarityScratch, differentiate_similarity};
use super::strips::write_blocks;
use super::values::{Differences, ValueScratch, load_values};
use super::{BandSums, Plan};
use crate::lanes::with_simd;
use crate::passes::rasterize::TilePixels;
use crate::passes::rasterize_backward::BlockGradient;
use crate::view::{BLOCK_PX, TILE_BLOCKS};

/// Rows of a band: whole blocks and whole groups.
pub(super) const BAND_PX: usize = 20;
/// Groups of a band.
const BAND_GROUPS: usize = BAND_PX / GROUP;
/// Groups that are kept: a group's window reaches into its neighbours.
const RING: usize = 3;
/// Groups above the image, so that what lies there has a number.
const ABOVE: usize = 2;

const _: () = assert!(BAND_PX.is_multiple_of(BLOCK_PX) && BAND_PX.is_multiple_of(GROUP));

/// A group of rows, counted from [`ABOVE`] the image.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct Group(usize);

impl Group {
    /// Its row number `j` of the image, if that is within it.
    pub(super) fn row(self, plan: &Plan, j: usize) -> Option<usize> {
        (self.0 * GROUP + j).checked_sub(ABOVE * GROUP).filter(|y| *y < plan.height)
    }

    fn slot(self) -> usize {
        self.0 % RING
    }

    /// The one above, itself and the one below.
    fn window(self) -> [Self; 3] {
        [Self(self.0 - 1), self, Self(self.0 + 1)]
    }

    fn next(self) -> Self {
        Self(self.0 + 1)
    }
}

/// What a thread works with, kept between steps.
#[derive(Default)]
pub(super) struct Sweep {
    /// Group whose gradient would come next.
    next: Option<Group>,
    /// Planes of values in strips: `[RING, 3, strip, planes]`.
    values: Vec<Stack>,
    /// Derivatives of SSIM, convolved along the rows: `[RING, 3, strip, DERIVATIVES]`.
    derivatives: Vec<Stack>,
    sums: [GroupSums; RING],
    loading: ValueScratch,
    similarity: SimilarityScratch,
    gradient: GradientScratch,
}

/// Sums over a group's rows.
#[derive(Clone, Copy, Default)]
struct GroupSums {
    differences: Differences,
    ssim: f64,
}

impl Sweep {
    /// Before a view: what was left of another is of no use.
    pub(super) fn begin(&mut self) {
        self.next = None;
    }

    fn resize(&mut self, plan: &Plan) {
        self.values.resize(RING * 3 * plan.strip * plan.planes.count(), Stack::default());
        self.derivatives.resize(RING * 3 * plan.strip * DERIVATIVES, Stack::default());
        self.loading.resize(plan);
        self.similarity.resize(plan);
        self.gradient.resize(plan);
    }

    /// Loads the group below `group`, and then has all that this one's similarity hangs on.
    fn advance(&mut self, level: Level, plan: &Plan, source: (&[TilePixels], &View), group: Group) {
        self.load(level, plan, source, group.next());
        let (values, derivatives) = (3 * plan.strip * plan.planes.count(), 3 * plan.strip * DERIVATIVES);
        let rows = group.window().map(|group| &self.values[group.slot() * values..][..values]);
        let out = &mut self.derivatives[group.slot() * derivatives..][..derivatives];
        self.sums[group.slot()].ssim = 0.0;
        for (channel, out) in out.chunks_exact_mut(plan.strip * DERIVATIVES).enumerate() {
            let length = plan.strip * plan.planes.count();
            let rows = rows.map(|rows| &rows[channel * length..][..length]);
            let similarity = &mut self.similarity;
            self.sums[group.slot()].ssim += with_simd!(level, simd => differentiate_similarity(simd, plan, (rows, group), similarity, out));
        }
    }

    fn load(&mut self, level: Level, plan: &Plan, source: (&[TilePixels], &View), group: Group) {
        let length = 3 * plan.strip * plan.planes.count();
        let values = &mut self.values[group.slot() * length..][..length];
        let loading = &mut self.loading;
        self.sums[group.slot()].differences = with_simd!(level, simd => load_values(simd, plan, source, group, (loading, values)));
    }

    /// Gradient of a group of the band's rows, number `first_row` of the band and those below, into the scratch.
    fn differentiate(&mut self, level: Level, plan: &Plan, (group, first_row): (Group, usize), by_knots: &mut [[f64; RESPONSE_KNOTS]; 3]) {
        let (values, derivatives) = (plan.strip * plan.planes.count(), plan.strip * DERIVATIVES);
        for (channel, by_knots) in by_knots.iter_mut().enumerate() {
            let of = |group: Group| group.slot() * 3 + channel;
            let own = &self.values[of(group) * values..][..values];
            let derivatives = group.window().map(|group| &self.derivatives[of(group) * derivatives..][..derivatives]);
            let out = (&mut self.gradient, channel * BAND_PX + first_row);
            with_simd!(level, simd => differentiate_values(simd, plan, (group, own, derivatives), out, by_knots));
        }
    }
}

/// Sums of a band, and the gradient by its radiance to its blocks, row by row.
pub(super) fn differentiate_band(
    level: Level,
    plan: &Plan,
    source: (&[TilePixels], &View),
    band: usize,
    sweep: &mut Sweep,
    blocks: &mut [BlockGradient],
) -> BandSums {
    let first = Group(ABOVE + band * BAND_GROUPS);
    if sweep.next != Some(first) {
        sweep.resize(plan);
        sweep.loading.begin();
        // The band's first gradient hangs on the group above, whose windows reach one further.
        sweep.load(level, plan, source, Group(first.0 - 2));
        sweep.load(level, plan, source, Group(first.0 - 1));
        sweep.advance(level, plan, source, Group(first.0 - 1));
        sweep.advance(level, plan, source, first);
    }
    let mut sums = BandSums::ZERO;
    for n in 0..BAND_GROUPS {
        let group = Group(first.0 + n);
        sweep.advance(level, plan, source, group.next());
        let GroupSums { differences, ssim } = sweep.sums[group.slot()];
        sums.differences.absolute += differences.absolute;
        sums.differences.squared += differences.squared;
        sums.ssim += ssim;
        sweep.differentiate(level, plan, (group, n * GROUP), &mut sums.by_knots);
    }
    sweep.next = Some(Group(first.0 + BAND_GROUPS));
    let linear = sweep.gradient.linear();
    let stride = linear.len() / (3 * BAND_PX);
    for (row, blocks) in blocks.chunks_exact_mut(plan.across * TILE_BLOCKS).enumerate() {
        write_blocks(blocks, &linear[row * BLOCK_PX * stride..], stride, BAND_PX);
    }
    sums
}
