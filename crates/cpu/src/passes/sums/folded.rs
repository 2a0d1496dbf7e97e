//! Sums over pixels, splat by splat, by halving vectors.
//!
//! In: staged splats of a block. Out: their sums, added to the entries' gradients.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x4, f32x8, f64x2};
use luxel_core::each;

use super::{ENTRY_LEN, EntryGradient, SUMS, Staged, SummedSplats};
use crate::lanes::{LANES, Lanes, V};

/// The two halves of a vector. Sums over lanes begin by adding them, so later products take half a
/// vector.
#[derive(Clone, Copy)]
pub(super) struct Halves<S: Simd>(pub(super) [f32x8<S>; 2]);

impl<S: Simd> Halves<S> {
    #[inline(always)]
    pub(super) fn new(v: V<S>) -> Self {
        let (low, high) = v.0.split();
        Self([low, high])
    }

    #[inline(always)]
    pub(super) fn times(self, other: Self) -> Self {
        Self([self.0[0] * other.0[0], self.0[1] * other.0[1]])
    }

    #[inline(always)]
    pub(super) fn sum(self) -> f32x8<S> {
        self.0[0] + self.0[1]
    }

    /// Returns the product, with the two halves added.
    #[inline(always)]
    pub(super) fn dot(self, other: Self) -> f32x8<S> {
        self.0[1].mul_add(other.0[1], self.0[0] * other.0[0])
    }
}

/// Adds the sums of each splat to its entry's gradient.
#[inline(always)]
pub(super) fn add_folded<S: Simd, const ABSOLUTE: bool>(
    simd: S,
    &SummedSplats { entries, picks, colors, .. }: &SummedSplats<'_>,
    Staged { u, v, share, weight, .. }: &Staged,
    out: &mut [EntryGradient],
) {
    let load = |lanes: &Lanes| Halves::new(V::load(simd, lanes));
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

/// Adds the sums of g u and g v to the place of absolute sums.
#[inline(always)]
pub(super) fn add_first_folded<S: Simd>(
    simd: S,
    &SummedSplats { entries, picks, .. }: &SummedSplats<'_>,
    Staged { u, v, .. }: &Staged,
    shares: &[Lanes; LANES],
    out: &mut [EntryGradient],
) {
    let load = |lanes: &Lanes| Halves::new(V::load(simd, lanes));
    let zero = f32x8::splat(simd, 0.0);
    for (((index, u), v), share) in picks.iter().zip(u).zip(v).zip(shares) {
        let (u, v, g) = (load(u), load(v), load(share));
        let mut sums = [zero; SUMS];
        [sums[SUMS - 2], sums[SUMS - 1]] = [g.times(u).sum(), g.times(v).sum()];
        add_halves(simd, sums, &mut out[entries[*index as usize].place as usize]);
    }
}

/// Sums each of the half vectors over its lanes and adds the sums to an entry's.
#[inline(always)]
pub(super) fn add_halves<S: Simd>(simd: S, sums: [f32x8<S>; SUMS], out: &mut EntryGradient) {
    let quarter = |half: f32x8<S>| -> f32x4<S> {
        let (low, high) = half.split();
        low + high
    };
    let zero = f32x4::splat(simd, 0.0);
    // A 4x4 transposition with additions in between: ((0+2) + (1+3)) of each vector.
    let four = |a: f32x4<S>, b: f32x4<S>, c: f32x4<S>, d: f32x4<S>| -> f32x4<S> {
        let ab = a.zip_low(b) + a.zip_high(b);
        let cd = c.zip_low(d) + c.zip_high(d);
        // ab = [a02, b02, a13, b13]: each pair moves as one 64-bit number.
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
