//! Figures of a scene against views.
//!
//! In: an engine with the scene loaded, views in the data set's units, the radiance scale; out: figures per view and their mean, and
//! the error by luminance over all views. Views are rendered one after another, the engine being parallel in itself, and measured some at a
//! time, one a thread, with LPIPS one by one; predictions are handed out in the order of the views, and no more than a batch is held.
//!
//! Views of recorded values are compared with what the camera's response makes of the render, in its own values without a mu-law; figures that need
//! radiance are left out of them. Where images and scene differ by a gain that is nobody's fault ([`GainFit`]), figures after its removal stand beside
//! those as it is; gains that training found belong to its images, whose figures are after their removal alone.

use luxel_core::{Engine, EngineError, Image, Knots, PixelValues, RadianceScale, Remedy, RenderOptions, Response, View};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::{
    FieldMetrics, FieldOptions, GainChannels, Lpips, LpipsError, LuminanceProfile, MetricsError, ViewMetrics, field_metrics,
    log_gain_of_view, psnr_scene, render_as_captured, view_metrics,
};

/// mu of a mu-law that is a straight line to the last digit: recorded values are compared as they are.
const LINEAR_MU: f32 = 1e-6;

/// Why views cannot be evaluated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvaluationError {
    /// The engine cannot render a view.
    #[error(transparent)]
    Engine(#[from] EngineError),
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
    /// Returns what to do about the error, where it is known.
    pub fn remedy(&self) -> Option<&Remedy> {
        match self {
            Self::Engine(error) => error.remedy(),
            Self::Metrics { .. } | Self::Lpips { .. } | Self::NoResponse { .. } => None,
        }
    }
}

/// What is taken out of predictions before they are measured: gains by channel, medians of image over render unless they are known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum GainFit<'a> {
    /// Nothing.
    #[default]
    None,
    /// One gain for all views: a scale that nothing fixes, as of radiance from recordings.
    Common,
    /// A gain of each view: exposure and white balance that drift.
    PerView,
    /// ln gain of each view by channel, in the order of the views, as `luxel_train::Trainer::log_gains` has them; of views beyond, nothing.
    Known(&'a [[f32; 3]]),
}

/// How views are measured.
#[derive(Clone, Copy, Debug)]
pub struct Measures<'a> {
    /// Data-set radiance of one normalised unit.
    pub radiance_scale: RadianceScale,
    /// mu of the mu-law.
    pub mu: f32,
    /// Of the figures that need no mu-law.
    pub field: FieldOptions,
    /// The network of the user's weights, if there is one.
    pub lpips: Option<&'a Lpips>,
    /// The response of the camera that recorded the views of recorded values.
    pub response: Option<&'a Knots>,
    /// What is taken out of the predictions.
    pub gain_fit: GainFit<'a>,
}

impl Measures<'_> {
    /// With the default display, without HDR-FLIP and LPIPS, of images in linear Rec.709.
    pub fn new(radiance_scale: RadianceScale, mu: f32) -> Self {
        Self { radiance_scale, mu, field: FieldOptions::default(), lpips: None, response: None, gain_fit: GainFit::None }
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

/// Renders and measures `views`. `each` gets every view with its prediction in normalised units, or as it is recorded. Views without a valid pixel are left
/// out, with a warning; of no views the means are 0.
///
/// # Errors
/// [`EvaluationError::Engine`] if a view cannot be rendered, [`EvaluationError::Metrics`] if a render is not finite, [`EvaluationError::NoResponse`] for a view of
/// recorded values without a response.
pub fn evaluate(
    engine: &mut dyn Engine,
    options: &RenderOptions,
    measures: &Measures<'_>,
    views: &[View],
    each: &mut dyn FnMut(&View, &Image, &ViewMetrics),
) -> Result<SplitMetrics, EvaluationError> {
    let mut named = Vec::with_capacity(views.len());
    let mut profile = LuminanceProfile::default();
    let measured: Vec<(usize, &View)> = views.iter().enumerate().filter(|(_, view)| has_valid_pixel(view)).collect();
    let common = match measures.gain_fit {
        GainFit::Common => common_gain(engine, options, measures.radiance_scale, &measured)?,
        GainFit::None | GainFit::PerView | GainFit::Known(_) => [0.0; 3],
    };
    for batch in measured.chunks(measures.batch()) {
        let mut pairs = Vec::with_capacity(batch.len());
        for (index, view) in batch {
            let mut prediction = engine.render(&view.camera, options)?;
            match measures.gain_fit {
                GainFit::None => {}
                GainFit::Common => multiply(&mut prediction, common),
                GainFit::PerView => {
                    let log = log_gain(&prediction, view, measures.radiance_scale);
                    multiply(&mut prediction, log.unwrap_or_default());
                }
                GainFit::Known(logs) => multiply(&mut prediction, logs.get(*index).copied().unwrap_or_default()),
            }
            pairs.push((*view, seen_by(view, prediction, measures.radiance_scale, measures.response)?));
        }
        let figures: Vec<_> = pairs.par_iter().map(|(view, prediction)| measure(view, prediction, measures)).collect();
        // In the order of the views: sums come out the same for any number of threads, and the first error is reported.
        for ((view, prediction), figures) in pairs.iter().zip(figures) {
            let (metrics, field, of_view) = figures?;
            profile.merge(&of_view);
            each(view, prediction, &metrics);
            named.push(NamedMetrics { name: view.name.clone(), metrics, field });
        }
    }
    let all: Vec<ViewMetrics> = named.iter().map(|view| view.metrics).collect();
    let fields: Option<Vec<FieldMetrics>> = named.iter().map(|view| view.field.clone()).collect();
    let mean = ViewMetrics::mean(&all).unwrap_or_default();
    let mean_field = fields.and_then(|fields| FieldMetrics::mean(&fields));
    Ok(SplitMetrics { mean, mean_field, views: named, profile })
}

/// ln of the gain of a view's image over its render, by channel; `None` of recorded values, or of too few pixels to tell.
fn log_gain(render: &Image, view: &View, radiance_scale: RadianceScale) -> Option<[f32; 3]> {
    if view.values != PixelValues::Radiance {
        return None;
    }
    log_gain_of_view(render, view, radiance_scale.target_scale([1.0; 3]), GainChannels::Separate)
}

/// ln of the one gain of all views over their renders: the mean of theirs.
fn common_gain(
    engine: &mut dyn Engine,
    options: &RenderOptions,
    radiance_scale: RadianceScale,
    views: &[(usize, &View)],
) -> Result<[f32; 3], EvaluationError> {
    let (mut sum, mut count) = ([0.0f64; 3], 0usize);
    for (_, view) in views {
        if let Some(log) = log_gain(&engine.render(&view.camera, options)?, view, radiance_scale) {
            sum = [0, 1, 2].map(|c| sum[c] + f64::from(log[c]));
            count += 1;
        }
    }
    Ok(sum.map(|sum| (sum / count.max(1) as f64) as f32))
}

fn multiply(image: &mut Image, log_gain: [f32; 3]) {
    let gain = log_gain.map(f32::exp);
    for pixel in &mut image.pixels {
        *pixel = [pixel[0] * gain[0], pixel[1] * gain[1], pixel[2] * gain[2]];
    }
}

/// A render in normalised units as the view's image has it: radiance, or what is recorded of it.
fn seen_by(view: &View, render: Image, radiance_scale: RadianceScale, response: Option<&Knots>) -> Result<Image, EvaluationError> {
    match (view.values, response) {
        (PixelValues::Radiance, _) => Ok(render),
        (PixelValues::Recorded { exposure_s }, Some(knots)) => {
            Ok(render_as_captured(&render, &Response { knots: *knots, exposure: radiance_scale.exposure(exposure_s, [1.0; 3]) }))
        }
        (PixelValues::Recorded { .. }, None) => Err(EvaluationError::NoResponse { view: view.name.clone() }),
    }
}

/// PSNR of one view of known ln gain by protocol `scene`, dB, for progress; `None` for a view without a valid pixel. No gains are fitted.
///
/// # Errors
/// As [`evaluate`].
pub fn probe(
    engine: &mut dyn Engine,
    options: &RenderOptions,
    measures: &Measures<'_>,
    (view, log_gain): (&View, [f32; 3]),
) -> Result<Option<f64>, EvaluationError> {
    if !(0..view.image.pixels.len()).any(|i| view.is_valid(i)) {
        return Ok(None);
    }
    let mut prediction = engine.render(&view.camera, options)?;
    multiply(&mut prediction, log_gain);
    let prediction = seen_by(view, prediction, measures.radiance_scale, measures.response)?;
    let (target, mu) = (normalised(view, measures.radiance_scale), mu_of(view, measures));
    psnr_scene(&prediction, &target, view.mask.as_deref(), mu).map(Some).map_err(|source| failed(view, source))
}

/// mu of the mu-law that the view's values are compared under.
fn mu_of(view: &View, measures: &Measures<'_>) -> f32 {
    match view.values {
        PixelValues::Radiance => measures.mu,
        PixelValues::Recorded { .. } => LINEAR_MU,
    }
}

type Figures = (ViewMetrics, Option<FieldMetrics>, LuminanceProfile);

fn measure(view: &View, prediction: &Image, measures: &Measures<'_>) -> Result<Figures, EvaluationError> {
    let (target, mask) = (normalised(view, measures.radiance_scale), view.mask.as_deref());
    let metrics = view_metrics(prediction, &target, mask, mu_of(view, measures)).map_err(|source| failed(view, source))?;
    if view.values != PixelValues::Radiance {
        return Ok((metrics, None, LuminanceProfile::default()));
    }
    let mut field = field_metrics(prediction, &target, mask, &measures.field).map_err(|source| failed(view, source))?;
    let profile = LuminanceProfile::of(prediction, &target, mask, measures.field.color_space).map_err(|source| failed(view, source))?;
    if let Some(lpips) = measures.lpips {
        let distance = lpips.of_radiance(prediction, &target, mask, measures.mu, measures.field.color_space);
        lpips.record(distance.map_err(|source| EvaluationError::Lpips { view: view.name.clone(), source })?, &mut field);
    }
    Ok((metrics, Some(field), profile))
}

fn normalised(view: &View, radiance_scale: RadianceScale) -> Image {
    let mut target = Image::clone(&view.image);
    if view.values == PixelValues::Radiance {
        radiance_scale.normalise(&mut target);
    }
    target
}

fn has_valid_pixel(view: &View) -> bool {
    let has_one = (0..view.image.pixels.len()).any(|i| view.is_valid(i));
    if !has_one {
        tracing::warn!(view = view.name, "no valid pixel; left out of the figures");
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
