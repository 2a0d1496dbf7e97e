//! Sums over rays, splat by splat, by halving vectors.
//!
//! In: staged splats of a block. Out: their sums, added to the entries' gradients. The first
//! moments are weighted by the cosine between ray and splat: an offset across the ray of the
//! centre changes by as much when the centre moves.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8};
use luxel_core::each;

use super::folded::{Halves, add_halves};
use super::{EntryGradient, Staged, SummedSplats};
use crate::lanes::{Lanes, V};

/// Adds the sums of each splat to its entry's gradient.
#[inline(always)]
pub(super) fn add_sums_of_rays<S: Simd, const ABSOLUTE: bool>(
    simd: S,
    &SummedSplats { entries, picks, colors, .. }: &SummedSplats<'_>,
    Staged { u, v, facing, share, weight, .. }: &Staged,
    out: &mut [EntryGradient],
) {
    let load = |lanes: &Lanes| Halves::new(V::load(simd, lanes));
    let colors = each!([0, 1, 2] i => { let color = &colors[i]; load(color) });
    for (i, index) in picks.iter().enumerate() {
        let entry = &entries[*index as usize];
        let (u, v, facing) = (load(&u[i]), load(&v[i]), load(&facing[i]));
        let (g, weight) = (load(&share[i]), load(&weight[i]));
        let (gu, gv) = (g.times(u), g.times(v));
        let (du, dv) = (gu.times(facing), gv.times(facing));
        let [red, green, blue] = each!([0, 1, 2] c => weight.dot(colors[c]));
        let [absolute_u, absolute_v] = match ABSOLUTE {
            true => {
                let root = entry.root_of_rows();
                let along = each!([0, 1] half => (gu.0[half] * root[0] + gv.0[half] * root[1]).abs());
                [gu.0[0].abs() + gu.0[1].abs(), along[0] + along[1]]
            }
            false => [f32x8::splat(simd, 0.0); 2],
        };
        let sums = [g.sum(), du.sum(), dv.sum(), gu.dot(u), gu.dot(v), gv.dot(v), red, green, blue, absolute_u, absolute_v];
        add_halves(simd, sums, &mut out[entry.place as usize]);
    }
}
