//! A trained scene and the complete state of a training run.

use crate::{ColorSpace, DensifyStats, Moments, RasterConfig, Splats};

/// What a scene file holds: everything needed to render it in the data set's radiance.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// In normalised units.
    pub splats: Splats,
    /// Data-set radiance of one normalised unit: a render times this is in the units of the input images.
    pub radiance_scale: f32,
    /// Primaries of the radiance.
    pub color_space: ColorSpace,
    /// How the scene was rasterised in training, and so should be rendered.
    pub raster: RasterConfig,
    /// Edits of light made since training, oldest first, in the text form of [`crate::Edit`]: a record, not applied again.
    pub edits: Vec<String>,
}

/// State of a training run at the end of a step; enough to continue bit for bit.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// The scene as it stands.
    pub scene: Scene,
    /// Adam's moments.
    pub moments: Moments,
    /// Densification statistics since the last densification.
    pub stats: DensifyStats,
    /// Mean of the parameters so far, where the last steps are averaged and have begun.
    pub average: Option<Splats>,
    /// Everything else (step, random state, schedule, configuration, fingerprint) as the trainer's JSON.
    pub state_json: String,
}
