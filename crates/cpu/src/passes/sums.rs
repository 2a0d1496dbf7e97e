//! Sums over a block's pixels of what `rasterize_backward` found for some splats, added to the gradients of their entries.
//!
//! Two ways to the same bits, which way depending on the registers. [`fold`] adds up a splat's sixteen numbers by halves: eleven sums that end in
//! vectors of four are sixty operations on short registers for each splat. [`turn`] turns sixteen splats by sixteen pixels around, so that each number of a
//! vector is another splat's and nothing is added across; turning takes 32 exchanges of two registers where a register holds sixteen numbers, and
//! four times as many where it holds eight.

use bytemuck::{Pod, Zeroable};
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x4, f32x8, f64x2};
use luxel_core::{Real, each};

use super::rasterize::{Seen, first_pixel_center};
use super::sort::Entry;
use crate::lanes::{LANES, Lanes, V, is_one_register};
use crate::view::BLOCK_PX;

/// Sums over the pixels of a tile of one splat; g is the gradient by ln(alpha), (u, v) the whitened offset of the pixel from the centre.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C, align(16))]
pub(crate) struct EntryGradient {
    /// g.
    pub(crate) log_alpha: f32,
    /// g u, g v.
    pub(crate) first: [f32; 2],
    /// g u^2, g u v, g v^2.
    pub(crate) second: [f32; 3],
    /// By the radiance.
    pub(crate) radiance: [f32; 3],
    /// |g u|, |g (root[1] u + root[2] v)|: AbsGS.
    pub(crate) absolute: [f32; 2],
    padding: f32,
}

/// Numbers in an [`EntryGradient`], and in an [`Entry`].
pub(crate) const ENTRY_LEN: usize = 12;
/// Of these, the ones in use.
const SUMS: usize = 11;

/// What is known of up to sixteen splats at a block's pixels.
pub(crate) struct Staged {
    /// For [`fold`]: offsets from the centre, whitened.
    u: [Lanes; LANES],
    v: [Lanes; LANES],
    /// For [`turn`]: the first eight fields of each entry, from which offsets follow.
    fields: [Lanes; LANES / 2],
    /// log2(alpha), then alpha / (1 - alpha), at last g.
    pub(crate) share: [Lanes; LANES],
    /// alpha times transmittance.
    pub(crate) weight: [Lanes; LANES],
}

impl Staged {
    pub(crate) const ZERO: Self = Self {
        u: [Lanes::ZERO; LANES],
        v: [Lanes::ZERO; LANES],
        fields: [Lanes::ZERO; LANES / 2],
        share: [Lanes::ZERO; LANES],
        weight: [Lanes::ZERO; LANES],
    };

    /// Keeps of pick number `i` what its sums need of the entry.
    #[inline(always)]
    pub(crate) fn see<S: Simd>(&mut self, i: usize, entry: &Entry, seen: &Seen<S>) {
        if is_one_register::<S>() {
            self.keep_fields(i, entry);
        } else {
            self.keep_offsets(i, seen);
        }
    }

    #[inline(always)]
    fn keep_fields(&mut self, i: usize, entry: &Entry) {
        let (kept, fields): (&mut [[f32; 8]; LANES], &[f32; ENTRY_LEN]) = (bytemuck::cast_mut(&mut self.fields), bytemuck::cast_ref(entry));
        kept[i].copy_from_slice(&fields[..8]);
    }

    #[inline(always)]
    fn keep_offsets<S: Simd>(&mut self, i: usize, seen: &Seen<S>) {
        seen.u.store(&mut self.u[i]);
        seen.v.store(&mut self.v[i]);
    }
}

/// Adds the sums of `picks` among a tile's entries to their gradients. `colors` is the gradient by the radiance of the block's pixels.
#[inline(always)]
pub(crate) fn add_sums<S: Simd, const ABSOLUTE: bool>(
    simd: S,
    (entries, picks): (&[Entry], &[u32]),
    (block, staged, colors): (usize, &Staged, &[Lanes; 3]),
    out: &mut [EntryGradient],
) {
    if is_one_register::<S>() {
        turn::<_, ABSOLUTE>(simd, (entries, picks), (block, staged, colors), out);
    } else {
        fold::<_, ABSOLUTE>(simd, (entries, picks), (staged, colors), out);
    }
}

/// A vector's halves, which sums over its lanes begin with: products go on as half a vector.
#[derive(Clone, Copy)]
struct Halves<S: Simd>([f32x8<S>; 2]);

impl<S: Simd> Halves<S> {
    #[inline(always)]
    fn of(v: V<S>) -> Self {
        let (low, high) = v.0.split();
        Self([low, high])
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        Self([self.0[0] * other.0[0], self.0[1] * other.0[1]])
    }

    #[inline(always)]
    fn sum(self) -> f32x8<S> {
        self.0[0] + self.0[1]
    }

    /// Half of the way to the sum of the products.
    #[inline(always)]
    fn dot(self, other: Self) -> f32x8<S> {
        self.0[1].mul_add(other.0[1], self.0[0] * other.0[0])
    }
}

/// Adds each splat's numbers up by halves.
#[inline(always)]
fn fold<S: Simd, const ABSOLUTE: bool>(
    simd: S,
    (entries, picks): (&[Entry], &[u32]),
    (Staged { u, v, share, weight, .. }, colors): (&Staged, &[Lanes; 3]),
    out: &mut [EntryGradient],
) {
    let load = |lanes: &Lanes| Halves::of(V::load(simd, lanes));
    let colors = each!([0, 1, 2] i => { let color = &colors[i]; load(color) });
    for ((((index, u), v), share), weight) in picks.iter().zip(u).zip(v).zip(share).zip(weight) {
        let entry = &entries[*index as usize];
        let (u, v, g, weight) = (load(u), load(v), load(share), load(weight));
        let (gu, gv) = (g.times(u), g.times(v));
        let [red, green, blue] = each!([0, 1, 2] i => weight.dot(colors[i]));
        let [absolute_x, absolute_y] = match ABSOLUTE {
            true => {
                let along = each!([0, 1] half => (gu.0[half] * entry.root[1] + gv.0[half] * entry.root[2]).abs());
                [gu.0[0].abs() + gu.0[1].abs(), along[0] + along[1]]
            }
            false => [f32x8::splat(simd, 0.0); 2],
        };
        let sums = [g.sum(), gu.sum(), gv.sum(), gu.dot(u), gu.dot(v), gv.dot(v), red, green, blue, absolute_x, absolute_y];
        add_halves(simd, sums, &mut out[entry.place as usize]);
    }
}

/// Sums each of the half vectors over its lanes and adds the sums to an entry's.
#[inline(always)]
fn add_halves<S: Simd>(simd: S, sums: [f32x8<S>; SUMS], out: &mut EntryGradient) {
    let quarter = |half: f32x8<S>| -> f32x4<S> {
        let (low, high) = half.split();
        low + high
    };
    let zero = f32x4::splat(simd, 0.0);
    // A 4x4 transposition with the sums in between: ((0+2) + (1+3)) of each vector.
    let four = |a: f32x4<S>, b: f32x4<S>, c: f32x4<S>, d: f32x4<S>| -> f32x4<S> {
        let ab = a.zip_low(b) + a.zip_high(b);
        let cd = c.zip_low(d) + c.zip_high(d);
        // ab = [a02, b02, a13, b13]: pairs move as one 64-bit number.
        let (ab, cd): (f64x2<S>, f64x2<S>) = (ab.bitcast(), cd.bitcast());
        let (low, high): (f32x4<S>, f32x4<S>) = (ab.zip_low(cd).bitcast(), ab.zip_high(cd).bitcast());
        low + high
    };
    let q = each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10] i => quarter(sums[i]));
    let numbers: &mut [f32; ENTRY_LEN] = bytemuck::cast_mut(out);
    let mut add = |at: usize, values: f32x4<S>| {
        let numbers = &mut numbers[at..at + 4];
        (f32x4::from_slice(simd, numbers) + values).store_slice(numbers);
    };
    add(0, four(q[0], q[1], q[2], q[3]));
    add(4, four(q[4], q[5], q[6], q[7]));
    add(8, four(q[8], q[9], q[10], zero));
}

/// Turns splats by pixels around and adds up vectors of splats.
#[inline(always)]
fn turn<S: Simd, const ABSOLUTE: bool>(
    simd: S,
    (entries, picks): (&[Entry], &[u32]),
    (block, Staged { fields, share, weight, .. }, colors): (usize, &Staged, &[Lanes; 3]),
    out: &mut [EntryGradient],
) {
    let [g, gu, gv, guu, guv, gvv, absolute_x, absolute_y] = Offsets::new(simd, fields, block).sums::<ABSOLUTE>(&turned(simd, share));
    let weight = turned(simd, weight);
    let [red, green, blue] = each!([0, 1, 2] i => sum_of_products(&weight, &colors[i]));
    // Back to splats, the bits of their numbers taken from the lane to the row: eight fields of two splats in a row, and four fields of four.
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

/// Sixteen splats by a block's pixels: of each pixel, the splats' numbers. Where there are fewer splats, numbers beyond the last mean nothing.
#[inline(always)]
fn turned<S: Simd>(simd: S, rows: &[Lanes; LANES]) -> [V<S>; LANES] {
    V::transpose(each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15] i => { let row = &rows[i]; V::load(simd, row) }))
}

/// Where a block's pixels are as seen from sixteen splats.
struct Offsets<S: Simd> {
    root: [V<S>; 3],
    /// Of each column, from the centre, pixels.
    dx: [V<S>; BLOCK_PX],
    /// Of each row, what it adds to u.
    shear: [V<S>; BLOCK_PX],
    /// Of each row.
    v: [V<S>; BLOCK_PX],
}

impl<S: Simd> Offsets<S> {
    /// With the roundings of [`super::rasterize::Seen::new`].
    #[inline(always)]
    fn new(simd: S, fields: &[Lanes; LANES / 2], block: usize) -> Self {
        let mut fields = each!([0, 1, 2, 3, 4, 5, 6, 7] n => { let row = &fields[n]; V::load(simd, row) });
        // Two entries a row: four rounds take the bits of the field's number from the lane to the row.
        for _ in 0..4 {
            fields = V::interleaved(fields);
        }
        let [mean_x, mean_y, root_0, root_1, root_2, ..] = fields;
        let [x, y] = each!([0, 1] axis => first_pixel_center(block)[axis]);
        let dy = each!([0, 1, 2, 3] row => V::splat(simd, y + row as f32) - mean_y);
        Self {
            root: [root_0, root_1, root_2],
            dx: each!([0, 1, 2, 3] column => V::splat(simd, x + column as f32) - mean_x),
            shear: each!([0, 1, 2, 3] row => { let dy = dy[row]; dy * root_1 }),
            v: each!([0, 1, 2, 3] row => { let dy = dy[row]; dy * root_2 }),
        }
    }

    /// Sums over the pixels in the order of [`fold`]: pixels eight apart, then four, two, one.
    #[inline(always)]
    fn sums<const ABSOLUTE: bool>(&self, g: &[V<S>; LANES]) -> [V<S>; 8] {
        let even = plus(self.column::<ABSOLUTE>(g, 0), self.column::<ABSOLUTE>(g, 2));
        let odd = plus(self.column::<ABSOLUTE>(g, 1), self.column::<ABSOLUTE>(g, 3));
        plus(even, odd)
    }

    #[inline(always)]
    fn column<const ABSOLUTE: bool>(&self, g: &[V<S>; LANES], column: usize) -> [V<S>; 8] {
        plus(self.pair::<ABSOLUTE>(g, column, 0), self.pair::<ABSOLUTE>(g, column, 1))
    }

    /// Sums over the pixels of a column in rows `row` and `row` + 2: g, g u, g v, g u^2, g u v, g v^2, and AbsGS's.
    #[inline(always)]
    fn pair<const ABSOLUTE: bool>(&self, g: &[V<S>; LANES], column: usize, row: usize) -> [V<S>; 8] {
        let g = each!([0, 1] i => g[BLOCK_PX * (row + 2 * i) + column]);
        let u = each!([0, 1] i => self.root[0].mul_add(self.dx[column], self.shear[row + 2 * i]));
        let v = each!([0, 1] i => self.v[row + 2 * i]);
        let (gu, gv) = (each!([0, 1] i => { let g = g[i]; g * u[i] }), each!([0, 1] i => { let g = g[i]; g * v[i] }));
        let [absolute_x, absolute_y] = match ABSOLUTE {
            true => {
                let along = each!([0, 1] i => { let (gu, gv) = (gu[i], gv[i]); (gu * self.root[1] + gv * self.root[2]).abs() });
                [gu[0].abs() + gu[1].abs(), along[0] + along[1]]
            }
            false => [g[0].lift(0.0); 2],
        };
        [
            g[0] + g[1],
            gu[0] + gu[1],
            gv[0] + gv[1],
            gu[1].mul_add(u[1], gu[0] * u[0]),
            gu[1].mul_add(v[1], gu[0] * v[0]),
            gv[1].mul_add(v[1], gv[0] * v[0]),
            absolute_x,
            absolute_y,
        ]
    }
}

#[inline(always)]
fn plus<S: Simd>(a: [V<S>; 8], b: [V<S>; 8]) -> [V<S>; 8] {
    each!([0, 1, 2, 3, 4, 5, 6, 7] i => { let a = a[i]; a + b[i] })
}

/// Sums over the pixels of the splats' weights times a number of each pixel, in the order of [`fold`].
#[inline(always)]
fn sum_of_products<S: Simd>(weight: &[V<S>; LANES], color: &Lanes) -> V<S> {
    let columns = each!([0, 1, 2, 3] column => {
        let pairs = each!([0, 1] row => {
            let (near, far) = (BLOCK_PX * row + column, BLOCK_PX * (row + 2) + column);
            weight[far].mul_add(weight[far].lift(color.0[far]), weight[near] * color.0[near])
        });
        pairs[0] + pairs[1]
    });
    (columns[0] + columns[2]) + (columns[1] + columns[3])
}

#[cfg(test)]
mod tests {
    use fearless_simd::Level;

    use super::*;
    use crate::lanes::with_simd;
    use crate::passes::rasterize::pixel_centers;

    #[test]
    fn both_ways_add_the_same_bits() {
        let mut state = 1u32;
        let mut noise = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        for (block, count) in [(0, 1), (13, 5), (63, 16)] {
            let mut entries = [Entry::default(); 40];
            for (place, entry) in entries.iter_mut().enumerate() {
                entry.mean_px = [16.0 + 20.0 * noise(), 16.0 + 20.0 * noise()];
                entry.root = [1.0 + noise(), noise(), 1.0 + noise()];
                entry.place = (7 * place % 40) as u32;
            }
            let picks: Vec<u32> = (0..count).map(|i| 39 - 2 * i).collect();
            let mut staged = Staged::ZERO;
            let mut lanes = || Lanes(std::array::from_fn(|_| noise()));
            let colors = [lanes(), lanes(), lanes()];
            for rows in [&mut staged.share, &mut staged.weight] {
                rows.fill_with(&mut lanes);
            }
            let before: Vec<EntryGradient> =
                (0..40).map(|_| bytemuck::cast::<[f32; ENTRY_LEN], _>(std::array::from_fn(|_| noise()))).collect();
            for level in [Level::new(), Level::baseline()] {
                let (mut folded, mut turned) = (before.clone(), before.clone());
                with_simd!(level, simd => {
                    for (i, index) in picks.iter().enumerate() {
                        let entry = &entries[*index as usize];
                        staged.keep_fields(i, entry);
                        staged.keep_offsets(i, &Seen::new(simd, entry, pixel_centers(simd, block)));
                    }
                    fold::<_, true>(simd, (&entries, &picks), (&staged, &colors), &mut folded);
                    turn::<_, true>(simd, (&entries, &picks), (block, &staged, &colors), &mut turned);
                });
                assert_ne!(folded, before);
                assert_eq!(folded, turned, "block {block}, {count} splats");
            }
        }
    }
}
