//! Refinement of a display bake against tone-mapped renders.
//!
//! Tone mapping per splat does not commute with blending: where bright and dark splats make up a
//! pixel, the bake's pixel is darker or flatter than the tone-mapped one. Viewers of display bakes
//! also enlarge splats smaller than a pixel, while the scene may be made for rasterisers that do
//! not ([`luxel_core::Antialias`]). The bake's harmonics, opacities and scales are therefore fitted
//! to the renders of the radiance scene: at first each splat's radiance times the curve's gain
//! where it is visible ([`super::gain`]), and then for some steps by training with these renders,
//! tone-mapped, as targets: 0.8 L1 + 0.2 (1 - SSIM) on display values, by Adam. Its steps are about
//! as long as its rates, which follow from how far a parameter may move in all steps together
//! ([`Reach`]) and fall to a tenth; higher terms of the harmonics move a twentieth as far as the
//! constant one, as in training. Views come in a fixed shuffled order, so that equal inputs give
//! equal files. At the end, harmonics are drawn towards their mean where they would be negative.

use std::borrow::Cow;
use std::path::Path;
use std::time::Instant;

use luxel_core::engine::{AdamBetas, CameraGradientChoice, LearningRates, StatsCollection, StepConfig};
use luxel_core::{ColorModel, Dataset, Engine, LossWeights, PixelValues, Scene, Similarity, Target, ToneCurve, View, text};
use luxel_io::{Appearance, BakeOptions, Baked};

use super::error::reference;
use super::gain::{GainView, Gains, exposed};
use crate::camera_path::with_at_most;
use crate::error::Context;
use crate::memory::engine_bytes;
use crate::{Event, Observer, Result, memory};

/// Steps of refinement unless a number is given.
pub const DEFAULT_REFINE_STEPS: u32 = 100;

/// Bounds of refinement by default, which keep its time to that of some hundred training steps:
/// views, at an even stride, and pixels of each.
const MOST_VIEWS: usize = 64;
const MOST_PIXELS: u64 = 1 << 20;

/// The extent of a refinement.
#[derive(Clone, Copy, Debug)]
pub(super) struct Refinement {
    steps: u32,
    is_bounded: bool,
}

impl Refinement {
    /// The refinement that is made unless another is asked for.
    pub(super) const DEFAULT: Self = Self { steps: DEFAULT_REFINE_STEPS, is_bounded: true };

    /// Returns a refinement on all views at their full size.
    pub(super) fn explicit(steps: u32) -> Self {
        Self { steps, is_bounded: false }
    }

    /// Returns the views to refine on, with reduced cameras where they are large.
    fn views(self, views: &[View]) -> Vec<View> {
        if !self.is_bounded {
            return views.to_vec();
        }
        let stride = views.len().div_ceil(MOST_VIEWS).max(1);
        views.iter().step_by(stride).map(reduced).collect()
    }
}

/// Returns the views of a data set that a refinement compares with.
fn shown(dataset: &Dataset) -> &[View] {
    if dataset.train.is_empty() { &dataset.test } else { &dataset.train }
}

/// Returns a view without its image, whose camera has at most [`MOST_PIXELS`].
fn reduced(view: &View) -> View {
    View { camera: with_at_most(&view.camera, MOST_PIXELS), ..view.clone() }
}

/// Checks that there is memory for the largest parts of [`write_with_refined_display`] on a
/// processor: the engine's splats and buffers, with the bake, and the targets of all views.
///
/// # Errors
/// The system refuses it.
pub fn check_refinement_room(scene: &Scene, dataset: &Dataset) -> Result<()> {
    let views = Refinement::DEFAULT.views(shown(dataset));
    let pixels: Vec<u64> = views.iter().map(|view| view.camera.size_px.map(u64::from).iter().product()).collect();
    let largest = pixels.iter().copied().max().unwrap_or(0);
    let engine = engine_bytes(scene.splats.len() as u64, ColorModel::Sh { degree: 3 }, largest);
    let targets = pixels.iter().sum::<u64>().saturating_mul(size_of::<[f32; 3]>() as u64);
    memory::check_room("refining the display bake", engine.saturating_add(targets), "leave the refinement out, or allow more memory")
}

/// Writes a scene with a display layer that is refined on the views of `dataset`, by default within
/// a bounded time. The radiance model beside it has the bits of a file without refinement.
///
/// # Errors
/// A device that gave up; the file system's refusal.
pub fn write_with_refined_display(
    path: &Path,
    scene: &Scene,
    dataset: &Dataset,
    steps: u32,
    engine: &mut dyn Engine,
    observer: &dyn Observer,
) -> Result<()> {
    let mut baked = Baked::new(scene, &BakeOptions { appearance: Appearance::preview_of(scene.color_space), max_degree: 3 });
    refine(&mut baked, scene, dataset, Refinement { steps, is_bounded: true }, engine, observer)?;
    let unit = scene.world_from_local.scale();
    let mut scene = Cow::Borrowed(scene);
    // A file has lengths in units of the world. With a unit of 1 no bit changes.
    if unit != 1.0 {
        baked.transform(&Similarity::IDENTITY);
        Similarity::scaling(unit).apply(&mut scene.to_mut().splats);
    }
    luxel_io::write_exact_ply(path, &scene, &baked).context("cannot write the scene")
}

/// How far a parameter may move.
#[derive(Clone, Copy)]
struct Reach {
    /// Sum of the rates over all steps.
    sum: f32,
    /// Rates at the first step: those between which Adam neither crawls nor overshoots.
    rates: [f32; 2],
}

impl Reach {
    /// The harmonics' constant term; 3.5 of it are 1 of display value.
    const DC: Self = Self { sum: 10.0, rates: [2.5e-3, 0.1] };
    /// Logits of opacity.
    const OPACITY: Self = Self { sum: 20.0, rates: [0.05, 0.5] };
    /// Logarithms of scales.
    const SCALE: Self = Self { sum: 2.0, rates: [0.005, 0.05] };

    /// Returns the rate at the first of `steps`.
    fn rate(self, steps: u32) -> f32 {
        (self.sum / (MEAN * steps as f32)).clamp(self.rates[0], self.rates[1])
    }
}

/// Higher terms' part of the constant term's rate.
const REST: f32 = 1.0 / 20.0;
/// Rates at the last step are this part of the first one's: on average, 0.39 of them.
const LAST: f32 = 0.1;
const MEAN: f32 = 0.39;
/// mu of a mu-law that is almost linear: display values are compared as they are.
const LINEAR_MU: f32 = 1e-3;

/// Trains the bake's harmonics, opacities and scales.
pub(super) fn refine(
    baked: &mut Baked,
    scene: &Scene,
    dataset: &Dataset,
    refinement: Refinement,
    engine: &mut dyn Engine,
    observer: &dyn Observer,
) -> Result<()> {
    let start = Instant::now();
    let steps = refinement.steps;
    let views = refinement.views(shown(dataset));
    let (targets, gains) = targets(baked, scene, &views, engine)?;
    let views = targets.len();
    gains.apply(baked, scene);
    engine.load(&baked.scene.splats, None).context("cannot load the bake")?;
    let render = baked.scene.render_options();
    let [dc_rate, opacity_rate, scale_rate] = [Reach::DC, Reach::OPACITY, Reach::SCALE].map(|reach| reach.rate(steps));
    let (mut first, mut last) = (0.0, 0.0);
    observer.event(Event::StepsBegin { done: 0, total: steps });
    for step in 1..=steps {
        let decay = LAST.powf((step - 1) as f32 / steps.max(2) as f32);
        let config = StepConfig {
            step,
            render,
            loss: LossWeights::default(),
            learning_rates: LearningRates {
                log_scale: scale_rate * decay,
                opacity_logit: opacity_rate * decay,
                sh_dc: dc_rate * decay,
                sh_rest: REST * dc_rate * decay,
                ..LearningRates::ZERO
            },
            betas: AdamBetas::default(),
            position_noise: None,
            dropout: None,
            stats: StatsCollection::Off,
            camera_gradient: CameraGradientChoice::Skip,
        };
        let view = &targets[shuffled(step as usize - 1, targets.len())];
        let report = engine.train_step(view, &config).context("cannot refine the bake")?;
        let n = targets.len() as u32;
        first += if step <= n { report.l1 } else { 0.0 };
        last += if step + n > steps { report.l1 } else { 0.0 };
        observer.event(Event::Step { done: step });
    }
    observer.event(Event::StepsEnd);
    let rounds = (targets.len() as u32).min(steps).max(1) as f32;
    let (trained, _) = engine.save().context("cannot read the bake back")?;
    let splats = &mut baked.scene.splats;
    (splats.sh, splats.log_scale, splats.opacity_logit) = (trained.sh, trained.log_scale, trained.opacity_logit);
    baked.lift_negative();
    let (first, last) = (f64::from(first / rounds), f64::from(last / rounds));
    observer.note(&format!(
        "display bake refined in {} by {} on {}: mean error {} before, {} after",
        text::duration(start.elapsed()),
        text::plural(steps as usize, "step"),
        text::plural(views, "view"),
        text::number(first),
        text::number(last)
    ));
    Ok(())
}

/// Returns views with the target images of the bake, and the gains from radiance to them.
fn targets(baked: &Baked, scene: &Scene, views: &[View], engine: &mut dyn Engine) -> Result<(Vec<View>, Gains)> {
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let options = scene.render_options();
    let mut gains = Gains::new(scene.splats.len());
    let mut targets = Vec::with_capacity(views.len());
    for view in views {
        let image = engine.render(&view.camera, &options).context("cannot render a view")?;
        let exposed = exposed(scene, baked, &image);
        let displayed = reference(scene, baked, image);
        gains.add(&GainView { camera: &view.camera, options: &options, exposed: &exposed, displayed: &displayed }, engine)?;
        let image = displayed.into();
        let target = Target { curve: ToneCurve::MuLaw { mu: LINEAR_MU }, ..Target::default() };
        targets.push(View { image, values: PixelValues::Radiance, noise: None, mask: None, target, ..view.clone() });
    }
    Ok((targets, gains))
}

/// Returns the index of the view at `step`: every view once a round, in strides that are coprime to
/// their number.
fn shuffled(step: usize, count: usize) -> usize {
    let is_coprime = |stride: &usize| {
        let (mut a, mut b) = (*stride, count);
        while b > 0 {
            (a, b) = (b, a % b);
        }
        a == 1
    };
    // The golden section of the count lies far from any short period.
    let stride = ((count as f64 * 0.618) as usize..).find(is_coprime).unwrap_or(1);
    (step * stride) % count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_bounded_by_views_and_pixels() {
        let folder = tempfile::tempdir().unwrap();
        crate::synthetic::write_dataset(folder.path(), crate::synthetic::BallsOptions { side_px: 16, views: 9 }).unwrap();
        let view = crate::Dataset::open(folder.path()).unwrap().train[0].clone();
        let sized = |size_px: [u32; 2]| View { camera: luxel_core::Camera { size_px, ..view.camera.clone() }, ..view.clone() };
        let many = vec![sized([4000, 3000]); 150];
        let found = Refinement::DEFAULT.views(&many);
        assert!(found.len() == 50 && found.iter().all(|view| view.camera.size_px == [1000, 750]), "{:?}", found[0].camera);
        assert_eq!(Refinement::DEFAULT.views(&[sized([1024, 1024])])[0].camera.size_px, [1024, 1024]);
        assert_eq!(Refinement::explicit(5).views(&many).len(), 150);
    }

    #[test]
    fn every_view_comes_once_a_round() {
        for count in 1..40 {
            let mut seen: Vec<usize> = (0..count).map(|step| shuffled(step, count)).collect();
            seen.sort_unstable();
            assert_eq!(seen, (0..count).collect::<Vec<_>>());
        }
    }
}
