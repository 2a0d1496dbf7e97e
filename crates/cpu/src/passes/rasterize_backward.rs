//! Pass `rasterize_backward`: gradients of each tile's splats, back to front.
//!
//! In: bins, footprints, the tiles' pixels, gradient of the loss by the pixels' radiance ([`TileGradient`], zero where there is no pixel).
//! Out: one [`EntryGradient`] per entry of the bins, in their order: sums over the tile's pixels. They are gathered by splat later, in a
//! fixed order, so no two threads ever add to one number.
//!
//! With w_i = T_i alpha_i and S_i = sum over j > i of w_j c_j (background last), d alpha_i = T_i c_i - S_i / (1 - alpha_i), dotted
//! with the pixel's gradient. Gradients by centre and conic follow from the moments of g = alpha d alpha over the pixel offsets,
//! which are summed here and turned into them per splat. Where alpha is capped it has no gradient.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, f32x4, f64x2};
use luxel_core::Real;
use luxel_core::each;
use rayon::prelude::*;

use super::bin::Bins;
use super::project::Footprint;
use super::rasterize::{Spread, TileBuffer, TilePixels, fetch_entries, pixel_centers};
use crate::lanes::{Lanes, V, with_simd};
use crate::view::{BLOCKS, ScreenCamera, TILE_PX};

/// Gradient by the radiance of a tile's pixels: [4 blocks, 3 channels].
pub(crate) type TileGradient = [[Lanes; 3]; BLOCKS];

/// Sums over the pixels of a tile of one splat; g is the gradient by ln(alpha), d the offset of the pixel from the centre.
#[derive(Clone, Copy, Debug, Default, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(64))]
pub(crate) struct EntryGradient {
    /// g.
    pub(crate) log_alpha: f32,
    /// g dx, g dy.
    pub(crate) first: [f32; 2],
    /// g dx^2, g dx dy, g dy^2.
    pub(crate) second: [f32; 3],
    /// By the radiance.
    pub(crate) radiance: [f32; 3],
    /// |g ((conic d)_x)|, |g ((conic d)_y)|: AbsGS.
    pub(crate) absolute: [f32; 2],
    padding: [f32; 5],
}

/// Numbers in an [`EntryGradient`]: a cache line, as entries are fetched one by one.
pub(crate) const ENTRY_LEN: usize = 16;

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
    (bins, footprints): (&Bins, &[Footprint]),
    (pixels, gradients): (&TileBuffer, &[TileGradient]),
    absolute: AbsoluteSums,
    out: &mut Vec<EntryGradient>,
) {
    out.resize(bins.len(), EntryGradient::default());
    let across = camera.tiles()[0];
    // Each tile's entries are a run of `out`.
    let mut runs = Vec::with_capacity(pixels.tiles.len());
    let mut rest = out.as_mut_slice();
    for tile in 0..pixels.tiles.len() {
        let (run, others) = rest.split_at_mut(bins.tile(tile).len());
        runs.push(run);
        rest = others;
    }
    runs.into_par_iter().enumerate().for_each_init(Vec::new, |entries, (tile, run)| {
        let origin_px = [(tile % across * TILE_PX) as f32, (tile / across * TILE_PX) as f32];
        fetch_entries(bins, footprints, tile, entries);
        let entries = entries.as_slice();
        let (pixels, gradients) = (&pixels.tiles[tile], &gradients[tile]);
        match absolute {
            AbsoluteSums::Skip => {
                with_simd!(level, simd => tile_backward::<_, false>(simd, camera, origin_px, entries, (pixels, gradients), run))
            }
            AbsoluteSums::Collect => {
                with_simd!(level, simd => tile_backward::<_, true>(simd, camera, origin_px, entries, (pixels, gradients), run))
            }
        }
    });
}

/// State of a block's pixels on the way from back to front.
#[derive(Clone, Copy)]
struct BlockState<S: Simd> {
    centers: [V<S>; 2],
    gradient: [V<S>; 3],
    transmittance: V<S>,
    /// Gradient-weighted radiance from behind.
    behind: V<S>,
    last: V<S>,
}

#[inline(always)]
fn tile_backward<S: Simd, const ABSOLUTE: bool>(
    simd: S,
    camera: &ScreenCamera,
    origin_px: [f32; 2],
    entries: &[Footprint],
    (pixels, gradients): (&TilePixels, &TileGradient),
    out: &mut [EntryGradient],
) {
    let c = |value: f32| V::splat(simd, value);
    let (zero, one) = (c(0.0), c(1.0));
    let max_alpha = c(camera.cutoffs.max_alpha);
    let mut last_of_block = [0usize; BLOCKS];
    let mut blocks: [BlockState<S>; BLOCKS] = each!([0, 1, 2, 3] b => {
        let gradient = each!([0, 1, 2] channel => V::load(simd, &gradients[b][channel]));
        let transmittance = V::load(simd, &pixels[b].transmittance);
        let background = each!([0, 1, 2] i => c(camera.background[i]) * gradient[i]);
        last_of_block[b] = pixels[b].last.0.iter().fold(0.0f32, |a, v| a.max(*v)) as usize;
        BlockState {
            centers: pixel_centers(simd, b),
            gradient,
            transmittance,
            behind: transmittance * (background[0] + background[1] + background[2]),
            last: V::load(simd, &pixels[b].last),
        }
    });
    let last = last_of_block.iter().copied().fold(0, usize::max);
    out[last..].fill(EntryGradient::default());
    for (index, f) in entries.iter().enumerate().take(last).rev() {
        let spread = Spread::new(simd, f, origin_px);
        let color = each!([0, 1, 2] i => c(f.radiance[i]));
        let conic = each!([0, 1, 2] i => { let v = f.conic[i]; c(v * std::f32::consts::LN_2) });
        let position = c(index as f32);
        let mut sums = [zero; 11];
        let mut any = false;
        for b in 0..BLOCKS {
            if index >= last_of_block[b] {
                continue;
            }
            let state = &mut blocks[b];
            let offset = [state.centers[0] - spread.mean[0], state.centers[1] - spread.mean[1]];
            let exponent = spread.log2_alpha(offset);
            let hit = exponent.ge(spread.log2_threshold) & position.lt(state.last);
            if !hit.any_true() {
                continue;
            }
            any = true;
            let uncapped = exponent.exp2();
            let alpha = V::select(hit, uncapped.min(max_alpha), zero);
            let inverse = (one - alpha).reciprocal();
            let transmittance = state.transmittance * inverse;
            let weight = alpha * transmittance;
            let shine = color[0].mul_add(state.gradient[0], color[1].mul_add(state.gradient[1], color[2] * state.gradient[2]));
            let d_alpha = transmittance.mul_add(shine, -(state.behind * inverse));
            state.transmittance = transmittance;
            state.behind = weight.mul_add(shine, state.behind);
            let g = V::select(hit & uncapped.lt(max_alpha), alpha * d_alpha, zero);
            let (gx, gy) = (g * offset[0], g * offset[1]);
            sums[0] = sums[0] + g;
            sums[1] = sums[1] + gx;
            sums[2] = sums[2] + gy;
            sums[3] = gx.mul_add(offset[0], sums[3]);
            sums[4] = gx.mul_add(offset[1], sums[4]);
            sums[5] = gy.mul_add(offset[1], sums[5]);
            for channel in 0..3 {
                sums[6 + channel] = weight.mul_add(state.gradient[channel], sums[6 + channel]);
            }
            if ABSOLUTE {
                sums[9] = sums[9] + conic[0].mul_add(gx, conic[1] * gy).abs();
                sums[10] = sums[10] + conic[1].mul_add(gx, conic[2] * gy).abs();
            }
        }
        out[index] = if any { sum_lanes(simd, sums) } else { EntryGradient::default() };
    }
}

/// Sums each of the vectors over its lanes, in one order whatever the instruction set.
#[inline(always)]
fn sum_lanes<S: Simd>(simd: S, sums: [V<S>; 11]) -> EntryGradient {
    let quarter = |v: V<S>| -> f32x4<S> {
        let (low, high) = v.0.split();
        let half = low + high;
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
    let mut out = EntryGradient::default();
    let numbers: &mut [f32; ENTRY_LEN] = bytemuck::cast_mut(&mut out);
    four(q[0], q[1], q[2], q[3]).store_slice(&mut numbers[0..4]);
    four(q[4], q[5], q[6], q[7]).store_slice(&mut numbers[4..8]);
    four(q[8], q[9], q[10], zero).store_slice(&mut numbers[8..12]);
    out
}
