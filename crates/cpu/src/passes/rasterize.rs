//! Pass `rasterize`: front-to-back blending of each tile's splats.
//!
//! In: bins, footprints. Out: [`TileBuffer`]: per tile and 4x4 block the radiance `[3]`, the transmittance left, and how many of
//! the tile's entries had been looked at when each pixel was last changed (what the backward pass starts from). Source: 3DGS (Kerbl
//! et al. 2023) eq. 3 with the thresholds of [`luxel_core::Cutoffs`]. A pixel stops before the splat that would take its
//! transmittance below `min_transmittance`; the background shines through what is left.

use std::sync::atomic::Ordering;

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd};
use luxel_core::{Image, Real, each};
use rayon::prelude::*;

use super::bin::Bins;
use super::project::Footprint;
use crate::lanes::{LANES, Lanes, M, V, with_simd};
use crate::view::{BLOCK_ORIGINS_PX, BLOCKS, ScreenCamera, TILE_PIXELS, TILE_PX};

/// Pixels of a block, in registers' order: row-major within 4x4.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct BlockPixels {
    pub(crate) radiance: [Lanes; 3],
    pub(crate) transmittance: Lanes,
    /// Entries of the tile up to and including the last that changed the pixel; exact, as tiles have fewer than 2^24.
    pub(crate) last: Lanes,
}

/// Pixels of a tile.
pub(crate) type TilePixels = [BlockPixels; BLOCKS];

/// All tiles, row by row.
#[derive(Default)]
pub(crate) struct TileBuffer {
    pub(crate) tiles: Vec<TilePixels>,
}

impl TileBuffer {
    /// Copies the radiance into `image` (pixels of the last tiles beyond the image are left out).
    pub(crate) fn to_image(&self, camera: &ScreenCamera) -> Image {
        let [width, height] = camera.size_px;
        let mut image = Image::filled(width, height, [0.0; 3]);
        let across = camera.tiles()[0];
        image.pixels.par_chunks_mut(TILE_PX * width).enumerate().for_each(|(tile_row, band)| {
            for (y, row) in band.chunks_mut(width).enumerate() {
                for (x, pixel) in row.iter_mut().enumerate() {
                    let (block, lane) = block_of(x % TILE_PX, y);
                    let block = &self.tiles[tile_row * across + x / TILE_PX][block];
                    *pixel = each!([0, 1, 2] c => block.radiance[c].0[lane]);
                }
            }
        });
        image
    }
}

/// Block and lane of a tile's pixel.
#[inline(always)]
pub(crate) fn block_of(x: usize, y: usize) -> (usize, usize) {
    (y / 4 * 2 + x / 4, y % 4 * 4 + x % 4)
}

/// Blends all tiles.
pub(crate) fn rasterize(level: Level, camera: &ScreenCamera, bins: &Bins, footprints: &[Footprint], out: &mut TileBuffer) {
    let across = camera.tiles()[0];
    out.tiles.resize(across * camera.tiles()[1], TilePixels::default());
    out.tiles.par_iter_mut().enumerate().for_each_init(Vec::new, |entries, (tile, pixels)| {
        let origin = [tile % across * TILE_PX, tile / across * TILE_PX];
        fetch_entries(bins, footprints, tile, entries);
        with_simd!(level, simd => rasterize_tile(simd, camera, origin, entries, pixels));
    });
}

/// Copies the footprints of a tile's entries, front to back. They lie scattered in memory: fetching them ahead of the blending lets
/// the fetches overlap, which the blending's branches would prevent.
#[inline]
pub(crate) fn fetch_entries(bins: &Bins, footprints: &[Footprint], tile: usize, out: &mut Vec<Footprint>) {
    out.clear();
    out.extend(bins.splat[bins.tile(tile)].iter().map(|i| footprints[i.load(Ordering::Relaxed) as usize]));
}

/// Centres of a block's pixels relative to the tile's origin.
#[inline(always)]
pub(crate) fn pixel_centers<S: Simd>(simd: S, block: usize) -> [V<S>; 2] {
    let [x, y] = BLOCK_ORIGINS_PX[block];
    const COLUMN: [f32; LANES] = [0.5, 1.5, 2.5, 3.5, 0.5, 1.5, 2.5, 3.5, 0.5, 1.5, 2.5, 3.5, 0.5, 1.5, 2.5, 3.5];
    const ROW: [f32; LANES] = [0.5, 0.5, 0.5, 0.5, 1.5, 1.5, 1.5, 1.5, 2.5, 2.5, 2.5, 2.5, 3.5, 3.5, 3.5, 3.5];
    [V::load(simd, &Lanes(COLUMN)) + x as f32, V::load(simd, &Lanes(ROW)) + y as f32]
}

/// A footprint spread over the lanes; the exponent of alpha at a pixel.
#[derive(Clone, Copy)]
pub(crate) struct Spread<S: Simd> {
    pub(crate) mean: [V<S>; 2],
    half_xx: V<S>,
    xy: V<S>,
    half_yy: V<S>,
    log2_opacity: V<S>,
    pub(crate) log2_threshold: V<S>,
}

impl<S: Simd> Spread<S> {
    #[inline(always)]
    pub(crate) fn new(simd: S, f: &Footprint, origin_px: [f32; 2]) -> Self {
        let c = |value: f32| V::splat(simd, value);
        Self {
            mean: [c(f.mean_px[0] - origin_px[0]), c(f.mean_px[1] - origin_px[1])],
            half_xx: c(-0.5 * f.conic[0]),
            xy: c(-f.conic[1]),
            half_yy: c(-0.5 * f.conic[2]),
            log2_opacity: c(f.log2_opacity),
            log2_threshold: c(f.log2_threshold),
        }
    }

    /// log2(alpha) before the cap, at an offset from the mean.
    #[inline(always)]
    pub(crate) fn log2_alpha(&self, [dx, dy]: [V<S>; 2]) -> V<S> {
        let along_x = self.half_xx.mul_add(dx, self.xy * dy);
        along_x.mul_add(dx, (self.half_yy * dy).mul_add(dy, self.log2_opacity))
    }
}

#[inline(always)]
fn rasterize_tile<S: Simd>(simd: S, camera: &ScreenCamera, origin: [usize; 2], entries: &[Footprint], out: &mut TilePixels) {
    let c = |value: f32| V::splat(simd, value);
    let (zero, one) = (c(0.0), c(1.0));
    let max_alpha = c(camera.cutoffs.max_alpha);
    let min_transmittance = c(camera.cutoffs.min_transmittance);
    let origin_px = origin.map(|v| v as f32);
    let centers = each!([0, 1, 2, 3] b => pixel_centers(simd, b));
    let mut radiance = [[zero; 3]; BLOCKS];
    let mut transmittance = [one; BLOCKS];
    let mut last = [zero; BLOCKS];
    // Pixels beyond the image are finished from the start.
    let mut live: [M<S>; BLOCKS] = each!([0, 1, 2, 3] b => {
        let [x, y] = centers[b];
        (x + origin_px[0]).lt(c(camera.size_px[0] as f32)) & (y + origin_px[1]).lt(c(camera.size_px[1] as f32))
    });
    let mut any_live = each!([0, 1, 2, 3] b => live[b].any_true());
    for (index, f) in entries.iter().enumerate() {
        let spread = Spread::new(simd, f, origin_px);
        let color = each!([0, 1, 2] i => c(f.radiance[i]));
        for b in 0..BLOCKS {
            if !any_live[b] {
                continue;
            }
            let exponent = spread.log2_alpha([centers[b][0] - spread.mean[0], centers[b][1] - spread.mean[1]]);
            let mut hit = exponent.ge(spread.log2_threshold) & live[b];
            if !hit.any_true() {
                continue;
            }
            let alpha = exponent.exp2().min(max_alpha);
            let left = (-alpha).mul_add(transmittance[b], transmittance[b]);
            let finished = hit & left.lt(min_transmittance);
            if finished.any_true() {
                live[b] &= !finished;
                any_live[b] = live[b].any_true();
                hit &= !finished;
            }
            let weight = V::select(hit, alpha * transmittance[b], zero);
            for (sum, color) in radiance[b].iter_mut().zip(color) {
                *sum = weight.mul_add(color, *sum);
            }
            transmittance[b] = V::select(hit, left, transmittance[b]);
            last[b] = V::select(hit, c((index + 1) as f32), last[b]);
        }
        if !any_live.contains(&true) {
            break;
        }
    }
    for (b, block) in out.iter_mut().enumerate() {
        for ((out, sum), background) in block.radiance.iter_mut().zip(radiance[b]).zip(camera.background) {
            transmittance[b].mul_add(c(background), sum).store(out);
        }
        transmittance[b].store(&mut block.transmittance);
        last[b].store(&mut block.last);
    }
}

// Blocks and lanes tile the tile.
const _: () = assert!(BLOCKS * LANES == TILE_PIXELS);
