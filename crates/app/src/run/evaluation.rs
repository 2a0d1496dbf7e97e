//! Metrics of a split, the images they are made from, and `metrics.json`. PSNR and SSIM are always
//! named with their protocol (see [`luxel_metrics`]).

use std::collections::BTreeMap;
use std::path::Path;

use luxel::error::Context;
use luxel::{Device, FrameProgress, RADIANCE_SCALE, Result, SelectedEngine};
use luxel_core::{ColorSpace, Dataset, Engine, Image, Knots, LossWeights, PixelValues, RadianceScale, RenderOptions, Scene, View};
use luxel_io::{ExrOptions, ExrSample, Supervision};
use luxel_metrics::{FieldOptions, FlipChoice};
use luxel_metrics::{GainFit, Lpips, Measures, SplitMetrics};
use luxel_train::{AlignmentScene, ExposureCompensation, LensVignetting, PoseReport, align_camera, pose_change};
use serde::{Deserialize, Serialize};

use super::RunConfig;

/// `metrics.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Metrics {
    /// Name of the colour model's preset.
    pub method: String,
    /// Steps of training.
    pub iterations: u32,
    /// Splats, of anchors all that they can decode; 0 for a radiance field.
    pub splats: usize,
    /// Parameters of a radiance field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field_parameters: Option<usize>,
    /// Seconds of training, evaluation left out, over all resumed parts.
    pub train_seconds: f64,
    /// Seconds of processors meanwhile, all threads together; `null` where the system does not
    /// tell.
    #[serde(default)]
    pub train_cpu_seconds: Option<f64>,
    /// Peak of resident memory; `null` where the system does not report it.
    pub peak_rss_bytes: Option<u64>,
    /// Radiance of the data set that is 1 in protocol `scene`.
    pub radiance_scale: RadianceScale,
    /// mu of the mu-law.
    pub mu: f32,
    /// Seed.
    pub seed: u64,
    /// Threads.
    pub threads: usize,
    /// Place where the engine ran: threads of a processor, or a GPU.
    #[serde(default)]
    pub computed_by: String,
    /// Version of the program.
    pub luxel_version: String,
    /// Revision of its sources; `null` where it is unknown.
    #[serde(default)]
    pub revision: Option<String>,
    /// Cargo features that it was built with.
    #[serde(default)]
    pub features: Vec<String>,
    /// Folder of the data set.
    pub dataset: String,
    /// Corrections of the training images' poses and focal lengths, if they were refined.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub poses: Option<PoseReport>,
    /// Corrections by which the test views were aligned to the scene for `test_aligned`, if poses
    /// were refined.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub test_alignment: Option<PoseReport>,
    /// Vignetting of each lens, which is applied to the renders of its views before they are
    /// measured, if it was learned.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub vignetting: Vec<LensVignetting>,
    /// `test`, and at the end of training `train`; where poses were refined, `test_aligned`; where
    /// a capture leaves gains open, `test_gain_common` or `test_gain_per_view` too; where a
    /// response is learned `test_ldr`, captured images of the test views; where the method lifts
    /// colours, `test_folded` and `test_folded_gain_common`, of the scene without the lift.
    pub splits: BTreeMap<String, SplitMetrics>,
}

/// A loaded scene with the settings of rendering and measuring it.
pub struct Rendering<'a> {
    /// The engine, which holds the scene.
    pub engine: &'a mut dyn Engine,
    /// Settings of rendering, those of training.
    pub options: RenderOptions,
    /// Data-set radiance of one normalised unit.
    pub radiance_scale: RadianceScale,
    /// Data-set radiance that is 1 in protocol `scene`, in the decades and on the display of PU21;
    /// `None` for that of a normalised unit.
    pub protocol_scale: Option<RadianceScale>,
    /// mu of the mu-law.
    pub mu: f32,
    /// Colour space of the data set.
    pub color_space: ColorSpace,
    /// Luminance at which the display of PU21 shows one normalised unit, cd/m2.
    pub peak_luminance: f32,
    /// Whether HDR-FLIP is computed.
    pub flip: FlipChoice,
    /// The network of the user's weights, if there is one.
    pub lpips: Option<&'a Lpips>,
    /// The response of the camera that recorded the views of recorded values.
    pub response: Option<Knots>,
    /// ln gains of the training images, by name: their metrics are computed after the gains are
    /// removed.
    pub log_gains: BTreeMap<String, [f32; 3]>,
    /// Receives the views as they are done; `None` where another task reports its own progress.
    pub progress: Option<FrameProgress<'a>>,
}

/// Name of the split of test views that were aligned to the scene.
pub const TEST_ALIGNED: &str = "test_aligned";

/// Names of the splits of test views as the scene file shows them where the method lifts colours to
/// radiance: without the lift, as they are and after one gain for all views.
const FOLDED: [(&str, GainFit<'static>); 2] = [("test_folded", GainFit::None), ("test_folded_gain_common", GainFit::Common)];
/// Name of the split of the captured images beside the radiance of test views.
const TEST_LDR: &str = "test_ldr";

/// Test views that were aligned to a scene.
#[derive(Clone, Debug)]
pub struct AlignedViews {
    /// The views, with other cameras.
    pub views: Vec<View>,
    /// How far they were moved.
    pub report: PoseReport,
}

impl Rendering<'_> {
    /// Returns the PSNR of one view by protocol `scene` in dB; `None` if all of it is masked.
    ///
    /// # Errors
    /// A device that gave up; a render that is not finite.
    pub fn probe(&mut self, view: &View) -> Result<Option<f64>> {
        let log_gain = self.log_gain(view);
        let measures = Measures { response: self.response.as_ref(), ..self.measures() };
        Ok(luxel_metrics::probe(self.engine, &self.options, &measures, view, log_gain)?)
    }

    /// Returns the settings of the measurement without response, display and network.
    fn measures(&self) -> Measures<'static> {
        Measures { protocol_scale: self.protocol_scale, ..Measures::new(self.radiance_scale, self.mu) }
    }

    /// Returns the ln gain of a view: 0 unless it was trained on.
    fn log_gain(&self, view: &View) -> [f32; 3] {
        self.log_gains.get(&view.name).copied().unwrap_or_default()
    }

    /// Measures the test views again: after the removal of gains that a capture does not determine,
    /// and in the captured images beside their radiance. Returns the metrics by name of the split.
    ///
    /// # Errors
    /// As [`Self::evaluate`].
    pub fn evaluate_fitted(&mut self, config: &RunConfig, views: &[View]) -> Result<Vec<(&'static str, SplitMetrics)>> {
        let mut splits = Vec::new();
        for (name, fit) in due_fits(config, views) {
            splits.extend(self.evaluate(views, None, fit)?.map(|split| (name, split)));
        }
        if self.response.is_some() {
            splits.extend(self.evaluate(&captured_beside(views), None, GainFit::None)?.map(|split| (TEST_LDR, split)));
        }
        Ok(splits)
    }

    /// Measures the test views as the scene file of a method shows them that lifts colours to
    /// radiance; none without one. Returns the metrics by name of the split.
    ///
    /// # Errors
    /// As [`Self::evaluate`].
    pub fn evaluate_folded(&mut self, folded: Option<&Scene>, threads: usize, views: &[View]) -> Result<Vec<(&'static str, SplitMetrics)>> {
        let Some(folded) = folded else { return Ok(Vec::new()) };
        let device = Device::Cpu.with_threads(u32::try_from(threads).unwrap_or(1).max(1));
        let mut engine = SelectedEngine::open(&device)?.engine;
        engine.load(&folded.splats, None).context("cannot load the scene")?;
        let mut rendering = Rendering {
            engine: engine.as_mut(),
            response: self.response,
            log_gains: self.log_gains.clone(),
            progress: self.progress,
            options: self.options,
            radiance_scale: self.radiance_scale,
            protocol_scale: self.protocol_scale,
            mu: self.mu,
            color_space: self.color_space,
            peak_luminance: self.peak_luminance,
            flip: self.flip,
            lpips: self.lpips,
        };
        let mut splits = Vec::new();
        for (name, fit) in FOLDED {
            splits.extend(rendering.evaluate(views, None, fit)?.map(|split| (name, split)));
        }
        let done = rendering.progress.map(|progress| progress.done);
        if let (Some(progress), Some(done)) = (&mut self.progress, done) {
            progress.done = done;
        }
        Ok(splits)
    }

    /// Returns test views whose poses are aligned to the scene, each on its own image, and by how
    /// much they were moved; `None` if there are no views.
    ///
    /// # Errors
    /// A device that gave up, or that cannot differentiate by the camera.
    pub fn align(&mut self, loss: LossWeights, views: &[View]) -> Result<Option<AlignedViews>> {
        if views.is_empty() {
            return Ok(None);
        }
        let positions = self.engine.geometry()?.position;
        let scene = AlignmentScene {
            render: self.options,
            loss,
            radiance_scale: self.radiance_scale,
            mu: self.mu,
            response: self.response,
            positions,
        };
        let mut aligned = Vec::with_capacity(views.len());
        let mut changes = Vec::with_capacity(views.len());
        for view in views {
            let camera =
                align_camera(self.engine, &view.loaded()?, &scene).with_context(|| format!("cannot align test view {}", view.name))?;
            changes.push(pose_change(&view.camera, &camera, scene.depth(&view.camera)));
            aligned.push(View { camera, ..view.clone() });
        }
        Ok(Some(AlignedViews { views: aligned, report: PoseReport::of_changes(&changes) }))
    }

    /// Measures a split, after the removal of the gains that training found, or of those that
    /// `gain_fit` fits. Returns `None` if no view has a valid pixel. With a folder, writes the
    /// images into `renders/` and `gt/`, in the units of the data set or as recorded.
    ///
    /// # Errors
    /// A device that gave up; a render that is not finite; an image that cannot be written.
    pub fn evaluate(&mut self, views: &[View], images: Option<&Path>, gain_fit: GainFit<'_>) -> Result<Option<SplitMetrics>> {
        let (scale, color_space) = (self.radiance_scale, self.color_space);
        let protocol_scale = self.protocol_scale.unwrap_or(scale);
        let known: Vec<[f32; 3]> = views.iter().map(|view| self.log_gain(view)).collect();
        let gain_fit = match gain_fit {
            GainFit::None => GainFit::Known(&known),
            fitted => fitted,
        };
        let names = || views.iter().map(|view| view.name.as_str());
        let stems: BTreeMap<&str, String> = names().zip(unique_stems(names())).collect();
        let mut failed: Result<()> = Ok(());
        let mut progress = self.progress.take();
        let mut each = |view: &View, prediction: &Image, _: &_| {
            let mut files = Vec::new();
            if let (Some(folder), Some(stem), Ok(())) = (images, stems.get(view.name.as_str()), &failed) {
                files = ["renders", "gt"].map(|kind| folder.join(kind).join(format!("{stem}.exr"))).to_vec();
                let mut render = prediction.clone();
                if view.values == PixelValues::Radiance {
                    scale.restore(&mut render);
                }
                let mut pictures = files.iter().zip([&render, &view.image]);
                failed = pictures.try_for_each(|(path, image)| write_exr(path, image, color_space, protocol_scale));
            }
            if let (Some(progress), Ok(())) = (&mut progress, &failed) {
                progress.add(&view.name, files);
            }
        };
        let field = FieldOptions { peak_luminance: self.peak_luminance, color_space, flip: self.flip };
        let measures = Measures { field, lpips: self.lpips, response: self.response.as_ref(), gain_fit, ..self.measures() };
        let metrics = luxel_metrics::evaluate(self.engine, &self.options, &measures, views, &mut each)?;
        failed?;
        self.progress = progress;
        // Without views there are no means.
        Ok((!metrics.views.is_empty()).then_some(metrics))
    }
}

/// Returns the gains that a capture does not determine, as fits by name of their split.
fn due_fits(config: &RunConfig, views: &[View]) -> Vec<(&'static str, GainFit<'static>)> {
    let is_radiance = views.iter().all(|view| view.values == PixelValues::Radiance);
    let drifts = config.train.exposure_compensation != ExposureCompensation::Off;
    let fits = [
        ("test_gain_common", GainFit::Common, config.load.supervision.reads_recordings()),
        ("test_gain_per_view", GainFit::PerView, drifts),
    ];
    fits.into_iter().filter(|(.., is_due)| *is_due && is_radiance).map(|(name, fit, _)| (name, fit)).collect()
}

/// Returns the captured images beside the radiance of views, seen by the views' cameras.
fn captured_beside(views: &[View]) -> Vec<View> {
    let seen_by = |view: &View, captured: &View| View { camera: view.camera.clone(), target: view.target, ..captured.clone() };
    views.iter().flat_map(|view| view.recordings.iter().map(|captured| seen_by(view, captured))).collect()
}

/// Returns how many images the evaluation of a run renders: of test and training views, and of
/// test views for each fit and in their captured images.
pub(super) fn count_frames(config: &RunConfig, dataset: &Dataset) -> u32 {
    let aligned = usize::from(config.train.refine_poses);
    let folded = if config.train.method.lifts_colors() { FOLDED.len() } else { 0 };
    let test = dataset.test.len() * (1 + aligned + folded + due_fits(config, &dataset.test).len());
    let learns_response = config.load.supervision == Supervision::Ldr;
    let captured: usize = dataset.test.iter().filter(|_| learns_response).map(|view| view.recordings.len()).sum();
    u32::try_from(test + captured + dataset.train.len()).unwrap_or(u32::MAX)
}

/// Writes half floats, unless a value needs more.
fn write_exr(path: &Path, image: &Image, color_space: ColorSpace, scale: RadianceScale) -> Result<()> {
    let sample = ExrSample::smallest_for(image);
    let numbers = vec![(RADIANCE_SCALE.to_owned(), scale.get())];
    luxel_io::write_exr(path, image, &ExrOptions { sample, color_space, numbers, ..ExrOptions::default() })
        .context("cannot write an evaluation image")?;
    Ok(())
}

/// Returns file stems of views: the last part of each name; where that is not unique, the whole
/// name with `_` between its parts; and a number where even that is taken.
pub fn unique_stems<'a>(names: impl Iterator<Item = &'a str> + Clone) -> Vec<String> {
    let last = |name: &'a str| name.rsplit('/').next().unwrap_or(name);
    let mut uses: BTreeMap<&str, usize> = BTreeMap::new();
    for name in names.clone() {
        *uses.entry(last(name)).or_default() += 1;
    }
    let mut taken = std::collections::BTreeSet::new();
    let mut stems = Vec::new();
    for name in names {
        let stem = if uses.get(last(name)) == Some(&1) { last(name).to_owned() } else { name.replace('/', "_") };
        let mut unique = stem.clone();
        let mut number = 2;
        while !taken.insert(unique.clone()) {
            unique = format!("{stem}_{number}");
            number += 1;
        }
        stems.push(unique);
    }
    stems
}

#[cfg(test)]
mod tests {

    use luxel_core::{Mask, Target, synthetic};
    use luxel_cpu::CpuEngine;

    use super::*;

    /// Measures a scene of 30 splats against its own render.
    fn measured(mask: Option<Mask>, gain: f32, log_gains: BTreeMap<String, [f32; 3]>) -> (Option<SplitMetrics>, Option<f64>) {
        measured_by(None, mask, gain, log_gains)
    }

    fn measured_by(
        protocol_scale: Option<RadianceScale>,
        mask: Option<Mask>,
        gain: f32,
        log_gains: BTreeMap<String, [f32; 3]>,
    ) -> (Option<SplitMetrics>, Option<f64>) {
        let mut engine = CpuEngine::new(1).unwrap();
        engine.load(&synthetic::room(30, 1), None).unwrap();
        let (camera, options) = (synthetic::room_camera([16, 12]), RenderOptions::default());
        let mut image = engine.render(&camera, &options).unwrap();
        image.scale(gain);
        let (image, mask) = (image.into(), mask.map(Into::into));
        let (recordings, target) = (Vec::new(), Target::default());
        let view = View { name: "a".into(), camera, image, values: PixelValues::Radiance, noise: None, mask, recordings, target };
        let mut rendering = Rendering {
            engine: &mut engine,
            options,
            radiance_scale: RadianceScale::ONE,
            protocol_scale,
            mu: 5000.0,
            color_space: ColorSpace::default(),
            peak_luminance: FieldOptions::DEFAULT_PEAK_LUMINANCE,
            flip: FlipChoice::Skip,
            lpips: None,
            response: None,
            log_gains,
            progress: None,
        };
        let psnr = rendering.probe(&view).unwrap();
        (rendering.evaluate(&[view], None, GainFit::None).unwrap(), psnr)
    }

    #[test]
    fn a_split_of_masked_views_has_no_metrics() {
        assert!(measured(None, 1.0, BTreeMap::new()).0.is_some_and(|split| split.views.len() == 1));
        assert_eq!(measured(Some(Mask::from_valid(vec![false; 16 * 12])), 1.0, BTreeMap::new()), (None, None));
    }

    #[test]
    fn a_gain_that_training_found_is_no_error() {
        let psnr = |log_gains| {
            let (split, probed) = measured(None, 0.5, log_gains);
            let found = split.unwrap().mean.psnr_scene;
            assert!((found - probed.unwrap()).abs() < 1e-9, "{found} {probed:?}");
            found
        };
        let without = psnr(BTreeMap::from([("b".to_owned(), [0.5f32.ln(); 3])]));
        let with = psnr(BTreeMap::from([("a".to_owned(), [0.5f32.ln(); 3])]));
        assert!(without < 40.0 && with > 99.0, "{without} {with}");
    }

    #[test]
    fn metrics_by_another_scale_are_those_of_images_in_its_units() {
        let by = |scale: Option<f32>| {
            let (split, probed) = measured_by(scale.and_then(RadianceScale::new), None, 0.8, BTreeMap::new());
            let (split, probed) = (split.unwrap(), probed.unwrap());
            assert!((split.mean.psnr_scene - probed).abs() < 1e-9);
            split
        };
        let (own, one, half) = (by(None), by(Some(1.0)), by(Some(0.5)));
        assert_eq!(own, one);
        let (own, half) = (own.mean, half.mean);
        assert!((own.psnr_gtmax - half.psnr_gtmax).abs() < 1e-4 && (own.psnr_selfmax - half.psnr_selfmax).abs() < 1e-4);
        let mut engine = CpuEngine::new(1).unwrap();
        engine.load(&synthetic::room(30, 1), None).unwrap();
        let mut render = engine.render(&synthetic::room_camera([16, 12]), &RenderOptions::default()).unwrap();
        render.scale(2.0);
        let mut image = render.clone();
        image.scale(0.8);
        let expected = luxel_metrics::view_metrics(&render, &image, None, 5000.0).unwrap();
        assert!((half.psnr_scene - expected.psnr_scene).abs() < 1e-3, "{} {}", half.psnr_scene, expected.psnr_scene);
        assert!((half.psnr_scene - own.psnr_scene).abs() > 0.01);
    }

    #[test]
    fn stems_that_collide_get_their_folder() {
        let names = ["left/000", "right/000", "right/001", "right_000"];
        assert_eq!(unique_stems(names.into_iter()), ["left_000", "right_000", "001", "right_000_2"]);
    }
}
