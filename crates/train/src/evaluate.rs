//! Figures of a scene against views.
//!
//! In: an engine with the scene loaded, views in the data set's units, the radiance scale; out: figures per view and their mean, and
//! the error by luminance over all views. Views are rendered one after another, the engine being parallel in itself, and measured some at a
//! time, one a thread, with LPIPS one by one; predictions are handed out in the order of the views, and no more than a batch is held.

use luxel_core::metrics::{FieldMetrics, FieldOptions, LuminanceProfile, ViewMetrics, field_metrics, psnr_scene, view_metrics};
use luxel_core::{Engine, Image, RenderOptions, View};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::{Lpips, TrainError};

/// How views are measured.
#[derive(Clone, Copy, Debug)]
pub struct Measures<'a> {
    /// Data-set radiance of one normalised unit.
    pub radiance_scale: f32,
    /// mu of the mu-law.
    pub mu: f32,
    /// Of the figures that need no mu-law.
    pub field: FieldOptions,
    /// The network of the user's weights, if there is one.
    pub lpips: Option<&'a Lpips>,
}

impl Measures<'_> {
    /// With the default display, without HDR-FLIP and LPIPS, of images in linear Rec.709.
    pub fn new(radiance_scale: f32, mu: f32) -> Self {
        Self { radiance_scale, mu, field: FieldOptions::default(), lpips: None }
    }

    /// Views that are measured side by side. A network is parallel in itself, and its features of one view may fill gigabytes.
    fn batch(&self) -> usize {
        if self.lpips.is_some() { 1 } else { rayon::current_num_threads().max(1) }
    }
}

/// Figures of one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NamedMetrics {
    /// Name of the view.
    pub name: String,
    /// Its figures.
    #[serde(flatten)]
    pub metrics: ViewMetrics,
    /// Its figures that need no mu-law; `None` in files from before they were measured.
    #[serde(flatten)]
    pub field: Option<FieldMetrics>,
}

/// Figures of a split. In files both means are one object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "SplitFile", into = "SplitFile")]
pub struct SplitMetrics {
    /// Means over the views.
    pub mean: ViewMetrics,
    /// Means over the views of what needs no mu-law; `None` unless all have it.
    pub mean_field: Option<FieldMetrics>,
    /// In the order of the views.
    pub views: Vec<NamedMetrics>,
    /// Error by luminance, over all views.
    pub profile: LuminanceProfile,
}

/// [`SplitMetrics`] as they are written.
#[derive(Serialize, Deserialize)]
struct SplitFile {
    mean: MeanFile,
    views: Vec<NamedMetrics>,
    profile: LuminanceProfile,
}

#[derive(Serialize, Deserialize)]
struct MeanFile {
    #[serde(flatten)]
    metrics: ViewMetrics,
    #[serde(flatten)]
    field: Option<FieldMetrics>,
}

impl From<SplitFile> for SplitMetrics {
    fn from(SplitFile { mean, views, profile }: SplitFile) -> Self {
        Self { mean: mean.metrics, mean_field: mean.field, views, profile }
    }
}

impl From<SplitMetrics> for SplitFile {
    fn from(SplitMetrics { mean, mean_field, views, profile }: SplitMetrics) -> Self {
        Self { mean: MeanFile { metrics: mean, field: mean_field }, views, profile }
    }
}

/// Renders and measures `views`. `each` gets every view with its prediction in normalised units. Views without a valid pixel are left
/// out, with a warning; of no views the means are 0.
///
/// # Errors
/// [`TrainError::Engine`] if a view cannot be rendered, [`TrainError::Metrics`] if a render is not finite.
pub fn evaluate(
    engine: &mut dyn Engine,
    options: &RenderOptions,
    measures: &Measures<'_>,
    views: &[View],
    each: &mut dyn FnMut(&View, &Image, &ViewMetrics),
) -> Result<SplitMetrics, TrainError> {
    let mut named = Vec::with_capacity(views.len());
    let mut profile = LuminanceProfile::default();
    let measured: Vec<&View> = views.iter().filter(|view| has_valid_pixel(view)).collect();
    for batch in measured.chunks(measures.batch()) {
        let mut pairs = Vec::with_capacity(batch.len());
        for view in batch {
            pairs.push((*view, engine.render(&view.camera, options)?));
        }
        let figures: Vec<_> = pairs.par_iter().map(|(view, prediction)| measure(view, prediction, measures)).collect();
        // In the order of the views: sums come out the same for any number of threads, and the first error is reported.
        for ((view, prediction), figures) in pairs.iter().zip(figures) {
            let (metrics, field, of_view) = figures?;
            profile.merge(&of_view);
            each(view, prediction, &metrics);
            named.push(NamedMetrics { name: view.name.clone(), metrics, field: Some(field) });
        }
    }
    let all: Vec<ViewMetrics> = named.iter().map(|view| view.metrics).collect();
    let fields: Vec<FieldMetrics> = named.iter().filter_map(|view| view.field.clone()).collect();
    let mean = ViewMetrics::mean(&all).unwrap_or_default();
    Ok(SplitMetrics { mean, mean_field: FieldMetrics::mean(&fields), views: named, profile })
}

/// PSNR of one view by protocol `scene`, dB, for progress; `None` for a view without a valid pixel.
///
/// # Errors
/// As [`evaluate`].
pub fn probe(
    engine: &mut dyn Engine,
    options: &RenderOptions,
    radiance_scale: f32,
    mu: f32,
    view: &View,
) -> Result<Option<f64>, TrainError> {
    if !(0..view.image.pixels.len()).any(|i| view.is_valid(i)) {
        return Ok(None);
    }
    let prediction = engine.render(&view.camera, options)?;
    let target = normalised(view, radiance_scale);
    psnr_scene(&prediction, &target, view.mask.as_deref(), mu).map(Some).map_err(|source| failed(view, source))
}

fn measure(view: &View, prediction: &Image, measures: &Measures<'_>) -> Result<(ViewMetrics, FieldMetrics, LuminanceProfile), TrainError> {
    let (target, mask) = (normalised(view, measures.radiance_scale), view.mask.as_deref());
    let (metrics, profile) = view_metrics(prediction, &target, mask, measures.mu).map_err(|source| failed(view, source))?;
    let mut field = field_metrics(prediction, &target, mask, &measures.field).map_err(|source| failed(view, source))?;
    if let Some(lpips) = measures.lpips {
        let distance = lpips.of_radiance(prediction, &target, mask, measures.mu, measures.field.color_space);
        lpips.record(distance.map_err(|source| TrainError::Lpips { view: view.name.clone(), source })?, &mut field);
    }
    Ok((metrics, field, profile))
}

fn normalised(view: &View, radiance_scale: f32) -> Image {
    let mut target = Image::clone(&view.image);
    target.scale(1.0 / radiance_scale);
    target
}

fn has_valid_pixel(view: &View) -> bool {
    let has_one = (0..view.image.pixels.len()).any(|i| view.is_valid(i));
    if !has_one {
        tracing::warn!(view = view.name, "no valid pixel; left out of the figures");
    }
    has_one
}

fn failed(view: &View, source: luxel_core::metrics::MetricsError) -> TrainError {
    TrainError::Metrics { view: view.name.clone(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_a_split_are_one_object_a_view_and_one_of_means() {
        let field = FieldMetrics { pu21_psnr: 31.5, hdr_flip: Some(0.125), pu21_peak_luminance: 1000.0, ..FieldMetrics::default() };
        let metrics = ViewMetrics { psnr_scene: 30.25, ..ViewMetrics::default() };
        let view = NamedMetrics { name: "images/000".into(), metrics, field: Some(field.clone()) };
        let split = SplitMetrics { mean: metrics, mean_field: Some(field), views: vec![view], profile: LuminanceProfile::default() };
        let json = serde_json::to_value(&split).unwrap();
        for object in [&json["mean"], &json["views"][0]] {
            assert_eq!((&object["psnr_scene"], &object["pu21_psnr"], &object["hdr_flip"]), (&30.25.into(), &31.5.into(), &0.125.into()));
            assert!(object.get("lpips_alex").is_none());
        }
        assert_eq!(serde_json::from_value::<SplitMetrics>(json.clone()).unwrap(), split);
        // Files from before there were these figures.
        let mut old = json;
        for key in ["pu21_psnr", "pu21_ssim", "pu21_peak_luminance", "log_rmse", "hdr_flip", "relative_error_by_decade"] {
            old["mean"].as_object_mut().unwrap().remove(key);
            old["views"][0].as_object_mut().unwrap().remove(key);
        }
        let read: SplitMetrics = serde_json::from_value(old).unwrap();
        assert_eq!((read.mean, read.mean_field, &read.views[0].field), (metrics, None, &None));
    }
}
