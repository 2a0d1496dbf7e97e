//! Supersampling: averages samples to pixels after `rasterize`, and spreads gradients back to
//! samples after `loss`.
//!
//! In: pixels of the samples, or the gradient by the pixels. Out: pixels of the image, or the
//! gradient by the samples.
//!
//! With `samples` along the side of a pixel the passes work on a camera with that many times the
//! pixels in each direction, and a pixel of the image is the mean of its square of samples. Blocks
//! and tiles of samples lie within blocks and tiles of pixels, so whole blocks are added up. Sums
//! are in the order of blocks and lanes: the same bits for any number of threads. Degenerate:
//! samples beyond the image are ignored, and get a zero gradient.

use rayon::prelude::*;

use super::rasterize::{BlockPixels, TilePixels};
use super::rasterize_backward::BlockGradient;
use crate::lanes::{LANES, Lanes};
use crate::view::{BLOCK_PX, ScreenCamera, TILE_BLOCKS};

/// Returns, for each lane of a block of samples, the lane of its pixel. `at` is the position of the
/// block of samples within the block of pixels, in blocks.
fn lanes_of_samples(samples: usize, at: [usize; 2]) -> [usize; LANES] {
    std::array::from_fn(|lane| {
        let [x, y] = [lane % BLOCK_PX + at[0] * BLOCK_PX, lane / BLOCK_PX + at[1] * BLOCK_PX].map(|v| v / samples);
        y * BLOCK_PX + x
    })
}

/// Returns the tables of [`lanes_of_samples`] for all blocks of samples within a block of pixels,
/// row by row.
fn tables(samples: usize) -> Vec<[usize; LANES]> {
    (0..samples * samples).map(|n| lanes_of_samples(samples, [n % samples, n / samples])).collect()
}

/// Computes the image's pixels from their samples. `sampled` is the samples' camera.
pub(crate) fn resolve(sampled: &ScreenCamera, tiles: &[TilePixels], out: &mut Vec<TilePixels>) {
    let samples = sampled.samples;
    let ([across, down], [image_across, image_down]) = (sampled.tiles(), sampled.without_supersampling().tiles());
    let share = 1.0 / (samples * samples) as f32;
    let tables = tables(samples);
    out.resize_with(image_across * image_down, TilePixels::default);
    out.par_iter_mut().enumerate().for_each(|(tile, out)| {
        for (block, out) in out.0.iter_mut().enumerate() {
            let column = tile % image_across * TILE_BLOCKS + block % TILE_BLOCKS;
            let row = tile / image_across * TILE_BLOCKS + block / TILE_BLOCKS;
            *out = BlockPixels::default();
            for (n, table) in tables.iter().enumerate() {
                let (x, y) = (column * samples + n % samples, row * samples + n / samples);
                // Beyond the last tile of samples there is nothing of the image.
                if x >= across * TILE_BLOCKS || y >= down * TILE_BLOCKS {
                    continue;
                }
                let from = &tiles[y / TILE_BLOCKS * across + x / TILE_BLOCKS].0[y % TILE_BLOCKS * TILE_BLOCKS + x % TILE_BLOCKS];
                for (sum, values) in out.radiance.iter_mut().zip(&from.radiance) {
                    add(sum, values, table, share);
                }
                add(&mut out.transmittance, &from.transmittance, table, share);
            }
        }
    });
}

/// Adds samples to their pixels.
fn add(sum: &mut Lanes, values: &Lanes, table: &[usize; LANES], share: f32) {
    for (value, lane) in values.0.iter().zip(table) {
        sum.0[*lane] += value * share;
    }
}

/// Computes the gradient by the samples' radiance from that by the pixels'.
pub(crate) fn spread(sampled: &ScreenCamera, gradient: &[BlockGradient], out: &mut Vec<BlockGradient>) {
    let samples = sampled.samples;
    let ([across, down], [image_across, _]) = (sampled.tiles(), sampled.without_supersampling().tiles());
    let (width, image_width) = (across * TILE_BLOCKS, image_across * TILE_BLOCKS);
    let share = 1.0 / (samples * samples) as f32;
    let tables = tables(samples);
    out.resize(width * down * TILE_BLOCKS, [Lanes::ZERO; 3]);
    out.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, out) in row.iter_mut().enumerate() {
            let table = &tables[y % samples * samples + x % samples];
            // A row or column of samples beyond the pixels' last tile is beyond the image.
            let Some(from) = gradient.get(y / samples * image_width + x / samples).filter(|_| x / samples < image_width) else {
                *out = [Lanes::ZERO; 3];
                continue;
            };
            for (out, from) in out.iter_mut().zip(from) {
                for (value, lane) in out.0.iter_mut().zip(table) {
                    *value = from.0[*lane] * share;
                }
            }
        }
    });
}
