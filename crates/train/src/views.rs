//! The training views as the steps see them: at the resolution of the step and with pixels weighted
//! by their noise, each with the target whose scale takes its image to normalised units and divides
//! it by its gain.
//!
//! In: views in the data set's units, which share their images. Out: one view at a time, with its
//! target, which the loss applies; thus images need not be copied, on a GPU either. Captured values
//! have no units, and their scale is 1.
//!
//! Where images are in memory, all images of a reduced resolution are kept, too, which takes at
//! most a quarter of the memory of the full ones. They are made when the first step needs them and
//! dropped when their stage ends, so that two reduced stages are never in memory. Where images are
//! read on demand, one view is in memory and the next is read ahead ([`crate::ahead`]); reduced
//! images are stored beside the full ones when they are first made, where those are stored.
//!
//! Effects of a reduced resolution (`f` is the reduction of a side):
//! - Loss: it is a mean over pixels, so its size and that of the regularisers stay the same. Images
//!   are averaged in linear light, before the mu-law, so a lamp smaller than a pixel keeps its
//!   energy. SSIM's window of 11 pixels covers `f` times the distance.
//! - Densification: the statistic is |dL/dmean| in NDC. For a splat of `s` pixels in an image of
//!   `S`, the sum of its pixels' gradients is proportional to s / S^2. NDC has S / 2 pixels, so the
//!   statistic is proportional to s / S: for splats larger than a pixel it does not depend on the
//!   resolution, and the thresholds stay the same. However, residuals finer than `f` pixels are
//!   averaged away. They cause no growth until their stage, and AbsGS's absolute sums, which count
//!   them, approach the signed ones. Slower growth in coarse stages is intended.
//! - Pruning and resets depend on opacity and on scale in world units, not on pixels. They do not
//!   change.
//! - Dilation is in rendered pixels. With compensation for area, splats smaller than a coarse pixel
//!   keep their light. 3DGS's dilation by 0.3 px^2 (`antialias` off) has no compensation and covers
//!   `0.3 f^2` full pixels squared. Splats below `0.55 f` full pixels are drawn too large, and the
//!   optimiser makes them smaller and fainter. After the stage they are too thin until they have
//!   grown back. A schedule has to leave enough steps for that.
//! - Mip-splatting's 3D filter limits the frequencies to those that the data set samples. It is
//!   computed from cameras of full resolution in all stages. With a stage's own cameras it would be
//!   `f` times as wide, and at the end of the stage all splats of its size would suddenly change in
//!   shape and opacity. The 2D filter prevents aliasing in coarse images.

use std::sync::Arc;

use luxel_core::{Camera, Mask, OnDemand, PixelValues, ReadError, Target, ToneCurve, View};
use rayon::prelude::*;

use crate::ahead::{Ahead, Key, Wanted};
use crate::crop::{Crop, cropped, draw, gradient_factor};
use crate::pixel_weights::{NoiseChoice, ToneScale, weighted};
use crate::resolution::{Stage, factor_at};
use crate::turn::turn;

/// Smallest valid fraction of a reduced pixel's area. A pixel below it describes its neighbours
/// rather than itself, and is masked.
const MIN_VALID: f64 = 0.5;

/// The training views over a run.
pub(crate) struct TrainingViews {
    /// The views in the units of the data set, which share its images.
    full: Vec<View>,
    /// The same views; the masks of those with known noise hold weights. Empty where images are
    /// read on demand.
    weighted: Vec<View>,
    stages: Vec<Stage>,
    tone: ToneScale,
    /// Cameras of full resolution in the place of the views' own, if those are corrected.
    moved: Option<Vec<Camera>>,
    /// The views of the current stage, if its resolution is reduced and images are in memory.
    reduced: Option<Reduced>,
    /// The reader of images that are read on demand, the view of the current step, and the reduced
    /// views that are stored.
    ahead: Ahead,
    current: Option<(Key, View)>,
    stored: Option<Stored>,
}

/// Views of a reduced resolution that are stored beside the full ones; `None` for those that are
/// reduced each time.
struct Stored {
    factor: u32,
    views: Vec<Option<View>>,
}

struct Reduced {
    factor: u32,
    /// Weighted views in the units of the data set.
    views: Vec<View>,
}

impl TrainingViews {
    pub(crate) fn new(train: &[View], stages: Vec<Stage>, noise: NoiseChoice, tone: ToneScale) -> Self {
        let with_noise = |view: &View| View { noise: noise.model(view), ..view.clone() };
        let full: Vec<View> = train.iter().map(with_noise).collect();
        let weighted = match full.iter().all(View::is_in_memory) {
            true => full.iter().map(|view| weighted_by_noise(view.clone(), tone)).collect(),
            false => Vec::new(),
        };
        let ahead = Ahead::new(move |wanted| prepare(wanted, tone));
        Self { full, weighted, stages, tone, moved: None, reduced: None, ahead, current: None, stored: None }
    }

    /// Returns the number of views.
    pub(crate) fn len(&self) -> usize {
        self.full.len()
    }

    /// Returns the name of view `index`.
    pub(crate) fn name(&self, index: usize) -> &str {
        self.full.get(index).map_or("", |view| &view.name)
    }

    /// Returns the cameras at full resolution.
    pub(crate) fn cameras(&self) -> Vec<&Camera> {
        match &self.moved {
            Some(cameras) => cameras.iter().collect(),
            None => self.full.iter().map(|view| &view.camera).collect(),
        }
    }

    /// Sees the views through other cameras of full resolution, in the order of the views.
    pub(crate) fn move_to(&mut self, cameras: Vec<Camera>) {
        self.moved = Some(cameras);
    }

    /// Returns the corrected camera of view `index` at a reduced resolution, if there is one.
    fn moved_camera(&self, index: usize, factor: u32) -> Option<Camera> {
        Some(self.moved.as_ref()?.get(index)?.downscaled(factor))
    }

    /// Returns the number of pixels of all views together, at full resolution.
    pub(crate) fn train_px(&self) -> u64 {
        pixels(&self.full)
    }

    /// Returns the reduction of a side at `step`.
    pub(crate) fn factor(&self, step: u32) -> u32 {
        factor_at(&self.stages, step)
    }

    /// Returns the smallest side of the images, pixels.
    pub(crate) fn smallest_side_px(&self) -> u32 {
        self.full.iter().flat_map(|view| view.camera.size_px).min().unwrap_or(1)
    }

    /// Replaces the stages of the resolution, from the next step on.
    pub(crate) fn set_stages(&mut self, stages: Vec<Stage>) {
        self.stages = stages;
    }

    /// Returns the stages of the resolution.
    pub(crate) fn stages(&self) -> &[Stage] {
        &self.stages
    }

    /// Returns the factor by which gradients of positions on screen are larger at `step` than in
    /// whole views, for crops of at most `side_px` pixels a side.
    pub(crate) fn gradient_factor(&self, step: u32, side_px: u32) -> f32 {
        gradient_factor(&self.full, side_px.saturating_mul(self.factor(step)))
    }

    /// Returns view `index` as `step` sees it, all of it, with the target of gain `gain` under the
    /// mu-law; `None` if there is no such view. The scale of captured values is 1, because their
    /// gain applies to the exposure.
    ///
    /// # Errors
    /// An image that cannot be read.
    pub(crate) fn at(&mut self, step: u32, index: usize, gain: [f32; 3]) -> Result<Option<&mut View>, ReadError> {
        self.part_at(step, index, gain, None)
    }

    /// Returns what [`Self::at`] does, or a part of it.
    ///
    /// # Errors
    /// An image that cannot be read.
    pub(crate) fn part_at(&mut self, step: u32, index: usize, gain: [f32; 3], crop: Option<Crop>) -> Result<Option<&mut View>, ReadError> {
        let factor = self.factor(step);
        let Some(full) = self.full.get(index) else { return Ok(None) };
        let scale = match full.values {
            PixelValues::Radiance => self.tone.radiance_scale.target_scale(gain),
            PixelValues::Recorded { .. } => [1.0; 3],
        };
        let target = Target { curve: ToneCurve::MuLaw { mu: self.tone.mu }, scale, vignetting: None };
        let moved = self.moved_camera(index, factor);
        let key = Key { index, factor, crop };
        let view = if self.weighted.is_empty() {
            self.on_demand(key)?
        } else if let Some(crop) = crop {
            let part = self.in_memory(step, key).map(|whole| cropped(whole, draw(whole, crop)));
            self.current = part.map(|part| (key, part));
            self.current.as_mut().map(|(_, part)| part)
        } else {
            self.in_memory(step, key)
        };
        let Some(view) = view else { return Ok(None) };
        show(view, target, moved);
        Ok(Some(view))
    }

    /// Returns the captured image beside view `index` that `step` sees, at its resolution; `None`
    /// if there is none.
    ///
    /// # Errors
    /// An image that cannot be read.
    pub(crate) fn recording_at(&self, step: u32, index: usize, crop: Option<Crop>) -> Result<Option<View>, ReadError> {
        let Some(full) = self.full.get(index) else { return Ok(None) };
        let Some(recording) = full.recordings.get(turn(step, index, self.full.len(), full.recordings.len())) else { return Ok(None) };
        let (recording, factor) = (recording.loaded()?, self.factor(step));
        let recording = if factor == 1 { recording } else { recording.downscaled(factor, MIN_VALID) };
        Ok(Some(match crop {
            Some(crop) => cropped(&recording, draw(&recording, crop)),
            None => recording,
        }))
    }

    /// Asks for the view of the next step in advance, where images are read on demand.
    pub(crate) fn ask(&mut self, step: u32, index: usize, crop: Option<Crop>) {
        if !self.weighted.is_empty() {
            return;
        }
        let wanted = self.wanted(Key { index, factor: self.factor(step), crop });
        self.ahead.ask(|| wanted);
    }

    /// Returns a view whose mask is in memory, and whose image need not be: for what looks at the
    /// weights of pixels alone.
    ///
    /// # Errors
    /// A mask, or an image that decides the weights, that cannot be read.
    pub(crate) fn weights_at(&mut self, step: u32, index: usize) -> Result<Option<View>, ReadError> {
        let key = Key { index, factor: self.factor(step), crop: None };
        match self.wanted(key).filter(|wanted| self.weighted.is_empty() && wanted.reduce_by == 1 && wanted.view.noise.is_none()) {
            Some(Wanted { view, .. }) => {
                let mask = view.mask.as_ref().map(OnDemand::loaded).transpose()?;
                let mut view = View { mask, ..view };
                let (target, moved) = (view.target, self.moved_camera(index, key.factor));
                show(&mut view, target, moved);
                Ok(Some(view))
            }
            None => Ok(self.at(step, index, [1.0; 3])?.map(|view| view.clone())),
        }
    }

    /// Returns what is to be read for a view.
    fn wanted(&mut self, key: Key) -> Option<Wanted> {
        let full = self.full.get(key.index)?;
        if key.factor == 1 || !self.weighted.is_empty() {
            self.stored = None;
            return Some(Wanted { key, view: full.clone(), reduce_by: key.factor });
        }
        if self.stored.as_ref().is_none_or(|stored| stored.factor != key.factor) {
            let views = self.full.iter().map(|view| stored_reduced(view, key.factor)).collect();
            self.stored = Some(Stored { factor: key.factor, views });
        }
        let stored = self.stored.as_ref().and_then(|stored| stored.views.get(key.index)?.clone());
        Some(match stored {
            Some(view) => Wanted { key, view, reduce_by: 1 },
            None => Wanted { key, view: full.clone(), reduce_by: key.factor },
        })
    }

    /// Returns a whole view whose image is in memory.
    fn in_memory(&mut self, step: u32, Key { index, factor, .. }: Key) -> Option<&mut View> {
        if factor == 1 {
            self.reduced = None;
            return self.weighted.get_mut(index);
        }
        self.reduced(step, factor).views.get_mut(index)
    }

    /// Returns a view that is read on demand.
    fn on_demand(&mut self, key: Key) -> Result<Option<&mut View>, ReadError> {
        if self.current.as_ref().is_none_or(|(current, _)| *current != key) {
            // The last one makes room for the next.
            self.current = None;
            let Some(wanted) = self.wanted(key) else { return Ok(None) };
            self.current = Some((key, self.ahead.take(&wanted)?));
        }
        Ok(self.current.as_mut().map(|(_, view)| view))
    }

    /// Returns the views of a reduced resolution, which are made where they are not there.
    fn reduced(&mut self, step: u32, factor: u32) -> &mut Reduced {
        // The old stage is dropped before the new one is made, to save memory.
        let made = self.reduced.take().filter(|reduced| reduced.factor == factor);
        let tone = self.tone;
        self.reduced.insert(made.unwrap_or_else(|| {
            let views = self.full.par_iter().map(|view| reduce(view, factor, tone)).collect();
            tracing::info!(step, factor, "training resolution");
            Reduced { factor, views }
        }))
    }
}

/// Reads a view, at the resolution and with the weights of its step.
fn prepare(wanted: &Wanted, tone: ToneScale) -> Result<View, ReadError> {
    let view = wanted.view.loaded()?;
    let view = if wanted.reduce_by == 1 { weighted_by_noise(view, tone) } else { reduce(&view, wanted.reduce_by, tone) };
    Ok(match wanted.key.crop {
        Some(crop) => cropped(&view, draw(&view, crop)),
        None => view,
    })
}

/// Returns the reduced view as it is stored beside the full one, or will be once it is read; `None`
/// where nothing is stored, or where reducing makes a mask that the view does not have.
fn stored_reduced(view: &View, factor: u32) -> Option<View> {
    if view.values != PixelValues::Radiance {
        return None;
    }
    let camera = view.camera.downscaled(factor.min(view.camera.size_px[0]).min(view.camera.size_px[1]).max(1));
    let size = camera.size_px.map(|side| side as usize);
    let label = factor.to_string();
    let (image, mask) = (view.clone(), view.clone());
    let make_image = move || Ok(image.loaded()?.downscaled(factor, MIN_VALID).image.into_value());
    let make_mask = move || {
        let mask = mask.loaded()?.downscaled(factor, MIN_VALID).mask;
        Ok(mask.map_or_else(|| Mask { weights: vec![1.0; size[0] * size[1]] }, OnDemand::into_value))
    };
    let image = view.image.source()?.derived(&label, size, Arc::new(make_image))?;
    let mask = match &view.mask {
        None => None,
        Some(mask) => Some(mask.source()?.derived(&label, size, Arc::new(make_mask))?),
    };
    let noise = view.noise.map(|model| model.averaged((factor * factor) as usize));
    Some(View { camera, image, mask, noise, ..view.clone() })
}

/// Gives a view its target, and the pose and focal length of another camera if there is one; what
/// its image covers stays.
fn show(view: &mut View, target: Target, moved: Option<Camera>) {
    view.target = target;
    if let Some(Camera { camera_from_world, focal_px, .. }) = moved {
        (view.camera.camera_from_world, view.camera.focal_px) = (camera_from_world, focal_px);
    }
}

/// Returns the number of pixels of all views together.
pub(crate) fn pixels(views: &[View]) -> u64 {
    views.iter().map(View::pixel_count).sum()
}

/// Returns the number of pixels of the largest view.
pub(crate) fn largest_px(views: &[View]) -> u64 {
    views.iter().map(View::pixel_count).max().unwrap_or(0)
}

fn reduce(view: &View, factor: u32, tone: ToneScale) -> View {
    weighted_by_noise(view.downscaled(factor, MIN_VALID), tone)
}

/// Returns the view with weights by its noise in its mask, if the noise is known. Captured values
/// are not weighted, because noise models describe radiance.
fn weighted_by_noise(view: View, tone: ToneScale) -> View {
    match view.noise.filter(|_| view.values == PixelValues::Radiance) {
        Some(model) => View { mask: Some(weighted(&view, model, tone).into()), ..view },
        None => view,
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::{Image, RadianceScale};

    use super::*;
    use crate::crop::Shape;
    use crate::testing::{camera_at, view_of};

    fn views(stages: &str) -> TrainingViews {
        let image = |shade: f32| Image::from_pixels(32, 32, (0..32 * 32).map(|i| [shade, i as f32, 2.0]).collect()).unwrap();
        let train = [view_of("a", camera_at([0.0; 3], [32, 32]), image(4.0)), view_of("b", camera_at([1.0; 3], [32, 32]), image(8.0))];
        let schedule: crate::ResolutionSchedule = stages.parse().unwrap();
        TrainingViews::new(
            &train,
            schedule.stages(100, 10, 32),
            NoiseChoice::Auto,
            ToneScale { radiance_scale: RadianceScale::new(2.0).unwrap(), mu: 5000.0 },
        )
    }

    #[test]
    fn steps_see_the_view_of_their_stage_and_its_scale() {
        let mut views = views("4@0,2@10,1@20");
        for (step, side) in [(1, 8), (10, 8), (11, 16), (20, 16), (21, 32), (22, 32), (1, 8)] {
            for (index, name, red) in [(0, "a", 4.0), (1, "b", 8.0)] {
                let view = views.at(step, index, [1.0; 3]).unwrap().unwrap();
                assert_eq!((view.name.as_str(), view.camera.size_px, view.image.width), (name, [side; 2], side as usize), "{step}");
                assert!(view.image.pixels.iter().all(|rgb| rgb[0] == red && rgb[2] == 2.0), "{step}");
                assert_eq!(view.target, Target { curve: ToneCurve::MuLaw { mu: 5000.0 }, scale: [0.5; 3], vignetting: None });
            }
        }
        assert!(views.at(1, 2, [1.0; 3]).unwrap().is_none() && views.at(30, 2, [1.0; 3]).unwrap().is_none());
    }

    #[test]
    fn an_image_is_divided_by_its_gain_at_every_resolution() {
        let mut views = views("2@0,1@10");
        for step in [1, 11] {
            assert_eq!(views.at(step, 0, [2.0, 1.0, 0.5]).unwrap().unwrap().target.scale, [0.25, 0.5, 1.0], "{step}");
            assert_eq!(views.at(step, 1, [1.0; 3]).unwrap().unwrap().target.scale, [0.5; 3], "{step}");
        }
    }

    #[test]
    fn pixels_of_known_noise_are_weighted_at_every_resolution() {
        let mut views = views("2@0,1@10");
        let model = luxel_core::NoiseModel { read: 0.5, shot: 0.1 };
        let stages = views.stages.clone();
        let train = views.full.clone();
        views = TrainingViews::new(&train, stages, NoiseChoice::Given(model), views.tone);
        let least = |view: &View| view.mask.as_ref().unwrap().weights.iter().copied().fold(1.0, f32::min);
        let coarse = least(views.at(1, 0, [1.0; 3]).unwrap().unwrap());
        let fine = least(views.at(11, 0, [1.0; 3]).unwrap().unwrap());
        assert!(fine > 0.0 && fine < coarse && coarse < 1.0, "{fine} {coarse}");
    }

    #[test]
    fn recorded_values_are_seen_as_they_are() {
        let mut views = views("2@0,1@10");
        views.full.iter_mut().for_each(|view| view.values = PixelValues::Recorded { exposure_s: 0.1 });
        assert_eq!(views.at(11, 0, [3.0; 3]).unwrap().unwrap().target.scale, [1.0; 3]);
    }

    #[test]
    fn only_the_present_stage_is_held() {
        let mut views = views("4@0,2@10,1@20");
        views.at(1, 0, [1.0; 3]).unwrap();
        assert!(views.reduced.as_ref().is_some_and(|reduced| reduced.factor == 4));
        views.at(11, 0, [1.0; 3]).unwrap();
        assert!(views.reduced.as_ref().is_some_and(|reduced| reduced.factor == 2));
        views.at(21, 0, [1.0; 3]).unwrap();
        assert!(views.reduced.is_none());
    }

    #[test]
    fn a_view_is_the_same_allocation_in_every_step() {
        let mut views = views("2@0,1@10");
        for step in [1, 11] {
            let at = |views: &mut TrainingViews, gain| views.at(step, 0, gain).unwrap().map(|view| Arc::as_ptr(&view.image.shared()));
            let first = at(&mut views, [1.0; 3]);
            assert_eq!(at(&mut views, [2.0; 3]), first);
        }
        // At full resolution, the images are those of the data set.
        assert!(views.full.iter().zip(&views.weighted).all(|(view, weighted)| Arc::ptr_eq(&view.image.shared(), &weighted.image.shared())));
    }

    #[test]
    fn a_part_is_the_same_from_memory_and_on_demand() {
        let train = views("1@0").full;
        let later: Vec<View> = train.iter().map(crate::testing::on_demand).collect();
        let tone = ToneScale { radiance_scale: RadianceScale::ONE, mu: 5000.0 };
        let noise = NoiseChoice::Given(luxel_core::NoiseModel { read: 0.5, shot: 0.1 });
        let stages = "2@0,1@10".parse::<crate::ResolutionSchedule>().unwrap().stages(100, 10, 32);
        let of = |train: &[View]| TrainingViews::new(train, stages.clone(), noise, tone);
        let (mut now, mut later) = (of(&train), of(&later));
        for step in [1, 2, 11, 12, 13] {
            let crop = Some(Crop { shape: Shape::Tile { side_px: 12 }, seed: u64::from(step) });
            later.ask(step, 1, crop);
            let [a, b] = [&mut now, &mut later].map(|views| views.part_at(step, 1, [1.0; 3], crop).unwrap().unwrap().clone());
            assert_eq!((&a.image, &a.mask, &a.camera, a.target), (&b.image, &b.mask, &b.camera, b.target), "{step}");
            assert!(a.camera.size_px.iter().all(|side| *side <= 12), "{step}");
        }
        assert!(now.gradient_factor(1, 12) < now.gradient_factor(11, 12) && now.gradient_factor(11, 32) == 1.0);
    }
}
