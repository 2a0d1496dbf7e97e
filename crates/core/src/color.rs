//! The colour model: how a splat's coefficients become radiance towards a viewer. Methods differ in
//! nothing else.
//!
//! In: `sh [K,3]` and `raw_luminance [M]` of one splat, unit direction from the camera to the
//! splat. Out: linear RGB radiance >= 0, in the scene's normalised units, unbounded above.
//! - [`ColorModel::Sh`]: max(0, 1/2 + sum_m k_m Y_m(v)) (Kerbl et al. 2023, with its offset).
//! - [`ColorModel::Lcd`]: L(v) q(v) with q = (r + e) / (sum r + 3 e), r = max(0, sum_m k_m Y_m(v))
//!   (LCD-GS eq. 4) and L = g(l_0 + sum_{m>0} l_m Y_m(v)). q sums to 1, so L is the splat's
//!   R + G + B. The paper uses luminance degree 0. [`DEAD_CHROMA_FLOOR`] is e.

mod activation;

use serde::{Deserialize, Serialize};

use self::activation::scale_luminance;
pub use self::activation::{Activation, MAX_EXP_ARGUMENT};
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
    /// Luminance times chromaticity: LCD-GS.
    Lcd {
        /// Degree of the chromaticity's harmonics, 0 to 5.
        chroma_degree: u8,
        /// Degree of the luminance's harmonics, 0 to 3; 0 is the paper.
        luminance_degree: u8,
        /// Map of the raw luminance to a positive number.
        activation: Activation,
    },
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
    /// Returns the highest degree of any of the model's harmonics.
    pub fn max_degree(self) -> usize {
        self.sh_degree().max(self.luminance_degree())
    }

    /// Returns the degree of the RGB or chromaticity harmonics.
    pub fn sh_degree(self) -> usize {
        match self {
            Self::Sh { degree } => degree.into(),
            Self::Lcd { chroma_degree, .. } => chroma_degree.into(),
        }
    }

    /// Returns the degree of the luminance's harmonics; 0 for a model without luminance.
    pub fn luminance_degree(self) -> usize {
        match self {
            Self::Sh { .. } => 0,
            Self::Lcd { luminance_degree, .. } => luminance_degree.into(),
        }
    }

    /// Returns K, the number of harmonics per channel of `Splats::sh`.
    pub fn sh_coefficients(self) -> usize {
        sh::coefficients(self.sh_degree())
    }

    /// Returns M, the number of values of `Splats::raw_luminance` per splat (0 for [`Self::Sh`]).
    pub fn luminance_coefficients(self) -> usize {
        match self {
            Self::Sh { .. } => 0,
            Self::Lcd { luminance_degree, .. } => sh::coefficients(luminance_degree.into()),
        }
    }

    /// Returns the number of colour parameters per splat.
    pub fn parameters(self) -> usize {
        3 * self.sh_coefficients() + self.luminance_coefficients()
    }

    /// Returns whether the degrees are within the supported ranges.
    pub fn is_valid(self) -> bool {
        self.sh_degree() <= sh::MAX_DEGREE && self.luminance_degree() <= 3
    }

    /// Returns the short name: `sh3`, `lcd` (chroma degree 3, luminance degree 0, softplus),
    /// `lcd-c2-l1-exp`.
    pub fn name(self) -> String {
        match self {
            Self::Sh { degree } => format!("sh{degree}"),
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
        }
    }

    /// Returns the radiance towards a viewer. `sh(m, channel)` and `raw_luminance(m)` fetch the
    /// splat's coefficients.
    #[inline(always)]
    pub fn radiance<R: Real>(self, basis: &ColorBasis<R>, sh: impl Fn(usize, usize) -> R, raw_luminance: impl Fn(usize) -> R) -> [R; 3] {
        let response = self.response(basis, &sh);
        let zero = response[0].lift(0.0);
        match self {
            Self::Sh { .. } => each!([0, 1, 2] i => { let s = response[i]; (s + s.lift(SH_OFFSET)).max(zero) }),
            Self::Lcd { activation, .. } => {
                let luminance = activation.apply(self.raw_luminance(basis, &raw_luminance));
                let (chroma, _) = chromaticity(response);
                each!([0, 1, 2] i => { let q = chroma[i]; luminance * q })
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
        let response = self.response(basis, &sh);
        let zero = response[0].lift(0.0);
        let mut d_basis = [zero; MAX_COEFFICIENTS];
        let d_response = match self {
            Self::Sh { .. } => each!([0, 1, 2] c => (response[c] + zero.lift(SH_OFFSET)).if_positive(d_radiance[c], zero)),
            Self::Lcd { activation, .. } => {
                let raw = self.raw_luminance(basis, &raw_luminance);
                let luminance = activation.apply(raw);
                let (chroma, sum) = chromaticity(response);
                let along = d_radiance[0] * chroma[0] + d_radiance[1] * chroma[1] + d_radiance[2] * chroma[2];
                let d_raw = along * activation.derivative(raw);
                add_luminance(0, d_raw);
                let rest = 1..self.active_luminance(basis);
                for ((m, y), d_y) in rest.clone().zip(&basis.values[rest.clone()]).zip(&mut d_basis[rest]) {
                    add_luminance(m, d_raw * *y);
                    *d_y = d_raw * raw_luminance(m);
                }
                let scale = luminance / sum;
                each!([0, 1, 2] c => response[c].if_positive(scale * (d_radiance[c] - along), zero))
            }
        };
        let active = 0..self.active_sh(basis);
        for ((m, y), d_y) in active.clone().zip(&basis.values[active.clone()]).zip(&mut d_basis[active]) {
            for (c, d_response) in d_response.iter().enumerate() {
                add_sh(m, c, *d_response * *y);
                *d_y = d_response.mul_add(sh(m, c), *d_y);
            }
        }
        let v = basis.direction;
        let g = sh::basis_gradient(basis.active_degree.min(self.max_degree()), v, &d_basis);
        let radial = g[0] * v[0] + g[1] * v[1] + g[2] * v[2];
        each!([0, 1, 2] i => g[i] - radial * v[i])
    }

    /// Returns the coefficients `(sh DC [3], raw luminance)` of a splat that emits `rgb` in every
    /// direction.
    ///
    /// The chromaticity's DC sums to 1 / C0, so that its normaliser starts at 1.
    pub fn constant(self, rgb: [f32; 3]) -> ([f32; 3], f32) {
        match self {
            Self::Sh { .. } => (rgb.map(|c| (c - SH_OFFSET) / sh::C0), 0.0),
            Self::Lcd { activation, .. } => {
                let rgb = rgb.map(|c| c.max(0.0));
                let luminance: f32 = rgb.iter().sum();
                let chroma = if luminance > 0.0 { rgb.map(|c| c / luminance) } else { [1.0 / 3.0; 3] };
                (each!([0, 1, 2] i => { let q = chroma[i]; q / sh::C0 }), activation.inverse(luminance))
            }
        }
    }

    /// Returns whether luminance is a separate parameter, which can change without changing
    /// chromaticity.
    pub fn separates_luminance(self) -> bool {
        match self {
            Self::Sh { .. } => false,
            Self::Lcd { .. } => true,
        }
    }

    /// Returns a splat's radiance from its degree-0 terms alone: the same in every direction.
    pub fn base_radiance(self, sh: &[f32], raw_luminance: &[f32]) -> [f32; 3] {
        self.radiance(&ColorBasis::new(0, [0.0, 0.0, 1.0]), |m, c| sh[3 * m + c], |m| raw_luminance[m])
    }

    /// Returns R + G + B of [`Self::base_radiance`].
    pub fn base_luminance(self, sh: &[f32], raw_luminance: &[f32]) -> f32 {
        match self {
            Self::Sh { .. } => self.base_radiance(sh, raw_luminance).iter().sum(),
            Self::Lcd { activation, .. } => activation.apply(raw_luminance[0]),
        }
    }

    /// Multiplies a splat's radiance by `factor` in every direction, by changing its `sh [K,3]` and
    /// `raw_luminance [M]`.
    ///
    /// - [`Self::Sh`]: k' = f k, and the offset of 1/2 moves into the DC. Exact.
    /// - [`Self::Lcd`]: only the raw luminance changes; chromaticity coefficients stay
    ///   bit-identical. Exact for luminance degree 0, and for every degree with Exp and Relu. With
    ///   Softplus above degree 0, exact to first order in the view-dependent part. A factor of 0
    ///   leaves a luminance of 1e-8, or the old one if that was smaller (0 with Relu).
    pub fn scale_radiance(self, sh: &mut [f32], raw_luminance: &mut [f32], factor: f32) {
        match self {
            Self::Sh { .. } => {
                let (dc, rest) = sh.split_at_mut(3);
                // In f64, because the DC of a dark splat nearly cancels the offset.
                let (factor_exact, offset) = (f64::from(factor), f64::from(SH_OFFSET) / f64::from(sh::C0));
                dc.iter_mut().for_each(|dc| *dc = (factor_exact * (f64::from(*dc) + offset) - offset) as f32);
                rest.iter_mut().for_each(|value| *value *= factor);
            }
            Self::Lcd { activation, .. } => scale_luminance(activation, raw_luminance, factor),
        }
    }

    #[inline(always)]
    fn active_sh<R>(self, basis: &ColorBasis<R>) -> usize {
        sh::coefficients(basis.active_degree.min(self.sh_degree()))
    }

    #[inline(always)]
    fn active_luminance<R>(self, basis: &ColorBasis<R>) -> usize {
        sh::coefficients(basis.active_degree.min(self.luminance_degree()))
    }

    #[inline(always)]
    fn response<R: Real>(self, basis: &ColorBasis<R>, sh: &impl Fn(usize, usize) -> R) -> [R; 3] {
        let mut response = each!([0, 1, 2] c => sh(0, c) * basis.values[0]);
        let rest = 1..self.active_sh(basis);
        for (m, y) in rest.clone().zip(&basis.values[rest]) {
            for (c, value) in response.iter_mut().enumerate() {
                *value = sh(m, c).mul_add(*y, *value);
            }
        }
        response
    }

    /// Returns l(v) = l_0 + sum over m > 0 of l_m Y_m(v).
    ///
    /// The constant term is not multiplied by its basis value, so that the paper's parameter and
    /// learning rate keep their meaning.
    #[inline(always)]
    fn raw_luminance<R: Real>(self, basis: &ColorBasis<R>, raw: &impl Fn(usize) -> R) -> R {
        let mut sum = raw(0);
        let rest = 1..self.active_luminance(basis);
        for (m, y) in rest.clone().zip(&basis.values[rest]) {
            sum = raw(m).mul_add(*y, sum);
        }
        sum
    }
}

/// Returns the chromaticity and the normaliser it was divided by.
#[inline(always)]
fn chromaticity<R: Real>(response: [R; 3]) -> ([R; 3], R) {
    let floor = response[0].lift(DEAD_CHROMA_FLOOR);
    let r = each!([0, 1, 2] i => { let s = response[i]; s.max(s.lift(0.0)) + floor });
    let sum = r[0] + r[1] + r[2];
    (each!([0, 1, 2] i => { let value = r[i]; value / sum }), sum)
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
