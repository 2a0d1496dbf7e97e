//! Contributions of splats to the training views; adaptive density control relocates the smallest
//! ([`crate::densify::adc`]).
//!
//! In: an engine with `N` splats, the views at the resolution of the step. Out: `[N]`, each splat's
//! blending weights, summed over the unmasked pixels of all views used. A splat that none of these
//! views sees has infinity if other views were skipped, because one of them may see it, and 0 if no
//! view was skipped.

use luxel_core::{Engine, EngineError, RenderOptions, View};

use crate::TrainError;
use crate::views::TrainingViews;

/// Largest number of views used in one round, so that rounds cost little beside the steps between
/// them.
const MOST_VIEWS: usize = 24;

/// A round of densification.
#[derive(Clone, Copy)]
pub(crate) struct Round {
    /// The step after which it takes place.
    pub(crate) step: u32,
    /// Its number in the run.
    pub(crate) number: u32,
}

/// Returns the contributions for a round. If there are more views than are used, they are taken at
/// a constant stride, and each round starts one view later than the last.
pub(crate) fn contribution(
    engine: &mut dyn Engine,
    views: &mut TrainingViews,
    round: Round,
    options: &RenderOptions,
) -> Result<Vec<f32>, TrainError> {
    let stride = views.len().div_ceil(MOST_VIEWS).max(1);
    let mut sums = vec![0.0; engine.len()];
    for index in (round.number as usize % stride..views.len()).step_by(stride) {
        let Some(view) = views.weights_at(round.step, index)? else { continue };
        add_contribution(engine, &view, options, &mut sums)?;
    }
    if stride > 1 {
        sums.iter_mut().filter(|sum| **sum == 0.0).for_each(|sum| *sum = f32::INFINITY);
    }
    Ok(sums)
}

/// Adds the contribution of each splat to `view` to `sums` (`[N]`): its blending weights, summed
/// over the pixels with the weights of the mask.
///
/// # Errors
/// Returns the errors of [`Engine::contributions`].
pub fn add_contribution(engine: &mut dyn Engine, view: &View, options: &RenderOptions, sums: &mut [f32]) -> Result<(), EngineError> {
    let found = engine.contributions(&view.camera, options, &pixel_weights(view))?;
    sums.iter_mut().zip(&found.masked).for_each(|(sum, seen)| *sum += seen);
    Ok(())
}

/// Returns whether the views of `step` see each splat (`[N]`). Those that contribute least, and
/// together make up at most `part` of the views' pixels, count as unseen. A splat brighter than 1
/// (normalised units) counts by its light, because even a small part of a lamp is much light.
pub(crate) fn visible_splats(
    engine: &mut dyn Engine,
    views: &mut TrainingViews,
    step: u32,
    options: &RenderOptions,
    part: f32,
) -> Result<Vec<bool>, TrainError> {
    let mut shown = vec![0.0f32; engine.len()];
    let mut pixels = 0.0f64;
    for index in 0..views.len() {
        let Some(view) = views.weights_at(step, index)? else { continue };
        let found = engine.contributions(&view.camera, options, &pixel_weights(&view))?;
        for (shown, (masked, light)) in shown.iter_mut().zip(found.masked.iter().zip(&found.light)) {
            *shown += masked.max(*light);
            pixels += f64::from(*masked);
        }
    }
    let mut least: Vec<(f32, usize)> = shown.into_iter().zip(0..).collect();
    least.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let (mut visible, mut left) = (vec![true; least.len()], f64::from(part) * pixels);
    for (shown, i) in least {
        left -= f64::from(shown);
        if left < 0.0 || pixels == 0.0 {
            break;
        }
        visible[i] = false;
    }
    Ok(visible)
}

/// Returns the weight of each pixel of a view.
fn pixel_weights(view: &View) -> Vec<f32> {
    view.mask.as_ref().map_or_else(|| vec![1.0; view.pixel_count() as usize], |mask| mask.weights.clone())
}

#[cfg(test)]
mod tests {
    use luxel_core::{ColorModel, Image, Mask, RadianceScale, Splat, Splats, View, logit};
    use luxel_cpu::CpuEngine;

    use super::*;
    use crate::pixel_weights::{NoiseChoice, ToneScale};
    use crate::testing::{camera_at, view_of};

    /// A splat that all cameras see, one behind them all.
    fn splats() -> Splats {
        let mut splats = Splats::empty(ColorModel::Sh { degree: 0 });
        for depth in [4.0, -4.0] {
            let sh = [0.5; 3];
            let splat = Splat {
                position: [0.0, 0.0, depth],
                rotation: [1.0, 0.0, 0.0, 0.0],
                log_scale: [0.3f32.ln(); 3],
                opacity_logit: logit(0.6),
                sh: &sh,
                raw_luminance: &[],
            };
            splats.push(&splat);
        }
        splats
    }

    fn found(train: &[View], round: u32) -> Vec<f32> {
        let mut engine = CpuEngine::new(1).unwrap();
        engine.load(&splats(), None).unwrap();
        let mut views =
            TrainingViews::new(train, Vec::new(), NoiseChoice::Auto, ToneScale { radiance_scale: RadianceScale::ONE, mu: 5000.0 });
        contribution(&mut engine, &mut views, Round { step: 100, number: round }, &RenderOptions::default()).unwrap()
    }

    fn view(mask: Option<f32>) -> View {
        let mask = mask.map(|weight| Mask { weights: vec![weight; 32 * 32] }.into());
        View { mask, ..view_of("a", camera_at([0.0; 3], [32, 32]), Image::filled(32, 32, [0.0; 3])) }
    }

    #[test]
    fn weights_are_summed_over_the_views_and_over_what_counts_of_them() {
        let [one, nothing] = found(&[view(None)], 0)[..] else { panic!("two splats") };
        assert!(one > 1.0 && nothing == 0.0);
        assert_eq!(found(&[view(None), view(Some(0.0)), view(Some(0.5))], 7), [1.5 * one, 0.0]);
    }

    #[test]
    fn of_many_views_a_part_is_used_and_unseen_splats_are_unknown() {
        let [one, _] = found(&[view(None)], 0)[..] else { panic!("two splats") };
        // Every third of 60 views is used; only the views of the second round see the splat.
        let train: Vec<View> = (0..60).map(|i| view(Some(if i % 3 == 1 { 1.0 } else { 0.0 }))).collect();
        let second = found(&train, 1);
        assert!((second[0] / (20.0 * one) - 1.0).abs() < 1e-5 && second[1] == f32::INFINITY);
        assert_eq!(found(&train, 2), [f32::INFINITY; 2]);
    }

    #[test]
    fn splats_that_contribute_least_are_unseen_but_a_lamp_is_visible() {
        let radiances = [0.1, 40.0, 0.1, 0.1];
        let sizes = [1.0f32, 0.1, 0.1, 1.0];
        let mut splats = Splats::empty(ColorModel::Sh { degree: 0 });
        // The splats lie side by side, except for the last, which is behind the cameras. The lamp
        // covers as few pixels as the dark splat of its size.
        for (i, (radiance, size)) in radiances.into_iter().zip(sizes).enumerate() {
            let sh = splats.color_model.constant([0.0, radiance, 0.0]).0;
            let splat = Splat {
                position: [1.2 * (i as f32 - 1.0), 0.0, if i == 3 { -4.0 } else { 4.0 }],
                rotation: [1.0, 0.0, 0.0, 0.0],
                log_scale: [(0.3 * size).ln(); 3],
                opacity_logit: logit(0.6),
                sh: &sh,
                raw_luminance: &[],
            };
            splats.push(&splat);
        }
        let seen_of = |train: &[View], part: f32| {
            let mut engine = CpuEngine::new(1).unwrap();
            engine.load(&splats, None).unwrap();
            let mut views =
                TrainingViews::new(train, Vec::new(), NoiseChoice::Auto, ToneScale { radiance_scale: RadianceScale::ONE, mu: 5000.0 });
            visible_splats(&mut engine, &mut views, 100, &RenderOptions::default(), part).unwrap()
        };
        let train = [view(None), view(Some(0.5))];
        let cases = [(0.0, [true, true, true, false]), (0.1, [true, true, false, false]), (0.9, [true, true, false, false])];
        for (part, expected) in cases {
            assert_eq!(seen_of(&train, part), expected, "{part}");
        }
        assert!(seen_of(&train, 1.0)[1], "more light than all else together");
        assert_eq!(seen_of(&[view(Some(0.0))], 0.5), [true; 4], "where no pixel counts nothing is known");
    }
}
