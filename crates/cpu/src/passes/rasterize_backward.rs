//! Pass `rasterize_backward`: gradients of each tile's splats, back to front.
//!
//! In: the tiles' sorted lists and pixels, gradient of the loss by the pixels' radiance ([`BlockGradient`]s row by row).
//! Out: one [`EntryGradient`] per entry of a tile, in the order of its bin: sums over the tile's pixels. They are gathered by splat later,
//! in a fixed order, so no two threads ever add to one number.
//!
//! With w_i = T_i alpha_i and S_i = sum over j > i of w_j c_j (background last), d alpha_i = T_i c_i - S_i / (1 - alpha_i), dotted
//! with the pixel's gradient. By the odds o_i = alpha_i / (1 - alpha_i) and the transmittance behind the splat, w_i = o_i T_(i+1), T_i = T_(i+1) + w_i
//! and g = alpha_i d alpha_i = w_i c_i - o_i S_i: where a pixel is not changed the odds are zero, and it stays what it is to the bit. Gradients by
//! centre and covariance follow from the moments of g over the pixels' whitened offsets (u, v), which are summed here and turned into them per
//! splat. Where alpha is capped it has no gradient.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, f32x4, f32x8, f64x2};
use luxel_core::Real;
use luxel_core::each;
use rayon::prelude::*;

use super::picks::{MOST_PICKS, Picks};
use super::rasterize::{BlockPixels, Seen, TilePixels, pixel_centers};
use super::sort::{Entry, TileList, WORD};
use crate::lanes::{LOG2_OF_ZERO, Lanes, V, with_simd};
use crate::view::{BLOCKS, ScreenCamera, TILE_BLOCKS};

/// Gradient by the radiance of a block's pixels.
pub(crate) type BlockGradient = [Lanes; 3];

/// Sums over the pixels of a tile of one splat; g is the gradient by ln(alpha), (u, v) the whitened offset of the pixel from the centre.
#[derive(Clone, Copy, Debug, Default, bytemuck::Pod, bytemuck::Zeroable)]
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

/// Numbers in an [`EntryGradient`].
pub(crate) const ENTRY_LEN: usize = 12;
/// Of these, the ones in use.
const SUMS: usize = 11;

/// Whether AbsGS's sums are wanted.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum AbsoluteSums {
    /// Leave them zero.
    Skip,
    /// Sum them.
    Collect,
}

/// Differentiates all tiles.
pub(crate) fn rasterize_backward(
    level: Level,
    camera: &ScreenCamera,
    lists: &[TileList],
    (pixels, gradients): (&[TilePixels], &[BlockGradient]),
    absolute: AbsoluteSums,
    out: &mut Vec<Vec<EntryGradient>>,
) {
    out.resize_with(lists.len(), Vec::new);
    let across = camera.tiles()[0];
    out.par_iter_mut().zip(lists).zip(pixels).enumerate().for_each(|(tile, ((out, list), pixels))| {
        out.clear();
        out.resize(list.entries.len(), EntryGradient::default());
        list.fetch();
        let mut stages = Stages::ZERO;
        for block in 0..BLOCKS {
            let row = tile / across * TILE_BLOCKS + block / TILE_BLOCKS;
            let gradient = &gradients[(row * across + tile % across) * TILE_BLOCKS + block % TILE_BLOCKS];
            let (pixels, out) = (&pixels.0[block], (&mut stages, out.as_mut_slice()));
            match absolute {
                AbsoluteSums::Skip => {
                    with_simd!(level, simd => block_backward::<_, false>(simd, camera, (list, block), (pixels, gradient), out))
                }
                AbsoluteSums::Collect => {
                    with_simd!(level, simd => block_backward::<_, true>(simd, camera, (list, block), (pixels, gradient), out))
                }
            }
        }
    });
}

/// What the stages hand on: of each pick, as the block's pixels see it.
struct Stages {
    u: [Lanes; MOST_PICKS],
    v: [Lanes; MOST_PICKS],
    /// log2(alpha), then alpha / (1 - alpha), then g.
    share: [Lanes; MOST_PICKS],
    /// alpha times transmittance.
    weight: [Lanes; MOST_PICKS],
}

impl Stages {
    const ZERO: Self = Self {
        u: [Lanes::ZERO; MOST_PICKS],
        v: [Lanes::ZERO; MOST_PICKS],
        share: [Lanes::ZERO; MOST_PICKS],
        weight: [Lanes::ZERO; MOST_PICKS],
    };
}

/// What differentiating a block's splats goes on with from one to the next in front.
struct Unwinding<S: Simd> {
    centers: [V<S>; 2],
    /// As [`BlockPixels::last`].
    last: V<S>,
    gradient: [V<S>; 3],
    transmittance: V<S>,
    /// Gradient-weighted radiance from behind.
    behind: V<S>,
    max_alpha: V<S>,
    log2_max_alpha: f32,
    max_odds: V<S>,
}

#[inline(always)]
fn block_backward<S: Simd, const ABSOLUTE: bool>(
    simd: S,
    camera: &ScreenCamera,
    (list, block): (&TileList, usize),
    (pixels, gradient): (&BlockPixels, &BlockGradient),
    (stages, out): (&mut Stages, &mut [EntryGradient]),
) {
    let max_alpha = V::splat(simd, camera.cutoffs.max_alpha);
    let gradient = each!([0, 1, 2] channel => V::load(simd, &gradient[channel]));
    let transmittance = V::load(simd, &pixels.transmittance);
    let background = each!([0, 1, 2] i => gradient[i] * camera.background[i]);
    let mut unwinding = Unwinding {
        centers: pixel_centers(simd, block),
        last: V::load(simd, &pixels.last),
        gradient,
        transmittance,
        behind: transmittance * (background[0] + background[1] + background[2]),
        max_alpha,
        log2_max_alpha: camera.cutoffs.max_alpha.log2(),
        max_odds: odds(max_alpha),
    };
    let end = pixels.last.0.iter().fold(0.0f32, |a, v| if *v > a { *v } else { a }) as usize;
    let mut picks = Picks::NONE;
    for n in (0..end.div_ceil(WORD)).rev() {
        let mut bits = list.word(n, block);
        if end - n * WORD < WORD {
            bits &= (1 << (end - n * WORD)) - 1;
        }
        picks.pick_descending(n * WORD, bits);
        if picks.is_enough() {
            unwind::<_, ABSOLUTE>(simd, &mut unwinding, &list.entries, picks.take(), (stages, out));
        }
    }
    unwind::<_, ABSOLUTE>(simd, &mut unwinding, &list.entries, picks.take(), (stages, out));
}

/// alpha / (1 - alpha).
#[inline(always)]
fn odds<S: Simd>(alpha: V<S>) -> V<S> {
    alpha * (alpha.lift(1.0) - alpha).reciprocal()
}

/// Differentiates the picks among a tile's entries in front of what has been differentiated.
#[inline(always)]
fn unwind<S: Simd, const ABSOLUTE: bool>(
    simd: S,
    state: &mut Unwinding<S>,
    entries: &[Entry],
    picks: &[u32],
    (stages, out): (&mut Stages, &mut [EntryGradient]),
) {
    let c = |value: f32| V::splat(simd, value);
    let Stages { u, v, share, weight } = stages;
    for (((index, u), v), share) in picks.iter().zip(u.iter_mut()).zip(v.iter_mut()).zip(share.iter_mut()) {
        let entry = &entries[*index as usize];
        let seen = Seen::new(simd, entry, state.centers);
        let hit = seen.log2_alpha.ge(c(entry.log2_threshold)) & state.last.gt(c(*index as f32));
        seen.u.store(u);
        seen.v.store(v);
        V::select(hit, seen.log2_alpha, c(LOG2_OF_ZERO)).store(share);
    }
    for share in &mut share[..picks.len()] {
        odds(V::load(simd, share).exp2().min(state.max_alpha)).store(share);
    }
    let gradient = state.gradient;
    for ((index, share), weight) in picks.iter().zip(share.iter_mut()).zip(weight.iter_mut()) {
        let entry = &entries[*index as usize];
        let odds = V::load(simd, share);
        let blended = odds * state.transmittance;
        let color = each!([0, 1, 2] i => c(entry.radiance[i]));
        let shine = color[0].mul_add(gradient[0], color[1].mul_add(gradient[1], color[2] * gradient[2]));
        let given = blended * shine;
        let g = (-odds).mul_add(state.behind, given);
        let g = if entry.log2_opacity < state.log2_max_alpha { g } else { V::select(odds.lt(state.max_odds), g, c(0.0)) };
        state.transmittance = state.transmittance + blended;
        state.behind = state.behind + given;
        g.store(share);
        blended.store(weight);
    }
    let colors = each!([0, 1, 2] i => Halves::of(gradient[i]));
    for ((((index, u), v), share), weight) in picks.iter().zip(u).zip(v).zip(share).zip(weight) {
        let entry = &entries[*index as usize];
        let [g, weight] = [Halves::of(V::load(simd, share)), Halves::of(V::load(simd, weight))];
        let [u, v] = [Halves::of(V::load(simd, u)), Halves::of(V::load(simd, v))];
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
        add_sums(simd, sums, &mut out[entry.place as usize]);
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

/// Sums each of the half vectors over its lanes, in one order whatever the instruction set, and adds the sums to an entry's.
#[inline(always)]
fn add_sums<S: Simd>(simd: S, sums: [f32x8<S>; SUMS], out: &mut EntryGradient) {
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
