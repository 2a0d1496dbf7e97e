//! Vignetting, between `rasterize` and `loss`: multiplies the image's pixels by the gain of their
//! place, and takes the gradient back.
//!
//! In: pixels of the image, or the gradient by the vignetted pixels. Out: vignetted pixels, or the
//! gradient by the scene's, and that by the coefficients of ln gain. With p a pixel's radiance, v
//! its gain and d the gradient by v p: the gradient by p is v d, and that by ln v is d v p, summed
//! over channels; coefficient k of ln v has the factor r^(2k). Sums are f64 in the order of rows
//! and lanes: the same bits for any number of threads. Views without vignetting do not come here.
//! Degenerate: a pixel without a gradient adds nothing, even if it is NaN.

use fearless_simd::Simd;
use luxel_core::{Real, VIGNETTING_TERMS, Vignetting};
use luxel_lanes::Level;
use rayon::prelude::*;

use super::rasterize::{TilePixels, pixel_centers};
use super::rasterize_backward::BlockGradient;
use crate::lanes::{LANES, V, with_simd};
use crate::view::{ScreenBlock, ScreenCamera, TILE_BLOCKS, TILE_PX};

/// Sums over pixels, one for each coefficient.
type Sums = [f64; VIGNETTING_TERMS];

/// Computes the vignetted pixels. `camera` is that of the image's own pixels.
pub(crate) fn vignette(level: Level, camera: &ScreenCamera, vignetting: &Vignetting, tiles: &[TilePixels], out: &mut Vec<TilePixels>) {
    out.resize_with(tiles.len(), TilePixels::default);
    out.par_iter_mut().zip(tiles).enumerate().for_each(|(tile, (out, pixels))| {
        let origin_px = camera.tile_origin_px(tile);
        with_simd!(level, simd => vignette_tile(simd, vignetting, origin_px, pixels, out));
    });
}

#[inline(always)]
fn vignette_tile<S: Simd>(simd: S, vignetting: &Vignetting, origin_px: [usize; 2], pixels: &TilePixels, out: &mut TilePixels) {
    for (index, (out, pixels)) in out.0.iter_mut().zip(&pixels.0).enumerate() {
        let radius_squared = radius_squared(simd, vignetting, ScreenBlock { origin_px, index });
        let gain = vignetting.log_gain_at(radius_squared).exp();
        for (out, values) in out.radiance.iter_mut().zip(&pixels.radiance) {
            (V::load(simd, values) * gain).store(out);
        }
        out.transmittance = pixels.transmittance;
    }
}

/// Returns r^2 at the centres of a block's pixels.
#[inline(always)]
fn radius_squared<S: Simd>(simd: S, vignetting: &Vignetting, ScreenBlock { origin_px, index }: ScreenBlock) -> V<S> {
    let [x, y] = pixel_centers(simd, index);
    vignetting.radius_squared([x + origin_px[0] as f32, y + origin_px[1] as f32])
}

/// Converts the gradient by `vignetted` pixels, row by row of blocks, to that by the scene's
/// pixels, in place. Returns the gradient by the coefficients of ln gain.
pub(crate) fn vignette_backward(
    level: Level,
    camera: &ScreenCamera,
    vignetting: &Vignetting,
    vignetted: &[TilePixels],
    gradient: &mut [BlockGradient],
) -> [f32; VIGNETTING_TERMS] {
    let [across, down] = camera.tiles();
    let rows = gradient.par_chunks_exact_mut(across * TILE_BLOCKS).take(down * TILE_BLOCKS).enumerate();
    let sums = rows.map(|(row, blocks)| {
        let tiles = &vignetted[row / TILE_BLOCKS * across..][..across];
        let mut sums = Sums::default();
        with_simd!(level, simd => differentiate_row(simd, vignetting, row, tiles, blocks, &mut sums));
        sums
    });
    let mut total = Sums::default();
    for sums in sums.collect::<Vec<_>>() {
        total.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
    }
    total.map(|sum| sum as f32)
}

/// Differentiates a row of blocks; `tiles` are those that it lies in.
#[inline(always)]
fn differentiate_row<S: Simd>(
    simd: S,
    vignetting: &Vignetting,
    row: usize,
    tiles: &[TilePixels],
    blocks: &mut [BlockGradient],
    sums: &mut Sums,
) {
    let zero = V::splat(simd, 0.0);
    for (column, gradient) in blocks.iter_mut().enumerate() {
        let tile = column / TILE_BLOCKS;
        let index = row % TILE_BLOCKS * TILE_BLOCKS + column % TILE_BLOCKS;
        let origin_px = [tile * TILE_PX, row / TILE_BLOCKS * TILE_PX];
        let radius_squared = radius_squared(simd, vignetting, ScreenBlock { origin_px, index });
        let gain = vignetting.log_gain_at(radius_squared).exp();
        let mut by_log_gain = zero;
        for (by, values) in gradient.iter_mut().zip(&tiles[tile].0[index].radiance) {
            let by_vignetted = V::load(simd, by);
            let product = by_vignetted * V::load(simd, values);
            by_log_gain = by_log_gain + by_vignetted.abs().if_positive(product, zero);
            (by_vignetted * gain).store(by);
        }
        add_powers(by_log_gain.lanes(), radius_squared.lanes(), sums);
    }
}

/// Adds the gradients by ln gain of a block's pixels, times the powers of r^2.
#[inline(always)]
fn add_powers(by_log_gain: [f32; LANES], radius_squared: [f32; LANES], sums: &mut Sums) {
    for (by, radius_squared) in by_log_gain.iter().zip(radius_squared) {
        let mut term = f64::from(*by);
        for sum in &mut *sums {
            *sum += term;
            term *= f64::from(radius_squared);
        }
    }
}
