//! The exposure of a display bake: the log-average luminance of the splats, weighted by opacity and
//! size, comes to middle grey (Reinhard et al. 2002).
//!
//! In: a scene. Out: a factor on its normalised radiance; 1 for a black or empty scene.

use luxel_core::{Scene, luminance_rec709, sh, sigmoid};
use rayon::prelude::*;

/// The linear display value that an average scene is exposed to.
pub const MIDDLE_GREY: f64 = 0.18;
/// Luminance below this part of the weighted median counts as this much, so that black splats do
/// not pull the average to 0.
const DARKEST: f64 = 1e-3;
/// Area above this many times the median counts as this much: a few huge splats (sky, backdrop) do
/// not set the exposure.
const LARGEST: f64 = 16.0;

/// Returns the exposure of a display bake without views to measure it by: a factor on normalised
/// radiance, 1 for a black or empty scene and for colours that are a display's.
pub fn display_exposure(scene: &Scene) -> f32 {
    if !scene.color_space.is_linear() {
        return 1.0;
    }
    let splats = &scene.splats;
    let views = sh::lattice(6);
    let to_luminance = |rgb: [f32; 3]| f64::from(luminance_rec709(rgb.map(super::bounded)));
    let luminance_of = |i: usize| views.iter().map(|v| to_luminance(splats.radiance(i, *v))).sum::<f64>() / views.len() as f64;
    let luminance: Vec<f64> = (0..splats.len()).into_par_iter().map(luminance_of).collect();
    let area: Vec<f64> = splats.log_scale.iter().map(|s| cross_section(*s)).collect();
    let largest = LARGEST * median(area.iter().map(|a| Weighted { value: *a, weight: 1.0 }).collect());
    let weight: Vec<f64> = area.iter().zip(&splats.opacity_logit).map(|(a, o)| a.min(largest) * f64::from(sigmoid(*o))).collect();
    let darkest = DARKEST * median(luminance.iter().zip(&weight).map(|(l, w)| Weighted { value: *l, weight: *w }).collect());
    let total: f64 = weight.iter().sum();
    let sum: f64 = luminance.iter().zip(&weight).map(|(l, w)| w * l.max(darkest).max(f64::MIN_POSITIVE).ln()).sum();
    let exposure = (MIDDLE_GREY / (sum / total).exp()) as f32;
    if darkest > 0.0 && exposure.is_normal() { exposure } else { 1.0 }
}

/// Returns the product of the two larger standard deviations.
fn cross_section(log_scale: [f32; 3]) -> f64 {
    let smallest = log_scale.into_iter().fold(f32::INFINITY, f32::min);
    let larger = log_scale.iter().map(|s| f64::from(*s)).sum::<f64>() - f64::from(smallest);
    larger.clamp(-200.0, 200.0).exp()
}

/// A value with its weight.
struct Weighted {
    value: f64,
    weight: f64,
}

/// Returns the value at half the total weight; 0 for none.
fn median(mut values: Vec<Weighted>) -> f64 {
    values.sort_unstable_by(|a, b| a.value.total_cmp(&b.value));
    let half = 0.5 * values.iter().map(|v| v.weight).sum::<f64>();
    let mut sum = 0.0;
    let reached = values.iter().find(|v| {
        sum += v.weight;
        sum >= half
    });
    reached.map_or(0.0, |v| v.value)
}
