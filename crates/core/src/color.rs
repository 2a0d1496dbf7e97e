//! The colour model: how a splat's coefficients become radiance towards a viewer. Methods differ in
//! nothing else.
//!
//! In: `sh [K,3]` and `raw_luminance [M]` of one splat, unit direction from the camera to the
//! splat. Out: linear RGB radiance >= 0, in the scene's normalised units, unbounded above.
//! - [`ColorModel::Sh`]: max(0, 1/2 + sum_m k_m Y_m(v)) (Kerbl et al. 2023, with its offset).
//! - [`ColorModel::LogSh`]: exp(1/2 + sum_m k_m Y_m(v)), as methods have it that learn the exposure
//!   of captured images (HDR-GS, Cai et al. 2024; GaussHDR, Liu et al. 2025).
//! - [`ColorModel::Lcd`]: L(v) q(v) with q = (r + e) / (sum r + 3 e), r = max(0, sum_m k_m Y_m(v))
//!   (LCD-GS eq. 4) and L = g(l_0 + sum_{m>0} l_m Y_m(v)). q sums to 1, so L is the splat's
//!   R + G + B. The paper uses luminance degree 0. [`DEAD_CHROMA_FLOOR`] is e.
//! - [`ColorModel::Mix`]: sum_i g_i c_i(v), where each c_i is one of the above and g_i >= 0 is
//!   the splat's gain of light i.

mod activation;
mod light;
mod mix;

use serde::{Deserialize, Serialize};

pub use self::activation::{Activation, MAX_EXP_ARGUMENT, softplus};
pub use self::light::Light;
use self::light::{Form, LuminanceTerm, log_constant};
pub use self::mix::{Component, MAX_LIGHTS, Mix};
use crate::engine::EngineError;
use crate::sh::{self, MAX_COEFFICIENTS};
use crate::{Real, each};

/// Offset of [`ColorModel::Sh`], so that zero coefficients are mid-grey as in 3DGS.
pub const SH_OFFSET: f32 = 0.5;

/// Floor e of the chromaticity (r + e) / (sum r + 3 e).
///
/// If all three responses are <= 0, the paper's L1 normalisation is 0/0 and every gradient of the
/// splat vanishes: training can never recover it. With the floor such a splat is grey and keeps the
/// gradient of its luminance. Initial chromaticities sum to 1, so 1e-3 bounds the desaturation at
/// 0.3 %.
pub const DEAD_CHROMA_FLOOR: f32 = 1e-3;

/// The representation of radiance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum ColorModel {
    /// Spherical harmonics of RGB radiance: 3D Gaussian splatting.
    Sh {
        /// Degree 0 to 5.
        degree: u8,
    },
    /// Spherical harmonics of the natural logarithm of RGB radiance.
    LogSh {
        /// Degree 0 to 5.
        degree: u8,
    },
    /// Luminance times chromaticity: LCD-GS.
    Lcd {
        /// Degree of the chromaticity's harmonics, 0 to 5.
        chroma_degree: u8,
        /// Degree of the luminance's harmonics, 0 to 3; 0 is the paper.
        luminance_degree: u8,
        /// Map of the raw luminance to a positive number.
        activation: Activation,
    },
    /// The sum of several lights, each with a gain per splat: scenes of the same geometry under
    /// other light, added. See [`Mix`].
    Mix(Mix),
}

/// The harmonic basis evaluated at a splat's viewing direction.
pub struct ColorBasis<R> {
    /// Unit vector from the camera to the splat, world axes.
    pub direction: [R; 3],
    /// Basis values up to the active degree.
    pub values: [R; MAX_COEFFICIENTS],
    /// Active degree (training raises it step by step).
    pub active_degree: usize,
}

impl<R: Real> ColorBasis<R> {
    /// Evaluates the basis at `direction` up to `active_degree`.
    #[inline(always)]
    pub fn new(active_degree: usize, direction: [R; 3]) -> Self {
        let mut values = [direction[0].lift(0.0); MAX_COEFFICIENTS];
        sh::basis(active_degree, direction, &mut values);
        Self { direction, values, active_degree }
    }
}

impl ColorModel {
    /// Returns the model's only light; `None` for a mix.
    #[inline(always)]
    pub fn single(self) -> Option<Light> {
        match self {
            Self::Sh { degree } => Some(Light { degree, form: Form::Linear }),
            Self::LogSh { degree } => Some(Light { degree, form: Form::Log }),
            Self::Lcd { chroma_degree, luminance_degree, activation } => {
                Some(Light { degree: chroma_degree, form: Form::Chroma(LuminanceTerm { degree: luminance_degree, activation }) })
            }
            Self::Mix(_) => None,
        }
    }

    /// Returns the number of lights: 1, unless the model is a mix.
    pub fn lights(self) -> usize {
        if let Self::Mix(mix) = self { mix.len() } else { 1 }
    }

    /// Returns light `index` with the places of its coefficients; the last one if there are fewer.
    #[inline(always)]
    pub fn component(self, index: usize) -> Component {
        match self {
            Self::Sh { degree } => Component::alone(Light { degree, form: Form::Linear }),
            Self::LogSh { degree } => Component::alone(Light { degree, form: Form::Log }),
            Self::Lcd { chroma_degree, luminance_degree, activation } => {
                let form = Form::Chroma(LuminanceTerm { degree: luminance_degree, activation });
                Component::alone(Light { degree: chroma_degree, form })
            }
            Self::Mix(mix) => mix.component(index),
        }
    }

    /// Returns the lights with the places of their coefficients.
    pub fn components(self) -> impl Iterator<Item = Component> {
        (0..self.lights()).map(move |index| self.component(index))
    }

    /// Checks that the model can be trained: a mix is not.
    ///
    /// # Errors
    /// [`EngineError::Invalid`].
    pub fn check_trainable(self) -> Result<(), EngineError> {
        match self {
            Self::Sh { .. } | Self::LogSh { .. } | Self::Lcd { .. } => Ok(()),
            Self::Mix(_) => Err(EngineError::invalid(
                "the scene is a mix of lights, expected a scene of one light: train the scenes that were mixed, and mix them again",
            )),
        }
    }

    /// Returns the highest degree of any of the model's harmonics.
    pub fn max_degree(self) -> usize {
        self.sh_degree().max(self.luminance_degree())
    }

    /// Returns the degree of the RGB or chromaticity harmonics; of a mix, the highest.
    pub fn sh_degree(self) -> usize {
        match self {
            Self::Sh { degree } | Self::LogSh { degree } => degree.into(),
            Self::Lcd { chroma_degree, .. } => chroma_degree.into(),
            Self::Mix(mix) => mix.lights().map(Light::sh_degree).max().unwrap_or(0),
        }
    }

    /// Returns the degree of the luminance's harmonics; 0 for a model without luminance; of a mix,
    /// the highest.
    pub fn luminance_degree(self) -> usize {
        match self {
            Self::Sh { .. } | Self::LogSh { .. } => 0,
            Self::Lcd { luminance_degree, .. } => luminance_degree.into(),
            Self::Mix(mix) => mix.lights().map(Light::luminance_degree).max().unwrap_or(0),
        }
    }

    /// Returns K, the number of harmonics per channel of `Splats::sh`; of a mix, those of all
    /// lights.
    pub fn sh_coefficients(self) -> usize {
        match self {
            Self::Sh { .. } | Self::LogSh { .. } | Self::Lcd { .. } => sh::coefficients(self.sh_degree()),
            Self::Mix(mix) => mix.lights().map(Light::sh_coefficients).sum(),
        }
    }

    /// Returns M, the number of values of `Splats::raw_luminance` per splat: 0 for [`Self::Sh`]
    /// and [`Self::LogSh`]; of a mix, the gain and the raw luminance of each light.
    pub fn luminance_coefficients(self) -> usize {
        match self {
            Self::Sh { .. } | Self::LogSh { .. } => 0,
            Self::Lcd { luminance_degree, .. } => sh::coefficients(luminance_degree.into()),
            Self::Mix(mix) => mix.lights().map(|light| 1 + light.luminance_coefficients()).sum(),
        }
    }

    /// Returns the number of colour parameters per splat.
    pub fn parameters(self) -> usize {
        3 * self.sh_coefficients() + self.luminance_coefficients()
    }

    /// Returns whether the degrees are within the supported ranges.
    pub fn is_valid(self) -> bool {
        self.components().all(|component| component.light.is_valid())
    }

    /// Returns the short name: `sh3`, `logsh3`, `lcd` (chroma degree 3, luminance degree 0,
    /// softplus), `lcd-c2-l1-exp`, `lcd+sh3` for a mix.
    pub fn name(self) -> String {
        match self {
            Self::Sh { degree } => format!("sh{degree}"),
            Self::LogSh { degree } => format!("logsh{degree}"),
            Self::Lcd { chroma_degree, luminance_degree, activation } => {
                let mut name = String::from("lcd");
                if chroma_degree != 3 || luminance_degree != 0 {
                    name += &format!("-c{chroma_degree}-l{luminance_degree}");
                }
                match activation {
                    Activation::Softplus => name,
                    Activation::Exp => name + "-exp",
                    Activation::Relu => name + "-relu",
                }
            }
            Self::Mix(mix) => mix.lights().map(|light| light.model().name()).collect::<Vec<_>>().join("+"),
        }
    }

    /// Returns the radiance towards a viewer. `sh(m, channel)` and `raw_luminance(m)` fetch the
    /// splat's coefficients.
    #[inline(always)]
    pub fn radiance<R: Real>(self, basis: &ColorBasis<R>, sh: impl Fn(usize, usize) -> R, raw_luminance: impl Fn(usize) -> R) -> [R; 3] {
        match self.single() {
            Some(light) => light.radiance(basis, sh, raw_luminance),
            None => {
                // A closure would not be inlined.
                let zero = basis.direction[0].lift(0.0);
                let mut sum = [zero; 3];
                for component in self.components() {
                    let radiance = component.radiance(basis, &sh, &raw_luminance);
                    let gain = component.gain(&raw_luminance).unwrap_or(zero.lift(1.0));
                    sum = each!([0, 1, 2] i => { let c = radiance[i]; gain.mul_add(c, sum[i]) });
                }
                sum
            }
        }
    }

    /// Computes the gradient of [`Self::radiance`] and returns the part by the viewing direction,
    /// tangential to the sphere.
    ///
    /// In: `d_radiance`. Out: `add_sh(m, channel, gradient)` and `add_luminance(m, gradient)`,
    /// called once for each coefficient up to the active degree.
    #[inline(always)]
    pub fn backward<R: Real>(
        self,
        basis: &ColorBasis<R>,
        sh: impl Fn(usize, usize) -> R,
        raw_luminance: impl Fn(usize) -> R,
        d_radiance: [R; 3],
        mut add_sh: impl FnMut(usize, usize, R),
        mut add_luminance: impl FnMut(usize, R),
    ) -> [R; 3] {
        if let Some(light) = self.single() {
            return light.backward(basis, sh, raw_luminance, d_radiance, add_sh, add_luminance);
        }
        let mut d_direction = [basis.direction[0].lift(0.0); 3];
        for component in self.components() {
            let Component { light, sh: first_sh, luminance: first_luminance, gain } = component;
            let g = component.gain(&raw_luminance).unwrap_or(d_radiance[0].lift(1.0));
            if let Some(gain) = gain {
                let c = component.radiance(basis, &sh, &raw_luminance);
                add_luminance(gain, d_radiance[0] * c[0] + d_radiance[1] * c[1] + d_radiance[2] * c[2]);
            }
            let d = light.backward(
                basis,
                |m, c| sh(first_sh + m, c),
                |m| raw_luminance(first_luminance + m),
                each!([0, 1, 2] i => { let d = d_radiance[i]; g * d }),
                |m, c, gradient| add_sh(first_sh + m, c, gradient),
                |m, gradient| add_luminance(first_luminance + m, gradient),
            );
            d_direction = each!([0, 1, 2] i => d_direction[i] + d[i]);
        }
        d_direction
    }

    /// Returns the coefficients `(sh DC [3], raw luminance)` of a splat that emits `rgb` in every
    /// direction; of a mix, those of its first light.
    ///
    /// The chromaticity's DC sums to 1 / C0, so that its normaliser starts at 1.
    pub fn constant(self, rgb: [f32; 3]) -> ([f32; 3], f32) {
        let light = self.component(0).light;
        match light.activation() {
            None if light.is_log() => (rgb.map(log_constant), 0.0),
            None => (rgb.map(|c| (c - SH_OFFSET) / sh::C0), 0.0),
            Some(activation) => {
                let rgb = rgb.map(|c| c.max(0.0));
                let luminance: f32 = rgb.iter().sum();
                let chroma = if luminance > 0.0 { rgb.map(|c| c / luminance) } else { [1.0 / 3.0; 3] };
                (each!([0, 1, 2] i => { let q = chroma[i]; q / sh::C0 }), activation.inverse(luminance))
            }
        }
    }

    /// Returns whether luminance is a separate parameter, which can change without changing
    /// chromaticity. A mix has gains.
    pub fn separates_luminance(self) -> bool {
        match self {
            Self::Sh { .. } | Self::LogSh { .. } => false,
            Self::Lcd { .. } | Self::Mix(_) => true,
        }
    }

    /// Returns a splat's radiance from its degree-0 terms alone: the same in every direction.
    pub fn base_radiance(self, sh: &[f32], raw_luminance: &[f32]) -> [f32; 3] {
        self.radiance(&ColorBasis::new(0, [0.0, 0.0, 1.0]), |m, c| sh[3 * m + c], |m| raw_luminance[m])
    }

    /// Returns R + G + B of [`Self::base_radiance`].
    pub fn base_luminance(self, sh: &[f32], raw_luminance: &[f32]) -> f32 {
        self.components().map(|component| component.base_luminance(sh, raw_luminance)).sum()
    }

    /// Multiplies a splat's radiance by `factor` in every direction, by changing its `sh [K,3]` and
    /// `raw_luminance [M]`.
    ///
    /// - [`Self::Sh`]: k' = f k, and the offset of 1/2 moves into the DC. Exact.
    /// - [`Self::LogSh`]: ln f is added to the DC. Exact; a factor of 0 leaves 1e-8 or less.
    /// - [`Self::Lcd`]: only the raw luminance changes; chromaticity coefficients stay
    ///   bit-identical. Exact for luminance degree 0, and for every degree with Exp and Relu. With
    ///   Softplus above degree 0, exact to first order in the view-dependent part. A factor of 0
    ///   leaves a luminance of 1e-8, or the old one if that was smaller (0 with Relu).
    /// - [`Self::Mix`]: only the gains change. Exact.
    pub fn scale_radiance(self, sh: &mut [f32], raw_luminance: &mut [f32], factor: f32) {
        match self.single() {
            Some(light) => light.scale_radiance(sh, raw_luminance, factor),
            None => self.components().for_each(|component| component.scale(raw_luminance, factor)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lobed(activation: Activation, constant: f32, lobe: f32) -> (ColorModel, [f32; 4]) {
        (ColorModel::Lcd { chroma_degree: 0, luminance_degree: 1, activation }, [constant, lobe, -lobe, 0.5 * lobe])
    }

    /// Returns R + G + B in some directions.
    fn luminances(model: ColorModel, raw: &[f32]) -> Vec<f64> {
        let towards = |v| model.radiance(&ColorBasis::new(1, v), |_, _| 1.0f32, |m| raw[m]).iter().map(|c| f64::from(*c)).sum();
        [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.6, 0.8], [-0.48, 0.64, -0.6]].map(towards).to_vec()
    }

    #[test]
    fn a_dark_constant_under_bright_lobes_scales_in_every_direction() {
        for (activation, constant, lobe) in [
            (Activation::Exp, -30.0, 30.0),
            (Activation::Exp, -10.0, 3.0),
            (Activation::Exp, 55.0, 2.0),
            (Activation::Softplus, -30.0, 5.0),
            (Activation::Softplus, -120.0, 9.0),
            (Activation::Softplus, -18.0, 0.5),
        ] {
            for factor in [0.5f32, 1e-6, 1.0, 3.0] {
                let (model, before) = lobed(activation, constant, lobe);
                let mut after = before;
                model.scale_radiance(&mut [1.0; 3], &mut after, factor);
                for (found, expected) in luminances(model, &after).iter().zip(luminances(model, &before)) {
                    let expected = f64::from(factor) * expected;
                    // f32 resolves parameters of 30, and so their exponentials, to 2e-6 only; it
                    // hardly resolves numbers below 1e-38.
                    assert!(
                        (found - expected).abs() <= 5e-5 * expected + 1e-37,
                        "{activation:?} {constant} x {factor}: {found} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_factor_of_zero_leaves_no_light_and_makes_none() {
        for (activation, constant) in
            [(Activation::Exp, -30.0), (Activation::Exp, 4.0), (Activation::Softplus, -30.0), (Activation::Softplus, 4.0)]
        {
            let (model, before) = lobed(activation, constant, 20.0);
            let mut after = before;
            model.scale_radiance(&mut [1.0; 3], &mut after, 0.0);
            assert!(after[0] <= before[0] && luminances(model, &after).iter().all(|l| *l < 1.1e-8), "{activation:?} {constant}: {after:?}");
        }
    }
}
