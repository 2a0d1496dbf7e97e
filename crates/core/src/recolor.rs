//! Conversion of a scene to another colour model: geometry stays, colours are approximated.
//!
//! In: splats. Out: splats of the new model, of the nearest colours it can represent. Degenerate:
//! there is no conversion from [`ColorModel::Lcd`] or [`ColorModel::Mix`] to another model, from
//! [`ColorModel::LogSh`] to anything but another degree, nor to a mix.

use crate::sh::C0;
use crate::{ColorModel, SH_OFFSET, Splats};

/// Lower bound of the channels of a splat's mean colour, so that the gradient of each channel's
/// chromaticity stays alive.
const DARKEST: f32 = 0.01;

impl Splats {
    /// Returns the same splats in `color_model`; `None` from [`ColorModel::Lcd`] or a mix to
    /// anything else, because products of luminance and chromaticity are not harmonics, and to a
    /// mix.
    ///
    /// - [`ColorModel::Sh`] and [`ColorModel::LogSh`] to another degree: higher coefficients are
    ///   dropped, missing ones are zero.
    /// - [`ColorModel::Sh`] to [`ColorModel::LogSh`]: exact for the constant term, and of the
    ///   others to first order. Channels of the constant term below 0.01 count as 0.01.
    /// - [`ColorModel::Sh`] to [`ColorModel::Lcd`]: the luminance is R + G + B of the constant
    ///   term, in every direction. The chromaticity is that of the harmonics in every direction, up
    ///   to its degree and the floor [`crate::DEAD_CHROMA_FLOOR`]. Channels of the constant term
    ///   below 0.01 count as 0.01.
    pub fn with_color_model(&self, color_model: ColorModel) -> Option<Self> {
        if color_model == self.color_model {
            return Some(self.clone());
        }
        let converts = match self.color_model {
            ColorModel::Sh { .. } => color_model.single().is_some(),
            ColorModel::LogSh { .. } => matches!(color_model, ColorModel::LogSh { .. }),
            ColorModel::Lcd { .. } | ColorModel::Mix(_) => false,
        };
        if !converts {
            return None;
        }
        let is_cut = matches!(color_model, ColorModel::Sh { .. }) || matches!(self.color_model, ColorModel::LogSh { .. });
        let mut splats = Self { color_model, sh: Vec::new(), raw_luminance: Vec::new(), ..self.clone() };
        splats.sh.reserve_exact(self.len() * 3 * color_model.sh_coefficients());
        for i in 0..self.len() {
            let from = self.sh_of(i);
            let rgb = [0, 1, 2].map(|c| (C0 * from[c] + SH_OFFSET).max(DARKEST));
            let constant = color_model.constant(rgb);
            let (dc, raw_luminance, scale) = match color_model {
                _ if is_cut => ([from[0], from[1], from[2]], 0.0, [1.0; 3]),
                // ln(c + d) = ln c + d / c to first order.
                ColorModel::LogSh { .. } => (constant.0, 0.0, rgb.map(f32::recip)),
                // The response is the harmonics' radiance divided by the luminance; the normaliser
                // removes the rest.
                _ => (constant.0, constant.1, [1.0 / rgb.iter().sum::<f32>(); 3]),
            };
            splats.sh.extend(dc);
            let rest = from[3..].iter().enumerate().map(|(i, k)| k * scale[i % 3]).chain(std::iter::repeat(0.0));
            splats.sh.extend(rest.take(3 * (color_model.sh_coefficients() - 1)));
            let luminance = std::iter::once(raw_luminance).chain(std::iter::repeat(0.0));
            splats.raw_luminance.extend(luminance.take(color_model.luminance_coefficients()));
        }
        Some(splats)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Activation, DEAD_CHROMA_FLOOR, luminance_sum, synthetic};

    const DIRECTIONS: [[f32; 3]; 3] = [[0.0, 0.0, 1.0], [0.6, -0.8, 0.0], [-0.48, 0.6, 0.64]];

    fn lcd(luminance_degree: u8) -> ColorModel {
        ColorModel::Lcd { chroma_degree: 3, luminance_degree, activation: Activation::Softplus }
    }

    #[test]
    fn lcd_keeps_the_harmonics_chromaticity_and_the_constant_terms_luminance() {
        let sh = synthetic::room(200, 3);
        for degree in [0, 1] {
            let lcd = sh.with_color_model(lcd(degree)).unwrap();
            lcd.validate().unwrap();
            assert_eq!((&lcd.position, &lcd.opacity_logit, &lcd.rotation), (&sh.position, &sh.opacity_logit, &sh.rotation));
            let mut compared = 0;
            for (i, direction) in (0..sh.len()).flat_map(|i| DIRECTIONS.map(|d| (i, d))) {
                let constant = [0, 1, 2].map(|c| C0 * sh.sh_of(i)[c] + SH_OFFSET);
                let (from, to) = (sh.radiance(i, direction), lcd.radiance(i, direction));
                if constant.iter().chain(&from).all(|v| *v > DARKEST) {
                    let luminance = luminance_sum(constant);
                    assert!((luminance_sum(to) - luminance).abs() < 1e-5, "splat {i}: {to:?} {constant:?}");
                    for c in 0..3 {
                        // The floor pulls towards grey.
                        let floored = |v: f32, channels: f32| v / luminance + channels * DEAD_CHROMA_FLOOR;
                        let (a, b) = (floored(from[c], 1.0) / floored(luminance_sum(from), 3.0), to[c] / luminance_sum(to));
                        assert!((a - b).abs() < 1e-5, "splat {i}, channel {c}: {a} {b}");
                    }
                    compared += 1;
                }
            }
            assert!(compared > 300, "{compared}");
        }
    }

    #[test]
    fn harmonics_are_cut_or_filled_with_zeros() {
        let sh3 = synthetic::room(20, 4);
        let sh1 = sh3.with_color_model(ColorModel::Sh { degree: 1 }).unwrap();
        let sh5 = sh3.with_color_model(ColorModel::Sh { degree: 5 }).unwrap();
        for i in 0..sh3.len() {
            assert_eq!(sh1.sh_of(i), &sh3.sh_of(i)[..12]);
            assert_eq!(sh5.radiance(i, DIRECTIONS[2]), sh3.radiance(i, DIRECTIONS[2]));
        }
        assert_eq!(sh5.with_color_model(sh3.color_model).unwrap(), sh3);
        sh5.validate().unwrap();
    }

    #[test]
    fn small_view_dependence_survives_the_logarithm() {
        let mut sh = synthetic::room(50, 5);
        let k = 3 * sh.color_model.sh_coefficients();
        for splat in sh.sh.chunks_exact_mut(k) {
            splat[..3].iter_mut().for_each(|dc| *dc = dc.abs());
            splat[3..].iter_mut().for_each(|k| *k *= 0.05);
        }
        let log = sh.with_color_model(ColorModel::LogSh { degree: 3 }).unwrap();
        log.validate().unwrap();
        for (i, direction) in (0..sh.len()).flat_map(|i| DIRECTIONS.map(|d| (i, d))) {
            let (from, to) = (sh.radiance(i, direction), log.radiance(i, direction));
            (0..3).for_each(|c| assert!((to[c] / from[c] - 1.0).abs() < 2e-3, "splat {i}: {to:?} {from:?}"));
        }
        assert_eq!(log.with_color_model(sh.color_model), None);
        let low = log.with_color_model(ColorModel::LogSh { degree: 1 }).unwrap();
        assert_eq!(low.sh_of(7), &log.sh_of(7)[..12]);
    }

    #[test]
    fn luminance_and_chromaticity_do_not_become_harmonics() {
        let lcd0 = synthetic::room(5, 1).with_color_model(lcd(0)).unwrap();
        assert_eq!(lcd0.with_color_model(lcd(0)).unwrap(), lcd0);
        assert_eq!(lcd0.with_color_model(ColorModel::Sh { degree: 3 }), None);
    }
}
