//! Sums over a block's pixels of the gradients that `rasterize_backward` computes for some splats,
//! added to the gradients of their entries.
//!
//! In: up to sixteen [`Staged`] splats of a block. Out: [`EntryGradient`]s.
//!
//! There are two implementations, chosen by the size of the registers. [`folded`] adds up the
//! sixteen numbers of one splat by halving vectors, which takes many operations on short registers
//! for each splat. [`transposed`] first transposes sixteen splats by sixteen pixels, so that each
//! lane is a different splat and nothing is added across lanes; the transposition takes 32
//! exchanges of two registers where a register holds sixteen numbers, and four times as many where
//! it holds eight.

mod folded;
mod of_rays;
mod transposed;

use bytemuck::{Pod, Zeroable};
use fearless_simd::Simd;

use folded::{add_first_folded, add_folded};
use of_rays::add_sums_of_rays;
pub(crate) use transposed::add_weighted;
use transposed::{add_first_transposed, add_transposed};

use super::rasterize::{Centers, Pixels, Rays, SplatAtPixels};
use super::sort::Entry;
use crate::lanes::{LANES, Lanes, is_one_register};

/// The sums over the pixels of a tile for one splat; g is the gradient by ln(alpha), (u, v) the
/// whitened offset of the pixel from the centre.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C, align(16))]
pub(crate) struct EntryGradient {
    /// g.
    pub(crate) log_alpha: f32,
    /// g u, g v; for rays, times the cosine between ray and splat.
    pub(crate) first: [f32; 2],
    /// g u^2, g u v, g v^2.
    pub(crate) second: [f32; 3],
    /// Gradient by the radiance.
    pub(crate) radiance: [f32; 3],
    /// |g u|, |g (root[1] u + root[2] v)|: AbsGS. Where channels are blended whose first three
    /// statistics are of, g u and g v of these.
    pub(crate) absolute: [f32; 2],
    padding: f32,
}

/// Numbers in an [`EntryGradient`] and in an [`Entry`].
pub(crate) const ENTRY_LEN: usize = 12;
/// Numbers of an [`EntryGradient`] that are in use.
const SUMS: usize = 11;

/// Up to sixteen splats at a block's pixels, staged for summation.
pub(crate) struct Staged {
    /// For [`folded`]: whitened offsets from the centre.
    u: [Lanes; LANES],
    v: [Lanes; LANES],
    /// For rays: cosines between the rays and the splat.
    facing: [Lanes; LANES],
    /// For [`transposed`]: the first eight fields of each entry, from which the offsets follow.
    fields: [Lanes; LANES / 2],
    /// In turn: log2(alpha), alpha / (1 - alpha), g.
    pub(crate) share: [Lanes; LANES],
    /// alpha times transmittance.
    pub(crate) weight: [Lanes; LANES],
}

impl Staged {
    pub(crate) const ZERO: Self = Self {
        u: [Lanes::ZERO; LANES],
        v: [Lanes::ZERO; LANES],
        facing: [Lanes::ZERO; LANES],
        fields: [Lanes::ZERO; LANES / 2],
        share: [Lanes::ZERO; LANES],
        weight: [Lanes::ZERO; LANES],
    };

    /// Stores what the sums need of pick number `i`.
    #[inline(always)]
    fn stage<S: Simd>(&mut self, i: usize, entry: &Entry, splat: &SplatAtPixels<S>) {
        if is_one_register::<S>() {
            self.keep_fields(i, entry);
        } else {
            self.keep_offsets(i, splat);
        }
    }

    #[inline(always)]
    fn keep_fields(&mut self, i: usize, entry: &Entry) {
        let (kept, fields): (&mut [[f32; 8]; LANES], &[f32; ENTRY_LEN]) = (bytemuck::cast_mut(&mut self.fields), bytemuck::cast_ref(entry));
        kept[i].copy_from_slice(&fields[..8]);
    }

    #[inline(always)]
    fn keep_offsets<S: Simd>(&mut self, i: usize, splat: &SplatAtPixels<S>) {
        splat.u.store(&mut self.u[i]);
        splat.v.store(&mut self.v[i]);
    }
}

/// The splats whose sums are added up, and the block over whose pixels.
pub(crate) struct SummedSplats<'a> {
    /// Entries of the tile.
    pub(crate) entries: &'a [Entry],
    /// Numbers of the splats among the entries.
    pub(crate) picks: &'a [u32],
    /// Number of the block within the tile.
    pub(crate) block: usize,
    /// Gradient by the radiance of the block's pixels.
    pub(crate) colors: &'a [Lanes; 3],
}

/// Pixels over which sums are computed.
pub(crate) trait Summed<S: Simd>: Pixels<S> {
    /// Stores what the sums need of pick number `i`.
    fn stage(staged: &mut Staged, i: usize, entry: &Entry, splat: &SplatAtPixels<S>);
    /// Adds the sums of staged splats to their entries' gradients, `out`.
    fn add_sums<const ABSOLUTE: bool>(simd: S, splats: &SummedSplats<'_>, staged: &Staged, out: &mut [EntryGradient]);
}

impl<S: Simd> Summed<S> for Centers<S> {
    #[inline(always)]
    fn stage(staged: &mut Staged, i: usize, entry: &Entry, splat: &SplatAtPixels<S>) {
        staged.stage(i, entry, splat);
    }

    #[inline(always)]
    fn add_sums<const ABSOLUTE: bool>(simd: S, splats: &SummedSplats<'_>, staged: &Staged, out: &mut [EntryGradient]) {
        add_sums::<_, ABSOLUTE>(simd, splats, staged, out);
    }
}

impl<S: Simd> Summed<S> for Rays<S> {
    #[inline(always)]
    fn stage(staged: &mut Staged, i: usize, entry: &Entry, splat: &SplatAtPixels<S>) {
        staged.keep_offsets(i, splat);
        (splat.facing * Self::facing_scale(entry)).store(&mut staged.facing[i]);
    }

    #[inline(always)]
    fn add_sums<const ABSOLUTE: bool>(simd: S, splats: &SummedSplats<'_>, staged: &Staged, out: &mut [EntryGradient]) {
        add_sums_of_rays::<_, ABSOLUTE>(simd, splats, staged, out);
    }
}

/// Adds the sums of staged splats to their entries' gradients, `out`.
#[inline(always)]
fn add_sums<S: Simd, const ABSOLUTE: bool>(simd: S, splats: &SummedSplats<'_>, staged: &Staged, out: &mut [EntryGradient]) {
    if is_one_register::<S>() {
        add_transposed::<_, ABSOLUTE>(simd, splats, staged, out);
    } else {
        add_folded::<_, ABSOLUTE>(simd, splats, staged, out);
    }
}

/// Adds the sums of g u and g v, of another g than the staged one, to the place of absolute sums.
#[inline(always)]
pub(crate) fn add_first_moments<S: Simd>(
    simd: S,
    splats: &SummedSplats<'_>,
    staged: &Staged,
    shares: &[Lanes; LANES],
    out: &mut [EntryGradient],
) {
    if is_one_register::<S>() {
        add_first_transposed(simd, splats, staged, shares, out);
    } else {
        add_first_folded(simd, splats, staged, shares, out);
    }
}

#[cfg(test)]
mod tests {
    use luxel_lanes::Level;

    use super::*;
    use crate::lanes::with_simd;
    use crate::passes::rasterize::pixel_centers;

    #[test]
    fn both_implementations_agree() {
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
            for level in [Level::best(), Level::baseline()] {
                let (mut folded, mut transposed) = (before.clone(), before.clone());
                with_simd!(level, simd => {
                    for (i, index) in picks.iter().enumerate() {
                        let entry = &entries[*index as usize];
                        staged.keep_fields(i, entry);
                        staged.keep_offsets(i, &Centers(pixel_centers(simd, block)).evaluate(simd, entry));
                    }
                    let splats = SummedSplats { entries: &entries, picks: &picks, block, colors: &colors };
                    add_folded::<_, true>(simd, &splats, &staged, &mut folded);
                    add_transposed::<_, true>(simd, &splats, &staged, &mut transposed);
                });
                assert_ne!(folded, before);
                for (folded, transposed) in folded.iter().zip(&transposed) {
                    let [folded, transposed]: [[f32; ENTRY_LEN]; 2] = [folded, transposed].map(|gradient| bytemuck::cast(*gradient));
                    let scale = folded.iter().fold(1.0, |largest: f32, number| largest.max(number.abs()));
                    for (folded, transposed) in folded.iter().zip(transposed) {
                        assert!(
                            (folded - transposed).abs() <= 4e-6 * scale,
                            "block {block}, {count} splats: {folded} and {transposed} of {scale}"
                        );
                    }
                }
            }
        }
    }
}
