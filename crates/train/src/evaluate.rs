//! Figures of a scene against views.
//!
//! In: an engine with the scene loaded, views in the data set's units, the radiance scale; out: figures per view and their mean, and
//! the error by luminance over all views. Predictions are handed out as they are made, so that none has to be kept.

use luxel_core::metrics::{LuminanceProfile, ViewMetrics, view_metrics};
use luxel_core::{Engine, Image, RenderOptions, View};
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
    for view in views {
        if (0..view.image.pixels.len()).all(|i| !view.is_valid(i)) {
            tracing::warn!(view = view.name, "no valid pixel; left out of the figures");
            continue;
        }
        let mut target = Image::clone(&view.image);
        target.scale(1.0 / radiance_scale);
        let prediction = engine.render(&view.camera, options)?;
        let (metrics, of_view) = view_metrics(&prediction, &target, view.mask.as_deref(), mu)
            .map_err(|source| TrainError::Metrics { view: view.name.clone(), source })?;
        profile.merge(&of_view);
        each(view, &prediction, &metrics);
        named.push(NamedMetrics { name: view.name.clone(), metrics });
    }
    let all: Vec<ViewMetrics> = named.iter().map(|view| view.metrics).collect();
    Ok(SplitMetrics { mean: ViewMetrics::mean(&all).unwrap_or_default(), views: named, profile })
}
