//! Edits of light: maps on the luminance of selected splats that leave geometry and chromaticity alone (LCD-GS, "local luminance
//! editing").
//!
//! In: [`Splats`]. Out: the same splats with other colour coefficients. The luminance of a splat is that of its degree-0 term, R + G + B
//! in normalised units ([`Splats::base_luminance`]); an [`Edit`] turns it into a factor by which the splat's radiance is scaled in
//! every direction:
//! - [`ColorModel::Sh`]: k' = f k, and the offset of 1/2 moves into the DC. Exact.
//! - [`ColorModel::Lcd`]: the raw luminance alone changes; chromaticity coefficients keep their bits. Exact for luminance degree 0 and
//!   for every degree with Exp and Relu; with Softplus above degree 0, exact to first order in the view-dependent part.
//!
//! Degenerate: a splat of luminance 0 has no factor under [`Edit::Power`] and stays as it is. [`crate::Activation::inverse`] keeps
//! luminances at 1e-8 and above, so a gain of 0 leaves that much.

use serde::{Deserialize, Serialize};

use crate::sh::C0;
use crate::{Activation, ColorModel, SH_OFFSET, Splats};

/// A map on luminance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Edit {
    /// L' = gain L; gain >= 0.
    Gain(f32),
    /// L' = pivot (L / pivot)^exponent: contrast about `pivot`; an exponent below 1 lifts shadows and tames lamps.
    Power {
        /// Above 0; 1 changes nothing.
        exponent: f32,
        /// Luminance that stays as it is, above 0, normalised units.
        pivot: f32,
    },
}

/// Which splats an edit applies to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Selection {
    /// All of them.
    #[default]
    All,
    /// Those whose [`Splats::base_luminance`] is in `[min, max)`, normalised units.
    LuminanceRange {
        /// Included.
        min: f32,
        /// Excluded; may be infinite.
        max: f32,
    },
}

/// Why an edit was not applied. The splats are as they were.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum EditError {
    /// Parameter out of range.
    #[error("{name} is {found}, expected {expected}")]
    Parameter {
        /// Which.
        name: &'static str,
        /// Its value.
        found: f32,
        /// What it should be.
        expected: &'static str,
    },
    /// The result does not fit into f32.
    #[error("splat {splat} of luminance {luminance} would overflow; lower the gain or the exponent")]
    Overflow {
        /// Index of the first such splat.
        splat: usize,
        /// Its luminance before the edit.
        luminance: f32,
    },
}

impl Splats {
    /// Luminance (R + G + B, normalised units) of splat `i` by its degree-0 term: the same from everywhere.
    pub fn base_luminance(&self, i: usize) -> f32 {
        match self.color_model {
            ColorModel::Sh { .. } => self.sh_of(i)[..3].iter().map(|k| (SH_OFFSET + C0 * k).max(0.0)).sum(),
            ColorModel::Lcd { activation, .. } => activation.apply(self.raw_luminance_of(i)[0]),
        }
    }
}

impl Selection {
    /// Whether a splat of this luminance is selected.
    pub fn contains(self, luminance: f32) -> bool {
        match self {
            Self::All => true,
            Self::LuminanceRange { min, max } => min <= luminance && luminance < max,
        }
    }
}

impl Edit {
    /// Applies the edit to the selected splats and returns their number.
    ///
    /// # Errors
    /// [`EditError`]; the splats are unchanged then.
    pub fn apply(self, selection: Selection, splats: &mut Splats) -> Result<usize, EditError> {
        self.check()?;
        let (k, m) = (3 * splats.color_model.sh_coefficients(), splats.color_model.luminance_coefficients());
        let (mut sh, mut raw) = (splats.sh.clone(), splats.raw_luminance.clone());
        let mut selected = 0;
        for i in 0..splats.len() {
            let luminance = splats.base_luminance(i);
            if !selection.contains(luminance) {
                continue;
            }
            selected += 1;
            let Some(factor) = self.factor(luminance) else { continue };
            let (sh, raw) = (&mut sh[i * k..(i + 1) * k], &mut raw[i * m..(i + 1) * m]);
            match splats.color_model {
                ColorModel::Sh { .. } => scale_sh(sh, factor),
                ColorModel::Lcd { activation, .. } => scale_luminance(splats.color_model, activation, raw, factor),
            }
            if sh.iter().chain(raw.iter()).any(|v| !v.is_finite()) {
                return Err(EditError::Overflow { splat: i, luminance });
            }
        }
        (splats.sh, splats.raw_luminance) = (sh, raw);
        Ok(selected)
    }

    fn check(self) -> Result<(), EditError> {
        let in_range = |name, found: f32, lowest_allowed: bool, expected| {
            let fits = found.is_finite() && (found > 0.0 || lowest_allowed && found == 0.0);
            if fits { Ok(()) } else { Err(EditError::Parameter { name, found, expected }) }
        };
        match self {
            Self::Gain(gain) => in_range("gain", gain, true, "a finite number, 0 or more"),
            Self::Power { exponent, pivot } => {
                in_range("exponent", exponent, false, "a finite number above 0")?;
                in_range("pivot", pivot, false, "a finite number above 0")
            }
        }
    }

    /// L' / L; `None` where it does not exist.
    fn factor(self, luminance: f32) -> Option<f32> {
        match self {
            Self::Gain(gain) => Some(gain),
            Self::Power { exponent, pivot } => (luminance > 0.0).then(|| (luminance / pivot).powf(exponent - 1.0)),
        }
    }
}

/// `sh [K,3]` such that 1/2 + sum k Y becomes `factor` times that.
fn scale_sh(sh: &mut [f32], factor: f32) {
    for value in sh.iter_mut() {
        *value *= factor;
    }
    for dc in &mut sh[..3] {
        *dc += (factor - 1.0) * (SH_OFFSET / C0);
    }
}

/// `raw [M]` such that the activated luminance becomes `factor` times itself.
fn scale_luminance(model: ColorModel, activation: Activation, raw: &mut [f32], factor: f32) {
    let Some((constant, rest)) = raw.split_first_mut() else { return };
    let before = *constant;
    let rest_factor = match activation {
        // Homogeneous: the whole of it scales, below zero too.
        Activation::Relu => {
            *constant *= factor;
            factor
        }
        // A factor is a shift of the constant.
        Activation::Exp => {
            *constant = model.map_luminance(before, |l| l * factor).unwrap_or(before);
            1.0
        }
        // g(l') = f g(l) at the constant, and f g'(l) dl = g'(l') dl' next to it.
        Activation::Softplus => {
            *constant = model.map_luminance(before, |l| l * factor).unwrap_or(before);
            factor * activation.derivative(before) / activation.derivative(*constant)
        }
    };
    for value in rest {
        *value *= rest_factor;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::Splat;

    fn lcd(luminance_degree: u8, activation: Activation) -> ColorModel {
        ColorModel::Lcd { chroma_degree: 3, luminance_degree, activation }
    }

    /// Models whose gain is exact.
    fn exact_models() -> Vec<ColorModel> {
        let mut models = vec![ColorModel::Sh { degree: 0 }, ColorModel::Sh { degree: 3 }, ColorModel::Sh { degree: 5 }];
        models.extend([Activation::Softplus, Activation::Exp, Activation::Relu].map(|a| lcd(0, a)));
        models.extend([lcd(2, Activation::Exp), lcd(3, Activation::Relu)]);
        models
    }

    /// Splats of luminance around `2^ev`, with view dependence.
    fn splats(model: ColorModel, evs: &[f32], wobble: f32) -> Splats {
        let mut splats = Splats::empty(model);
        for (n, ev) in evs.iter().enumerate() {
            let l = ev.exp2();
            let (dc, raw0) = model.constant([0.5 * l, 0.3 * l, 0.2 * l]);
            let noise = |i: usize, size: f32| ((i * 31 + n * 7) as f32 * 1.7).sin() * size;
            let sh_size = if matches!(model, ColorModel::Sh { .. }) { wobble * l } else { wobble };
            let mut sh: Vec<f32> = (0..3 * model.sh_coefficients()).map(|i| noise(i, sh_size)).collect();
            sh[..3].copy_from_slice(&dc);
            let mut raw: Vec<f32> = (0..model.luminance_coefficients()).map(|i| noise(i + 5, wobble)).collect();
            if let Some(first) = raw.first_mut() {
                *first = raw0;
            }
            let splat = Splat {
                position: [0.0; 3],
                rotation: [1.0, 0.0, 0.0, 0.0],
                log_scale: [0.0; 3],
                opacity_logit: 0.0,
                sh: &sh,
                raw_luminance: &raw,
            };
            splats.push(&splat);
        }
        splats
    }

    const DIRECTIONS: [[f32; 3]; 4] = [[1.0, 0.0, 0.0], [0.0, 0.6, 0.8], [-0.48, 0.64, -0.6], [0.0, 0.0, -1.0]];

    /// f32 tolerance: relative, plus the cancellation of the offset of 1/2 in `Sh` and the floor of luminances.
    fn close(found: f32, expected: f32, factor: f32) -> bool {
        (found - expected).abs() < 2e-5 * expected + 3e-6 * (1.0 + factor)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn gain_scales_radiance_in_every_direction(gain_ev in -8f32..8.0, ev in -10f32..8.0) {
            let gain = gain_ev.exp2();
            for model in exact_models() {
                let before = splats(model, &[ev, ev + 1.0], 0.05);
                let mut after = before.clone();
                prop_assert_eq!(Edit::Gain(gain).apply(Selection::All, &mut after), Ok(2));
                for i in 0..2 {
                    for direction in DIRECTIONS {
                        let (a, b) = (after.radiance(i, direction), before.radiance(i, direction));
                        for c in 0..3 {
                            let expected = gain * b[c];
                            prop_assert!(close(a[c], expected, gain), "{}: {} expected {}", model.name(), a[c], expected);
                        }
                    }
                }
            }
        }

        #[test]
        fn power_maps_the_base_luminance_and_keeps_the_pivot(exponent in 0.3f32..2.0, ev in -6f32..6.0) {
            for model in exact_models() {
                let pivot = 0.7;
                let mut after = splats(model, &[ev], 0.0);
                let luminance = after.base_luminance(0);
                Edit::Power { exponent, pivot }.apply(Selection::All, &mut after).unwrap();
                let expected = pivot * (luminance / pivot).powf(exponent);
                prop_assert!(close(after.base_luminance(0), expected, expected / luminance), "{}", model.name());
            }
        }

        /// Softplus above degree 0: the error is second order in the view-dependent part.
        #[test]
        fn gain_of_view_dependent_softplus_is_first_order_exact(gain_ev in -4f32..4.0, ev in -6f32..6.0) {
            let gain = gain_ev.exp2();
            let before = splats(lcd(2, Activation::Softplus), &[ev], 0.02);
            let mut after = before.clone();
            Edit::Gain(gain).apply(Selection::All, &mut after).unwrap();
            for direction in DIRECTIONS {
                let (a, b) = (after.radiance(0, direction), before.radiance(0, direction));
                for c in 0..3 {
                    prop_assert!((a[c] - gain * b[c]).abs() <= 0.01 * gain * b[c] + 1e-6, "{} {}", a[c], gain * b[c]);
                }
            }
        }
    }

    #[test]
    fn chromaticity_and_geometry_keep_their_bits() {
        for activation in [Activation::Softplus, Activation::Exp, Activation::Relu] {
            let before = splats(lcd(2, activation), &[-4.0, 0.0, 5.0], 0.1);
            let mut after = before.clone();
            for edit in [Edit::Gain(7.3), Edit::Power { exponent: 0.4, pivot: 0.2 }] {
                edit.apply(Selection::All, &mut after).unwrap();
            }
            assert_ne!(after.raw_luminance, before.raw_luminance);
            let restored = Splats { raw_luminance: before.raw_luminance.clone(), ..after };
            assert_eq!(restored, before);
        }
    }

    #[test]
    fn only_selected_splats_change() {
        for model in exact_models() {
            let before = splats(model, &[-5.0, 0.0, 5.0], 0.01);
            let mut after = before.clone();
            let range = Selection::LuminanceRange { min: 0.5, max: 2.0 };
            assert_eq!(Edit::Gain(3.0).apply(range, &mut after), Ok(1), "{}", model.name());
            for i in 0..3 {
                let same = after.sh_of(i) == before.sh_of(i) && after.raw_luminance_of(i) == before.raw_luminance_of(i);
                assert_eq!(same, i != 1);
            }
        }
    }

    #[test]
    fn black_relu_splats_stay_black() {
        let mut after = splats(lcd(0, Activation::Relu), &[0.0], 0.0);
        after.raw_luminance[0] = -3.0;
        Edit::Power { exponent: 0.5, pivot: 1.0 }.apply(Selection::All, &mut after).unwrap();
        assert_eq!(after.raw_luminance[0], -3.0);
        Edit::Gain(0.0).apply(Selection::All, &mut after).unwrap();
        assert_eq!(after.base_luminance(0), 0.0);
    }

    #[test]
    fn parameters_out_of_range_and_overflow_leave_the_splats_alone() {
        for model in exact_models() {
            let before = splats(model, &[5.0], 0.01);
            let mut after = before.clone();
            let edits = [
                Edit::Gain(-1.0),
                Edit::Gain(f32::NAN),
                Edit::Power { exponent: 0.0, pivot: 1.0 },
                Edit::Power { exponent: 2.0, pivot: f32::INFINITY },
                Edit::Gain(f32::MAX),
            ];
            for edit in edits {
                assert!(edit.apply(Selection::All, &mut after).is_err(), "{edit:?} {}", model.name());
                assert_eq!(after, before);
            }
        }
    }
}
