//! Measurements of a session on the way: a training view at each line of the log, a few test views
//! for the curve, and everything at an evaluation.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

use luxel::export::{check_refinement_room, write_with_refined_display};
use luxel::refined_views::{test_views_of, train_views_of};
use luxel::{Event, Result, SelectedEngine};
use luxel_core::{ColorSpace, Dataset, Engine, Knots, RadianceScale, RenderOptions, Scene, View};
use luxel_metrics::{FieldOptions, FlipChoice, GainFit};
use luxel_train::{LensVignetting, SceneContent};

use super::super::evaluation::{Metrics, Rendering, TEST_ALIGNED};
use super::super::kept_renders::KeptRenders;
use super::super::log::LOG_EVERY;
use super::super::test_curve::TestCurve;
use super::super::{Captures, RunCameras, report, vignetting_text};
use super::{LoopState, Session};
use crate::{build_info, files, process, schema};

/// Time and memory that training took before an evaluation.
#[derive(Clone, Copy)]
struct Spent {
    seconds: f64,
    processor_seconds: Option<f64>,
    peak_rss_bytes: Option<u64>,
}

impl Session<'_> {
    /// Returns the PSNR of one training view, in turn: a sign of progress between evaluations.
    pub(super) fn probe(&mut self) -> Result<Option<f64>> {
        let turn = (self.trainer.iteration() / LOG_EVERY) as usize % self.dataset.train.len().max(1);
        let Some(view) = self.dataset.train.get(turn) else { return Ok(None) };
        let mut seen = view.clone();
        self.show_vignetting(std::slice::from_ref(view), [&mut seen]);
        if let Some(camera) = self.trainer.refined_cameras().and_then(|cameras| cameras.into_iter().nth(turn)) {
            seen.camera = camera;
        }
        self.rendering().probe(&seen)
    }

    /// Returns the mean PSNR of a few test views, for the curve of the report; `None` if all of
    /// them are masked.
    pub(super) fn sample_test_views(&mut self, schedule: TestCurve) -> Result<Option<f64>> {
        let test = self.test_views().into_owned();
        let mut rendering = self.rendering();
        let views = schedule.views().filter_map(|i| test.get(i));
        let found: Vec<Option<f64>> = views.map(|view| rendering.probe(view)).collect::<Result<_>>()?;
        let found: Vec<f64> = found.into_iter().flatten().collect();
        Ok((!found.is_empty()).then(|| found.iter().sum::<f64>() / found.len() as f64))
    }

    /// Writes scene, images, metrics and report of this step, with the clock stopped.
    pub(super) fn evaluate(&mut self, state: &mut LoopState) -> Result<()> {
        let spent =
            Spent { seconds: state.clock.seconds(), processor_seconds: state.clock.processor_seconds(), peak_rss_bytes: state.peak_rss() };
        let psnr = state.clock.paused(|| self.evaluate_at(spent))?;
        state.psnr_test = psnr.or(state.psnr_test);
        Ok(())
    }

    fn evaluate_at(&mut self, spent: Spent) -> Result<Option<f64>> {
        let iteration = self.trainer.iteration();
        let (dataset, finished) = (self.dataset, self.trainer.is_finished());
        let config = self.config;
        let folded = self.write_scene(iteration)?.filter(|_| finished && config.train.method.lifts_colors());
        let images = self.folder.evaluation(iteration);
        Captures::new(&*self.trainer, &dataset.train).write(self.folder)?;
        let mut splits = BTreeMap::new();
        let train = self.train_views().into_owned();
        let test_views = self.test_views().into_owned();
        let (poses, vignetting) = (self.trainer.pose_report(), self.trainer.vignetting().unwrap_or_default());
        let folder = self.folder;
        let (threads, size, settings) = (self.threads, self.trainer.size(), self.settings());
        let is_slow = self.trainer.renders_slowly();
        let mut kept;
        let engine: &mut dyn Engine = match self.trainer.engine() {
            engine if is_slow => {
                kept = KeptRenders::new(engine);
                &mut kept
            }
            engine => engine,
        };
        let mut rendering = settings.on(engine);
        let test = rendering.evaluate(&test_views, Some(&images), GainFit::None)?;
        let aligned = if poses.is_some() { rendering.align(config.train.loss_weights(), &test_views)? } else { None };
        if let Some(aligned) = &aligned
            && let Some(split) = rendering.evaluate(&aligned.views, None, GainFit::None)?
        {
            splits.insert(TEST_ALIGNED.to_owned(), split);
        }
        if poses.is_some() {
            let test = aligned.iter().flat_map(|aligned| &aligned.views);
            RunCameras::new(iteration, dataset, train.iter().chain(test)).write(folder)?;
        }
        let train = if finished { rendering.evaluate(&train, None, GainFit::None)? } else { None };
        for (name, split) in rendering.evaluate_fitted(config, &test_views)? {
            splits.insert(name.to_owned(), split);
        }
        for (name, split) in rendering.evaluate_folded(folded.as_deref(), threads, &test_views)? {
            splits.insert(name.to_owned(), split);
        }
        for (name, split) in [("test", test), ("train", train)] {
            if let Some(split) = split {
                splits.insert(name.to_owned(), split);
            }
        }
        let metrics = Metrics {
            method: self.config.method_name(),
            iterations: iteration,
            splats: size.splats(),
            field_parameters: size.field_parameters(),
            train_seconds: spent.seconds,
            train_cpu_seconds: spent.processor_seconds,
            peak_rss_bytes: spent.peak_rss_bytes.max(process::peak_resident_bytes()),
            radiance_scale: self.trainer.radiance_scale(),
            mu: self.config.train.mu,
            seed: self.config.train.seed,
            threads: self.threads,
            computed_by: self.computed_by.clone(),
            luxel_version: luxel::VERSION.into(),
            revision: build_info::REVISION.map(Into::into),
            features: build_info::features().into_iter().map(Into::into).collect(),
            dataset: self.config.dataset_path(self.folder.root()).display().to_string(),
            poses,
            test_alignment: aligned.map(|aligned| aligned.report),
            vignetting,
            splits,
        };
        self.publish(&metrics, &images)
    }

    /// Writes metrics and report, and tells of them; returns the PSNR of the test views.
    fn publish(&self, metrics: &Metrics, images: &Path) -> Result<Option<f64>> {
        let iteration = metrics.iterations;
        files::write_json(&self.folder.metrics(), schema::METRICS, metrics)?;
        if !metrics.vignetting.is_empty() {
            self.observer.note(&format!("vignetting after {iteration} steps: {}", vignetting_text(&metrics.vignetting)));
        }
        if self.trainer.is_finished() {
            report::write(self.folder, self.config, self.dataset, report::Evaluated { metrics, images })?;
        }
        let psnr = metrics.splits.get("test").map(|split| split.mean.psnr_scene);
        // Last: it marks the evaluation as complete.
        files::write_json(&images.join("metrics.json"), schema::METRICS, metrics)?;
        for (name, split) in &metrics.splits {
            let mean = split.mean;
            let (split, views) = (name.clone(), split.views.len());
            self.observer.event(Event::Evaluation { step: iteration, split, mean, views });
        }
        Ok(psnr)
    }

    /// Writes the scene file of step `iteration`, and returns a scene of splats.
    fn write_scene(&mut self, iteration: u32) -> Result<Option<Box<Scene>>> {
        let (path, scene) = match self.trainer.content()? {
            SceneContent::Splats(scene) => {
                let path = self.folder.scene(iteration);
                self.write_splats(&path, &scene)?;
                (path, Some(scene))
            }
            SceneContent::Arrays(file) => {
                let path = self.folder.result(self.config.train.method, iteration);
                files::write_arrays(&path, &file)?;
                (path, None)
            }
        };
        self.observer.event(Event::Saved { path });
        Ok(scene)
    }

    /// Writes a scene of splats. The last one's display layer, which splat viewers show, is
    /// refined; where that fails, it is written as the others are.
    fn write_splats(&mut self, path: &Path, scene: &Scene) -> Result<()> {
        let steps = self.config.run.refine_display;
        if self.trainer.is_finished() && steps > 0 && !scene.splats.is_empty() {
            let refined = SelectedEngine::open(&self.config.device).and_then(|mut selected| {
                if selected.gpu.is_none() {
                    // An allocation that failed in the middle of it would end the run before its
                    // metrics.
                    check_refinement_room(scene, &self.refined_dataset())?;
                }
                write_with_refined_display(path, scene, &self.refined_dataset(), steps, selected.engine.as_mut(), self.observer)
            });
            match refined {
                Ok(()) => return Ok(()),
                Err(error) => self.observer.warn(&format!("{:#}", error.context("the display colours of the scene file are not refined"))),
            }
        }
        Ok(luxel_io::write_scene_ply(path, scene)?)
    }

    /// Returns the training views as the trainer sees them: with refined cameras and vignetting, if
    /// there are any.
    fn train_views(&self) -> Cow<'_, [View]> {
        let mut views = train_views_of(&*self.trainer, self.dataset);
        if self.trainer.config().vignetting {
            self.show_vignetting(&self.dataset.train, views.to_mut());
        }
        views
    }

    /// Returns the test views with the lenses and the vignetting that the trainer sees, if those
    /// are optimised.
    fn test_views(&self) -> Cow<'_, [View]> {
        let mut views = test_views_of(&*self.trainer, self.dataset);
        if self.trainer.config().vignetting {
            self.show_vignetting(&self.dataset.test, views.to_mut());
        }
        views
    }

    /// Gives views the vignetting that the trainer has found of their lenses.
    fn show_vignetting<'v>(&self, given: &[View], views: impl IntoIterator<Item = &'v mut View>) {
        LensVignetting::show_in(&self.trainer.vignetting().unwrap_or_default(), given, views);
    }

    /// Returns the data set with the training views as the trainer sees them.
    fn refined_dataset(&self) -> Cow<'_, Dataset> {
        match self.train_views() {
            Cow::Borrowed(_) => Cow::Borrowed(self.dataset),
            Cow::Owned(train) => Cow::Owned(Dataset { train, ..self.dataset.clone() }),
        }
    }

    fn rendering(&mut self) -> Rendering<'_> {
        let settings = self.settings();
        settings.on(self.trainer.engine())
    }

    fn settings(&self) -> Settings {
        Settings {
            options: self.trainer.render_options(),
            radiance_scale: self.trainer.radiance_scale(),
            mu: self.config.train.mu,
            color_space: self.dataset.color_space,
            response: self.trainer.response(),
            log_gains: Captures::new(&*self.trainer, &self.dataset.train).log_gains_at(self.trainer.iteration()),
        }
    }
}

/// The settings of renders and measurements, without the engine.
struct Settings {
    options: RenderOptions,
    radiance_scale: RadianceScale,
    mu: f32,
    color_space: ColorSpace,
    response: Option<Knots>,
    log_gains: BTreeMap<String, [f32; 3]>,
}

impl Settings {
    fn on(self, engine: &mut dyn Engine) -> Rendering<'_> {
        let Self { options, radiance_scale, mu, color_space, response, log_gains } = self;
        Rendering {
            engine,
            options,
            radiance_scale,
            protocol_scale: None,
            mu,
            color_space,
            peak_luminance: FieldOptions::DEFAULT_PEAK_LUMINANCE,
            flip: FlipChoice::Skip,
            lpips: None,
            response,
            log_gains,
            progress: None,
        }
    }
}
