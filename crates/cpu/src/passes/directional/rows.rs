//! Coefficients of sixteen splats as rows of lanes, and back.
//!
//! In: `[N, stride]` numbers, up to sixteen splats of them. Out: rows `[width, 16]`. Degenerate:
//! the lanes of splats beyond the last are left as they are, or are zero.

use fearless_simd::Simd;
use luxel_core::each;

use crate::lanes::{LANES, Lanes, V, outlined};

/// Rows of coefficients: those of one splat, rounded up to whole vectors.
pub(super) fn row_count(width: usize) -> usize {
    width.next_multiple_of(LANES)
}

/// Rows that are copied number by number: fewer are not worth a transposition.
pub(super) const FEW_ROWS: usize = 4;

/// Transposes up to sixteen splats of `stride` numbers each to the first `width` rows.
#[inline(always)]
pub(super) fn load_rows<S: Simd>(simd: S, numbers: &[f32], stride: usize, width: usize, rows: &mut [Lanes]) {
    outlined!(simd => {
        if width <= FEW_ROWS {
            for (lane, splat) in numbers.chunks_exact(stride).enumerate() {
                rows.iter_mut().zip(&splat[..width]).for_each(|(row, number)| row.0[lane] = *number);
            }
            return;
        }
        let is_whole = numbers.len() == LANES * stride;
        for (first, rows) in (0..width).step_by(LANES).zip(rows.chunks_mut(LANES)) {
            if is_whole && first + LANES <= width {
                let splats =
                    each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15] i => V::load_slice(simd, &numbers[i * stride + first..]));
                V::transpose(splats).into_iter().zip(rows).for_each(|(row, lanes)| row.store(lanes));
                continue;
            }
            let mut block = [Lanes::ZERO; LANES];
            for (splat, lanes) in numbers.chunks(stride).zip(&mut block) {
                let numbers = &splat[first..width.min(first + LANES)];
                lanes.0[..numbers.len()].copy_from_slice(numbers);
            }
            transpose(simd, &mut block);
            rows.copy_from_slice(&block);
        }
    });
}

/// Transposes the first `width` rows to up to sixteen splats of `stride` numbers each, whose other
/// numbers become 0.
#[inline(always)]
pub(super) fn store_rows<S: Simd>(simd: S, rows: &[Lanes], width: usize, stride: usize, numbers: &mut [f32]) {
    outlined!(simd => {
        if width < stride {
            numbers.chunks_exact_mut(stride).for_each(|splat| splat[width..].fill(0.0));
        }
        if width <= FEW_ROWS {
            for (lane, splat) in numbers.chunks_exact_mut(stride).enumerate() {
                splat[..width].iter_mut().zip(rows).for_each(|(number, row)| *number = row.0[lane]);
            }
            return;
        }
        let is_whole = numbers.len() == LANES * stride;
        for (first, rows) in (0..width).step_by(LANES).zip(rows.chunks(LANES)) {
            if is_whole && first + LANES <= width {
                let rows = each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15] i => V::load(simd, &rows[i]));
                V::transpose(rows).into_iter().enumerate().for_each(|(i, splat)| splat.store_slice(&mut numbers[i * stride + first..]));
                continue;
            }
            let mut block = [Lanes::ZERO; LANES];
            block.copy_from_slice(rows);
            transpose(simd, &mut block);
            for (splat, lanes) in numbers.chunks_mut(stride).zip(&block) {
                let numbers = &mut splat[first..width.min(first + LANES)];
                numbers.copy_from_slice(&lanes.0[..numbers.len()]);
            }
        }
    });
}

#[inline(always)]
fn transpose<S: Simd>(simd: S, block: &mut [Lanes; LANES]) {
    let rows = V::transpose(each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15] i => { let row = &block[i]; V::load(simd, row) }));
    for (row, lanes) in rows.into_iter().zip(block) {
        row.store(lanes);
    }
}
