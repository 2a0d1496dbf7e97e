//! Evaluation of a finished or interrupted run: metrics of its newest scene, on its own data set or
//! another; and of a scene file without a run.
//!
//! In: a run folder, a data set, an engine. Out: `metrics.json`, the images of the test views, the
//! report, and the metrics themselves. The folder of a step's evaluation is for the run's own data
//! as the run read it; other data get a folder of their own. A scene file is measured with its own
//! settings, on black; nothing is written unless a folder is named.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

use luxel::error::{Context, bail};
use luxel::{Event, FrameProgress, Observer, Result, SelectedEngine};
use luxel_core::{Dataset, Engine, RadianceScale, Scene};
use luxel_io::LoadOptions;
use luxel_metrics::{FieldOptions, FlipChoice};
use luxel_metrics::{GainFit, Lpips, SplitMetrics};
use luxel_train::{LensVignetting, PoseReport};
use serde::Serialize;

use super::evaluation::TEST_ALIGNED;
use super::evaluation::count_frames;
use super::kept_renders::KeptRenders;
use super::report::Evaluated;
use super::state::LoadedRun;
use super::{Captures, Metrics, Rendering, RunCameras, RunConfig, RunFolder, log, report, state};
use crate::{build_info, files, output, process, schema};

/// Choice of the metrics of an evaluation.
#[derive(Clone, Copy, Debug)]
pub struct MetricsOptions<'a> {
    /// Luminance at which the display of PU21 shows the scale, cd/m2.
    pub peak_luminance: f32,
    /// Whether HDR-FLIP is computed.
    pub flip: FlipChoice,
    /// The network of LPIPS, if it is computed.
    pub lpips: Option<&'a Lpips>,
    /// Data-set radiance that is 1 in protocol `scene`, in the decades and on the display of PU21;
    /// `None` for the scene's radiance scale.
    pub scale: Option<RadianceScale>,
}

impl Default for MetricsOptions<'_> {
    /// The metrics of training: neither HDR-FLIP nor LPIPS.
    fn default() -> Self {
        Self { peak_luminance: FieldOptions::DEFAULT_PEAK_LUMINANCE, flip: FlipChoice::Skip, lpips: None, scale: None }
    }
}

/// A data set to measure a run against.
#[derive(Clone, Copy, Debug)]
pub struct EvaluationData<'a> {
    /// Path it was read from.
    pub path: &'a Path,
    /// Options it was read with.
    pub load: &'a LoadOptions,
    /// Its views.
    pub dataset: &'a Dataset,
}

/// Measures a run's newest scene, and writes `metrics.json`, images and report into its folder,
/// whose lock the caller holds. Returns the metrics by split, test before train.
///
/// # Errors
/// A run without a readable scene; images in another colour space than the scene; a device that
/// gave up; a file that cannot be written.
pub fn evaluate_run(
    folder: &RunFolder,
    config: &RunConfig,
    data: EvaluationData<'_>,
    metrics: MetricsOptions<'_>,
    selected: SelectedEngine,
    observer: &dyn Observer,
) -> Result<Vec<(&'static str, SplitMetrics)>> {
    let EvaluationData { path, load, dataset } = data;
    let LoadedRun { iteration, scene, selected, non_splat } = state::load_newest(folder, config, selected, observer)?;
    let SelectedEngine { mut engine, threads, computed_by, .. } = selected;
    let mut kept;
    let engine: &mut dyn Engine = match non_splat {
        None => engine.as_mut(),
        Some(_) => {
            kept = KeptRenders::new(engine.as_mut());
            &mut kept
        }
    };
    let splats = engine.len();
    check_color_space(path, dataset, &scene)?;
    let is_own = output::is_same(path, &config.dataset_path(folder.root()));
    let cameras = if is_own { RunCameras::read_at(folder, iteration)? } else { RunCameras::default() };
    let vignetting = vignetting_of(folder, config, data, iteration)?;
    let dataset = show_vignetting(&vignetting, dataset.in_frame(scene.world_from_local));
    let dataset = &*cameras.seen_by_training(dataset);
    let mut rendering = Rendering {
        engine,
        options: scene.render_options_before(config.train.background),
        radiance_scale: scene.radiance_scale,
        protocol_scale: metrics.scale,
        mu: config.train.mu,
        color_space: dataset.color_space,
        peak_luminance: metrics.peak_luminance,
        flip: metrics.flip,
        lpips: metrics.lpips,
        response: state::response(folder, config, iteration, non_splat.as_ref())?,
        log_gains: Captures::read(folder)?.log_gains_at(iteration),
        progress: Some(FrameProgress { observer, done: 0, total: count_frames(config, dataset) }),
    };
    let images =
        if is_own && *load == config.load { folder.evaluation(iteration) } else { folder.claim_evaluation_of(iteration, path, load)? };
    let (named, test_alignment) =
        measure(&mut rendering, config, dataset, &images, config.train.method.lifts_colors().then_some(&scene), threads)?;
    observer.event(Event::StepsEnd);
    let splits = named.iter().map(|(name, split)| ((*name).to_owned(), split.clone())).collect();
    let log = log::read(&folder.log())?;
    let spent = log.iter().rev().find(|record| record.iteration <= iteration);
    let metrics = Metrics {
        method: config.method_name(),
        iterations: iteration,
        splats,
        field_parameters: non_splat.and_then(|non_splat| non_splat.field_parameters),
        train_seconds: spent.map_or(0.0, |record| record.elapsed_s),
        train_cpu_seconds: spent.and_then(|record| record.cpu_s),
        peak_rss_bytes: spent.and_then(|record| record.peak_rss_bytes).max(process::peak_resident_bytes()),
        radiance_scale: metrics.scale.unwrap_or(scene.radiance_scale),
        mu: config.train.mu,
        seed: config.train.seed,
        threads,
        computed_by,
        luxel_version: luxel::VERSION.into(),
        revision: build_info::REVISION.map(Into::into),
        features: build_info::features().into_iter().map(Into::into).collect(),
        dataset: path.display().to_string(),
        poses: spent.and_then(|record| record.poses.clone()),
        test_alignment,
        vignetting,
        splits,
    };
    // Not beside the images: metrics there mark an evaluation by training.
    files::write_json(&folder.metrics(), schema::METRICS, &metrics)?;
    report::write(folder, config, dataset, Evaluated { metrics: &metrics, images: &images })?;
    Ok(named)
}

/// Metrics by split, test before train, and how the test views were aligned, if they were.
type Measured = (Vec<(&'static str, SplitMetrics)>, Option<PoseReport>);

/// Measures the views of a run, and writes the images of the test views. `folded` is the scene of
/// splats of a method that lifts colours.
fn measure(
    rendering: &mut Rendering<'_>,
    config: &RunConfig,
    dataset: &Dataset,
    images: &Path,
    folded: Option<&Scene>,
    threads: usize,
) -> Result<Measured> {
    let mut named = Vec::new();
    for (name, views, images) in [("test", &dataset.test, Some(images)), ("train", &dataset.train, None)] {
        named.extend(rendering.evaluate(views, images, GainFit::None)?.map(|split| (name, split)));
    }
    let mut test_alignment = None;
    if config.train.refine_poses
        && let Some(aligned) = rendering.align(config.train.loss_weights(), &dataset.test)?
    {
        let split = rendering.evaluate(&aligned.views, None, GainFit::None)?;
        // Beside the metrics before the alignment.
        named.splice(1.min(named.len())..1.min(named.len()), split.map(|split| (TEST_ALIGNED, split)));
        test_alignment = Some(aligned.report);
    }
    named.extend(rendering.evaluate_fitted(config, &dataset.test)?);
    named.extend(rendering.evaluate_folded(folded, threads, &dataset.test)?);
    Ok((named, test_alignment))
}

/// Returns the vignetting of a run's lenses. Where the data are not the run's own, what
/// `captures.json` has: a checkpoint does not name its lenses.
fn vignetting_of(folder: &RunFolder, config: &RunConfig, data: EvaluationData<'_>, iteration: u32) -> Result<Vec<LensVignetting>> {
    let is_own = output::is_same(data.path, &config.dataset_path(folder.root())) && *data.load == config.load;
    if is_own {
        return state::vignetting(folder, config, data.dataset, iteration);
    }
    Ok(Captures::read(folder)?.vignetting_at(iteration).unwrap_or_default().to_vec())
}

/// Gives all views of a data set the vignetting of their lenses.
fn show_vignetting<'a>(lenses: &[LensVignetting], mut dataset: Cow<'a, Dataset>) -> Cow<'a, Dataset> {
    if !lenses.is_empty() {
        let dataset = dataset.to_mut();
        for views in [&mut dataset.train, &mut dataset.test] {
            let given = views.clone();
            LensVignetting::show_in(lenses, &given, views);
        }
    }
    dataset
}

/// Metrics of a scene file, which [`schema::SCENE_METRICS`] writes.
#[derive(Clone, Debug, Serialize)]
pub struct SceneMetrics {
    /// Path of the scene.
    pub scene: String,
    /// Name of its colour model.
    pub color_model: String,
    /// Splats.
    pub splats: usize,
    /// Radiance of the data set that is 1 in protocol `scene`.
    pub radiance_scale: RadianceScale,
    /// mu of the mu-law.
    pub mu: f32,
    /// Place where the engine ran: threads of a processor, or a GPU.
    pub computed_by: String,
    /// Version of the program.
    pub luxel_version: String,
    /// Folder of the data set.
    pub dataset: String,
    /// `test` and `train`, where the data set has such views.
    pub splits: BTreeMap<String, SplitMetrics>,
}

/// Measures the scene of a file against the views of a data set. With a folder, writes the images
/// of the test views and their ground truth into `renders/` and `gt/` in it.
///
/// # Errors
/// Images in another colour space than the scene, or with captured values, which need the camera
/// response of a run; a data set without views; a device that gave up; a file that cannot be
/// written.
pub fn evaluate_scene(
    file: &Path,
    scene: &Scene,
    data: EvaluationData<'_>,
    metrics: MetricsOptions<'_>,
    selected: SelectedEngine,
    images: Option<&Path>,
) -> Result<SceneMetrics> {
    let SelectedEngine { mut engine, computed_by, .. } = selected;
    check_color_space(data.path, data.dataset, scene)?;
    let dataset = data.dataset.in_frame(scene.world_from_local);
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let mu = luxel_core::tone::MU;
    let mut rendering = Rendering {
        engine: engine.as_mut(),
        options: scene.render_options(),
        radiance_scale: scene.radiance_scale,
        protocol_scale: metrics.scale,
        mu,
        color_space: data.dataset.color_space,
        peak_luminance: metrics.peak_luminance,
        flip: metrics.flip,
        lpips: metrics.lpips,
        response: None,
        log_gains: BTreeMap::new(),
        progress: None,
    };
    let mut splits = BTreeMap::new();
    for (name, views, images) in [("test", &dataset.test, images), ("train", &dataset.train, None)] {
        splits.extend(rendering.evaluate(views, images, GainFit::None)?.map(|split| (name.to_owned(), split)));
    }
    if splits.is_empty() {
        bail!("{}: no view has a valid pixel to measure", data.path.display());
    }
    Ok(SceneMetrics {
        scene: file.display().to_string(),
        color_model: scene.splats.color_model.name(),
        splats: scene.splats.len(),
        radiance_scale: metrics.scale.unwrap_or(scene.radiance_scale),
        mu,
        computed_by,
        luxel_version: luxel::VERSION.into(),
        dataset: data.path.display().to_string(),
        splits,
    })
}

fn check_color_space(path: &Path, dataset: &Dataset, scene: &Scene) -> Result<()> {
    if dataset.color_space != scene.color_space.linear() {
        bail!(
            "{}: images are in {}, the scene is in {}: metrics need one colour space; convert the images",
            path.display(),
            dataset.color_space.name(),
            scene.color_space.name()
        );
    }
    Ok(())
}
