//! PU21: PSNR and SSIM of displayed light on a perceptually uniform scale.
//!
//! In: luminance Y in cd/m2, clamped to `[0.005, 10000]`. Out: the encoded value
//!
//! ```text
//! V = c6 (((c0 + c1 Y^c3) / (1 + c2 Y^c3))^c4 - c5)
//! ```
//!
//! One unit of V is about equally visible in the dark and in the light. A display of 100 cd/m2
//! covers 256 units, so that metrics are comparable with those of 8-bit images. Source: Mantiuk &
//! Azimi, "PU21: A novel perceptually uniform encoding for adapting existing quality metrics for
//! HDR", PCS 2021; coefficients `banding_glare`.
//!
//! The metrics follow the authors' `pu21_metric`: PSNR pools the three encoded channels, SSIM is
//! that of the encoded luminance, both with peak 256. Normalised radiance has no absolute unit, so
//! every value depends on the luminance at which a display shows 1, cd/m2.

use super::ssim::ssim_replicated_of_rows;
use super::{Pair, psnr_of_mse};
use luxel_core::luminance_rec709;

/// The peak of [`pu21_encode`]d values in PSNR and SSIM: about V of 100 cd/m2, the white of the
/// displays that 8-bit metrics were made for.
pub const PU21_PEAK: f64 = 256.0;
/// The darkest and the brightest luminance that the encoding was fitted to, cd/m2.
pub const PU21_RANGE_CD_M2: [f64; 2] = [0.005, 10_000.0];

/// The coefficients `banding_glare` of the paper's table 1.
const C: [f64; 7] = [0.353_487_901, 0.373_465_862_9, 8.277_049_286e-5, 0.906_256_262_7, 0.091_503_031_66, 0.909_951_720_4, 596.314_814_2];

/// Encodes a luminance in cd/m2. Luminances outside of [`PU21_RANGE_CD_M2`] count as its nearer
/// end, and NaN as the darker one.
pub fn pu21_encode(luminance_cd_m2: f64) -> f64 {
    let [low, high] = PU21_RANGE_CD_M2;
    let power = luminance_cd_m2.max(low).min(high).powf(C[3]);
    C[6] * (((C[0] + C[1] * power) / (1.0 + C[2] * power)).powf(C[4]) - C[5])
}

/// Returns PSNR (dB) and SSIM of a pair in linear Rec.709 in which a display shows 1 at
/// `peak_cd_m2`.
pub(super) fn pu21_psnr_ssim(pair: &Pair, peak_cd_m2: f64) -> (f64, f64) {
    let encode = |value: f32| pu21_encode(f64::from(value) * peak_cd_m2);
    let [width, height] = [pair.target.width, pair.target.height];
    let (mut squares, mut rows_done) = (0.0, 0);
    let similarity = ssim_replicated_of_rows([width, height], |y, predictions, targets| {
        // The first and the last row come several times.
        let is_new = y == rows_done;
        rows_done += usize::from(is_new);
        for (x, (prediction, target)) in predictions.iter_mut().zip(targets).enumerate() {
            let i = y * width + x;
            let (p, t) = (pair.prediction.pixels[i], pair.target.pixels[i]);
            // A masked pixel may hold NaN, which encodes as black.
            *target = encode(luminance_rec709(t)) / PU21_PEAK;
            *prediction = *target;
            if pair.is_valid(i) {
                *prediction = encode(luminance_rec709(p)) / PU21_PEAK;
                if is_new {
                    for c in 0..3 {
                        squares += ((encode(p[c]) - encode(t[c])) / PU21_PEAK).powi(2);
                    }
                }
            }
        }
    });
    (psnr_of_mse(squares / (3.0 * pair.valid_count as f64)), similarity)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoding_has_its_published_values() {
        let known =
            [(0.1, 5.717074), (1.0, 36.543911), (10.0, 123.647484), (100.0, 256.383897), (1000.0, 420.096921), (10_000.0, 595.393920)];
        for (luminance, expected) in known {
            assert!((pu21_encode(luminance) - expected).abs() < 1e-5, "{luminance}: {}", pu21_encode(luminance));
        }
    }

    #[test]
    fn what_no_display_shows_is_its_black_or_white() {
        for (hostile, end) in [(f64::NAN, 0.005), (-1.0, 0.005), (f64::NEG_INFINITY, 0.005), (f64::INFINITY, 1e4), (1e9, 1e4)] {
            assert_eq!(pu21_encode(hostile), pu21_encode(end));
        }
    }
}
