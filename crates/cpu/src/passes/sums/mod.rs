//! Sums over a block's pixels of what `rasterize_backward` found for some splats, added to the gradients of their entries.
//!
//! Two ways to the same sums, which way depending on the registers. [`fold`] adds up a splat's sixteen numbers by halves: eleven sums that end in
//! vectors of four are sixty operations on short registers for each splat. [`turn`] turns sixteen splats by sixteen pixels around, so that each number of a
//! vector is another splat's and nothing is added across; turning takes 32 exchanges of two registers where a register holds sixteen numbers, and
//! four times as many where it holds eight.

mod fold;
mod turn;

use bytemuck::{Pod, Zeroable};
use fearless_simd::Simd;

use fold::fold;
use turn::turn;

use super::rasterize::Seen;
use super::sort::Entry;
use crate::lanes::{LANES, Lanes, is_one_register};

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

#[cfg(test)]
mod tests {
    use fearless_simd::Level;

    use super::*;
    use crate::lanes::with_simd;
    use crate::passes::rasterize::pixel_centers;

    #[test]
    fn both_ways_agree() {
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
                for (folded, turned) in folded.iter().zip(&turned) {
                    let [folded, turned]: [[f32; ENTRY_LEN]; 2] = [folded, turned].map(|gradient| bytemuck::cast(*gradient));
                    let scale = folded.iter().fold(1.0, |largest: f32, number| largest.max(number.abs()));
                    for (folded, turned) in folded.iter().zip(turned) {
                        assert!((folded - turned).abs() <= 4e-6 * scale, "block {block}, {count} splats: {folded} and {turned} of {scale}");
                    }
                }
            }
        }
    }
}
