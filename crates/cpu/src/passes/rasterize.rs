//! Pass `rasterize`: blends each block's splats front to back.
//!
//! In: the tiles' sorted lists. Out: [`TilePixels`]: per tile and 4x4 block the radiance `[3]` and
//! the remaining transmittance; and [`Changes`], the entries that changed a pixel, if they are
//! wanted. Source: 3DGS (Kerbl et al. 2023) eq. 3 with the thresholds of [`luxel_core::Cutoffs`]. A
//! pixel stops before the splat that would lower its transmittance below `min_transmittance`; the
//! background is weighted by the remaining transmittance. Degenerate: pixels beyond the image are
//! finished from the start.

use fearless_simd::Simd;
use fearless_simd::prelude::*;
use luxel_core::{Image, Real, each};
use luxel_lanes::Level;
use rayon::prelude::*;

use super::changes::Changes;
use super::more_channels::{BlendMore, NoMore};
use super::picks::{MOST_PICKS, Picked, Picks};
use super::sort::{Entry, Tile, TileList, WORD};
use crate::lanes::{LANES, LOG2_OF_ZERO, Lanes, V, dot, with_simd};
use crate::rays::cross;
use crate::view::{BLOCK_PX, BLOCKS, ScreenBlock, ScreenCamera, TILE_BLOCKS, TILE_PX, block_of};

/// The pixels of a block, in the order of a vector's lanes: row-major within 4x4.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct BlockPixels {
    pub(crate) radiance: [Lanes; 3],
    pub(crate) transmittance: Lanes,
}

/// The pixels of a tile.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TilePixels(pub(crate) [BlockPixels; BLOCKS]);

impl Default for TilePixels {
    fn default() -> Self {
        Self([BlockPixels::default(); BLOCKS])
    }
}

/// Converts the radiance to an image (pixels of the last tiles beyond the image are left out).
pub(crate) fn to_image(tiles: &[TilePixels], camera: &ScreenCamera) -> Image {
    let [width, height] = camera.size_px;
    let mut image = Image::filled(width, height, [0.0; 3]);
    let across = camera.tiles()[0];
    image.pixels.par_chunks_mut(TILE_PX * width).enumerate().for_each(|(tile_row, band)| {
        for (y, row) in band.chunks_mut(width).enumerate() {
            for (column, pixels) in row.chunks_mut(BLOCK_PX).enumerate() {
                let (block, lane) = block_of(column % TILE_BLOCKS * BLOCK_PX, y);
                let block = &tiles[tile_row * across + column / TILE_BLOCKS].0[block];
                let channels = each!([0, 1, 2] c => &block.radiance[c].0[lane..lane + BLOCK_PX]);
                for (i, pixel) in pixels.iter_mut().enumerate() {
                    *pixel = each!([0, 1, 2] c => channels[c][i]);
                }
            }
        }
    });
    image
}

/// Converts the pixels to alpha, one minus the remaining transmittance: `[H*W]`.
pub(crate) fn to_alpha(tiles: &[TilePixels], camera: &ScreenCamera) -> Vec<f32> {
    let [width, height] = camera.size_px;
    let across = camera.tiles()[0];
    let alpha = |i: usize| {
        let (x, y) = (i % width, i / width);
        let (block, lane) = block_of(x % TILE_PX, y % TILE_PX);
        1.0 - tiles[y / TILE_PX * across + x / TILE_PX].0[block].transmittance.0[lane]
    };
    (0..width * height).into_par_iter().map(alpha).collect()
}

/// Blends a tile, and writes what changed its pixels to `changes` if that is given, which takes a
/// good part of the time.
pub(crate) fn rasterize(level: Level, camera: &ScreenCamera, tile: Tile<'_>, pixels: &mut TilePixels, changes: Option<&mut Changes>) {
    let mut unused = Changes::default();
    with_simd!(level, simd => match (changes, &camera.rays) {
        (Some(changes), None) => rasterize_blocks::<_, Centers<_>, _, true>(simd, camera, tile, pixels, changes, &mut NoMore),
        (None, None) => rasterize_blocks::<_, Centers<_>, _, false>(simd, camera, tile, pixels, &mut unused, &mut NoMore),
        (Some(changes), Some(_)) => rasterize_blocks::<_, Rays<_>, _, true>(simd, camera, tile, pixels, changes, &mut NoMore),
        (None, Some(_)) => rasterize_blocks::<_, Rays<_>, _, false>(simd, camera, tile, pixels, &mut unused, &mut NoMore),
    });
}

/// Blends a tile of a pinhole with more channels than those of its entries, and writes what changed
/// its pixels to `changes`.
pub(crate) fn rasterize_more(
    level: Level,
    camera: &ScreenCamera,
    tile: Tile<'_>,
    pixels: &mut TilePixels,
    changes: &mut Changes,
    more: &mut impl BlendMore,
) {
    with_simd!(level, simd => rasterize_blocks::<_, Centers<_>, _, true>(simd, camera, tile, pixels, changes, more));
}

/// Blends a tile's blocks, and records their changes if `RECORD_CHANGES`.
#[inline(always)]
fn rasterize_blocks<S: Simd, P: Pixels<S>, B: BlendMore, const RECORD_CHANGES: bool>(
    simd: S,
    camera: &ScreenCamera,
    Tile { index, list }: Tile<'_>,
    pixels: &mut TilePixels,
    changes: &mut Changes,
    more: &mut B,
) {
    let origin_px = camera.tile_origin_px(index);
    let mut scratch = BlendScratch { picks: Picks::NONE, alphas: [Lanes::ZERO; MOST_PICKS] };
    changes.clear();
    for (index, pixels) in pixels.0.iter_mut().enumerate() {
        let block = ScreenBlock { origin_px, index };
        more.begin_block(index);
        rasterize_block::<_, P, B, RECORD_CHANGES>(simd, camera, list, block, &mut scratch, pixels, changes, more);
        if RECORD_CHANGES {
            changes.end_block();
        }
    }
}

/// Returns the centre of the top left pixel of a block, relative to its tile's origin.
#[inline(always)]
pub(crate) fn first_pixel_center(block: usize) -> [f32; 2] {
    [(block % TILE_BLOCKS * BLOCK_PX) as f32 + 0.5, (block / TILE_BLOCKS * BLOCK_PX) as f32 + 0.5]
}

/// Returns the centres of a block's pixels, relative to the tile's origin.
#[inline(always)]
pub(crate) fn pixel_centers<S: Simd>(simd: S, block: usize) -> [V<S>; 2] {
    let [x, y] = first_pixel_center(block);
    const COLUMN: [f32; LANES] = [0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0];
    const ROW: [f32; LANES] = [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0];
    [V::load(simd, &Lanes(COLUMN)) + x, V::load(simd, &Lanes(ROW)) + y]
}

/// A splat evaluated at the pixels of a block.
#[derive(Clone, Copy)]
pub(crate) struct SplatAtPixels<S: Simd> {
    /// Offsets from the centre, whitened: see [`super::project::Footprint::root`].
    pub(crate) u: V<S>,
    pub(crate) v: V<S>,
    /// log2(alpha) before the cap.
    pub(crate) log2_alpha: V<S>,
    /// For rays, the cosine between the ray and the splat's direction, times a number of the splat
    /// above 0: see [`Rays::facing_scale`]; else unused.
    pub(crate) facing: V<S>,
}

/// The pixels of a block, at which splats are evaluated.
pub(crate) trait Pixels<S: Simd>: Copy {
    /// Returns the pixels of a block.
    fn load(simd: S, camera: &ScreenCamera, block: ScreenBlock) -> Self;
    /// Evaluates an entry of the block's tile.
    fn evaluate(self, simd: S, entry: &Entry) -> SplatAtPixels<S>;
}

/// Centres of the pixels relative to the origin of their tile, for a pinhole.
#[derive(Clone, Copy)]
pub(crate) struct Centers<S: Simd>(pub(crate) [V<S>; 2]);

impl<S: Simd> Pixels<S> for Centers<S> {
    #[inline(always)]
    fn load(simd: S, _: &ScreenCamera, block: ScreenBlock) -> Self {
        Self(pixel_centers(simd, block.index))
    }

    #[inline(always)]
    fn evaluate(self, simd: S, entry: &Entry) -> SplatAtPixels<S> {
        let c = |value: f32| V::splat(simd, value);
        let (dx, dy) = (self.0[0] - entry.mean_px[0], self.0[1] - entry.mean_px[1]);
        let u = c(entry.root[0]).mul_add(dx, dy * entry.root[1]);
        let v = dy * entry.root[2];
        let log2_alpha = (-u).mul_add(u, (-v).mul_add(v, c(entry.log2_opacity)));
        SplatAtPixels { u, v, log2_alpha, facing: c(1.0) }
    }
}

/// Rays of the pixels in camera space; zero where the image shows nothing.
#[derive(Clone, Copy)]
pub(crate) struct Rays<S: Simd>([V<S>; 3]);

impl<S: Simd> Rays<S> {
    /// Returns the factor that makes [`SplatAtPixels::facing`] of an entry a cosine.
    #[inline(always)]
    pub(crate) fn facing_scale(entry: &Entry) -> f32 {
        let [a, b] = entry.rows();
        let front = cross(a, b);
        1.0 / (front[0] * front[0] + front[1] * front[1] + front[2] * front[2]).sqrt().max(f32::MIN_POSITIVE)
    }
}

impl<S: Simd> Pixels<S> for Rays<S> {
    #[inline(always)]
    fn load(simd: S, camera: &ScreenCamera, block: ScreenBlock) -> Self {
        let zero = V::splat(simd, 0.0);
        let [x, y] = block.origin_px.map(|px| px / TILE_PX);
        Self(camera.rays.as_ref().map_or([zero; 3], |rays| rays.block(simd, y * camera.tiles()[0] + x, block.index)))
    }

    #[inline(always)]
    fn evaluate(self, simd: S, entry: &Entry) -> SplatAtPixels<S> {
        let [a, b] = entry.rows();
        let rows = [a, b, cross(a, b)];
        // Closures around vectors may stay calls: there are none here.
        let [u, v, facing] = each!([0, 1, 2] k => dot(self.0, each!([0, 1, 2] i => V::splat(simd, rows[k][i]))));
        let log2_alpha = (-u).mul_add(u, (-v).mul_add(v, V::splat(simd, entry.log2_opacity)));
        SplatAtPixels { u, v, log2_alpha: facing.if_positive(log2_alpha, V::splat(simd, LOG2_OF_ZERO)), facing }
    }
}

/// The transmittance of a finished pixel: negative, so that no splat raises it above the minimum
/// again. If finished pixels kept their tiny products, those could become subnormal, which some
/// processors multiply very slowly.
const FINISHED: f32 = -1.0;

/// The state of blending a block, carried from each splat to the one behind it.
struct Blending<S: Simd, P: Pixels<S>> {
    pixels: P,
    radiance: [V<S>; 3],
    /// Transmittance up to the splat at which the pixel stops.
    transmittance: V<S>,
    /// Transmittance as if no pixel ever stopped, so that a splat does not wait for the comparison
    /// of the one in front. Once below the minimum it stays there, which marks the pixel as
    /// finished; at the latest with the next picks it becomes [`FINISHED`].
    unstopped: V<S>,
    max_alpha: V<S>,
    min_transmittance: V<S>,
}

/// Buffers for blending a block.
struct BlendScratch {
    picks: Picks,
    /// Alphas of the picks, then their weights if there are more channels.
    alphas: [Lanes; MOST_PICKS],
}

/// Blends a block. The scratch has no picks before and after; its alphas may hold anything.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "an inlined part of a loop")]
fn rasterize_block<S: Simd, P: Pixels<S>, B: BlendMore, const RECORD_CHANGES: bool>(
    simd: S,
    camera: &ScreenCamera,
    list: &TileList,
    block: ScreenBlock,
    BlendScratch { picks, alphas }: &mut BlendScratch,
    out: &mut BlockPixels,
    changes: &mut Changes,
    more: &mut B,
) {
    let c = |value: f32| V::splat(simd, value);
    let centers = pixel_centers(simd, block.index);
    // Pixels beyond the image are finished from the start.
    let limit = each!([0, 1] i => c(camera.size_px[i] as f32 - block.origin_px[i] as f32));
    let inside = centers[0].lt(limit[0]) & centers[1].lt(limit[1]);
    let mut blending = Blending {
        pixels: P::load(simd, camera, block),
        radiance: [c(0.0); 3],
        transmittance: c(1.0),
        unstopped: V::select(inside, c(1.0), c(FINISHED)),
        max_alpha: c(camera.cutoffs.max_alpha),
        min_transmittance: c(camera.cutoffs.min_transmittance),
    };
    for n in 0..list.words() {
        picks.push_word(simd, (n * WORD) as u32, list.word(n, block.index));
        if picks.is_enough() {
            blend::<_, P, B, RECORD_CHANGES>(simd, &mut blending, &list.entries, picks.take(), alphas, changes, more);
            let live = blending.unstopped.ge(blending.min_transmittance);
            if !live.any_true() {
                break;
            }
            blending.unstopped = V::select(live, blending.unstopped, c(FINISHED));
        }
    }
    blend::<_, P, B, RECORD_CHANGES>(simd, &mut blending, &list.entries, picks.take(), alphas, changes, more);
    let Blending { radiance, transmittance, .. } = blending;
    for ((out, sum), background) in out.radiance.iter_mut().zip(radiance).zip(camera.background) {
        transmittance.mul_add(c(background), sum).store(out);
    }
    more.end_block(simd, transmittance);
    transmittance.store(&mut out.transmittance);
}

/// Blends picked entries of a tile behind those that are already blended.
#[inline(always)]
fn blend<S: Simd, P: Pixels<S>, B: BlendMore, const RECORD_CHANGES: bool>(
    simd: S,
    state: &mut Blending<S, P>,
    entries: &[Entry],
    picked: Picked<'_>,
    alphas: &mut [Lanes; MOST_PICKS],
    changes: &mut Changes,
    more: &mut B,
) {
    let c = |value: f32| V::splat(simd, value);
    let picks = picked.entries();
    for (index, alpha) in picks.iter().zip(alphas.iter_mut()) {
        let entry = &entries[*index as usize];
        let log2_alpha = state.pixels.evaluate(simd, entry).log2_alpha;
        V::select(log2_alpha.ge(c(entry.log2_threshold)), log2_alpha, c(LOG2_OF_ZERO)).store(alpha);
    }
    for alpha in &mut alphas[..picks.len()] {
        V::load(simd, alpha).exp2().min(state.max_alpha).store(alpha);
    }
    let mut changed = [0; MOST_PICKS];
    for ((index, share), changed) in picks.iter().zip(&mut *alphas).zip(&mut changed) {
        let entry = &entries[*index as usize];
        let alpha = V::load(simd, share);
        // Where the splat is below its threshold alpha is zero, so the pixel does not change.
        let left = (-alpha).mul_add(state.unstopped, state.unstopped);
        let live = left.ge(state.min_transmittance);
        let weight = V::select(live, alpha * state.unstopped, c(0.0));
        for (sum, color) in state.radiance.iter_mut().zip(entry.radiance) {
            *sum = weight.mul_add(c(color), *sum);
        }
        if B::IS_SOME {
            weight.store(share);
        }
        state.transmittance = V::select(live, left, state.transmittance);
        state.unstopped = left;
        if RECORD_CHANGES {
            *changed = weight.gt(c(0.0)).to_bitmask() as u16;
        }
    }
    more.blend(simd, &alphas[..picks.len()], picks);
    if RECORD_CHANGES {
        changes.record(simd, picked, &changed);
    }
}
