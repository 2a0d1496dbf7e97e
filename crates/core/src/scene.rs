//! A trained scene, and the complete state of a training run.

use crate::engine::DensifyStats;
use crate::{ColorSpace, Moments, RadianceScale, RasterConfig, RenderOptions, Splats};

/// A scene as a scene file stores it: everything needed to render it in the data set's radiance.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Splats, in normalised units.
    pub splats: Splats,
    /// Data-set radiance of one normalised unit; converts renders to the units of the input images.
    pub radiance_scale: RadianceScale,
    /// Colour space of the radiance.
    pub color_space: ColorSpace,
    /// Raster settings of training; renders should use the same.
    pub raster: RasterConfig,
    /// Edits of light since training, oldest first, in the text form of [`crate::Edit`]. They are a
    /// log: the splats contain them already.
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

    /// Returns [`Self::render_options`] with a background of this data-set radiance.
    pub fn render_options_before(&self, background: [f32; 3]) -> RenderOptions {
        RenderOptions { background: self.radiance_scale.normalised(background), ..self.render_options() }
    }
}

/// The state of a training run at the end of a step; enough to resume bit for bit.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// Current scene.
    pub scene: Scene,
    /// Adam's moments.
    pub moments: Moments,
    /// Densification statistics since the last densification.
    pub stats: DensifyStats,
    /// Running mean of the parameters, once the averaging of the last steps has begun.
    pub average: Option<Splats>,
    /// Everything else as the trainer's JSON: step, random state, schedule, configuration,
    /// fingerprint.
    pub state_json: String,
}
