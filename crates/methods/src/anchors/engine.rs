//! Anchors as an engine that renders: evaluation, rendering and measurements of speed ask any
//! engine for images. The splats that a camera sees are decoded and given to an engine of splats.

use luxel_core::engine::{DeepImage, Engine, EngineError, Evaluations, PassTime, RenderOnly};
use luxel_core::{Camera, Image, Layers, Remedy, RenderOptions};

use super::scene::AnchorScene;

/// Renders anchors on an engine of splats.
pub struct AnchorEngine {
    pub(super) scene: AnchorScene,
    /// The engine of splats, which a training uses for its steps, too.
    pub(super) engine: Box<dyn Engine>,
}

impl AnchorEngine {
    /// Returns an engine that renders `scene` on an engine of splats, whose scene is replaced.
    pub fn new(scene: AnchorScene, engine: Box<dyn Engine>) -> Self {
        Self { scene, engine }
    }

    /// Loads the splats that a camera sees.
    fn decode(&mut self, camera: &Camera, options: &RenderOptions) -> Result<&mut dyn Engine, EngineError> {
        camera.validate()?;
        let decoded = self.scene.decode(camera, options.raster.cutoffs.near);
        self.engine.load(&decoded.splats, None)?;
        Ok(&mut *self.engine)
    }
}

impl RenderOnly for AnchorEngine {
    fn no_splats(&self) -> EngineError {
        let message = "anchors decode their splats for each view, and have none that are the same for all views";
        EngineError::invalid(message).with_remedy(Remedy::set("method", "lcd"))
    }

    fn layers(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Layers, EngineError> {
        self.decode(camera, options)?.render_layers(camera, options)
    }

    fn image(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Image, EngineError> {
        self.decode(camera, options)?.render(camera, options)
    }

    fn normals(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Vec<[f32; 3]>, EngineError> {
        self.decode(camera, options)?.render_normals(camera, options)
    }

    fn deep_image(&mut self, camera: &Camera, options: &RenderOptions, most_samples: usize) -> Result<DeepImage, EngineError> {
        self.decode(camera, options)?.render_deep(camera, options, most_samples)
    }

    fn count_evaluations(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Option<Evaluations>, EngineError> {
        self.decode(camera, options)?.evaluations(camera, options)
    }

    fn splat_count(&self) -> usize {
        self.scene.splats()
    }

    fn pass_times(&self) -> &[PassTime] {
        self.engine.timings()
    }
}
