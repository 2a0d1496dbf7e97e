//! The training views as steps see them: in normalised units, at the resolution of the step, their pixels weighted by their noise, their images
//! divided by their gains.
//!
//! In: views in the data set's units, whose images are shared, not copied; out: one view at a time. Recorded values have no units and are seen as they
//! are. Of full resolution one normalised image is kept, as a second copy of all would double a run's memory. Of a reduced resolution all images are, which is at most a quarter of the first
//! copy: they are made when the first step needs them, and dropped when the stage ends; no two stages are ever held.
//!
//! What a reduced resolution changes, and what it does not (`f` is the reduction a side):
//! - Loss: a mean over pixels, so its size and that of the regularisers beside it stay. Targets are averaged in linear light before the mu-law: a
//!   lamp smaller than a pixel keeps its energy. SSIM's window of 11 pixels sees `f` times as far.
//! - Densification: |dL/dmean| in NDC. For a splat of `s` pixels on an image of `S`, the sum of its pixels' gradients goes as s / S^2 and NDC has S / 2
//!   pixels, so the statistic goes as s / S: of a splat larger than a pixel it does not depend on the resolution, and neither do the
//!   thresholds. What does change: a residual finer than `f` pixels is averaged away, so it asks for no splats until its stage comes, and
//!   AbsGS's absolute sums, which count such residuals, fall towards the signed ones. Growth is slower in coarse stages; that is the gain.
//! - Pruning and resets look at opacity and at scale in world units (there is no limit in pixels), and are the same.
//! - Dilation is 0.3 px^2 of the pixels rendered, `0.3 f^2` of full ones, and uncompensated: splats below `0.55 f` full pixels are drawn fatter than they are,
//!   which the optimiser answers with smaller, fainter ones. When the stage ends they are too thin, and mend within some hundred steps (a
//!   scale's logarithm moves by its rate, 5e-3, a step). A schedule has to leave room for that. `--antialias mip` compensates by area and does not have this.
//! - Mip's 3D filter bounds the frequency that the data set holds. It is computed from the cameras of full resolution in all stages: with a
//!   stage's own it would be `f` times as wide, and all splats of its size would change shape and opacity in the step the stage ends. The
//!   coarse image's aliasing is kept off by the 2D filter.

use std::sync::Arc;

use luxel_core::{Camera, Mask, PixelValues, View};
use rayon::prelude::*;

use crate::noise::{NoiseChoice, Seen, weighted};
use crate::resolution::{Stage, factor_at};

/// Part of a reduced pixel's area that must be valid: with less, it says more about its neighbours than about itself.
const MIN_VALID: f64 = 0.5;

/// Training views over a run.
pub(crate) struct TrainingViews {
    /// In the units of the data set, whose images they share.
    full: Vec<View>,
    /// Masks of full resolution by noise, of the views whose noise is known.
    weighted: Vec<Option<Arc<Mask>>>,
    stages: Vec<Stage>,
    seen: Seen,
    /// The views of the stage, if it is one of reduced resolution.
    reduced: Option<Reduced>,
    /// The view of a step at full resolution or under a gain, kept for the next step's.
    current: Option<View>,
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
        let weighted = full.iter().map(|view| mask_by_noise(view, seen)).collect();
        Self { full, weighted, stages, seen, reduced: None, current: None }
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

    /// View `index`, of gain `gain`, as `step` sees it; `None` if there is none. Recorded values are seen without the gain, which is one on the
    /// exposure.
    pub(crate) fn at(&mut self, step: u32, index: usize, gain: [f32; 3]) -> Option<&View> {
        let factor = self.factor(step);
        let unit = match self.full.get(index)?.values {
            PixelValues::Radiance => gain.map(|gain| 1.0 / self.seen.radiance_scale / gain),
            PixelValues::Recorded { .. } => [1.0; 3],
        };
        if factor == 1 {
            self.reduced = None;
            let (source, mask) = (self.full.get(index)?, self.weighted.get(index)?);
            return if unit == [1.0; 3] && mask.is_none() { Some(source) } else { scaled(source, mask.as_ref(), unit, &mut self.current) };
        }
        let is_made = self.reduced.as_ref().is_some_and(|reduced| reduced.factor == factor);
        if !is_made {
            // The old stage goes before the new one is made.
            self.reduced = None;
            let views = self.full.par_iter().map(|view| reduce(view, factor, self.seen)).collect();
            tracing::info!(step, factor, "training resolution");
            self.reduced = Some(Reduced { factor, views });
        }
        let source = self.reduced.as_ref()?.views.get(index)?;
        if unit == [1.0; 3] {
            self.current = None;
            return Some(source);
        }
        scaled(source, None, unit, &mut self.current)
    }
}

/// Pixels of the views together.
pub(crate) fn pixels(views: &[View]) -> u64 {
    views.iter().map(|view| view.camera.size_px.iter().map(|side| u64::from(*side)).product::<u64>()).sum()
}

fn reduce(view: &View, factor: u32, seen: Seen) -> View {
    let reduced = view.downscaled(factor, MIN_VALID);
    match mask_by_noise(&reduced, seen) {
        Some(mask) => View { mask: Some(mask), ..reduced },
        None => reduced,
    }
}

/// The view's mask with weights by its noise, if that is known. Recorded values are not radiance, which noise is reckoned from.
fn mask_by_noise(view: &View, seen: Seen) -> Option<Arc<Mask>> {
    let model = view.noise.filter(|_| view.values == PixelValues::Radiance)?;
    Some(Arc::new(weighted(view, model, seen)))
}

/// Makes `current` the view `source` with its channels times `unit`, and with `mask` if there is one, in the memory it has.
fn scaled<'a>(source: &View, mask: Option<&Arc<Mask>>, unit: [f32; 3], current: &'a mut Option<View>) -> Option<&'a View> {
    let target = current.get_or_insert_with(|| View { image: Arc::default(), ..source.clone() });
    target.name.clone_from(&source.name);
    target.camera.clone_from(&source.camera);
    (target.values, target.noise) = (source.values, source.noise);
    target.mask = mask.or(source.mask.as_ref()).cloned();
    // Not shared: engines hold no views.
    let image = Arc::make_mut(&mut target.image);
    (image.width, image.height) = (source.image.width, source.image.height);
    image.pixels.clear();
    image.pixels.extend(source.image.pixels.iter().map(|rgb| [rgb[0] * unit[0], rgb[1] * unit[1], rgb[2] * unit[2]]));
    Some(target)
}

#[cfg(test)]
mod tests {
    use luxel_core::Image;

    use super::*;
    use crate::testing::{camera_at, view_of};

    fn views(stages: &str) -> TrainingViews {
        let image = |shade: f32| Image::from_pixels(32, 32, (0..32 * 32).map(|i| [shade, i as f32, 2.0]).collect()).unwrap();
        let train = [view_of("a", camera_at([0.0; 3], [32, 32]), image(4.0)), view_of("b", camera_at([1.0; 3], [32, 32]), image(8.0))];
        let schedule: crate::ResolutionSchedule = stages.parse().unwrap();
        TrainingViews::new(&train, schedule.stages(100, 10, 32), NoiseChoice::Auto, Seen { radiance_scale: 2.0, mu: 5000.0 })
    }

    #[test]
    fn steps_see_the_view_of_their_stage_in_normalised_units() {
        let mut views = views("4@0,2@10,1@20");
        for (step, side) in [(1, 8), (10, 8), (11, 16), (20, 16), (21, 32), (22, 32), (1, 8)] {
            for (index, name, red) in [(0, "a", 2.0), (1, "b", 4.0)] {
                let view = views.at(step, index, [1.0; 3]).unwrap();
                assert_eq!((view.name.as_str(), view.camera.size_px, view.image.width), (name, [side; 2], side as usize), "{step}");
                assert!(view.image.pixels.iter().all(|rgb| rgb[0] == red && rgb[2] == 1.0), "{step}");
            }
        }
        assert!(views.at(1, 2, [1.0; 3]).is_none() && views.at(30, 2, [1.0; 3]).is_none());
    }

    #[test]
    fn an_image_is_divided_by_its_gain_at_every_resolution() {
        let mut views = views("2@0,1@10");
        for step in [1, 11] {
            let view = views.at(step, 0, [2.0, 1.0, 0.5]).unwrap();
            assert!(view.image.pixels.iter().all(|rgb| rgb[0] == 1.0 && rgb[2] == 2.0), "{step}");
            let view = views.at(step, 1, [1.0; 3]).unwrap();
            assert!(view.image.pixels.iter().all(|rgb| rgb[0] == 4.0 && rgb[2] == 1.0), "{step}");
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
        let coarse = least(views.at(1, 0, [1.0; 3]).unwrap());
        let fine = least(views.at(11, 0, [1.0; 3]).unwrap());
        assert!(fine > 0.0 && fine < coarse && coarse < 1.0, "{fine} {coarse}");
    }

    #[test]
    fn recorded_values_are_seen_as_they_are() {
        let mut views = views("2@0,1@10");
        views.full.iter_mut().for_each(|view| view.values = PixelValues::Recorded { exposure_s: 0.1 });
        let view = views.at(11, 0, [3.0; 3]).unwrap();
        assert!(view.image.pixels.iter().all(|rgb| rgb[0] == 4.0 && rgb[2] == 2.0));
    }

    #[test]
    fn only_the_present_stage_is_held() {
        let mut views = views("4@0,2@10,1@20");
        views.at(1, 0, [1.0; 3]);
        assert!(views.reduced.as_ref().is_some_and(|reduced| reduced.factor == 4));
        views.at(11, 0, [1.0; 3]);
        assert!(views.reduced.as_ref().is_some_and(|reduced| reduced.factor == 2));
        views.at(21, 0, [1.0; 3]);
        assert!(views.reduced.is_none() && views.current.is_some());
        // The images of the data set are shared all along.
        assert!(views.full.iter().all(|view| Arc::strong_count(&view.image) == 1));
    }

    #[test]
    fn a_step_at_full_resolution_reuses_the_image_of_the_last() {
        let mut views = views("off");
        let at = |views: &mut TrainingViews, index| views.at(1, index, [1.0; 3]).map(|view| view.image.pixels.as_ptr());
        assert_eq!(at(&mut views, 0), at(&mut views, 1));
    }
}
