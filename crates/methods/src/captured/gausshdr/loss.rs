//! GaussHDR's losses of images.
//!
//! In: captured values Y and uncertainties U3 as splats blend them, global values, local shifts and
//! uncertainties U2 of pixels, a view of captured values. Out: the loss and its gradient by all of
//! these. The loss E of Y counts w = U2^2 / (U2^2 + U3^2), that of the pixels' local values Z
//! counts 1 - w. To that come [`GLOBAL_WEIGHT`] times E of the pixels' global values, and the
//! uncertainties' own loss D / (2 U^2) + ln(U) / 2 with D = 1 - SSIM of Y and Z.
//!
//! As published, weights and D have no gradient. Degenerate: uncertainties below
//! [`LEAST_UNCERTAINTY`] count as that and have no gradient.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use luxel_core::engine::ChannelLoss;
use luxel_core::{LossWeights, View};
use luxel_lanes::functions::ln;
use luxel_lanes::sums::sum_in_order;
use luxel_lanes::{LANES, Level};
use rayon::prelude::*;

use super::tone::{LEAST_UNCERTAINTY, local_value};
use crate::captured::images::image_loss::{Compared, ComparedOut, Comparison, compare};
use crate::captured::images::radiance_loss::planes_of;

/// Weight of the loss of the pixels' global value.
const GLOBAL_WEIGHT: f32 = 0.5;

/// The images of a step.
pub(super) struct GaussImages<'a> {
    /// Width and height.
    pub(super) size: [usize; 2],
    /// Y, `[3, H, W]`.
    pub(super) captured: &'a [f32],
    /// U3, `[3, H, W]`.
    pub(super) uncertainty: &'a [f32],
    /// Global values, local shifts, U2, `[9, H, W]`.
    pub(super) pixels: &'a [f32],
    pub(super) view: &'a View,
    pub(super) weights: &'a LossWeights,
}

/// The parts of an uncertainty's loss that are the same for all values of a plane.
struct UncertaintyLoss<'a> {
    /// Factor of each value.
    each: f32,
    /// Weights of pixels.
    mask: Option<&'a [f32]>,
}

/// Compares the images with the view, and writes the gradients by Y, by the pixels' values and by
/// U3, in the shapes of [`GaussImages`].
pub(super) fn compare_images(
    images: &GaussImages<'_>,
    by_captured: &mut [f32],
    by_pixels: &mut [f32],
    by_uncertainty: &mut [f32],
) -> ChannelLoss {
    let len = 3 * images.size[0] * images.size[1];
    let (global, rest) = images.pixels.split_at(len);
    let (shift, u2) = rest.split_at(len);
    let target = planes_of(&images.view.image.pixels);
    let mask = images.view.mask.as_deref().map(|mask| &mask.weights[..]);
    let (mut share, mut others, mut local) = (vec![0.0; len], vec![0.0; len], vec![0.0; len]);
    let plane = (len / 3).max(1);
    let outs = (share.par_chunks_mut(plane), others.par_chunks_mut(plane), local.par_chunks_mut(plane));
    outs.into_par_iter().enumerate().for_each(|(c, (share, others, local))| {
        let at = c * plane..(c + 1) * plane;
        for (((share, others), u2), u3) in share.iter_mut().zip(others).zip(&u2[at.clone()]).zip(&images.uncertainty[at.clone()]) {
            let (u2, u3) = (u2 * u2, u3.max(LEAST_UNCERTAINTY).powi(2));
            *share = u2 / (u2 + u3);
            *others = 1.0 - *share;
        }
        for ((local, global), shift) in local.iter_mut().zip(&global[at.clone()]).zip(&shift[at]) {
            *local = local_value(*global, *shift).0;
        }
    });

    let compared = |prediction: &[f32], values: Option<&[f32]>, factor: f32, by_value: &mut [f32], dissimilarity: Option<&mut [f32]>| {
        let of = Compared { size: images.size, prediction, target: &target, pixels: mask, values, factor };
        compare(&of, images.weights, ComparedOut { by_value, dissimilarity })
    };
    let (mut d2, mut d3, mut by_local) = (vec![0.0; len], vec![0.0; len], vec![0.0; len]);
    let (by_global, rest) = by_pixels.split_at_mut(len);
    let (by_shift, by_u2) = rest.split_at_mut(len);
    let (of_y, (of_z, of_global)) = rayon::join(
        || compared(images.captured, Some(&share), 1.0, by_captured, Some(&mut d3)),
        || {
            rayon::join(
                || compared(&local, Some(&others), 1.0, &mut by_local, Some(&mut d2)),
                || compared(global, None, GLOBAL_WEIGHT, by_global, None),
            )
        },
    );
    let clipped = global.par_chunks(plane).zip(shift.par_chunks(plane)).zip(by_local.par_chunks(plane));
    by_global.par_chunks_mut(plane).zip(by_shift.par_chunks_mut(plane)).zip(clipped).for_each(|((by_global, by_shift), of)| {
        let ((global, shift), by_local) = of;
        for (i, by_local) in by_local.iter().enumerate() {
            let passed = if local_value(global[i], shift[i]).1 { *by_local } else { 0.0 };
            by_global[i] += passed;
            by_shift[i] = passed;
        }
    });
    let of_uncertainty = UncertaintyLoss { each: (len.max(1) as f32).recip(), mask };
    let (of_u2, of_u3) = rayon::join(
        || of_uncertainty.of_image(u2, &d2, by_u2, plane),
        || of_uncertainty.of_image(images.uncertainty, &d3, by_uncertainty, plane),
    );
    let Comparison { l1, ssim, .. } = of_z;
    let loss = of_y.loss + of_z.loss + GLOBAL_WEIGHT * of_global.loss + (of_u2 + of_u3) as f32;
    ChannelLoss { loss, l1, ssim }
}

impl UncertaintyLoss<'_> {
    /// Returns the loss of an image's uncertainties, and writes its gradient by them.
    fn of_image(&self, u: &[f32], d: &[f32], by_u: &mut [f32], plane: usize) -> f64 {
        let planes = u.par_chunks(plane).zip(d.par_chunks(plane)).zip(by_u.par_chunks_mut(plane));
        let sums: Vec<f64> =
            planes.map(|((u, d), by_u)| luxel_lanes::dispatch!(Level::best(), simd => self.of_plane(simd, u, d, by_u))).collect();
        sums.iter().sum()
    }

    #[inline(always)]
    fn of_plane<S: Simd>(&self, simd: S, u: &[f32], d: &[f32], by_u: &mut [f32]) -> f64 {
        let c = |value: f32| f32x16::splat(simd, value);
        let (half, least) = (c(0.5), c(LEAST_UNCERTAINTY));
        let mut sum = 0.0f64;
        for first in (0..u.len()).step_by(LANES) {
            let len = LANES.min(u.len() - first);
            let (mut of_u, mut of_d, mut factor) = ([1.0; LANES], [0.0; LANES], [0.0; LANES]);
            of_u[..len].copy_from_slice(&u[first..first + len]);
            of_d[..len].copy_from_slice(&d[first..first + len]);
            match self.mask {
                None => factor[..len].fill(self.each),
                Some(mask) => factor[..len].iter_mut().zip(&mask[first..]).for_each(|(factor, weight)| *factor = self.each * weight),
            }
            let (raw, d, factor) =
                (f32x16::load_array_ref(simd, &of_u), f32x16::load_array_ref(simd, &of_d), f32x16::load_array_ref(simd, &factor));
            let u = raw.max(least);
            let inverse = c(1.0) / u;
            let share = d * inverse * inverse;
            sum += f64::from(sum_in_order((factor * half * (share + ln(u))).to_array()));
            let by = factor * inverse * (half - share);
            let by = raw.simd_ge(least).select(by, c(0.0)).to_array();
            by_u[first..first + len].copy_from_slice(&by[..len]);
        }
        sum
    }
}
