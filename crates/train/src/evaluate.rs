//! Figures of a scene against views.
//!
//! In: an engine with the scene loaded, views in the data set's units, the radiance scale; out: figures per view and their mean, and
//! the error by luminance over all views. Views are rendered one after another, the engine being parallel in itself, and measured some at a
//! time, one a thread; predictions are handed out in the order of the views, and no more than a batch is held.

use luxel_core::metrics::{LuminanceProfile, ViewMetrics, psnr_scene, view_metrics};
use luxel_core::{Engine, Image, RenderOptions, View};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::TrainError;

/// Figures of one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NamedMetrics {
    /// Name of the view.
    pub name: String,
    /// Its figures.
    #[serde(flatten)]
    pub metrics: ViewMetrics,
}

/// Figures of a split.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SplitMetrics {
    /// Means over the views.
    pub mean: ViewMetrics,
    /// In the order of the views.
    pub views: Vec<NamedMetrics>,
    /// Error by luminance, over all views.
    pub profile: LuminanceProfile,
}

/// Renders and measures `views`. `each` gets every view with its prediction in normalised units. Views without a valid pixel are left
/// out, with a warning; of no views the means are 0.
///
/// # Errors
/// [`TrainError::Engine`] if a view cannot be rendered, [`TrainError::Metrics`] if a render is not finite.
pub fn evaluate(
    engine: &mut dyn Engine,
    options: &RenderOptions,
    radiance_scale: f32,
    mu: f32,
    views: &[View],
    each: &mut dyn FnMut(&View, &Image, &ViewMetrics),
) -> Result<SplitMetrics, TrainError> {
    let mut named = Vec::with_capacity(views.len());
    let mut profile = LuminanceProfile::default();
    let measured: Vec<&View> = views.iter().filter(|view| has_valid_pixel(view)).collect();
    for batch in measured.chunks(rayon::current_num_threads().max(1)) {
        let mut pairs = Vec::with_capacity(batch.len());
        for view in batch {
            pairs.push((*view, engine.render(&view.camera, options)?));
        }
        let figures: Vec<_> = pairs.par_iter().map(|(view, prediction)| measure(view, prediction, radiance_scale, mu)).collect();
        // In the order of the views: sums come out the same for any number of threads, and the first error is reported.
        for ((view, prediction), figures) in pairs.iter().zip(figures) {
            let (metrics, of_view) = figures?;
            profile.merge(&of_view);
            each(view, prediction, &metrics);
            named.push(NamedMetrics { name: view.name.clone(), metrics });
        }
    }
    let all: Vec<ViewMetrics> = named.iter().map(|view| view.metrics).collect();
    Ok(SplitMetrics { mean: ViewMetrics::mean(&all).unwrap_or_default(), views: named, profile })
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

fn measure(view: &View, prediction: &Image, radiance_scale: f32, mu: f32) -> Result<(ViewMetrics, LuminanceProfile), TrainError> {
    let target = normalised(view, radiance_scale);
    view_metrics(prediction, &target, view.mask.as_deref(), mu).map_err(|source| failed(view, source))
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
