//! The exposure of a display bake from views: their log-average luminance becomes middle grey
//! (Reinhard et al. 2002). Splats alone do not determine how bright a scene looks: a surface may be
//! a dark opaque splat under bright faint ones.
//!
//! In: a scene, views. Out: a factor on normalised radiance; none where all views are black.

use luxel_core::tone::rec709_of;
use luxel_core::{Dataset, Engine, Image, Scene, luminance_rec709};
use luxel_io::MIDDLE_GREY;

use crate::Result;
use crate::error::Context;

/// Number of views to measure, spread evenly.
const VIEWS: usize = 16;
/// Luminance below this part of the mean counts as this much, so that black pixels do not pull the
/// average to 0.
const DARKEST: f64 = 1e-3;

/// Returns the factor.
pub(super) fn from_views(scene: &Scene, dataset: &Dataset, engine: &mut dyn Engine) -> Result<Option<f32>> {
    let views = if dataset.train.is_empty() { &dataset.test } else { &dataset.train };
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let options = scene.render_options();
    let (mut luminance, mut image) = (Vec::new(), Image::default());
    for view in views.iter().step_by(views.len().div_ceil(VIEWS).max(1)) {
        engine.render_into(&view.camera, &options, &mut image).context("cannot render a view")?;
        luminance.extend(image.pixels.iter().map(|p| luminance_rec709(rec709_of(scene.color_space, *p)).max(0.0)));
    }
    Ok(to_grey(&luminance))
}

fn to_grey(luminance: &[f32]) -> Option<f32> {
    let count = luminance.len() as f64;
    let darkest = DARKEST * luminance.iter().copied().map(f64::from).sum::<f64>() / count;
    let log_average = luminance.iter().map(|l| f64::from(*l).max(darkest).ln()).sum::<f64>() / count;
    Some((MIDDLE_GREY / log_average.exp()) as f32).filter(|exposure| exposure.is_normal())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_log_average_comes_to_middle_grey() {
        let found = to_grey(&[1.0, 4.0, 2.0, 2.0]).unwrap();
        assert!((found - 0.09).abs() < 1e-6, "{found}");
        assert!(to_grey(&[0.0, 1.0]).is_some_and(|e| e < 100.0));
        assert_eq!((to_grey(&[]), to_grey(&[0.0; 3])), (None, None));
    }
}
