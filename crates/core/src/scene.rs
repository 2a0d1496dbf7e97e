//! A trained scene and the complete state of a training run.

use crate::engine::DensifyStats;
use crate::{ColorSpace, Moments, RadianceScale, RasterConfig, RenderOptions, Splats};

/// What a scene file holds: everything needed to render it in the data set's radiance.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// In normalised units.
    pub splats: Splats,
    /// Data-set radiance of one normalised unit; it turns renders into the input images' units.
    pub radiance_scale: RadianceScale,
    /// Primaries of the radiance.
    pub color_space: ColorSpace,
    /// How the scene was rasterised in training, and so should be rendered.
    pub raster: RasterConfig,
    /// Edits of light made since training, oldest first, in the text form of [`crate::Edit`]: a record, not applied again.
    pub edits: Vec<String>,
}

impl Scene {
    /// Returns the options that the scene is rendered with: its own raster settings, all degrees of
    /// its harmonics, and a black background.
    ///
    /// ```
    /// use luxel_core::{ColorModel, ColorSpace, RadianceScale, RasterConfig, Scene, Splats};
    ///
    /// let scene = Scene {
    ///     splats: Splats::empty(ColorModel::Sh { degree: 3 }),
    ///     radiance_scale: RadianceScale::ONE,
    ///     color_space: ColorSpace::LinearRec709,
    ///     raster: RasterConfig { samples: 2, ..RasterConfig::default() },
    ///     edits: Vec::new(),
    /// };
    /// assert_eq!(scene.render_options().raster.samples, 2);
    /// ```
    pub fn render_options(&self) -> RenderOptions {
        RenderOptions { raster: self.raster, ..RenderOptions::default() }
    }

    /// Returns the options of [`Self::render_options`] before a background of this data-set
    /// radiance.
    pub fn render_options_before(&self, background: [f32; 3]) -> RenderOptions {
        RenderOptions { background: self.radiance_scale.normalised(background), ..self.render_options() }
    }
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
