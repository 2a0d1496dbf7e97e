//! Evaluates a scene on views.
//!
//! In: an engine with the scene loaded, views in the data set's units and the radiance scale. Out:
//! the metrics of each view, their means, and the error by luminance over all views. The engine is
//! parallel in itself and renders one view after another. A batch of views is then measured in
//! parallel, one view a thread; with LPIPS, which is parallel in itself, a batch is one view.
//! Predictions are handed out in the order of the views, and at most one batch is in memory.
//!
//! Captured LDR views are compared in captured values, without a mu-law: the camera's response is
//! applied to the render first. They have no metrics that need radiance.
//!
//! Images and scene may differ by a gain, in exposure or white balance, that is no error of the
//! scene. [`GainFit`] selects the gains by which predictions are multiplied before they are
//! measured. The vignetting of a view's target ([`luxel_core::Target::vignetting`]) is applied to
//! its prediction before that.

use luxel_core::{Engine, EngineError, Image, Knots, PixelValues, RadianceScale, ReadError, Remedy, RenderOptions, Response, View};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::measures::Measures;
use crate::{
    FieldMetrics, GainChannels, LpipsError, LuminanceProfile, MetricsError, ViewMetrics, field_metrics, log_gain_of_view, psnr_scene,
    render_as_captured, view_metrics,
};

/// A mu so small that the mu-law is linear in single precision: captured values are compared as
/// they are.
const LINEAR_MU: f32 = 1e-6;

/// The reasons for which views cannot be evaluated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvaluationError {
    /// The engine cannot render a view.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// An image cannot be read again.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A view cannot be compared with its render.
    #[error("view {view}: {source}")]
    Metrics {
        /// Name of the view.
        view: String,
        /// The reason.
        source: MetricsError,
    },
    /// The LPIPS network cannot compare a view.
    #[error("view {view}: {source}")]
    Lpips {
        /// Name of the view.
        view: String,
        /// The reason.
        source: LpipsError,
    },
    /// A view holds captured values, and no camera response is known to compare them through.
    #[error("view {view}: it holds captured values, and no camera response is known to compare them through; compare with radiance")]
    NoResponse {
        /// Name of the view.
        view: String,
    },
}

impl EvaluationError {
    /// Returns the remedy for the error, where one is known.
    pub fn remedy(&self) -> Option<&Remedy> {
        match self {
            Self::Engine(error) => error.remedy(),
            Self::Read(error) => error.remedy.as_ref(),
            Self::Metrics { .. } | Self::Lpips { .. } | Self::NoResponse { .. } => None,
        }
    }
}

/// The gains by channel by which predictions are multiplied before they are measured. Fitted gains
/// are medians of image over render.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum GainFit<'a> {
    /// Predictions are measured as they are.
    #[default]
    None,
    /// One gain is fitted for all views: the scale that a reconstruction from captured LDR images
    /// leaves undetermined.
    Common,
    /// A gain is fitted for each view: exposure and white balance that drift between views.
    PerView,
    /// The ln gain of each view by channel is given, in the order of the views, as
    /// `luxel_train::Trainer::log_gains` returns them. Predictions of views beyond the end of the
    /// slice are measured as they are.
    Known(&'a [[f32; 3]]),
}

/// Metrics of one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NamedMetrics {
    /// Name of the view.
    pub name: String,
    /// Metrics under the mu-law.
    #[serde(flatten)]
    pub metrics: ViewMetrics,
    /// Metrics that need no mu-law; `None` for captured LDR views and in files that predate these
    /// metrics.
    #[serde(flatten)]
    pub field: Option<FieldMetrics>,
}

/// Metrics of a split. In files both means are one object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "SplitFile", into = "SplitFile")]
pub struct SplitMetrics {
    /// Means over the views.
    pub mean: ViewMetrics,
    /// Means over the views of the metrics that need no mu-law; `None` unless all views have them.
    pub mean_field: Option<FieldMetrics>,
    /// Metrics of each view, in the order of the views.
    pub views: Vec<NamedMetrics>,
    /// Error by luminance, over all views.
    pub profile: LuminanceProfile,
}

/// [`SplitMetrics`] in the form of files.
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

/// Renders and measures `views`, and calls `each` with every view, its prediction and its metrics.
///
/// The prediction is in normalised units, or in captured values for a captured LDR view. Views
/// without a valid pixel are left out, with a warning. Without any view the means are 0.
///
/// # Errors
/// [`EvaluationError::Engine`] if a view cannot be rendered, [`EvaluationError::Metrics`] if a
/// render is not finite or does not match its image, [`EvaluationError::Lpips`] if the network
/// cannot compare a view, and [`EvaluationError::NoResponse`] for a captured LDR view without a
/// response.
pub fn evaluate(
    engine: &mut dyn Engine,
    options: &RenderOptions,
    measures: &Measures<'_>,
    views: &[View],
    each: &mut dyn FnMut(&View, &Image, &ViewMetrics),
) -> Result<SplitMetrics, EvaluationError> {
    let mut named = Vec::with_capacity(views.len());
    let mut profile = LuminanceProfile::default();
    let common = match measures.gain_fit {
        GainFit::Common => common_gain(engine, options, measures.radiance_scale, views)?,
        GainFit::None | GainFit::PerView | GainFit::Known(_) => [0.0; 3],
    };
    let indices: Vec<usize> = (0..views.len()).collect();
    // The render of the view before, if the next one has its camera.
    let mut shared: Option<Image> = None;
    // Images of earlier views, whose memory is used again.
    let mut spare: Vec<Image> = Vec::new();
    for batch in indices.chunks(measures.batch(views)) {
        let mut pairs = Vec::with_capacity(batch.len());
        for index in batch {
            let (view, shared_render) = (views[*index].loaded()?, shared.take());
            if !has_valid_pixel(&view) {
                continue;
            }
            let render = match shared_render {
                Some(render) => render,
                None => {
                    let mut image = spare.pop().unwrap_or_default();
                    engine.render_into(&view.camera, options, &mut image)?;
                    image
                }
            };
            // Captured images of one pose come one after another, and are compared with one render.
            if views.get(index + 1).is_some_and(|next| next.camera == view.camera) {
                shared = Some(render.clone());
            }
            let mut prediction = render;
            vignette(&mut prediction, &view);
            match measures.gain_fit {
                GainFit::None => {}
                GainFit::Common => multiply(&mut prediction, common),
                GainFit::PerView => {
                    let log = log_gain(&prediction, &view, measures.radiance_scale);
                    multiply(&mut prediction, log.unwrap_or_default());
                }
                GainFit::Known(logs) => multiply(&mut prediction, logs.get(*index).copied().unwrap_or_default()),
            }
            let prediction = to_view_values(&view, prediction, measures.radiance_scale, measures.response)?;
            pairs.push((view, prediction));
        }
        let results: Vec<_> = pairs.par_iter().map(|(view, prediction)| measure(view, prediction, measures)).collect();
        // Results are taken in the order of the views: sums do not depend on the number of threads,
        // and the first error is the one reported.
        for ((view, prediction), result) in pairs.iter().zip(results) {
            let (metrics, field, view_profile) = result?;
            profile.merge(&view_profile);
            each(view, prediction, &metrics);
            named.push(NamedMetrics { name: view.name.clone(), metrics, field });
        }
        spare.extend(pairs.into_iter().map(|(_, prediction)| prediction));
    }
    let all: Vec<ViewMetrics> = named.iter().map(|view| view.metrics).collect();
    let fields: Option<Vec<FieldMetrics>> = named.iter().map(|view| view.field.clone()).collect();
    let mean = ViewMetrics::mean(&all).unwrap_or_default();
    let mean_field = fields.and_then(|fields| FieldMetrics::mean(&fields));
    Ok(SplitMetrics { mean, mean_field, views: named, profile })
}

/// Returns ln of the gain of a view's image over its render by channel, or `None` for a captured
/// LDR view or too few reliable pixels.
fn log_gain(render: &Image, view: &View, radiance_scale: RadianceScale) -> Option<[f32; 3]> {
    if view.values != PixelValues::Radiance {
        return None;
    }
    log_gain_of_view(render, view, radiance_scale.target_scale([1.0; 3]), GainChannels::Separate)
}

/// Returns ln of the one gain of all views over their renders: the mean of the views' ln gains.
fn common_gain(
    engine: &mut dyn Engine,
    options: &RenderOptions,
    radiance_scale: RadianceScale,
    views: &[View],
) -> Result<[f32; 3], EvaluationError> {
    let (mut sum, mut count, mut render) = ([0.0f64; 3], 0usize, Image::default());
    for view in views {
        let view = view.loaded()?;
        if !has_valid_pixel(&view) {
            continue;
        }
        engine.render_into(&view.camera, options, &mut render)?;
        vignette(&mut render, &view);
        if let Some(log) = log_gain(&render, &view, radiance_scale) {
            sum = [0, 1, 2].map(|c| sum[c] + f64::from(log[c]));
            count += 1;
        }
    }
    Ok(sum.map(|sum| (sum / count.max(1) as f64) as f32))
}

/// Gives a render the vignetting of a view's target.
fn vignette(image: &mut Image, view: &View) {
    if let Some(vignetting) = &view.target.vignetting {
        vignetting.apply(image);
    }
}

fn multiply(image: &mut Image, log_gain: [f32; 3]) {
    let gain = log_gain.map(f32::exp);
    for pixel in &mut image.pixels {
        *pixel = [pixel[0] * gain[0], pixel[1] * gain[1], pixel[2] * gain[2]];
    }
}

/// Converts a render in normalised units to the values of the view's image: radiance or captured
/// values.
fn to_view_values(view: &View, render: Image, radiance_scale: RadianceScale, response: Option<&Knots>) -> Result<Image, EvaluationError> {
    match (view.values, response) {
        (PixelValues::Radiance, _) => Ok(render),
        (PixelValues::Recorded { exposure_s }, Some(knots)) => {
            Ok(render_as_captured(&render, &Response { knots: *knots, exposure: radiance_scale.exposure(exposure_s, [1.0; 3]) }))
        }
        (PixelValues::Recorded { .. }, None) => Err(EvaluationError::NoResponse { view: view.name.clone() }),
    }
}

/// Returns the PSNR by protocol `scene` of one view with a given ln gain, dB, for progress reports;
/// `None` for a view without a valid pixel. No gain is fitted.
///
/// # Errors
/// The same as of [`evaluate`].
pub fn probe(
    engine: &mut dyn Engine,
    options: &RenderOptions,
    measures: &Measures<'_>,
    view: &View,
    log_gain: [f32; 3],
) -> Result<Option<f64>, EvaluationError> {
    let view = &view.loaded()?;
    if !(0..view.image.pixels.len()).any(|i| view.is_valid(i)) {
        return Ok(None);
    }
    let mut prediction = engine.render(&view.camera, options)?;
    vignette(&mut prediction, view);
    multiply(&mut prediction, log_gain);
    let prediction = to_view_values(view, prediction, measures.radiance_scale, measures.response)?;
    let (target, mu) = (measures.target(view), mu_of(view, measures));
    psnr_scene(&measures.in_protocol_units(view, &prediction), &target, view.mask.as_deref(), mu)
        .map(Some)
        .map_err(|source| failed(view, source))
}

/// Returns the mu with which the view's values are compared.
fn mu_of(view: &View, measures: &Measures<'_>) -> f32 {
    match view.values {
        PixelValues::Radiance => measures.mu,
        PixelValues::Recorded { .. } => LINEAR_MU,
    }
}

/// The metrics of a view, and its error by luminance.
type ViewResult = (ViewMetrics, Option<FieldMetrics>, LuminanceProfile);

fn measure(view: &View, prediction: &Image, measures: &Measures<'_>) -> Result<ViewResult, EvaluationError> {
    let (target, mask) = (measures.target(view), view.mask.as_deref());
    let prediction = &*measures.in_protocol_units(view, prediction);
    let of_view = || view_metrics(prediction, &target, mask, mu_of(view, measures)).map_err(|source| failed(view, source));
    if view.values != PixelValues::Radiance {
        return Ok((of_view()?, None, LuminanceProfile::default()));
    }
    // Of a large image, one is measured at a time.
    let of_field = || field_metrics(prediction, &target, mask, &measures.field).map_err(|source| failed(view, source));
    let (metrics, field) = rayon::join(of_view, of_field);
    let (metrics, mut field) = (metrics?, field?);
    let profile =
        LuminanceProfile::measure(prediction, &target, mask, measures.field.color_space).map_err(|source| failed(view, source))?;
    if let Some(lpips) = measures.lpips {
        let distance = lpips.radiance_distance(prediction, &target, mask, measures.mu, measures.field.color_space);
        lpips.record(distance.map_err(|source| EvaluationError::Lpips { view: view.name.clone(), source })?, &mut field);
    }
    Ok((metrics, Some(field), profile))
}

fn has_valid_pixel(view: &View) -> bool {
    let has_one = (0..view.image.pixels.len()).any(|i| view.is_valid(i));
    if !has_one {
        tracing::warn!(view = view.name, "no valid pixel; left out of the metrics");
    }
    has_one
}

fn failed(view: &View, source: MetricsError) -> EvaluationError {
    EvaluationError::Metrics { view: view.name.clone(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metrics_of_a_split_are_one_object_a_view_and_one_of_means() {
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
        // Files that predate these metrics.
        let mut old = json;
        for key in ["pu21_psnr", "pu21_ssim", "pu21_peak_luminance", "log_rmse", "hdr_flip", "relative_error_by_decade"] {
            old["mean"].as_object_mut().unwrap().remove(key);
            old["views"][0].as_object_mut().unwrap().remove(key);
        }
        let read: SplitMetrics = serde_json::from_value(old).unwrap();
        assert_eq!((read.mean, read.mean_field, &read.views[0].field), (metrics, None, &None));
    }
}
