//! Sums over pixels of sixteen splats at once, by transposing splats and pixels.
//!
//! In: staged splats of a block. Out: their sums, added to the entries' gradients.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x4, f32x8};
use luxel_core::{Real, each};

use super::{ENTRY_LEN, EntryGradient, Staged, SummedSplats};
use crate::lanes::{LANES, Lanes, V};
use crate::passes::rasterize::first_pixel_center;
use crate::view::BLOCK_PX;

/// Adds the sums of the splats to their entries' gradients.
#[inline(always)]
pub(super) fn add_transposed<S: Simd, const ABSOLUTE: bool>(
    simd: S,
    &SummedSplats { entries, picks, block, colors }: &SummedSplats<'_>,
    Staged { fields, share, weight, .. }: &Staged,
    out: &mut [EntryGradient],
) {
    let placement = BlockPlacement::new(simd, fields, block);
    let pixels = splats_by_pixels(simd, share);
    let [g, gu, gv, guu, guv, gvv] = placement.moments(&pixels);
    let [absolute_x, absolute_y] = if ABSOLUTE { placement.absolute(&pixels) } else { [V::splat(simd, 0.0); 2] };
    let weight = splats_by_pixels(simd, weight);
    let [red, green, blue] = each!([0, 1, 2] i => sum_of_products(&weight, &colors[i]));
    // Back to one splat after the other: each round moves a bit of the splat's number from the lane
    // to the row. The result is eight fields of two splats in a row, and four fields of four
    // splats.
    let mut eight = [g, gu, gv, guu, guv, gvv, red, green];
    for _ in 0..3 {
        eight = V::interleaved(eight);
    }
    let four = V::interleaved(V::interleaved([blue, absolute_x, absolute_y, V::splat(simd, 0.0)]));
    let (mut first, mut others) = ([Lanes::ZERO; 8], [Lanes::ZERO; 4]);
    each!([0, 1, 2, 3, 4, 5, 6, 7] n => eight[n].store(&mut first[n]));
    each!([0, 1, 2, 3] n => four[n].store(&mut others[n]));
    let (first, others): (&[[f32; 8]; LANES], &[[f32; 4]; LANES]) = (bytemuck::cast_ref(&first), bytemuck::cast_ref(&others));
    for ((index, first), others) in picks.iter().zip(first).zip(others) {
        let numbers: &mut [f32; ENTRY_LEN] = bytemuck::cast_mut(&mut out[entries[*index as usize].place as usize]);
        let (eight, four) = numbers.split_at_mut(8);
        (f32x8::from_slice(simd, eight) + f32x8::load_array_ref(simd, first)).store_slice(eight);
        (f32x4::from_slice(simd, four) + f32x4::load_array_ref(simd, others)).store_slice(four);
    }
}

/// Adds the sums of g u and g v to the place of absolute sums.
#[inline(always)]
pub(super) fn add_first_transposed<S: Simd>(
    simd: S,
    &SummedSplats { entries, picks, block, .. }: &SummedSplats<'_>,
    Staged { fields, .. }: &Staged,
    shares: &[Lanes; LANES],
    out: &mut [EntryGradient],
) {
    let [_, gu, gv, ..] = BlockPlacement::new(simd, fields, block).moments(&splats_by_pixels(simd, shares));
    for ((index, gu), gv) in picks.iter().zip(gu.lanes()).zip(gv.lanes()) {
        let sums = &mut out[entries[*index as usize].place as usize].absolute;
        sums[0] += gu;
        sums[1] += gv;
    }
}

/// Adds the sums over pixels of the splats' weights times each of some numbers of the pixels, to
/// `[places, numbers]` with rows rounded up to whole fours.
#[inline(always)]
pub(crate) fn add_weighted<S: Simd>(
    simd: S,
    &SummedSplats { entries, picks, .. }: &SummedSplats<'_>,
    weight: &[Lanes; LANES],
    numbers: &[Lanes],
    out: &mut [f32],
) {
    let weight = splats_by_pixels(simd, weight);
    let stride = numbers.len().next_multiple_of(4);
    for (n, numbers) in numbers.chunks(4).enumerate() {
        let mut sums = [V::splat(simd, 0.0); 4];
        for (sum, number) in sums.iter_mut().zip(numbers) {
            *sum = sum_of_products(&weight, number);
        }
        // As in `add_transposed`: four fields of four splats in a row.
        let four = V::interleaved(V::interleaved(sums));
        let mut rows = [Lanes::ZERO; 4];
        each!([0, 1, 2, 3] n => four[n].store(&mut rows[n]));
        let rows: &[[f32; 4]; LANES] = bytemuck::cast_ref(&rows);
        for (index, row) in picks.iter().zip(rows) {
            let sum = &mut out[entries[*index as usize].place as usize * stride + 4 * n..][..4];
            (f32x4::from_slice(simd, sum) + f32x4::load_array_ref(simd, row)).store_slice(sum);
        }
    }
}

/// Transposes rows of splats: returns for each pixel the numbers of sixteen splats. Those beyond
/// the last splat are arbitrary.
#[inline(always)]
fn splats_by_pixels<S: Simd>(simd: S, rows: &[Lanes; LANES]) -> [V<S>; LANES] {
    V::transpose(each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15] i => { let row = &rows[i]; V::load(simd, row) }))
}

/// The placement of a block relative to sixteen splats: a pixel X and Y half pixels from its centre
/// lies at (u + along_x[0] X + along_y[0] Y, v + along_y[1] Y).
struct BlockPlacement<S: Simd> {
    u: V<S>,
    v: V<S>,
    along_x: V<S>,
    along_y: [V<S>; 2],
    root: [V<S>; 3],
}

impl<S: Simd> BlockPlacement<S> {
    #[inline(always)]
    fn new(simd: S, fields: &[Lanes; LANES / 2], block: usize) -> Self {
        let mut fields = each!([0, 1, 2, 3, 4, 5, 6, 7] n => { let row = &fields[n]; V::load(simd, row) });
        // A row holds two entries: four rounds move the bits of the field's number from the lane to
        // the row.
        for _ in 0..4 {
            fields = V::interleaved(fields);
        }
        let [mean_x, mean_y, root_0, root_1, root_2, ..] = fields;
        let half_block = 0.5 * (BLOCK_PX - 1) as f32;
        let [x, y] = each!([0, 1] axis => first_pixel_center(block)[axis] + half_block);
        let (dx, dy) = (V::splat(simd, x) - mean_x, V::splat(simd, y) - mean_y);
        Self {
            u: root_0.mul_add(dx, dy * root_1),
            v: dy * root_2,
            along_x: root_0 * 0.5,
            along_y: [root_1 * 0.5, root_2 * 0.5],
            root: [root_0, root_1, root_2],
        }
    }

    /// Returns the sums over the pixels of g, g u, g v, g u^2, g u v, g v^2, from sums over X and
    /// Y. The distance of the block from the splat enters once, so numbers of nearly equal size are
    /// never subtracted.
    #[inline(always)]
    fn moments(&self, g: &[V<S>; LANES]) -> [V<S>; 6] {
        let rows = each!([0, 1, 2, 3] row => { let g = &g; along(each!([0, 1, 2, 3] column => g[BLOCK_PX * row + column])) });
        let [sum, y, yy] = along(each!([0, 1, 2, 3] row => rows[row][0]));
        let [x, xy, _] = along(each!([0, 1, 2, 3] row => rows[row][1]));
        let [xx, ..] = along(each!([0, 1, 2, 3] row => rows[row][2]));
        // Sums with the offsets du and dv of a pixel's u and v from the block's.
        let du = self.along_x.mul_add(x, self.along_y[0] * y);
        let dv = self.along_y[1] * y;
        let x_du = self.along_x.mul_add(xx, self.along_y[0] * xy);
        let y_du = self.along_x.mul_add(xy, self.along_y[0] * yy);
        let du_du = self.along_x.mul_add(x_du, self.along_y[0] * y_du);
        let du_dv = self.along_y[1] * y_du;
        let dv_dv = self.along_y[1] * (self.along_y[1] * yy);
        let (gu, gv) = (self.u.mul_add(sum, du), self.v.mul_add(sum, dv));
        let guu = self.u.mul_add(gu + du, du_du);
        let guv = self.u.mul_add(gv, self.v.mul_add(du, du_dv));
        let gvv = self.v.mul_add(gv + dv, dv_dv);
        [sum, gu, gv, guu, guv, gvv]
    }

    /// Returns AbsGS's sums.
    #[inline(always)]
    fn absolute(&self, g: &[V<S>; LANES]) -> [V<S>; 2] {
        let mut sums = [g[0].lift(0.0); 2];
        for row in 0..BLOCK_PX {
            let half_pixels = |n: usize| (2 * n) as f32 - (BLOCK_PX - 1) as f32;
            let v = self.along_y[1].mul_add(g[0].lift(half_pixels(row)), self.v);
            let first = self.along_y[0].mul_add(g[0].lift(half_pixels(row)), self.u);
            for column in 0..BLOCK_PX {
                let u = self.along_x.mul_add(g[0].lift(half_pixels(column)), first);
                let g = g[BLOCK_PX * row + column].abs();
                let along = (u * self.root[1] + v * self.root[2]).abs();
                sums = [g.mul_add(u.abs(), sums[0]), g.mul_add(along, sums[1])];
            }
        }
        sums
    }
}

/// Returns the sums of four numbers in a line, of the numbers times X, and of the numbers times
/// X^2, where X is -3, -1, 1, 3.
#[inline(always)]
fn along<S: Simd>(line: [V<S>; BLOCK_PX]) -> [V<S>; 3] {
    let [first, second, third, fourth] = line;
    let (outer, inner) = (first + fourth, second + third);
    [outer + inner, (fourth - first).mul_add(first.lift(3.0), third - second), outer.mul_add(first.lift(9.0), inner)]
}

/// Returns the sums over the pixels of the splats' weights times a number of each pixel.
#[inline(always)]
fn sum_of_products<S: Simd>(weight: &[V<S>; LANES], color: &Lanes) -> V<S> {
    let columns = each!([0, 1, 2, 3] column => {
        let term = |row: usize| (weight[BLOCK_PX * row + column], color.0[BLOCK_PX * row + column]);
        let (first, of_first) = term(0);
        let mut sum = first * of_first;
        for row in 1..BLOCK_PX {
            let (weight, color) = term(row);
            sum = weight.mul_add(weight.lift(color), sum);
        }
        sum
    });
    (columns[0] + columns[2]) + (columns[1] + columns[3])
}
