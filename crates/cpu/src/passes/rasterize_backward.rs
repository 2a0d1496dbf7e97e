//! Pass `rasterize_backward`: computes the gradients of each tile's splats, back to front.
//!
//! In: the tiles' records and pixels, gradient of the loss by the pixels' radiance
//! ([`BlockGradient`]s row by row). Out: one [`EntryGradient`] per entry of a tile, in the order of
//! the bins: sums over the tile's pixels. They are gathered by splat in a fixed order, by a later
//! pass or band by band, so no two threads ever add to the same number.
//!
//! With w_i = T_i alpha_i and S_i = sum over j > i of w_j c_j (background last), d alpha_i = T_i
//! c_i - S_i / (1 - alpha_i), dotted with the pixel's gradient. By the odds o_i = alpha_i / (1 -
//! alpha_i) and the transmittance behind the splat, w_i = o_i T_(i+1), T_i = T_(i+1) + w_i and g =
//! alpha_i d alpha_i = w_i c_i - o_i S_i: where a splat does not change a pixel the odds are zero,
//! and the pixel's state stays exactly the same. Gradients by centre and covariance follow from the
//! moments of g over the pixels' whitened offsets (u, v), which are summed here; pass
//! `project_backward` converts them for each splat. Degenerate: where alpha is capped it has no
//! gradient.

use std::ops::Range;

use fearless_simd::Simd;
use fearless_simd::prelude::*;
use luxel_core::{Real, each};
use rayon::prelude::*;

use super::changes::BlockChanges;
use super::more_channels::NoMore;
use super::more_channels_backward::{DifferentiateMore, Unwound};
use super::rasterize::{BlockPixels, Centers, Pixels, Rays, TilePixels};
use super::screen_gradients::{ScreenGradients, bands};
use super::sort::Entry;
use super::sums::{EntryGradient, Staged, Summed, SummedSplats};
use super::tile_records::{TileInputs, TileRecord, TileRecords};
use crate::lanes::{LANES, LOG2_OF_ZERO, Lanes, M, V, with_simd};
use crate::prefetch::fetch;
use crate::view::{BLOCKS, ScreenBlock, ScreenCamera, TILE_BLOCKS};

/// The part of the memory for records that the gradients of entries may take.
const ENTRIES_SHARE: usize = 2;

/// The gradient by the radiance of a block's pixels.
pub(crate) type BlockGradient = [Lanes; 3];

/// Whether to compute AbsGS's sums.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum AbsoluteSums {
    /// Leaves them zero.
    Skip,
    /// Computes them.
    Collect,
}

/// The results of rasterisation for each tile.
#[derive(Clone, Copy)]
pub(crate) struct RasterizedTiles<'a> {
    pub(crate) records: &'a TileRecords,
    pub(crate) pixels: &'a [TilePixels],
}

/// The inputs of differentiating a block.
struct BlockInputs<'a> {
    place: ScreenBlock,
    /// Entries of the tile.
    entries: &'a [Entry],
    changes: BlockChanges<'a>,
    pixels: &'a BlockPixels,
    gradient: &'a BlockGradient,
}

/// Differentiates all tiles.
pub(crate) fn rasterize_backward(
    inputs: &TileInputs<'_>,
    tiles: RasterizedTiles<'_>,
    gradients: &[BlockGradient],
    absolute: AbsoluteSums,
    out: &mut ScreenGradients,
) {
    let (bins, count) = (inputs.splats.bins, tiles.pixels.len());
    // Lists of rays are not in the order of tiles.
    let limit_bytes = if inputs.camera.rays.is_none() { tiles.records.limit_bytes() / ENTRIES_SHARE } else { usize::MAX };
    let bands = bands(bins, count, limit_bytes);
    if let [_] = *bands {
        return differentiate_tiles(inputs, tiles, gradients, absolute, 0..count, out.all(bins));
    }
    out.begin_bands(inputs.splats.footprints.len());
    for band in bands {
        let entries = bins.range(band.start).start..bins.range(band.end - 1).end;
        differentiate_tiles(inputs, tiles, gradients, absolute, band, out.band(entries.len()));
        out.add_band(bins, entries);
    }
}

/// Differentiates a range of tiles, of whose entries `out` are the gradients.
fn differentiate_tiles(
    inputs: &TileInputs<'_>,
    RasterizedTiles { records, pixels }: RasterizedTiles<'_>,
    gradients: &[BlockGradient],
    absolute: AbsoluteSums,
    range: Range<usize>,
    out: &mut [EntryGradient],
) {
    let TileInputs { camera, splats, .. } = *inputs;
    let across = camera.tiles()[0];
    let mut rest = out;
    let outs: Vec<&mut [EntryGradient]> =
        range.clone().map(|tile| rest.split_off_mut(..splats.bins.range(tile).len()).unwrap_or_default()).collect();
    // Tile by tile, as in `sort_and_rasterize`.
    outs.into_par_iter().zip(&pixels[range.clone()]).enumerate().with_max_len(1).for_each(|(n, (out, pixels))| {
        let tile = range.start + n;
        out.fill(EntryGradient::default());
        let work = TileBackward::new(tile, across, pixels, gradients, absolute);
        records.read(inputs, tile, |record| differentiate_tile(inputs, record, &work, out));
    });
}

/// The inputs of differentiating a tile, besides its record.
pub(crate) struct TileBackward<'a> {
    pub(crate) tile: usize,
    pub(crate) blocks: [&'a BlockPixels; BLOCKS],
    pub(crate) gradients: [&'a BlockGradient; BLOCKS],
    pub(crate) absolute: AbsoluteSums,
}

impl<'a> TileBackward<'a> {
    /// Finds the gradients of a tile's blocks among those of the image, row by row, of so many
    /// tiles `across`.
    pub(crate) fn new(tile: usize, across: usize, pixels: &'a TilePixels, gradients: &'a [BlockGradient], absolute: AbsoluteSums) -> Self {
        let gradients = std::array::from_fn(|block| &gradients[block_in_image(tile, block, across)]);
        Self { tile, blocks: pixels.0.each_ref(), gradients, absolute }
    }
}

/// Returns the number of a tile's block among all of the image, row by row.
pub(crate) fn block_in_image(tile: usize, block: usize, across: usize) -> usize {
    let row = tile / across * TILE_BLOCKS + block / TILE_BLOCKS;
    (row * across + tile % across) * TILE_BLOCKS + block % TILE_BLOCKS
}

/// Differentiates a tile.
pub(crate) fn differentiate_tile(inputs: &TileInputs<'_>, record: &TileRecord, work: &TileBackward<'_>, out: &mut [EntryGradient]) {
    let camera = inputs.camera;
    with_simd!(inputs.level, simd => match (work.absolute, &camera.rays) {
        (AbsoluteSums::Skip, None) => blocks_backward::<_, Centers<_>, _, false>(simd, camera, record, work, out, &mut NoMore),
        (AbsoluteSums::Collect, None) => blocks_backward::<_, Centers<_>, _, true>(simd, camera, record, work, out, &mut NoMore),
        (AbsoluteSums::Skip, Some(_)) => blocks_backward::<_, Rays<_>, _, false>(simd, camera, record, work, out, &mut NoMore),
        (AbsoluteSums::Collect, Some(_)) => blocks_backward::<_, Rays<_>, _, true>(simd, camera, record, work, out, &mut NoMore),
    });
}

/// Differentiates a tile of a pinhole that was blended with more channels.
pub(crate) fn differentiate_more(
    inputs: &TileInputs<'_>,
    record: &TileRecord,
    work: &TileBackward<'_>,
    out: &mut [EntryGradient],
    more: &mut impl DifferentiateMore,
) {
    let camera = inputs.camera;
    with_simd!(inputs.level, simd => match work.absolute {
        AbsoluteSums::Skip => blocks_backward::<_, Centers<_>, _, false>(simd, camera, record, work, out, more),
        AbsoluteSums::Collect => blocks_backward::<_, Centers<_>, _, true>(simd, camera, record, work, out, more),
    });
}

/// Differentiates the blocks of a tile.
#[inline(always)]
fn blocks_backward<S: Simd, P: Summed<S>, D: DifferentiateMore, const ABSOLUTE: bool>(
    simd: S,
    camera: &ScreenCamera,
    record: &TileRecord,
    work: &TileBackward<'_>,
    out: &mut [EntryGradient],
    more: &mut D,
) {
    let (entries, changes) = (&record.list.entries, &record.changes);
    fetch(entries);
    changes.fetch();
    let mut staged = Staged::ZERO;
    let origin_px = camera.tile_origin_px(work.tile);
    for (index, (pixels, gradient)) in work.blocks.iter().zip(work.gradients).enumerate() {
        let block = BlockInputs { place: ScreenBlock { origin_px, index }, entries, changes: changes.block(index), pixels, gradient };
        more.begin_block(index);
        block_backward::<_, P, D, ABSOLUTE>(simd, camera, &block, &mut staged, out, more);
    }
}

/// The state of differentiating a block, carried from each splat to the one in front of it.
struct Unwinding<S: Simd, P: Pixels<S>> {
    places: P,
    gradient: [V<S>; 3],
    transmittance: V<S>,
    /// Gradient-weighted radiance from behind the splat.
    behind: V<S>,
    max_alpha: V<S>,
    max_odds: V<S>,
}

/// Differentiates a block, and adds the sums over its pixels to the tile's entries in `out`.
#[inline(always)]
fn block_backward<S: Simd, P: Summed<S>, D: DifferentiateMore, const ABSOLUTE: bool>(
    simd: S,
    camera: &ScreenCamera,
    block: &BlockInputs<'_>,
    staged: &mut Staged,
    out: &mut [EntryGradient],
    more: &mut D,
) {
    let BlockInputs { place, entries, changes, pixels, gradient } = *block;
    let max_alpha = V::splat(simd, camera.cutoffs.max_alpha);
    let colors = each!([0, 1, 2] channel => V::load(simd, &gradient[channel]));
    let transmittance = V::load(simd, &pixels.transmittance);
    let background = each!([0, 1, 2] i => colors[i] * camera.background[i]);
    let mut unwinding = Unwinding {
        places: P::load(simd, camera, place),
        gradient: colors,
        transmittance,
        behind: more.behind(simd, transmittance, background[0] + background[1] + background[2]),
        max_alpha,
        max_odds: odds(max_alpha),
    };
    for chunk in changes.chunks_from_back(LANES) {
        unwind(simd, &mut unwinding, entries, chunk, staged, more);
        let splats = SummedSplats { entries, picks: chunk.entries, block: place.index, colors: gradient };
        P::add_sums::<ABSOLUTE>(simd, &splats, staged, out);
        more.add_sums(simd, &splats, staged, out);
    }
}

/// Returns alpha / (1 - alpha).
#[inline(always)]
fn odds<S: Simd>(alpha: V<S>) -> V<S> {
    alpha * (alpha.lift(1.0) - alpha).reciprocal()
}

/// Differentiates a chunk of changes, in front of those that are already differentiated.
#[inline(always)]
fn unwind<S: Simd, P: Summed<S>>(
    simd: S,
    state: &mut Unwinding<S, P>,
    entries: &[Entry],
    chunk: BlockChanges<'_>,
    staged: &mut Staged,
    more: &mut impl DifferentiateMore,
) {
    let c = |value: f32| V::splat(simd, value);
    for (i, (index, pixels)) in chunk.entries.iter().zip(chunk.pixels).enumerate().take(LANES) {
        let entry = &entries[*index as usize];
        let splat = state.places.evaluate(simd, entry);
        V::select(M::from_bitmask(simd, (*pixels).into()), splat.log2_alpha, c(LOG2_OF_ZERO)).store(&mut staged.share[i]);
        P::stage(staged, i, entry, &splat);
    }
    let Staged { share, weight, .. } = staged;
    let (share, weight) = (&mut share[..chunk.entries.len()], &mut weight[..chunk.entries.len()]);
    for share in share.iter_mut() {
        odds(V::load(simd, share).exp2().min(state.max_alpha)).store(share);
    }
    let gradient = state.gradient;
    for (i, ((index, share), weight)) in chunk.entries.iter().zip(share).zip(weight).enumerate().rev() {
        let entry = &entries[*index as usize];
        let odds = V::load(simd, share);
        let blended = odds * state.transmittance;
        let color = each!([0, 1, 2] i => c(entry.radiance[i]));
        let shading = color[0].mul_add(gradient[0], color[1].mul_add(gradient[1], color[2] * gradient[2]));
        let radiance = blended * more.shade(simd, shading, *index as usize);
        let g = (-odds).mul_add(state.behind, radiance);
        let is_free = odds.lt(state.max_odds);
        let g = V::select(is_free, g, c(0.0));
        more.unwind(simd, i, Unwound { odds, blended, shading, is_free });
        state.transmittance = state.transmittance + blended;
        state.behind = state.behind + radiance;
        g.store(share);
        blended.store(weight);
    }
}
