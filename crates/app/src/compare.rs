//! Two runs, measured side by side on the test views that both have.
//!
//! In: two run folders with images of their test views. Out: [`RunComparison`]: metrics of both by
//! one scale, and the second's minus the first's; pictures if they are asked for. The images are
//! those of each run's newest evaluation, and the ground truth must be the same to the bit.
//! Degenerate: views of one run alone are left out with a warning; no common view is an error.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use luxel::error::{Context, bail};
use luxel::{Error, Observer, Remedy, Result};
use luxel_core::Image;
use luxel_core::tone::{Tonemap, display_rgb8, rec709_of};
use luxel_io::ReadOptions;
use luxel_metrics::colormap::magma;
use serde::Serialize;

use luxel::compare::{CompareOptions, Comparison, ImageMetrics, MeanMetrics, compare};

use crate::files;
use crate::report::picture::mu_error;
use crate::run::{Metrics, RunFolder};

/// Mean absolute difference under the mu-law of the brightest colour in pictures of errors.
pub const FULL_SCALE_ERROR: f32 = 0.1;

/// Difference in dB between this comparison and a run's own metrics from which masks or gains must
/// be the reason.
const NOTABLE_DB: f64 = 0.05;

/// Longest metrics.json that is read.
const LIMIT_BYTES: u64 = 1 << 30;

/// Two runs on the same test views.
#[derive(Clone, Debug, Serialize)]
pub struct RunComparison {
    /// The runs, first and second.
    pub runs: [ComparedRun; 2],
    /// Radiance of 1 in protocol `scene`, that of the first run.
    pub scale: f32,
    /// mu of the mu-law.
    pub mu: f32,
    /// Luminance of that radiance on the display of PU21, cd/m2.
    pub peak_luminance: f32,
    /// Metrics of the second run minus those of the first, means over the views.
    pub difference: BTreeMap<&'static str, f64>,
    /// Views that both have, by name.
    pub views: Vec<ComparedView>,
}

/// A run of a comparison.
#[derive(Clone, Debug, Serialize)]
pub struct ComparedRun {
    /// Its folder.
    pub path: String,
    /// Colour model.
    pub method: String,
    /// Steps of training after which its images were rendered.
    pub iterations: u32,
    /// Number of splats, if its metrics are those of these steps.
    pub splats: Option<usize>,
    /// Seconds of training, likewise.
    pub train_seconds: Option<f64>,
    /// Means over the common views.
    pub mean: MeanMetrics,
}

/// A view of a comparison.
#[derive(Clone, Debug, Serialize)]
pub struct ComparedView {
    /// Name of its images.
    pub name: String,
    /// Metrics of the first run.
    pub first: ImageMetrics,
    /// Metrics of the second run.
    pub second: ImageMetrics,
    /// Second minus first.
    pub difference: BTreeMap<&'static str, f64>,
}

/// A run and its newest images.
struct Evaluated {
    root: PathBuf,
    iterations: u32,
    images: PathBuf,
    method: String,
    metrics: Option<Metrics>,
}

/// Measures two runs on the same test views. With `pictures`, a new folder, writes a picture of
/// each view: in the upper row the ground truth and both renders under the mu-law; in the lower
/// row where the second run's error is larger (orange) or smaller (blue), and the error of each
/// from black to yellow for [`FULL_SCALE_ERROR`].
///
/// # Errors
/// A folder that is no run or has no images; other ground truth; the errors of [`compare`].
pub fn compare_runs(runs: [&Path; 2], options: &CompareOptions, pictures: Option<&Path>, observer: &dyn Observer) -> Result<RunComparison> {
    let [first, second] = [Evaluated::open(runs[0])?, Evaluated::open(runs[1])?];
    check_ground_truth(&first, &second)?;
    let scale = options.scale.or(first.metrics.as_ref().map(|metrics| metrics.radiance_scale.get()));
    let options = CompareOptions { scale, ..options.clone() };
    let truth = first.images.join("gt");
    let [of_first, of_second] = [
        compare(&truth, &first.images.join("renders"), &options, observer)?,
        compare(&truth, &second.images.join("renders"), &options, observer)?,
    ];
    let (scale, mu, peak_luminance) = (of_first.scale, of_first.mu, of_first.peak_luminance);
    for (run, found) in [(&first, &of_first), (&second, &of_second)] {
        warn_of_other_metrics(run, found, observer);
    }
    let mut others: BTreeMap<String, ImageMetrics> = of_second.images.into_iter().map(|image| (image.name.clone(), image)).collect();
    let views: Vec<ComparedView> = of_first
        .images
        .into_iter()
        .filter_map(|first| {
            let second = others.remove(&first.name)?;
            let difference = difference(&named(&first), &named(&second));
            Some(ComparedView { name: first.name.clone(), first, second, difference })
        })
        .collect();
    if views.is_empty() {
        bail!("{} and {} have no test view in common", runs[0].display(), runs[1].display());
    }
    if let Some(folder) = pictures {
        views.iter().try_for_each(|view| write_picture(folder, view, scale, mu))?;
    }
    let means = [mean(views.iter().map(|view| &view.first)), mean(views.iter().map(|view| &view.second))];
    let [before, after] = [named_mean(&means[0]), named_mean(&means[1])];
    let [a, b] = means;
    Ok(RunComparison {
        runs: [first.described(a), second.described(b)],
        scale,
        mu,
        peak_luminance,
        difference: difference(&before, &after),
        views,
    })
}

impl Evaluated {
    fn open(root: &Path) -> Result<Self> {
        let (folder, config) = RunFolder::open(root)?;
        let Some(iterations) = folder.rendered_iterations().first().copied() else {
            let error = Error::new(format!("{}: has no images of test views to compare", root.display()));
            return Err(error.with_remedy(Remedy::advice(format!("evaluate it: luxel eval {}", root.display()))));
        };
        let metrics = files::read_text(&folder.metrics(), LIMIT_BYTES).ok().and_then(|text| serde_json::from_str::<Metrics>(&text).ok());
        Ok(Self {
            root: root.to_owned(),
            iterations,
            images: folder.evaluation(iterations),
            method: config.method_name(),
            metrics: metrics.filter(|metrics| metrics.iterations == iterations),
        })
    }

    fn described(self, mean: MeanMetrics) -> ComparedRun {
        let metrics = self.metrics.as_ref();
        ComparedRun {
            path: self.root.display().to_string(),
            method: self.method,
            iterations: self.iterations,
            splats: metrics.map(|metrics| metrics.splats),
            train_seconds: metrics.map(|metrics| metrics.train_seconds),
            mean,
        }
    }
}

/// Refuses runs whose ground truth differs: their metrics would be of different images.
fn check_ground_truth(first: &Evaluated, second: &Evaluated) -> Result<()> {
    let [ours, theirs] = [first, second].map(|run| run.images.join("gt"));
    let entries = std::fs::read_dir(&ours).with_context(|| format!("{}: cannot list the folder", ours.display()))?;
    for name in entries.flatten().map(|entry| entry.file_name()) {
        let (a, b) = (ours.join(&name), theirs.join(&name));
        if !(is_image(&a) && is_image(&b)) {
            continue;
        }
        let read = |path: &Path| luxel_io::read_image(path, &ReadOptions::default()).context("cannot read the ground truth");
        let [a_image, b_image] = [read(&a)?, read(&b)?];
        let is_same = a_image.color_space == b_image.color_space && is_equal(&a_image.image, &b_image.image);
        if !is_same {
            let message = format!("{} and {} differ, expected the same ground truth in both runs", a.display(), b.display());
            let advice = "train both on the same data at the same size";
            return Err(Error::new(message).with_remedy(Remedy::advice(advice)));
        }
    }
    Ok(())
}

fn is_image(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "exr") && path.is_file()
}

/// Returns whether images are equal to the bit.
fn is_equal(a: &Image, b: &Image) -> bool {
    let bits = |image: &Image| image.pixels.iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
    [a.width, a.height] == [b.width, b.height] && bits(a) == bits(b)
}

/// Warns where a run's own metrics differ: they leave masked pixels out, or remove gains.
fn warn_of_other_metrics(run: &Evaluated, found: &Comparison, observer: &dyn Observer) {
    let own = run.metrics.as_ref().and_then(|metrics| Some((metrics.radiance_scale.get(), metrics.splits.get("test")?)));
    let Some((_, split)) = own.filter(|(scale, split)| *scale == found.scale && split.views.len() == found.images.len()) else { return };
    let (own, here) = (split.mean.psnr_scene, found.mean.mu_law.psnr_scene);
    if (own - here).abs() > NOTABLE_DB {
        observer.warn(&format!(
            "{}: {here:.2} dB here, {own:.2} dB in its metrics.json, which leaves masked pixels out and removes gains; masks may be given \
             here too",
            run.root.display()
        ));
    }
}

/// Returns the metrics that are compared, by name.
fn named(image: &ImageMetrics) -> BTreeMap<&'static str, f64> {
    named_mean(&MeanMetrics { mu_law: image.mu_law, field: image.field.clone() })
}

fn named_mean(metrics: &MeanMetrics) -> BTreeMap<&'static str, f64> {
    let MeanMetrics { mu_law, field } = metrics;
    let of_target = ["psnr_black_scene", "psnr_black_gtmax"];
    let mut named: BTreeMap<_, _> = mu_law.named().into_iter().filter(|(name, _)| !of_target.contains(name)).collect();
    named.extend([("pu21_psnr", field.pu21_psnr), ("pu21_ssim", field.pu21_ssim), ("log_rmse", field.log_rmse)]);
    let optional = [("hdr_flip", field.hdr_flip), ("lpips_alex", field.lpips_alex), ("lpips_vgg", field.lpips_vgg)];
    named.extend(optional.into_iter().filter_map(|(name, value)| Some((name, value?))));
    named
}

fn difference(first: &BTreeMap<&'static str, f64>, second: &BTreeMap<&'static str, f64>) -> BTreeMap<&'static str, f64> {
    first.iter().filter_map(|(name, value)| Some((*name, second.get(name)? - value))).collect()
}

fn mean<'a>(images: impl Iterator<Item = &'a ImageMetrics>) -> MeanMetrics {
    let (mu_law, field): (Vec<_>, Vec<_>) = images.map(|image| (image.mu_law, image.field.clone())).unzip();
    MeanMetrics::new(&mu_law, &field)
}

/// Writes the picture of a view.
fn write_picture(folder: &Path, view: &ComparedView, scale: f32, mu: f32) -> Result<()> {
    let read = |path: &str| -> Result<Image> {
        let mut image = luxel_io::read_image(Path::new(path), &ReadOptions::default()).context("cannot read an image")?.image;
        image.scale(1.0 / scale);
        Ok(image)
    };
    let [truth, first, second] = [read(&view.first.reference)?, read(&view.first.test)?, read(&view.second.test)?];
    let shown = |image: &Image| -> Vec<[u8; 3]> {
        image.pixels.iter().map(|p| display_rgb8(Tonemap::Mulaw, 0.0, rec709_of(view.first.color_space, *p))).collect()
    };
    let errors = |image: &Image| -> Vec<f32> { image.pixels.iter().zip(&truth.pixels).map(|(p, t)| mu_error(*p, *t, mu)).collect() };
    let [of_first, of_second] = [errors(&first), errors(&second)];
    let signed = of_first.iter().zip(&of_second).map(|(a, b)| signed_color((b - a) / FULL_SCALE_ERROR)).collect();
    let colors = |errors: &[f32]| errors.iter().map(|error| magma(error / FULL_SCALE_ERROR)).collect::<Vec<_>>();
    let rows = [[shown(&truth), shown(&first), shown(&second)], [signed, colors(&of_first), colors(&of_second)]];
    let (width, height) = (truth.width, truth.height);
    let mut rgb8 = Vec::with_capacity(6 * width * height);
    for parts in &rows {
        for y in 0..height {
            parts.iter().for_each(|part| rgb8.extend_from_slice(&part[y * width..(y + 1) * width]));
        }
    }
    let path = folder.join(format!("{}.png", view.name));
    luxel_io::write_png(&path, 3 * width, 2 * height, rgb8.as_flattened()).context("cannot write a picture")
}

/// Returns black for 0, orange towards 1 and blue towards -1.
fn signed_color(share: f32) -> [u8; 3] {
    let end: [f32; 3] = if share > 0.0 { [255.0, 150.0, 30.0] } else { [60.0, 150.0, 255.0] };
    let part = share.abs().min(1.0);
    end.map(|c| (c * part).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_have_colours_and_zero_has_none() {
        assert_eq!([0.0, 1.0, 9.0, -1.0].map(signed_color), [[0; 3], [255, 150, 30], [255, 150, 30], [60, 150, 255]]);
        assert_eq!(difference(&BTreeMap::from([("a", 1.0), ("b", 2.0)]), &BTreeMap::from([("a", 4.0)])), BTreeMap::from([("a", 3.0)]));
    }
}
