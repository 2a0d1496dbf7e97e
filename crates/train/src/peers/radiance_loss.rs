//! The loss of a rendered radiance image under the mu-law, with its gradient by radiance.
//!
//! In: rendered pixels in normalised units, the view's image, and whether both are divided by one
//! scale or each by its own maximum. Out: a [`Comparison`] whose gradient is by radiance.
//!
//! By its own maximum m (HDR-GS), the value of a pixel is T(x / m). With g = dL/d(x/m) the gradient
//! is g_i / m, and the brightest value takes - sum_j g_j x_j / m^2 besides, shared among equals.
//! Degenerate: a black image is divided by 1.

use luxel_core::tone::mu_law;
use luxel_core::{LossWeights, View};

use super::image_loss::{Comparison, Planes, compare};
use crate::config::HdrNormalisation;

/// The comparison of a render with a view's radiance.
pub(super) struct RadianceLoss<'a> {
    pub(super) view: &'a View,
    pub(super) weights: LossWeights,
    pub(super) mu: f32,
    pub(super) normalisation: HdrNormalisation,
}

/// The largest of some values, at least the smallest positive number.
fn maximum(values: impl Iterator<Item = f32>) -> Option<f32> {
    Some(values.fold(0.0f32, f32::max)).filter(|m| *m > 0.0)
}

impl RadianceLoss<'_> {
    /// Returns the target's values under the mu-law.
    pub(super) fn target(&self) -> Planes {
        let [width, height] = self.view.camera.size_px.map(|side| side as usize);
        let pixels = &self.view.image.pixels;
        let scale = match self.normalisation {
            HdrNormalisation::Scene => self.view.target.scale,
            HdrNormalisation::Own => [maximum(pixels.iter().flatten().copied()).map_or(1.0, f32::recip); 3],
        };
        Planes::from_pixels(width, height, pixels, |c, value| mu_law(value * scale[c], self.mu))
    }

    /// Returns the factor that takes rendered radiance to the argument of the mu-law.
    pub(super) fn factor(&self, pixels: &[[f32; 3]]) -> f32 {
        match self.normalisation {
            HdrNormalisation::Scene => 1.0,
            HdrNormalisation::Own => maximum(pixels.iter().flatten().copied()).map_or(1.0, f32::recip),
        }
    }

    /// Returns the values of rendered radiance under the mu-law.
    pub(super) fn values(&self, pixels: &[[f32; 3]]) -> Planes {
        let [width, height] = self.view.camera.size_px.map(|side| side as usize);
        let factor = self.factor(pixels);
        Planes::from_pixels(width, height, pixels, |_, value| mu_law(value.max(0.0) * factor, self.mu))
    }

    /// Compares rendered pixels with the view.
    pub(super) fn compare(&self, values: &Planes) -> Comparison {
        compare(values, &self.target(), self.view.mask.as_deref().map(|mask| &mask.weights[..]), &self.weights)
    }

    /// Returns the gradient by radiance, interleaved, of a gradient by values under the mu-law.
    pub(super) fn by_radiance(&self, pixels: &[[f32; 3]], by_value: &Planes) -> Vec<[f32; 3]> {
        let factor = self.factor(pixels);
        let slope = |x: f32| self.mu / ((1.0 + self.mu * x) * self.mu.ln_1p());
        let by_argument = |i: usize| {
            let (by, rgb) = (by_value.pixel(i), pixels[i]);
            [0, 1, 2].map(|c| by[c] * slope(rgb[c].max(0.0) * factor))
        };
        let mut gradient: Vec<[f32; 3]> = (0..pixels.len()).map(|i| by_argument(i).map(|g| g * factor)).collect();
        let brightest = maximum(pixels.iter().flatten().copied());
        if let (HdrNormalisation::Own, Some(m)) = (self.normalisation, brightest) {
            let products = gradient.as_flattened().iter().zip(pixels.as_flattened());
            let along: f64 = products.map(|(g, x)| f64::from(*g) * f64::from(*x)).sum();
            let count = pixels.as_flattened().iter().filter(|x| **x == m).count();
            let share = (along / (f64::from(m) * count as f64)) as f32;
            let places = gradient.as_flattened_mut().iter_mut().zip(pixels.as_flattened());
            places.filter(|(_, x)| **x == m).for_each(|(g, _)| *g -= share);
        }
        gradient
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::Image;
    use luxel_core::random::standard_normal;

    use super::*;
    use crate::testing::{camera_at, view_of};

    fn pixels(seed: u64) -> Vec<[f32; 3]> {
        (0..9 * 7).map(|i| standard_normal(seed, i).map(|v: f32| 0.3 + 0.1 * v.abs())).collect()
    }

    #[test]
    fn gradients_by_radiance_are_those_of_differences_under_both_normalisations() {
        let view = view_of("a", camera_at([0.0; 3], [9, 7]), Image::from_pixels(9, 7, pixels(5)).unwrap());
        for normalisation in [HdrNormalisation::Scene, HdrNormalisation::Own] {
            let weights = LossWeights { squared_share: 1.0, ..LossWeights::default() };
            let loss = RadianceLoss { view: &view, weights, mu: 50.0, normalisation };
            let mut render = pixels(6);
            // The one maximum.
            render[20][1] = 1.5;
            let exact = loss.by_radiance(&render, &loss.compare(&loss.values(&render)).by_value);
            for (i, c) in [(20, 1), (3, 0), (44, 2), (62, 0)] {
                let moved = |h: f32| {
                    let mut render = render.clone();
                    render[i][c] += h;
                    f64::from(loss.compare(&loss.values(&render)).loss)
                };
                let numeric = (moved(2e-3) - moved(-2e-3)) / 4e-3;
                let found = f64::from(exact[i][c]);
                assert!((numeric - found).abs() < 2e-4 + 2e-2 * found.abs(), "{normalisation:?} {i}, {c}: {numeric:e} {found:e}");
            }
        }
    }

    #[test]
    fn the_loss_by_the_own_maximum_does_not_depend_on_the_scale() {
        let view = view_of("a", camera_at([0.0; 3], [9, 7]), Image::from_pixels(9, 7, pixels(5)).unwrap());
        let loss = RadianceLoss { view: &view, weights: LossWeights::default(), mu: 5000.0, normalisation: HdrNormalisation::Own };
        let of = |factor: f32| {
            let render: Vec<[f32; 3]> = pixels(6).iter().map(|rgb| rgb.map(|v| v * factor)).collect();
            loss.compare(&loss.values(&render)).loss
        };
        assert!((of(1.0) - of(64.0)).abs() < 1e-6);
        let black = vec![[0.0; 3]; 63];
        assert!(loss.by_radiance(&black, &loss.compare(&loss.values(&black)).by_value).iter().flatten().all(|v| v.is_finite()));
    }
}
