//! A trained scene, and the complete state of a training run.

use glam::DVec3;

use crate::engine::DensifyStats;
use crate::{Camera, ColorSpace, Moments, RadianceScale, RasterConfig, RenderOptions, Similarity, Splats};

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
    /// The transform from the coordinates of the splats (local) to those of the data set (world);
    /// the identity for scenes of usual size near the origin, see [`crate::SceneBounds`].
    pub world_from_local: Similarity,
    /// Length of a unit of the world, metres; `None` if it is unknown.
    pub metres_per_unit: Option<f64>,
}

impl Scene {
    /// Returns the options that the scene is rendered with: its own raster settings, all degrees of
    /// its harmonics, and a black background.
    ///
    /// ```
    /// use luxel_core::{ColorModel, ColorSpace, RadianceScale};
    /// use luxel_core::{RasterConfig, Scene, Similarity, Splats};
    ///
    /// let scene = Scene {
    ///     splats: Splats::empty(ColorModel::Sh { degree: 3 }),
    ///     radiance_scale: RadianceScale::ONE,
    ///     color_space: ColorSpace::LinearRec709,
    ///     raster: RasterConfig { samples: 2, ..RasterConfig::default() },
    ///     edits: Vec::new(),
    ///     world_from_local: Similarity::IDENTITY,
    ///     metres_per_unit: None,
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

    /// Returns a camera of the world in the coordinates of the splats.
    pub fn local_camera(&self, world: &Camera) -> Camera {
        let mut camera = world.clone();
        self.world_from_local.inverse().apply_to_camera(&mut camera);
        camera
    }

    /// Returns a camera of local coordinates in the world.
    pub fn world_camera(&self, local: &Camera) -> Camera {
        let mut camera = local.clone();
        self.world_from_local.apply_to_camera(&mut camera);
        camera
    }

    /// Returns the position of splat `i` in the world.
    pub fn world_position(&self, i: usize) -> DVec3 {
        self.world_from_local.point(DVec3::from_array(self.splats.position[i].map(f64::from)))
    }

    /// Takes the splats to other local coordinates; the world stays.
    pub fn move_to(&mut self, world_from_local: Similarity) {
        if self.world_from_local != world_from_local {
            self.world_from_local.then(&world_from_local.inverse()).apply(&mut self.splats);
            self.world_from_local = world_from_local;
        }
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
