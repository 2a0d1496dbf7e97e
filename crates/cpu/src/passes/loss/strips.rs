//! Rows in strips, and how they come from the tiles' blocks and return to blocks.
//!
//! A row of W pixels is cut into as many strips as a vector has lanes, of S = W / 16 pixels (rounded up): lane l of vector i is pixel
//! l S + i, `[S]` vectors a row, zero beyond the image. Vectors one apart are pixels one apart in every lane, so a window along the row reads
//! whole, aligned vectors just as a window down the columns does. Only at the strips' ends is a pixel's neighbour in the next lane:
//! [`pad`] puts those vectors on either side of the row.

use fearless_simd::Simd;

use crate::lanes::{LANES, Lanes, V};
use crate::passes::loss::convolution::RADIUS;
use crate::passes::rasterize::TilePixels;
use crate::passes::rasterize_backward::BlockGradient;
use crate::view::{BLOCK_PX, TILE_BLOCKS};

/// Pixels of a strip.
pub(super) fn strip_px(width_px: usize) -> usize {
    width_px.div_ceil(LANES)
}

/// Numbers that a linear row of strips of length `strip` has to hold: transposition reads a whole vector from the last strip's last pixel.
pub(super) fn linear_len(strip: usize) -> usize {
    (strip + 1) * LANES
}

/// Radiance of a row of blocks: row number `block_row` of each of a row of tiles. Out: linear rows of length `stride`, `[3, BLOCK_PX, stride]`.
///
/// Blocks are read, and written by [`write_blocks`], all channels at a time: in the order of memory, which the hardware fetches ahead.
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

/// Writes a row of blocks: the counterpart of [`read_blocks`]. Row `row` of channel `channel` is number `row + channel * channel_stride`.
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

/// First vectors of the transpositions that cover a strip: the last begins early rather than reach into the next strip, where there are
/// enough vectors for that.
fn blocks(strip: usize) -> impl Iterator<Item = usize> {
    (0..strip.div_ceil(LANES)).map(move |block| (block * LANES).min(strip.saturating_sub(LANES)))
}

/// Linear row (of [`linear_len`]) to strips.
#[inline(always)]
pub(super) fn to_strips<S: Simd>(simd: S, linear: &[f32], strip: usize, out: &mut [Lanes]) {
    for start in blocks(strip) {
        let mut rows = [V::splat(simd, 0.0); LANES];
        for (lane, row) in rows.iter_mut().enumerate() {
            *row = V::load_slice(simd, &linear[lane * strip + start..]);
        }
        let columns = V::transpose(rows);
        let out = &mut out[start..strip];
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
}

/// Strips to linear row (of [`linear_len`]).
#[inline(always)]
pub(super) fn from_strips<S: Simd>(simd: S, strips: &[Lanes], strip: usize, linear: &mut [f32]) {
    for start in blocks(strip) {
        let mut columns = [V::splat(simd, 0.0); LANES];
        let strips = &strips[start..strip];
        if let Some(strips) = strips.first_chunk::<LANES>() {
            for i in 0..LANES {
                columns[i] = V::load(simd, &strips[i]);
            }
        } else {
            for (column, values) in columns.iter_mut().zip(strips) {
                *column = V::load(simd, values);
            }
        }
        // In strips shorter than a vector, what a row writes beyond its strip is overwritten by the next.
        let rows = V::transpose(columns);
        for lane in 0..LANES {
            rows[lane].store_slice(&mut linear[lane * strip + start..]);
        }
    }
}

/// Fills the [`RADIUS`] pixels' vectors on either side of a padded row, or of `width` rows whose vectors stand together: the neighbouring
/// strips' pixels, zeros beyond the row.
#[inline(always)]
pub(super) fn pad<S: Simd>(simd: S, row: &mut [Lanes], strip: usize, width: usize) {
    // Outwards, so that strips shorter than the radius find their neighbours' neighbours.
    for k in 0..RADIUS * width {
        let left = (RADIUS - 1 - k / width) * width + k % width;
        V::load(simd, &row[left + strip * width]).lanes_up().store(&mut row[left]);
        let right = (RADIUS + strip) * width + k;
        V::load(simd, &row[right - strip * width]).lanes_down().store(&mut row[right]);
    }
}
