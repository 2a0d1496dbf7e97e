//! The start of the refinement of a display bake: each splat's radiance times the curve's gain at
//! the pixels that it contributes to.
//!
//! A curve T does not commute with blending, but a gain does: where a pixel's radiance C = sum(w_i
//! c_i) is displayed as T(C) = g C, so is sum(w_i g c_i). Where g is nearly constant over a splat's
//! pixels, g c_i blends to the right pixel, however its light is divided between faint bright
//! splats and opaque dark ones. Such colours may be far above 1: a splat of opacity 0.01 that makes
//! a pixel white needs 100. In: renders of the scene and their display values, view by view. Out:
//! harmonics of the bake. g is a mean by channel over all pixels of all views, weighted by the
//! splat's contribution to them.
//!
//! Degenerate: splats that no view shows keep their own tone-mapped colour; a channel without light
//! takes the gain of a [`FAINTEST`] one.

use luxel_core::tone::exposed_rec709;
use luxel_core::{Camera, ColorSpace, Engine, Image, RenderOptions, SH_OFFSET, Scene, sh};
use luxel_io::{Appearance, BakeOptions, Baked};

use crate::Result;
use crate::error::Context;

/// Least exposed radiance; a channel below this part of the pixel's brightest one counts as that
/// part, because curves that desaturate raise it.
const FAINTEST: f32 = 1e-3;
const FAINTEST_PART: f32 = 0.05;

/// A view of the scene.
#[derive(Clone, Copy)]
pub(super) struct GainView<'a> {
    /// Camera of the view.
    pub(super) camera: &'a Camera,
    /// Settings of its render.
    pub(super) options: &'a RenderOptions,
    /// Its radiance in linear Rec.709, exposed.
    pub(super) exposed: &'a Image,
    /// The display's values for it.
    pub(super) displayed: &'a Image,
}

/// Sums over pixels.
pub(super) struct Gains {
    /// Gain times blending weight.
    gain: Vec<[f64; 3]>,
    /// Blending weight.
    weight: Vec<f64>,
}

impl Gains {
    /// Returns sums of zero for `count` splats.
    pub(super) fn new(count: usize) -> Self {
        Self { gain: vec![[0.0; 3]; count], weight: vec![0.0; count] }
    }

    /// Adds a view of the scene that `engine` holds.
    pub(super) fn add(&mut self, view: &GainView<'_>, engine: &mut dyn Engine) -> Result<()> {
        let GainView { camera, options, exposed, displayed } = *view;
        for channel in 0..3 {
            // Masks are of 0..1, which gains times the faintest radiance are.
            let mask: Vec<f32> = exposed.pixels.iter().zip(&displayed.pixels).map(|(e, s)| FAINTEST * gain(*e, *s)[channel]).collect();
            let found = engine.contributions(camera, options, &mask).context("cannot measure the splats' contributions")?;
            for (sum, masked) in self.gain.iter_mut().zip(&found.masked) {
                sum[channel] += f64::from(masked / FAINTEST);
            }
            if channel == 0 {
                self.weight.iter_mut().zip(&found.blended).for_each(|(sum, blended)| *sum += f64::from(*blended));
            }
        }
        Ok(())
    }

    /// Sets the colours of the bake of `scene`.
    pub(super) fn apply(&self, baked: &mut Baked, scene: &Scene) {
        let degree = baked.scene.splats.color_model.sh_degree() as u8;
        let exposure_ev = (scene.radiance_scale.normalised_value(baked.exposure)).log2();
        let appearance = Appearance::Linear { color_space: ColorSpace::LinearRec709, exposure_ev };
        let linear = Baked::new(scene, &BakeOptions { appearance, max_degree: degree });
        let row = 3 * sh::coefficients(degree.into());
        let rows = baked.scene.splats.sh.chunks_exact_mut(row).zip(linear.scene.splats.sh.chunks_exact(row));
        for ((to, from), (gain, weight)) in rows.zip(self.gain.iter().zip(&self.weight)) {
            if *weight <= f64::from(f32::MIN_POSITIVE) {
                continue;
            }
            let gain = gain.map(|sum| (sum / weight) as f32);
            for (k, (to, from)) in to.iter_mut().zip(from).enumerate() {
                let gain = gain[k % 3];
                // The offset of 1/2 is part of the colour, too.
                let offset = if k < 3 { (gain - 1.0) * SH_OFFSET / sh::C0 } else { 0.0 };
                *to = gain * from + offset;
            }
        }
    }
}

/// Returns the radiance of a render in normalised units as the curve takes it: exposed, in linear
/// Rec.709.
pub(super) fn exposed(scene: &Scene, baked: &Baked, image: &Image) -> Image {
    let pixels = image.pixels.iter().map(|p| exposed_rec709(scene.color_space, *p, baked.exposure)).collect();
    Image { pixels, ..*image }
}

/// Returns the display value divided by the exposed radiance, 0 to 1 / [`FAINTEST`].
fn gain(exposed: [f32; 3], displayed: [f32; 3]) -> [f32; 3] {
    let brightest = exposed.into_iter().fold(FAINTEST, f32::max);
    let least = (FAINTEST_PART * brightest).max(FAINTEST);
    // NaN becomes the least, too.
    [0, 1, 2].map(|c| displayed[c].clamp(0.0, 1.0) / exposed[c].max(least).min(f32::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_take_radiance_to_display_values_and_are_bounded() {
        let exposed = [4.0, 1.0, 0.5];
        let found = gain(exposed, [0.9, 0.5, 0.4]);
        assert_eq!([0, 1, 2].map(|c| found[c] * exposed[c]), [0.9, 0.5, 0.4]);
        for dark in [[0.0; 3], [-1.0; 3], [f32::NAN; 3]] {
            assert!(gain(dark, [1.0; 3]).iter().all(|g| *g <= 1.0 / FAINTEST), "{dark:?}");
        }
        assert_eq!(gain([10.0, 0.0, 0.0], [1.0, 0.1, 0.1])[1], 0.1 / 0.5);
    }
}
