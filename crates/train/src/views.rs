//! The training views as steps see them: at the resolution of the step, their pixels weighted by their noise, and what their images are to be multiplied
//! by: to normalised units, without their gains.
//!
//! In: views in the data set's units, whose images are shared, not copied; out: one view at a time and its scale, which the loss applies, so that images
//! stay where they are, on a GPU too. Recorded values have no units and are seen as they are. Of a reduced resolution all images are kept, which is at most a quarter of
//! the first copy: they are made when the first step needs them, and dropped when the stage ends; no two stages are ever held.
//!
//! What a reduced resolution changes, and what it does not (`f` is the reduction a side):
//! - Loss: a mean over pixels, so its size and that of the regularisers beside it stay. Targets are averaged in linear light before the mu-law: a
//!   lamp smaller than a pixel keeps its energy. SSIM's window of 11 pixels sees `f` times as far.
//! - Densification: |dL/dmean| in NDC. For a splat of `s` pixels on an image of `S`, the sum of its pixels' gradients goes as s / S^2 and NDC has S / 2
//!   pixels, so the statistic goes as s / S: of a splat larger than a pixel it does not depend on the resolution, and neither do the
//!   thresholds. What does change: a residual finer than `f` pixels is averaged away, so it asks for no splats until its stage comes, and
//!   AbsGS's absolute sums, which count such residuals, fall towards the signed ones. Growth is slower in coarse stages; that is the gain.
//! - Pruning and resets look at opacity and at scale in world units (there is no limit in pixels), and are the same.
//! - Dilation is of the pixels rendered, and compensated by area: what is smaller than a coarse pixel keeps its light. 3DGS's (`--antialias off`) is 0.3 px^2,
//!   `0.3 f^2` of full ones, and not compensated: splats below `0.55 f` full pixels are drawn fatter than they are, which the optimiser answers with
//!   smaller, fainter ones. When the stage ends they are too thin, and mend within some hundred steps (a scale's logarithm moves by its rate,
//!   5e-3, a step). A schedule has to leave room for that.
//! - Mip's 3D filter bounds the frequency that the data set holds. It is computed from the cameras of full resolution in all stages: with a
//!   stage's own it would be `f` times as wide, and all splats of its size would change shape and opacity in the step the stage ends. The
//!   coarse image's aliasing is kept off by the 2D filter.

use std::sync::Arc;

use luxel_core::{Camera, PixelValues, View};
use rayon::prelude::*;

use crate::noise::{NoiseChoice, Seen, weighted};
use crate::resolution::{Stage, factor_at};

/// Part of a reduced pixel's area that must be valid: with less, it says more about its neighbours than about itself.
const MIN_VALID: f64 = 0.5;

/// Training views over a run.
pub(crate) struct TrainingViews {
    /// In the units of the data set, whose images they share.
    full: Vec<View>,
    /// Those with masks by noise, of the views whose noise is known.
    weighted: Vec<View>,
    stages: Vec<Stage>,
    seen: Seen,
    /// The views of the stage, if it is one of reduced resolution.
    reduced: Option<Reduced>,
}

struct Reduced {
    factor: u32,
    /// In the units of the data set, weighted.
    views: Vec<View>,
}

impl TrainingViews {
    pub(crate) fn new(train: &[View], stages: Vec<Stage>, noise: NoiseChoice, seen: Seen) -> Self {
        let with_noise = |view: &View| View { noise: noise.of(view), ..view.clone() };
        let full: Vec<View> = train.iter().map(with_noise).collect();
        let weighted = full.iter().map(|view| weighted_by_noise(view.clone(), seen)).collect();
        Self { full, weighted, stages, seen, reduced: None }
    }

    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        self.full.len()
    }

    /// Of full resolution.
    pub(crate) fn cameras(&self) -> Vec<&Camera> {
        self.full.iter().map(|view| &view.camera).collect()
    }

    /// Pixels of all views together, at full resolution.
    pub(crate) fn train_px(&self) -> u64 {
        pixels(&self.full)
    }

    /// Reduction a side at `step`.
    pub(crate) fn factor(&self, step: u32) -> u32 {
        factor_at(&self.stages, step)
    }

    /// View `index`, of gain `gain`, as `step` sees it, and what its image is to be multiplied by; `None` if there is none. Recorded values are seen
    /// without the gain, which is one on the exposure.
    pub(crate) fn at(&mut self, step: u32, index: usize, gain: [f32; 3]) -> Option<(&View, [f32; 3])> {
        let factor = self.factor(step);
        let scale = match self.full.get(index)?.values {
            PixelValues::Radiance => self.seen.radiance_scale.target_scale(gain),
            PixelValues::Recorded { .. } => [1.0; 3],
        };
        if factor == 1 {
            self.reduced = None;
            return Some((self.weighted.get(index)?, scale));
        }
        let is_made = self.reduced.as_ref().is_some_and(|reduced| reduced.factor == factor);
        if !is_made {
            // The old stage goes before the new one is made.
            self.reduced = None;
            let views = self.full.par_iter().map(|view| reduce(view, factor, self.seen)).collect();
            tracing::info!(step, factor, "training resolution");
            self.reduced = Some(Reduced { factor, views });
        }
        Some((self.reduced.as_ref()?.views.get(index)?, scale))
    }
}

/// Pixels of the views together.
pub(crate) fn pixels(views: &[View]) -> u64 {
    views.iter().map(|view| view.camera.size_px.iter().map(|side| u64::from(*side)).product::<u64>()).sum()
}

fn reduce(view: &View, factor: u32, seen: Seen) -> View {
    weighted_by_noise(view.downscaled(factor, MIN_VALID), seen)
}

/// The view, its mask with weights by its noise if that is known. Recorded values are not radiance, which noise is reckoned from.
fn weighted_by_noise(view: View, seen: Seen) -> View {
    match view.noise.filter(|_| view.values == PixelValues::Radiance) {
        Some(model) => View { mask: Some(Arc::new(weighted(&view, model, seen))), ..view },
        None => view,
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::{Image, RadianceScale};

    use super::*;
    use crate::testing::{camera_at, view_of};

    fn views(stages: &str) -> TrainingViews {
        let image = |shade: f32| Image::from_pixels(32, 32, (0..32 * 32).map(|i| [shade, i as f32, 2.0]).collect()).unwrap();
        let train = [view_of("a", camera_at([0.0; 3], [32, 32]), image(4.0)), view_of("b", camera_at([1.0; 3], [32, 32]), image(8.0))];
        let schedule: crate::ResolutionSchedule = stages.parse().unwrap();
        TrainingViews::new(
            &train,
            schedule.stages(100, 10, 32),
            NoiseChoice::Auto,
            Seen { radiance_scale: RadianceScale::new(2.0).unwrap(), mu: 5000.0 },
        )
    }

    #[test]
    fn steps_see_the_view_of_their_stage_and_its_scale() {
        let mut views = views("4@0,2@10,1@20");
        for (step, side) in [(1, 8), (10, 8), (11, 16), (20, 16), (21, 32), (22, 32), (1, 8)] {
            for (index, name, red) in [(0, "a", 4.0), (1, "b", 8.0)] {
                let (view, scale) = views.at(step, index, [1.0; 3]).unwrap();
                assert_eq!((view.name.as_str(), view.camera.size_px, view.image.width), (name, [side; 2], side as usize), "{step}");
                assert!(view.image.pixels.iter().all(|rgb| rgb[0] == red && rgb[2] == 2.0), "{step}");
                assert_eq!(scale, [0.5; 3]);
            }
        }
        assert!(views.at(1, 2, [1.0; 3]).is_none() && views.at(30, 2, [1.0; 3]).is_none());
    }

    #[test]
    fn an_image_is_divided_by_its_gain_at_every_resolution() {
        let mut views = views("2@0,1@10");
        for step in [1, 11] {
            assert_eq!(views.at(step, 0, [2.0, 1.0, 0.5]).unwrap().1, [0.25, 0.5, 1.0], "{step}");
            assert_eq!(views.at(step, 1, [1.0; 3]).unwrap().1, [0.5; 3], "{step}");
        }
    }

    #[test]
    fn pixels_of_known_noise_are_weighted_at_every_resolution() {
        let mut views = views("2@0,1@10");
        let model = luxel_core::NoiseModel { read: 0.5, shot: 0.1 };
        let stages = views.stages.clone();
        let train = views.full.clone();
        views = TrainingViews::new(&train, stages, NoiseChoice::Given(model), views.seen);
        let least = |view: &View| view.mask.as_ref().unwrap().weights.iter().copied().fold(1.0, f32::min);
        let coarse = least(views.at(1, 0, [1.0; 3]).unwrap().0);
        let fine = least(views.at(11, 0, [1.0; 3]).unwrap().0);
        assert!(fine > 0.0 && fine < coarse && coarse < 1.0, "{fine} {coarse}");
    }

    #[test]
    fn recorded_values_are_seen_as_they_are() {
        let mut views = views("2@0,1@10");
        views.full.iter_mut().for_each(|view| view.values = PixelValues::Recorded { exposure_s: 0.1 });
        assert_eq!(views.at(11, 0, [3.0; 3]).unwrap().1, [1.0; 3]);
    }

    #[test]
    fn only_the_present_stage_is_held() {
        let mut views = views("4@0,2@10,1@20");
        views.at(1, 0, [1.0; 3]);
        assert!(views.reduced.as_ref().is_some_and(|reduced| reduced.factor == 4));
        views.at(11, 0, [1.0; 3]);
        assert!(views.reduced.as_ref().is_some_and(|reduced| reduced.factor == 2));
        views.at(21, 0, [1.0; 3]);
        assert!(views.reduced.is_none());
    }

    #[test]
    fn a_view_is_the_same_allocation_in_every_step() {
        let mut views = views("2@0,1@10");
        for step in [1, 11] {
            let at = |views: &mut TrainingViews, gain| views.at(step, 0, gain).map(|(view, _)| Arc::as_ptr(&view.image));
            let first = at(&mut views, [1.0; 3]);
            assert_eq!(at(&mut views, [2.0; 3]), first);
        }
        // That of full resolution is the data set's.
        assert!(views.full.iter().zip(&views.weighted).all(|(view, weighted)| Arc::ptr_eq(&view.image, &weighted.image)));
    }
}
