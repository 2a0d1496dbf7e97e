//! The loss of a rendered radiance image under the mu-law, with its gradient by radiance.
//!
//! In: rendered radiance `[3, H, W]` in normalised units, the view's image, and whether both are
//! divided by one scale or each by its own maximum. Out: values under the mu-law, and from the
//! gradient by them that by radiance.
//!
//! By its own maximum m (HDR-GS), the value of a pixel is T(x / m). With g = dL/d(x/m) the gradient
//! is g_i / m, and the brightest value takes - sum_j g_j x_j / m^2 besides, shared among equals.
//! Degenerate: a black image is divided by 1.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use luxel_core::View;
use luxel_lanes::functions::ln_1p_by_ratio;
use luxel_lanes::{LANES, Level};
use luxel_train::HdrNormalisation;
use rayon::prelude::*;

use crate::captured::arithmetic::elementwise::{Elementwise, map_all};

/// How a render is compared with a view's radiance.
#[derive(Clone, Copy)]
pub(crate) struct RadianceCurve {
    pub(crate) mu: f32,
    pub(crate) normalisation: HdrNormalisation,
}

/// Returns the largest of some values, if one is above 0.
fn maximum(values: &[f32]) -> Option<f32> {
    let mut lanes = [0.0f32; LANES];
    let (whole, rest) = values.as_chunks::<LANES>();
    for block in whole {
        lanes.iter_mut().zip(block).for_each(|(most, v)| *most = most.max(*v));
    }
    Some(lanes.iter().chain(rest).copied().fold(0.0f32, f32::max)).filter(|m| *m > 0.0)
}

/// Returns an image's pixels as planes `[3, H, W]`.
pub(crate) fn planes_of(pixels: &[[f32; 3]]) -> Vec<f32> {
    let mut planes = vec![0.0; 3 * pixels.len()];
    planes.par_chunks_mut(pixels.len().max(1)).enumerate().for_each(|(c, plane)| {
        plane.iter_mut().zip(pixels).for_each(|(value, rgb)| *value = rgb[c]);
    });
    planes
}

/// The mu-law of values times a factor.
struct MuLaw {
    /// mu times the factor.
    slope: f32,
    /// 1 / ln(1 + mu).
    scale: f32,
}

impl Elementwise for MuLaw {
    #[inline(always)]
    fn apply<S: Simd>(&self, simd: S, x: f32x16<S>) -> f32x16<S> {
        let argument = x.max(f32x16::splat(simd, 0.0)) * f32x16::splat(simd, self.slope);
        ln_1p_by_ratio(argument) * f32x16::splat(simd, self.scale)
    }
}

impl RadianceCurve {
    fn mu_law(&self, factor: f32) -> MuLaw {
        MuLaw { slope: self.mu * factor, scale: self.mu.ln_1p().recip() }
    }

    /// Returns the target's values under the mu-law, `[3, H, W]`.
    pub(crate) fn target(&self, view: &View) -> Vec<f32> {
        let mut planes = planes_of(&view.image.pixels);
        let scale = match self.normalisation {
            HdrNormalisation::Scene => view.target.scale,
            HdrNormalisation::Own => [maximum(&planes).map_or(1.0, f32::recip); 3],
        };
        let pixels = view.image.pixels.len().max(1);
        planes.par_chunks_mut(pixels).zip(scale).for_each(|(plane, scale)| map_all(&self.mu_law(scale), plane));
        planes
    }

    /// Returns the factor that takes rendered radiance to the argument of the mu-law.
    fn factor(&self, radiance: &[f32]) -> f32 {
        match self.normalisation {
            HdrNormalisation::Scene => 1.0,
            HdrNormalisation::Own => maximum(radiance).map_or(1.0, f32::recip),
        }
    }

    /// Returns the values of rendered radiance under the mu-law.
    pub(crate) fn values(&self, radiance: &[f32]) -> Vec<f32> {
        let mut values = radiance.to_vec();
        let law = self.mu_law(self.factor(radiance));
        values.par_chunks_mut(radiance.len().div_ceil(3).max(1)).for_each(|values| map_all(&law, values));
        values
    }

    /// Turns the gradient by values under the mu-law into that by radiance.
    pub(crate) fn by_radiance(&self, radiance: &[f32], gradient: &mut [f32]) {
        let factor = self.factor(radiance);
        // d ln(1 + mu f x) / ln(1 + mu) = mu f dx / ((1 + mu f x) ln(1 + mu)).
        let (slope, scale) = (self.mu * factor, self.mu * factor / self.mu.ln_1p());
        let len = radiance.len().div_ceil(3).max(1);
        gradient.par_chunks_mut(len).zip(radiance.par_chunks(len)).for_each(|(gradient, radiance)| {
            luxel_lanes::dispatch!(Level::best(), _simd => divide_by_line(gradient, radiance, slope, scale));
        });
        if let (HdrNormalisation::Own, Some(m)) = (self.normalisation, maximum(radiance)) {
            let along: f64 = gradient.iter().zip(radiance).map(|(g, x)| f64::from(*g) * f64::from(*x)).sum();
            let count = radiance.iter().filter(|x| **x == m).count();
            let share = (along / (f64::from(m) * count as f64)) as f32;
            gradient.iter_mut().zip(radiance).filter(|(_, x)| **x == m).for_each(|(g, _)| *g -= share);
        }
    }
}

/// Multiplies by scale / (1 + slope max(x, 0)).
#[inline(always)]
fn divide_by_line(gradient: &mut [f32], radiance: &[f32], slope: f32, scale: f32) {
    for (g, x) in gradient.iter_mut().zip(radiance) {
        *g *= scale / (1.0 + slope * x.max(0.0));
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::random::standard_normal;
    use luxel_core::{Image, LossWeights};

    use super::*;
    use crate::captured::images::image_loss::{Compared, ComparedOut, compare};
    use crate::testing::{camera_at, view_of};

    fn view() -> View {
        let pixels = (0..9 * 7).map(|i| standard_normal(5, i).map(|v: f32| 0.3 + 0.1 * v.abs())).collect();
        view_of("a", camera_at([0.0; 3], [9, 7]), Image::from_pixels(9, 7, pixels).unwrap())
    }

    fn render() -> Vec<f32> {
        (0..3 * 9 * 7).map(|i| 0.3 + 0.1 * standard_normal(6, i)[0].abs()).collect()
    }

    /// Returns the loss of a render and its gradient by radiance.
    fn loss(curve: RadianceCurve, render: &[f32], weights: LossWeights) -> (f32, Vec<f32>) {
        let (prediction, target) = (curve.values(render), curve.target(&view()));
        let mut gradient = vec![0.0; render.len()];
        let of = Compared { size: [9, 7], prediction: &prediction, target: &target, pixels: None, values: None, factor: 1.0 };
        let loss = compare(&of, &weights, ComparedOut { by_value: &mut gradient, dissimilarity: None }).loss;
        curve.by_radiance(render, &mut gradient);
        (loss, gradient)
    }

    #[test]
    fn gradients_by_radiance_are_those_of_differences_under_both_normalisations() {
        for normalisation in [HdrNormalisation::Scene, HdrNormalisation::Own] {
            let weights = LossWeights { squared_share: 1.0, ..LossWeights::default() };
            let curve = RadianceCurve { mu: 50.0, normalisation };
            let mut render = render();
            // The one maximum.
            render[63 + 20] = 1.5;
            let exact = loss(curve, &render, weights).1;
            for i in [63 + 20, 3, 2 * 63 + 44, 62] {
                let moved = |h: f32| {
                    let mut render = render.clone();
                    render[i] += h;
                    f64::from(loss(curve, &render, weights).0)
                };
                let numeric = (moved(2e-3) - moved(-2e-3)) / 4e-3;
                let found = f64::from(exact[i]);
                assert!((numeric - found).abs() < 2e-4 + 2e-2 * found.abs(), "{normalisation:?} {i}: {numeric:e} {found:e}");
            }
        }
    }

    #[test]
    fn the_loss_by_the_own_maximum_does_not_depend_on_the_scale() {
        let curve = RadianceCurve { mu: 5000.0, normalisation: HdrNormalisation::Own };
        let of = |factor: f32| loss(curve, &render().iter().map(|v| v * factor).collect::<Vec<_>>(), LossWeights::default()).0;
        assert!((of(1.0) - of(64.0)).abs() < 1e-6);
        assert!(loss(curve, &[0.0; 189], LossWeights::default()).1.iter().all(|v| v.is_finite()));
    }
}
