//! Conversion of rows between blocks, linear rows and strips.
//!
//! In, out: pixels of tiles, linear rows, rows in strips.
//!
//! A row of W pixels is cut into as many strips as a vector has lanes, of S = W / 16 pixels
//! (rounded up): lane l of vector i is pixel l S + i, with `[S]` vectors per row, zero beyond the
//! image. Vectors one apart are pixels one apart in every lane, so a window along the row reads
//! whole, aligned vectors just as a window down the columns does. Only at the strips' ends is a
//! pixel's neighbour in the next lane: [`pad`] puts those vectors on either side of the row.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x4, f64x2};
use luxel_core::each;

use crate::lanes::{LANES, Lanes, V, is_one_register};
use crate::passes::loss::convolution::RADIUS;
use crate::passes::rasterize::TilePixels;
use crate::passes::rasterize_backward::BlockGradient;
use crate::view::{BLOCK_PX, TILE_BLOCKS};

/// Lanes of a short register.
const QUAD: usize = 4;

/// Returns the number of pixels of a strip.
pub(super) fn strip_px(width_px: usize) -> usize {
    width_px.div_ceil(LANES)
}

/// Returns how many numbers a linear row of strips of length `strip` must hold: the transposition
/// reads a whole vector from the last strip's last pixel.
pub(super) fn linear_len(strip: usize) -> usize {
    (strip + 1) * LANES
}

/// Reads the radiance of a row of blocks: row number `block_row` of each tile of a row. Out: linear
/// rows of length `stride`, `[3, BLOCK_PX, stride]`.
///
/// All channels of a block are read together (and written by [`write_blocks`]): this is the order
/// of memory, which the hardware prefetches.
#[inline(always)]
pub(super) fn read_blocks(tiles: &[TilePixels], block_row: usize, out: &mut [f32], stride: usize) {
    let blocks = tiles.iter().flat_map(|tile| &tile.0[block_row * TILE_BLOCKS..][..TILE_BLOCKS]);
    for (column, block) in blocks.enumerate() {
        for (channel, lanes) in block.radiance.iter().enumerate() {
            for (row, quad) in lanes.0.as_chunks::<BLOCK_PX>().0.iter().enumerate() {
                out[(channel * BLOCK_PX + row) * stride + column * BLOCK_PX..][..BLOCK_PX].copy_from_slice(quad);
            }
        }
    }
}

/// Writes a row of blocks: the inverse of [`read_blocks`]. Row `row` of channel `channel` is number
/// `row + channel * channel_stride`.
#[inline(always)]
pub(super) fn write_blocks(blocks: &mut [BlockGradient], values: &[f32], stride: usize, channel_stride: usize) {
    for (column, gradient) in blocks.iter_mut().enumerate() {
        for (channel, lanes) in gradient.iter_mut().enumerate() {
            for (row, quad) in lanes.0.as_chunks_mut::<BLOCK_PX>().0.iter_mut().enumerate() {
                quad.copy_from_slice(&values[(channel * channel_stride + row) * stride + column * BLOCK_PX..][..BLOCK_PX]);
            }
        }
    }
}

/// Returns the starts of the transpositions of `step` pixels that cover a strip. If the strip is
/// long enough, the last one begins early, so that it does not reach into the next strip.
fn starts(strip: usize, step: usize) -> impl Iterator<Item = usize> {
    (0..strip.div_ceil(step)).map(move |n| (n * step).min(strip.saturating_sub(step)))
}

/// Converts a linear row (of [`linear_len`]) to strips.
#[inline(always)]
pub(super) fn to_strips<S: Simd>(simd: S, linear: &[f32], strip: usize, out: &mut [Lanes]) {
    let out = &mut out[..strip];
    if is_one_register::<S>() {
        for start in starts(strip, LANES) {
            to_vectors(simd, &linear[start..], strip, &mut out[start..]);
        }
    } else {
        for start in starts(strip, QUAD) {
            to_quads(simd, &linear[start..], strip, &mut out[start..]);
        }
    }
}

/// Converts strips to a linear row (of [`linear_len`]). If strips are shorter than a transposition,
/// each writes beyond its end, and the next one overwrites that.
#[inline(always)]
pub(super) fn from_strips<S: Simd>(simd: S, strips: &[Lanes], strip: usize, linear: &mut [f32]) {
    let strips = &strips[..strip];
    if is_one_register::<S>() {
        for start in starts(strip, LANES) {
            from_vectors(simd, &strips[start..], strip, &mut linear[start..]);
        }
    } else {
        for start in starts(strip, QUAD) {
            from_quads(simd, &strips[start..], strip, &mut linear[start..]);
        }
    }
}

/// Converts the first pixels of all strips, as many as a vector has lanes.
#[inline(always)]
fn to_vectors<S: Simd>(simd: S, linear: &[f32], strip: usize, out: &mut [Lanes]) {
    let columns =
        V::transpose(each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15] lane => V::load_slice(simd, &linear[lane * strip..])));
    if let Some(out) = out.first_chunk_mut::<LANES>() {
        for i in 0..LANES {
            columns[i].store(&mut out[i]);
        }
    } else {
        for (column, out) in columns.iter().zip(out) {
            column.store(out);
        }
    }
}

/// The inverse of [`to_vectors`].
#[inline(always)]
fn from_vectors<S: Simd>(simd: S, strips: &[Lanes], strip: usize, linear: &mut [f32]) {
    let mut columns = [V::splat(simd, 0.0); LANES];
    if let Some(strips) = strips.first_chunk::<LANES>() {
        for i in 0..LANES {
            columns[i] = V::load(simd, &strips[i]);
        }
    } else {
        for (column, values) in columns.iter_mut().zip(strips) {
            *column = V::load(simd, values);
        }
    }
    let rows = V::transpose(columns);
    for lane in 0..LANES {
        rows[lane].store_slice(&mut linear[lane * strip..]);
    }
}

/// Converts the first [`QUAD`] pixels of all strips, four lanes at a time.
#[inline(always)]
fn to_quads<S: Simd>(simd: S, linear: &[f32], strip: usize, out: &mut [Lanes]) {
    for lane in (0..LANES).step_by(QUAD) {
        let columns = transpose_quad(each!([0, 1, 2, 3] i => f32x4::from_slice(simd, &linear[(lane + i) * strip..][..QUAD])));
        for (column, out) in columns.iter().zip(&mut *out) {
            column.store_slice(&mut out.0[lane..lane + QUAD]);
        }
    }
}

/// The inverse of [`to_quads`].
#[inline(always)]
fn from_quads<S: Simd>(simd: S, strips: &[Lanes], strip: usize, linear: &mut [f32]) {
    for lane in (0..LANES).step_by(QUAD) {
        let mut columns = [f32x4::splat(simd, 0.0); QUAD];
        for (column, values) in columns.iter_mut().zip(strips) {
            *column = f32x4::from_slice(simd, &values.0[lane..lane + QUAD]);
        }
        let rows = transpose_quad(columns);
        for i in 0..QUAD {
            rows[i].store_slice(&mut linear[(lane + i) * strip..][..QUAD]);
        }
    }
}

/// Transposes in registers of four numbers: where a vector takes several registers, a transposition
/// of whole vectors would run out of them.
#[inline(always)]
fn transpose_quad<S: Simd>(rows: [f32x4<S>; QUAD]) -> [f32x4<S>; QUAD] {
    let (ab_low, ab_high) = rows[0].interleave(rows[1]);
    let (cd_low, cd_high) = rows[2].interleave(rows[3]);
    // Each pair moves as one 64-bit number.
    let [ab_low, ab_high, cd_low, cd_high]: [f64x2<S>; 4] = [ab_low.bitcast(), ab_high.bitcast(), cd_low.bitcast(), cd_high.bitcast()];
    let ((first, second), (third, fourth)) = (ab_low.interleave(cd_low), ab_high.interleave(cd_high));
    [first.bitcast(), second.bitcast(), third.bitcast(), fourth.bitcast()]
}

/// Fills the vectors of [`RADIUS`] pixels on either side of a padded row: pixels of the
/// neighbouring strips, and zeros beyond the row.
#[inline(always)]
pub(super) fn pad<S: Simd>(simd: S, row: &mut [Lanes], strip: usize) {
    // Outwards, so that strips shorter than the radius read their neighbours' neighbours.
    for k in 0..RADIUS {
        let left = RADIUS - 1 - k;
        V::load(simd, &row[left + strip]).lanes_up().store(&mut row[left]);
        let right = RADIUS + strip + k;
        V::load(simd, &row[right - strip]).lanes_down().store(&mut row[right]);
    }
}
