//! One light: the formula of a colour model that is no sum of others.
//!
//! In: the coefficients of one splat, a basis. Out: radiance, and gradients. See [`super`] for the
//! formulas; a mix adds the radiance of several ([`super::Mix`]).

use super::activation::scale_luminance;
use super::{Activation, ColorBasis, ColorModel, DEAD_CHROMA_FLOOR, SH_OFFSET};
use crate::sh::{self, MAX_COEFFICIENTS};
use crate::{Real, each};

/// The luminance of LCD-GS.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct LuminanceTerm {
    /// Degree of its harmonics.
    pub(super) degree: u8,
    /// Map of the raw luminance to a positive number.
    pub(super) activation: Activation,
}

/// The quantity that the harmonics of a light hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Form {
    /// Radiance.
    Linear,
    /// The logarithm of radiance.
    Log,
    /// Chromaticity, beside a luminance.
    Chroma(LuminanceTerm),
}

/// A colour model of one light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Light {
    /// Degree of the harmonics of radiance, of its logarithm, or of chromaticity.
    pub(super) degree: u8,
    pub(super) form: Form,
}

impl Light {
    /// Returns the light as a colour model of its own.
    pub fn model(self) -> ColorModel {
        match self.form {
            Form::Linear => ColorModel::Sh { degree: self.degree },
            Form::Log => ColorModel::LogSh { degree: self.degree },
            Form::Chroma(LuminanceTerm { degree, activation }) => {
                ColorModel::Lcd { chroma_degree: self.degree, luminance_degree: degree, activation }
            }
        }
    }

    fn luminance(self) -> Option<LuminanceTerm> {
        match self.form {
            Form::Linear | Form::Log => None,
            Form::Chroma(term) => Some(term),
        }
    }

    /// Returns whether the harmonics are those of the radiance's logarithm.
    pub fn is_log(self) -> bool {
        self.form == Form::Log
    }

    /// Returns the degree of the RGB or chromaticity harmonics.
    pub fn sh_degree(self) -> usize {
        self.degree.into()
    }

    /// Returns the degree of the luminance's harmonics; 0 without a luminance.
    pub fn luminance_degree(self) -> usize {
        self.luminance().map_or(0, |term| term.degree.into())
    }

    /// Returns the map of the raw luminance; `None` without a luminance.
    pub fn activation(self) -> Option<Activation> {
        self.luminance().map(|term| term.activation)
    }

    /// Returns the highest degree of any of its harmonics.
    pub fn max_degree(self) -> usize {
        self.sh_degree().max(self.luminance_degree())
    }

    /// Returns the number of harmonics per channel.
    pub fn sh_coefficients(self) -> usize {
        sh::coefficients(self.sh_degree())
    }

    /// Returns the number of raw luminances, without the gain of a mix; 0 without a luminance.
    pub fn luminance_coefficients(self) -> usize {
        self.luminance().map_or(0, |term| sh::coefficients(term.degree.into()))
    }

    pub(super) fn is_valid(self) -> bool {
        self.sh_degree() <= sh::MAX_DEGREE && self.luminance_degree() <= 3
    }

    /// Returns the radiance towards a viewer. `sh(m, channel)` and `raw_luminance(m)` fetch the
    /// light's coefficients.
    #[inline(always)]
    pub fn radiance<R: Real>(self, basis: &ColorBasis<R>, sh: impl Fn(usize, usize) -> R, raw_luminance: impl Fn(usize) -> R) -> [R; 3] {
        let response = self.response(basis, &sh);
        let zero = response[0].lift(0.0);
        match self.form {
            Form::Linear => each!([0, 1, 2] i => { let s = response[i]; (s + s.lift(SH_OFFSET)).max(zero) }),
            Form::Log => each!([0, 1, 2] i => { let s = response[i]; Activation::Exp.apply(s + s.lift(SH_OFFSET)) }),
            Form::Chroma(LuminanceTerm { activation, .. }) => {
                let luminance = activation.apply(self.raw_luminance(basis, &raw_luminance));
                let (chroma, _) = chromaticity(response);
                each!([0, 1, 2] i => { let q = chroma[i]; luminance * q })
            }
        }
    }

    /// Computes the gradient of [`Self::radiance`], as [`super::ColorModel::backward`] does for all
    /// lights.
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
        let d_response = match self.form {
            Form::Linear => each!([0, 1, 2] c => (response[c] + zero.lift(SH_OFFSET)).if_positive(d_radiance[c], zero)),
            Form::Log => each!([0, 1, 2] c => d_radiance[c] * Activation::Exp.derivative(response[c] + zero.lift(SH_OFFSET))),
            Form::Chroma(LuminanceTerm { activation, .. }) => {
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

    /// Returns R + G + B of the degree-0 terms.
    pub(super) fn base_luminance(self, sh: &[f32], raw_luminance: &[f32]) -> f32 {
        match self.form {
            Form::Linear | Form::Log => {
                let basis = ColorBasis::new(0, [0.0, 0.0, 1.0]);
                self.radiance(&basis, |m, c| sh[3 * m + c], |m| raw_luminance[m]).iter().sum()
            }
            Form::Chroma(LuminanceTerm { activation, .. }) => activation.apply(raw_luminance[0]),
        }
    }

    /// Multiplies the radiance by `factor` in every direction: see [`ColorModel::scale_radiance`].
    pub(super) fn scale_radiance(self, sh: &mut [f32], raw_luminance: &mut [f32], factor: f32) {
        match self.form {
            Form::Linear => {
                let (dc, rest) = sh.split_at_mut(3);
                // In f64, because the DC of a dark splat nearly cancels the offset.
                let (factor_exact, offset) = (f64::from(factor), f64::from(SH_OFFSET) / f64::from(sh::C0));
                dc.iter_mut().for_each(|dc| *dc = (factor_exact * (f64::from(*dc) + offset) - offset) as f32);
                rest.iter_mut().for_each(|value| *value *= factor);
            }
            // Black has no logarithm and is the same in every direction.
            Form::Log if factor <= 0.0 => {
                let (dc, rest) = sh.split_at_mut(3);
                dc.iter_mut().for_each(|dc| *dc = dc.min(log_constant(0.0)));
                rest.fill(0.0);
            }
            Form::Log => {
                let shift = factor.ln() / sh::C0;
                sh.iter_mut().take(3).for_each(|dc| *dc += shift);
            }
            Form::Chroma(LuminanceTerm { activation, .. }) => scale_luminance(activation, raw_luminance, factor),
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

/// Returns the DC of log harmonics of a channel's radiance.
pub(super) fn log_constant(radiance: f32) -> f32 {
    (Activation::Exp.inverse(radiance) - SH_OFFSET) / sh::C0
}

/// Returns the chromaticity and the normaliser it was divided by.
#[inline(always)]
fn chromaticity<R: Real>(response: [R; 3]) -> ([R; 3], R) {
    let floor = response[0].lift(DEAD_CHROMA_FLOOR);
    let r = each!([0, 1, 2] i => { let s = response[i]; s.max(s.lift(0.0)) + floor });
    let sum = r[0] + r[1] + r[2];
    (each!([0, 1, 2] i => { let value = r[i]; value / sum }), sum)
}
