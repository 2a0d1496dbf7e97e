//! Pass `rasterize`: front-to-back blending of each block's splats.
//!
//! In: the tiles' sorted lists. Out: [`TilePixels`]: per tile and 4x4 block the radiance `[3]` and the transmittance left; and [`Changes`], the
//! entries that changed a pixel, if they are wanted. Source: 3DGS (Kerbl et al. 2023) eq. 3 with the thresholds of [`luxel_core::Cutoffs`]. A pixel stops before
//! the splat that would take its transmittance below `min_transmittance`; the background shines through what is left.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd};
use luxel_core::{Image, Real, each};
use rayon::prelude::*;

use super::changes::Changes;
use super::picks::{MOST_PICKS, Picks};
use super::sort::{Entry, TileList, WORD};
use crate::lanes::{LANES, LOG2_OF_ZERO, Lanes, V, with_simd};
use crate::view::{BLOCK_PX, BLOCKS, ScreenCamera, TILE_BLOCKS, TILE_PX, block_of};

/// Pixels of a block, in registers' order: row-major within 4x4.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct BlockPixels {
    pub(crate) radiance: [Lanes; 3],
    pub(crate) transmittance: Lanes,
}

/// Pixels of a tile.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TilePixels(pub(crate) [BlockPixels; BLOCKS]);

impl Default for TilePixels {
    fn default() -> Self {
        Self([BlockPixels::default(); BLOCKS])
    }
}

/// The radiance as an image (pixels of the last tiles beyond the image are left out).
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

/// One minus the transmittance left, `[H*W]`.
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

/// Blends a tile. What changes its pixels is noted for who asks for it, which takes a quarter of the time.
pub(crate) fn rasterize(
    level: Level,
    camera: &ScreenCamera,
    (list, tile): (&TileList, usize),
    (pixels, changes): (&mut TilePixels, Option<&mut Changes>),
) {
    let origin = camera.tile_origin_px(tile);
    with_simd!(level, simd => match changes {
        Some(changes) => rasterize_blocks::<_, true>(simd, camera, origin, list, (pixels, changes)),
        None => rasterize_blocks::<_, false>(simd, camera, origin, list, (pixels, &mut Changes::default())),
    });
}

/// Blends a tile's blocks, and notes their changes if `NOTED`.
#[inline(always)]
fn rasterize_blocks<S: Simd, const NOTED: bool>(
    simd: S,
    camera: &ScreenCamera,
    origin: [usize; 2],
    list: &TileList,
    (pixels, changes): (&mut TilePixels, &mut Changes),
) {
    let (mut picks, mut alphas) = (Picks::NONE, [Lanes::ZERO; MOST_PICKS]);
    changes.clear();
    for (block, pixels) in pixels.0.iter_mut().enumerate() {
        rasterize_block::<_, NOTED>(simd, camera, origin, (list, block), (&mut picks, &mut alphas), (pixels, changes));
        if NOTED {
            changes.end_block();
        }
    }
}

/// Centre of the top left pixel of a block, relative to its tile's origin.
#[inline(always)]
pub(crate) fn first_pixel_center(block: usize) -> [f32; 2] {
    [(block % TILE_BLOCKS * BLOCK_PX) as f32 + 0.5, (block / TILE_BLOCKS * BLOCK_PX) as f32 + 0.5]
}

/// Centres of a block's pixels relative to the tile's origin.
#[inline(always)]
pub(crate) fn pixel_centers<S: Simd>(simd: S, block: usize) -> [V<S>; 2] {
    let [x, y] = first_pixel_center(block);
    const COLUMN: [f32; LANES] = [0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0];
    const ROW: [f32; LANES] = [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0];
    [V::load(simd, &Lanes(COLUMN)) + x, V::load(simd, &Lanes(ROW)) + y]
}

/// A splat as the pixels of a block see it.
#[derive(Clone, Copy)]
pub(crate) struct Seen<S: Simd> {
    /// Offsets from the centre, whitened: see [`super::project::Footprint::root`].
    pub(crate) u: V<S>,
    pub(crate) v: V<S>,
    /// log2(alpha) before the cap.
    pub(crate) log2_alpha: V<S>,
}

impl<S: Simd> Seen<S> {
    #[inline(always)]
    pub(crate) fn new(simd: S, entry: &Entry, centers: [V<S>; 2]) -> Self {
        let c = |value: f32| V::splat(simd, value);
        let (dx, dy) = (centers[0] - entry.mean_px[0], centers[1] - entry.mean_px[1]);
        let u = c(entry.root[0]).mul_add(dx, dy * entry.root[1]);
        let v = dy * entry.root[2];
        let log2_alpha = (-u).mul_add(u, (-v).mul_add(v, c(entry.log2_opacity)));
        Self { u, v, log2_alpha }
    }
}

/// A transmittance that no splat brings above the least again. Products that went on below it could become too small to be normal numbers,
/// which some processors multiply at a hundredth of the pace.
const FINISHED: f32 = -1.0;

/// What blending a block's splats goes on with from one to the next behind.
struct Blending<S: Simd> {
    centers: [V<S>; 2],
    radiance: [V<S>; 3],
    /// Up to where the pixel stops.
    transmittance: V<S>,
    /// As if no pixel ever stopped, so that a splat waits for no comparison with the one in front. Once below the least it stays there, which is
    /// how finished pixels are told: [`FINISHED`] at the latest with the next picks.
    unstopped: V<S>,
    max_alpha: V<S>,
    min_transmittance: V<S>,
}

/// Blends a block. There are no picks before and after; what is in `alphas` does not matter.
#[inline(always)]
fn rasterize_block<S: Simd, const NOTED: bool>(
    simd: S,
    camera: &ScreenCamera,
    origin: [usize; 2],
    (list, block): (&TileList, usize),
    (picks, alphas): (&mut Picks, &mut [Lanes; MOST_PICKS]),
    (out, changes): (&mut BlockPixels, &mut Changes),
) {
    let c = |value: f32| V::splat(simd, value);
    let centers = pixel_centers(simd, block);
    // Pixels beyond the image are finished from the start.
    let limit = each!([0, 1] i => c(camera.size_px[i] as f32 - origin[i] as f32));
    let inside = centers[0].lt(limit[0]) & centers[1].lt(limit[1]);
    let mut blending = Blending {
        centers,
        radiance: [c(0.0); 3],
        transmittance: c(1.0),
        unstopped: V::select(inside, c(1.0), c(FINISHED)),
        max_alpha: c(camera.cutoffs.max_alpha),
        min_transmittance: c(camera.cutoffs.min_transmittance),
    };
    for n in 0..list.words() {
        picks.pick(simd, (n * WORD) as u32, list.word(n, block));
        if picks.is_enough() {
            blend::<_, NOTED>(simd, &mut blending, &list.entries, picks.take(), (alphas, changes));
            let live = blending.unstopped.ge(blending.min_transmittance);
            if !live.any_true() {
                break;
            }
            blending.unstopped = V::select(live, blending.unstopped, c(FINISHED));
        }
    }
    blend::<_, NOTED>(simd, &mut blending, &list.entries, picks.take(), (alphas, changes));
    let Blending { radiance, transmittance, .. } = blending;
    for ((out, sum), background) in out.radiance.iter_mut().zip(radiance).zip(camera.background) {
        transmittance.mul_add(c(background), sum).store(out);
    }
    transmittance.store(&mut out.transmittance);
}

/// Blends the picks among a tile's entries behind what has been blended.
#[inline(always)]
fn blend<S: Simd, const NOTED: bool>(
    simd: S,
    state: &mut Blending<S>,
    entries: &[Entry],
    (room, len): (&[u32; MOST_PICKS], usize),
    (alphas, changes): (&mut [Lanes; MOST_PICKS], &mut Changes),
) {
    let c = |value: f32| V::splat(simd, value);
    let picks = &room[..len];
    for (index, alpha) in picks.iter().zip(alphas.iter_mut()) {
        let entry = &entries[*index as usize];
        let log2_alpha = Seen::new(simd, entry, state.centers).log2_alpha;
        V::select(log2_alpha.ge(c(entry.log2_threshold)), log2_alpha, c(LOG2_OF_ZERO)).store(alpha);
    }
    for alpha in &mut alphas[..picks.len()] {
        V::load(simd, alpha).exp2().min(state.max_alpha).store(alpha);
    }
    let mut changed = [0; MOST_PICKS];
    for ((index, alpha), changed) in picks.iter().zip(alphas).zip(&mut changed) {
        let entry = &entries[*index as usize];
        let alpha = V::load(simd, alpha);
        // Where the splat is not seen nothing is taken, so that the pixel stays as it is.
        let left = (-alpha).mul_add(state.unstopped, state.unstopped);
        let live = left.ge(state.min_transmittance);
        let weight = V::select(live, alpha * state.unstopped, c(0.0));
        for (sum, color) in state.radiance.iter_mut().zip(entry.radiance) {
            *sum = weight.mul_add(c(color), *sum);
        }
        state.transmittance = V::select(live, left, state.transmittance);
        state.unstopped = left;
        if NOTED {
            *changed = weight.gt(c(0.0)).to_bitmask() as u16;
        }
    }
    if NOTED {
        changes.note(simd, (room, len), &changed);
    }
}
