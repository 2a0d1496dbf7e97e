//! `report.html` of a run, from the files in its folder: metrics, log, configuration and the newest
//! evaluation's images.

use std::path::Path;

use luxel::error::Context;
use luxel::{Result, bad_pixel_lines};
use luxel_core::{Dataset, Image, PixelValues, View};
use luxel_metrics::LuminanceProfile;
use luxel_metrics::SplitMetrics;

use super::evaluation::{Metrics, unique_stems};
use super::{RunConfig, RunFolder, log, vignetting_text};
use crate::report::{self, CurveSample, ReportInput, ReportSplit, ReportView};
use crate::{files, text};

/// Bytes of decoded images to hold for the page, which shows them small: a part of any machine's
/// memory.
const IMAGES_LIMIT_BYTES: usize = 512 << 20;

/// Length of a licence text that is quoted, bytes.
const CREDITS_LIMIT_BYTES: u64 = 16 << 10;

/// A complete evaluation.
#[derive(Clone, Copy)]
pub struct Evaluated<'a> {
    /// Metrics of all splits.
    pub metrics: &'a Metrics,
    /// Folder of the images.
    pub images: &'a Path,
}

/// Writes the report about an evaluation.
///
/// # Errors
/// A file that cannot be read or written.
pub fn write(folder: &RunFolder, config: &RunConfig, dataset: &Dataset, evaluated: Evaluated<'_>) -> Result<()> {
    let Evaluated { metrics, images } = evaluated;
    let input = ReportInput {
        title: title(config, folder),
        subtitle: format!("{}, {} iterations, {}", metrics.method, text::count(metrics.iterations as usize), size(metrics)),
        facts: facts(metrics, dataset),
        warnings: dataset.warnings.iter().cloned().chain(bad_pixel_lines(dataset)).collect(),
        splits: splits(metrics),
        curve: curve(folder, metrics)?,
        views: views(images, dataset, metrics)?,
        profile: metrics.splits.get("test").or(metrics.splits.get("train")).map_or_else(LuminanceProfile::default, |s| s.profile.clone()),
        config_toml: config.to_toml()?,
        credits: credits(&config.dataset_path(folder.root())),
        mu: metrics.mu,
        radiance_scale: metrics.radiance_scale,
        color_space: dataset.color_space,
    };
    report::write_report(&folder.report(), &input).context("cannot write the report")
}

fn title(config: &RunConfig, folder: &RunFolder) -> String {
    let path = config.dataset_path(folder.root());
    let name = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    match config.made_by {
        super::MadeBy::Demo => "Desk lamp".into(),
        super::MadeBy::Train => name(&path).unwrap_or_else(|| path.display().to_string()),
    }
}

/// Returns the number of splats, or of a field's parameters.
fn size(metrics: &Metrics) -> String {
    match metrics.field_parameters {
        Some(parameters) => text::plural(parameters, "parameter"),
        None => text::plural(metrics.splats, "splat"),
    }
}

fn facts(metrics: &Metrics, dataset: &Dataset) -> Vec<(String, String)> {
    let seconds = std::time::Duration::try_from_secs_f64(metrics.train_seconds).unwrap_or_default();
    let processor_seconds = metrics.train_cpu_seconds.and_then(|seconds| std::time::Duration::try_from_secs_f64(seconds).ok());
    let mut facts = vec![
        ("size", size(metrics)),
        ("training time", text::duration(seconds)),
        ("processor time", processor_seconds.map(text::duration).unwrap_or_default()),
        ("computed by", metrics.computed_by.clone()),
        ("peak memory", metrics.peak_rss_bytes.map_or("unknown".into(), text::bytes)),
        ("radiance scale", text::number(metrics.radiance_scale.get().into())),
        ("vignetting", vignetting_text(&metrics.vignetting)),
        ("seed", metrics.seed.to_string()),
        ("data set", format!("{} ({})", metrics.dataset, dataset.format)),
        ("views", format!("{} to train on, {} to test", dataset.train.len(), dataset.test.len())),
        ("luxel", metrics.luxel_version.clone()),
        ("revision", metrics.revision.clone().unwrap_or_default()),
        ("features", metrics.features.join(", ")),
    ];
    facts.retain(|(_, value)| !value.is_empty());
    facts.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

fn splits(metrics: &Metrics) -> Vec<ReportSplit> {
    let split = |(name, split): (&String, &SplitMetrics)| ReportSplit {
        name: name.clone(),
        mean: split.mean,
        views: split.views.iter().map(|view| (view.name.clone(), view.metrics)).collect(),
        mean_field: split.mean_field.clone(),
        fields: split.views.iter().filter_map(|view| Some((view.name.clone(), view.field.clone()?))).collect(),
    };
    // The map is in alphabetical order: test before train.
    metrics.splits.iter().map(split).collect()
}

/// Returns the log as curves. A line has the PSNR of test views at the last evaluation and at the
/// last look before it; here each is at the step that it is of, the last evaluation's too.
fn curve(folder: &RunFolder, metrics: &Metrics) -> Result<Vec<CurveSample>> {
    let records = log::read(&folder.log())?;
    let last = metrics.splits.get("test").map(|split| split.mean.psnr_scene);
    let changed = |now: Option<f64>, before: Option<f64>| now.filter(|_| now != before);
    let sample = |(i, record): (usize, &log::LogRecord)| {
        let before = i.checked_sub(1).and_then(|i| records.get(i));
        let after = records.get(i + 1).and_then(|after| changed(after.psnr_test, record.psnr_test));
        CurveSample {
            iteration: record.iteration,
            loss: record.loss,
            l1: record.l1,
            ssim: record.ssim,
            splats: record.splats,
            elapsed_s: record.elapsed_s,
            psnr_train: record.psnr_train,
            psnr_test: if record.iteration == metrics.iterations { last } else { after },
            psnr_test_sample: changed(record.psnr_test_sample, before.and_then(|before| before.psnr_test_sample)),
        }
    };
    Ok(records.iter().enumerate().map(sample).collect())
}

/// Returns renders of test views beside their images, evenly chosen if they are too many for
/// memory.
fn views(images: &Path, dataset: &Dataset, metrics: &Metrics) -> Result<Vec<ReportView>> {
    let Some(split) = metrics.splits.get("test") else { return Ok(Vec::new()) };
    let stems = unique_stems(dataset.test.iter().map(|view| view.name.as_str()));
    let renders = images.join("renders");
    let view_bytes = |view: &View| 2 * view.pixel_count() as usize * size_of::<[f32; 3]>();
    let total: usize = dataset.test.iter().map(view_bytes).sum();
    let every = total.div_ceil(IMAGES_LIMIT_BYTES).max(1);
    let mut views = Vec::new();
    for (view, stem) in dataset.test.iter().zip(&stems).step_by(every) {
        let Some(measured) = split.views.iter().find(|metrics| metrics.name == view.name) else { continue };
        let path = renders.join(format!("{stem}.exr"));
        let mut prediction = luxel_io::read_image(&path, &Default::default()).context("cannot read an evaluation image")?.image;
        let view = view.loaded()?;
        let mut target = Image::clone(&view.image);
        if view.values == PixelValues::Radiance {
            metrics.radiance_scale.normalise(&mut prediction);
            metrics.radiance_scale.normalise(&mut target);
        }
        let (name, mask) = (view.name.clone(), view.mask.clone());
        views.push(ReportView { name, prediction, target, mask, metrics: measured.metrics });
    }
    Ok(views)
}

/// Returns the licence text in a data set's folder, if there is one.
fn credits(dataset: &Path) -> Vec<String> {
    let names = ["LICENSES.txt", "LICENSE.txt", "LICENSE"];
    let text = names.iter().find_map(|name| files::read_text(&dataset.join(name), CREDITS_LIMIT_BYTES).ok());
    text.map_or_else(Vec::new, |text| text.lines().map(str::trim).filter(|line| !line.is_empty()).map(Into::into).collect())
}
