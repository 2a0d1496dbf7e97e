//! Luminance maps on spherical harmonics of radiance: evaluate, map, fit again.
//!
//! In: `sh [K,3]` of a splat. Out: a gain, and the harmonics nearest to the mapped radiance before
//! it, by least squares over [`DIRECTIONS`] fixed directions. The gain is the factor of the mean,
//! so that cut-offs, which follow the radiance before it, stay; and more where the result would be
//! brighter than the splat was in some direction, so that it reaches no pixel that it did not.
//! These harmonics do not separate luminance and hue, so a map other than a plain gain shifts hue:
//! [`ShMap::Channels`] by definition, and both modes by what harmonics of the same degree cannot
//! represent.
//!
//! Harmonics of the radiance's logarithm ([`crate::ColorModel::LogSh`]) are fitted to the logarithm
//! of the mapped radiance, which a power changes exactly.
//!
//! Degenerate: a channel that is negative in a direction, and so clipped to 0 there, is scaled by
//! the splat's factor at degree 0. It stays clipped, and a map that changes nothing changes no
//! coefficient.

use super::MapChain;
use crate::sh::{self, MAX_COEFFICIENTS};
use crate::{ColorModel, Cutoffs, MAX_EXP_ARGUMENT, SH_OFFSET, least_squares, luminance_sum};

/// Number of fixed directions: four for each harmonic of the highest degree.
const DIRECTIONS: usize = 4 * MAX_COEFFICIENTS;

/// The quantity that a luminance map acts on if the model does not separate luminance
/// ([`crate::ColorModel::Sh`], [`crate::ColorModel::LogSh`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ShMap {
    /// The luminance of the colour in each direction; channel ratios are kept. The most accurate
    /// choice.
    #[default]
    Luminance,
    /// Each channel by itself, as c' = c^beta of RGB values (LCD-GS's comparison with 3DGS). Grey
    /// is mapped as by [`Self::Luminance`].
    Channels,
}

/// A basis of harmonics in fixed directions, and its pseudo-inverse.
pub(super) struct Refit {
    model: ColorModel,
    scale: FitScale,
    /// Radiance up to which cut-offs are the same, normalised units.
    same_reach: f32,
    /// Number K of coefficients.
    coefficients: usize,
    /// Basis values, one row per direction.
    values: Vec<[f64; MAX_COEFFICIENTS]>,
    /// Transpose of (A^T A)^-1 A^T, one row per direction.
    fit: Vec<[f64; MAX_COEFFICIENTS]>,
}

/// The scale on which radiance is a sum of harmonics.
#[derive(Clone, Copy, PartialEq, Eq)]
enum FitScale {
    Linear,
    Log,
}

impl FitScale {
    /// Returns the radiance of a value, not clipped at 0.
    fn radiance(self, value: f64) -> f32 {
        match self {
            Self::Linear => value as f32,
            Self::Log => value.min(MAX_EXP_ARGUMENT.into()).exp() as f32,
        }
    }

    /// Returns the value of a radiance.
    fn value(self, radiance: f32) -> f64 {
        match self {
            Self::Linear => radiance.into(),
            Self::Log => f64::from(radiance.max(f32::MIN_POSITIVE)).ln(),
        }
    }
}

/// The map of one splat.
pub(super) struct SplatMap<'m> {
    pub(super) chain: &'m MapChain<'m>,
    pub(super) kind: ShMap,
    /// Weight of the selection.
    pub(super) weight: f32,
    /// Luminance of one unit of the harmonics, in those of the data set.
    pub(super) scale: f32,
    /// Factor of the degree-0 term.
    pub(super) base_factor: f32,
}

impl SplatMap<'_> {
    fn factor(&self, luminance: f32) -> f32 {
        self.chain.factor(luminance * self.scale, self.weight).unwrap_or(self.base_factor)
    }

    /// Returns the factor of the mean, where there is any light after it.
    fn gain(&self) -> f32 {
        if self.base_factor > 0.0 { self.base_factor } else { 1.0 }
    }

    /// Maps radiance that is not clipped, without the gain.
    fn apply(&self, rgb: [f32; 3]) -> [f32; 3] {
        let shared = match self.kind {
            ShMap::Luminance => Some(self.factor(luminance_sum(rgb.map(|c| c.max(0.0))))),
            ShMap::Channels => None,
        };
        rgb.map(|c| {
            let factor = match shared {
                _ if c <= 0.0 => self.base_factor,
                Some(factor) => factor,
                // Grey of luminance L has channels of L / 3.
                None => self.factor(3.0 * c),
            };
            c * (factor / self.gain())
        })
    }
}

impl Refit {
    /// Makes the basis for a model that does not separate luminance.
    pub(super) fn new(model: ColorModel, cutoffs: &Cutoffs) -> Self {
        let scale = if matches!(model, ColorModel::LogSh { .. }) { FitScale::Log } else { FitScale::Linear };
        let degree = model.sh_degree();
        let coefficients = sh::coefficients(degree);
        let basis = |direction: [f32; 3]| {
            let mut values = [0.0; MAX_COEFFICIENTS];
            sh::basis(degree, direction.map(f64::from), &mut values);
            values
        };
        let values: Vec<_> = sh::lattice(DIRECTIONS).into_iter().map(basis).collect();
        let fit = pseudo_inverse(&values, coefficients);
        Self { model, scale, same_reach: cutoffs.min_contribution / cutoffs.min_alpha, coefficients, values, fit }
    }

    /// Replaces `sh [K,3]` and returns the gain and the change of chromaticity: the sum of the
    /// channels' differences, 0 to 2, averaged over directions.
    pub(super) fn apply(&self, sh: &mut [f32], map: &SplatMap<'_>) -> (f32, f64) {
        let before: Vec<[f32; 3]> = self.values.iter().map(|y| self.radiance(sh, y)).collect();
        let targets: Vec<[f32; 3]> = before.iter().map(|rgb| map.apply(*rgb)).collect();
        // Exact comparison: what the map does not change keeps its bits.
        if targets == before {
            return (map.gain(), 0.0);
        }
        let mut fitted = [[0f64; 3]; MAX_COEFFICIENTS];
        for (target, fit) in targets.iter().zip(&self.fit) {
            let target = target.map(|c| self.scale.value(c) - f64::from(SH_OFFSET));
            for (k, fit) in fitted.iter_mut().zip(fit).take(self.coefficients) {
                k.iter_mut().zip(target).for_each(|(k, c)| *k += fit * c);
            }
        }
        for (to, from) in sh.iter_mut().zip(fitted.as_flattened()) {
            *to = *from as f32;
        }
        let after: Vec<[f32; 3]> = self.values.iter().map(|y| self.radiance(sh, y)).collect();
        let moved = before.iter().zip(&after).map(|(before, after)| super::chromaticity_distance(*before, *after).unwrap_or(0.0));
        let brighter = self.brighter(&before, &after);
        if brighter > 1.0 {
            self.model.scale_radiance(sh, &mut [], 1.0 / brighter);
        }
        (map.gain() * brighter, moved.sum::<f64>() / DIRECTIONS as f64)
    }

    /// Returns by how much the radiance rose in the direction where it rose most, as far as
    /// cut-offs follow it; at least 1.
    fn brighter(&self, before: &[[f32; 3]], after: &[[f32; 3]]) -> f32 {
        let brightest = |rgb: &[f32; 3]| rgb.iter().copied().fold(self.same_reach, f32::max);
        before
            .iter()
            .zip(after)
            .map(|(before, after)| brightest(after) / brightest(before))
            .filter(|ratio| ratio.is_finite())
            .fold(1.0, f32::max)
    }

    /// Returns the radiance, not clipped at 0.
    fn radiance(&self, sh: &[f32], values: &[f64; MAX_COEFFICIENTS]) -> [f32; 3] {
        let mut rgb = [f64::from(SH_OFFSET); 3];
        for (k, y) in sh.chunks_exact(3).zip(values) {
            rgb.iter_mut().zip(k).for_each(|(sum, k)| *sum += f64::from(*k) * y);
        }
        rgb.map(|c| self.scale.radiance(c))
    }
}

/// Returns the transpose of (A^T A)^-1 A^T of the basis values A `[DIRECTIONS, count]`.
fn pseudo_inverse(a: &[[f64; MAX_COEFFICIENTS]], count: usize) -> Vec<[f64; MAX_COEFFICIENTS]> {
    let gram = |i: usize| (0..count).map(move |j| a.iter().map(|y| y[i] * y[j]).sum::<f64>());
    let identity = |i: usize| (0..count).map(move |j| if i == j { 1.0 } else { 0.0 });
    let mut inverse = [[0f64; MAX_COEFFICIENTS]; MAX_COEFFICIENTS];
    for (to, from) in inverse.iter_mut().zip(least_squares::solve((0..count).map(|i| gram(i).chain(identity(i)).collect()).collect())) {
        to.iter_mut().zip(from).for_each(|(to, from)| *to = from);
    }
    let product = |y: &[f64; MAX_COEFFICIENTS]| inverse.map(|row| row.iter().zip(y).map(|(i, y)| i * y).sum());
    a.iter().map(product).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Map;

    fn harmonics(degree: usize, mean: f32, wobble: f32) -> Vec<f32> {
        let mut sh: Vec<f32> = (0..3 * sh::coefficients(degree)).map(|i| wobble * (i as f32 * 1.7 + 0.4).sin()).collect();
        for (c, dc) in sh[..3].iter_mut().enumerate() {
            *dc = (mean * (1.0 + c as f32) - SH_OFFSET) / sh::C0;
        }
        sh
    }

    fn mapped(maps: &[Map], kind: ShMap, sh: &mut [f32], degree: usize) -> f64 {
        let chain = MapChain::new(maps, 1.0);
        let (gain, moved) = Refit::new(ColorModel::Sh { degree: degree as u8 }, &Cutoffs::PARITY)
            .apply(sh, &SplatMap { chain: &chain, kind, weight: 1.0, scale: 1.0, base_factor: 1.0 });
        assert_eq!(gain, 1.0);
        moved
    }

    #[test]
    fn a_map_that_changes_nothing_gives_the_harmonics_back() {
        for degree in 0..=5 {
            // With and without negative lobes.
            for wobble in [0.02, 0.8] {
                let before = harmonics(degree, 0.2, wobble);
                let mut after = before.clone();
                let moved = mapped(&[Map::Power { exponent: 1.0, pivot: None }], ShMap::Luminance, &mut after, degree);
                let worst = before.iter().zip(&after).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                assert!(worst < 2e-6 && moved < 1e-5, "degree {degree}: {worst} {moved}");
            }
        }
    }

    #[test]
    fn colours_without_view_dependence_keep_their_hue_by_luminance_and_not_by_channels() {
        let power = [Map::Power { exponent: 1.2, pivot: Some(0.3) }];
        let (mut luminance, mut channels) = (harmonics(3, 0.2, 0.0), harmonics(3, 0.2, 0.0));
        assert!(mapped(&power, ShMap::Luminance, &mut luminance, 3) < 1e-5);
        assert!(mapped(&power, ShMap::Channels, &mut channels, 3) > 0.05);
        // R : G : B = 1 : 2 : 3, sum 1.2.
        let expected = 0.3 * (1.2f32 / 0.3).powf(1.2) / 6.0;
        assert!((SH_OFFSET + sh::C0 * luminance[0] - expected).abs() < 1e-5);
        // Each channel is mapped like a grey of luminance 3 c.
        let expected = 0.3 * (0.6f32 / 0.3).powf(1.2) / 3.0;
        assert!((SH_OFFSET + sh::C0 * channels[0] - expected).abs() < 1e-5);
    }

    #[test]
    fn a_power_of_log_harmonics_is_exact_by_channels() {
        let (model, power) = (ColorModel::LogSh { degree: 3 }, [Map::Power { exponent: 0.7, pivot: Some(3.0) }]);
        let before = harmonics(3, 1.5, 0.6);
        let mut after = before.clone();
        let (refit, chain) = (Refit::new(model, &Cutoffs::PARITY), MapChain::new(&power, 1.0));
        refit.apply(&mut after, &SplatMap { chain: &chain, kind: ShMap::Channels, weight: 1.0, scale: 1.0, base_factor: 1.0 });
        for (after, before) in after[3..].iter().zip(&before[3..]) {
            assert!((after - 0.7 * before).abs() < 1e-5, "{after} {before}");
        }
        for y in &refit.values {
            let (a, b) = (refit.radiance(&after, y), refit.radiance(&before, y));
            (0..3).for_each(|c| assert!((a[c] / b[c].powf(0.7) - 1.0).abs() < 1e-4, "{a:?} {b:?}"));
        }
    }

    #[test]
    fn small_view_dependence_follows_the_map() {
        let power = [Map::Power { exponent: 0.7, pivot: Some(1.0) }];
        let before = harmonics(2, 0.5, 0.02);
        let mut after = before.clone();
        mapped(&power, ShMap::Luminance, &mut after, 2);
        let (refit, chain) = (Refit::new(ColorModel::Sh { degree: 2 }, &Cutoffs::PARITY), MapChain::new(&power, 1.0));
        for y in &refit.values {
            let (a, b) = (refit.radiance(&after, y), refit.radiance(&before, y));
            let factor = chain.factor(luminance_sum(b), 1.0).unwrap();
            for c in 0..3 {
                assert!((a[c] - factor * b[c]).abs() < 1e-3 * b[c], "{a:?} {b:?} {factor}");
            }
        }
    }
}
