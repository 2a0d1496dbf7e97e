//! Anchors as an engine that renders: evaluation, rendering and measurements of speed ask any
//! engine for images. The splats that a camera sees are decoded and given to an engine of splats.
//! What needs a scene of splats is refused.

use std::ops::Range;

use luxel_core::edit::Contributions;
use luxel_core::engine::{
    DeepImage, DensifyPlan, DensifyStats, Engine, EngineError, Evaluations, Geometry, PassTime, SavedPart, SplatArray, StepConfig,
    StepReport,
};
use luxel_core::{Camera, Image, Layers, Moments, Remedy, RenderOptions, Splats, View};

use super::scene::AnchorScene;

/// Renders anchors on an engine of splats.
pub struct AnchorEngine {
    scene: AnchorScene,
    engine: Box<dyn Engine>,
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

/// Returns the error of a request that is about splats of a scene.
fn no_splats<T>() -> Result<T, EngineError> {
    let message = "anchors decode their splats for each view, and have none that are the same for all views";
    Err(EngineError::invalid(message).with_remedy(Remedy::set("method", "lcd")))
}

impl Engine for AnchorEngine {
    fn load(&mut self, _: &Splats, _: Option<&Moments>) -> Result<(), EngineError> {
        no_splats()
    }

    fn save(&mut self) -> Result<(Splats, Moments), EngineError> {
        no_splats()
    }

    fn save_array(&mut self, _: SavedPart, _: SplatArray, _: Range<usize>) -> Result<Vec<f32>, EngineError> {
        no_splats()
    }

    fn render(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Image, EngineError> {
        self.decode(camera, options)?.render(camera, options)
    }

    fn render_layers(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Layers, EngineError> {
        self.decode(camera, options)?.render_layers(camera, options)
    }

    fn render_deep(&mut self, camera: &Camera, options: &RenderOptions, most_samples: usize) -> Result<DeepImage, EngineError> {
        self.decode(camera, options)?.render_deep(camera, options, most_samples)
    }

    fn evaluations(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Option<Evaluations>, EngineError> {
        self.decode(camera, options)?.evaluations(camera, options)
    }

    fn contributions(&mut self, _: &Camera, _: &RenderOptions, _: &[f32]) -> Result<Contributions, EngineError> {
        no_splats()
    }

    fn train_step(&mut self, _: &View, _: &StepConfig) -> Result<StepReport, EngineError> {
        no_splats()
    }

    fn densify_stats(&mut self) -> Result<DensifyStats, EngineError> {
        no_splats()
    }

    fn set_densify_stats(&mut self, _: &DensifyStats) -> Result<(), EngineError> {
        no_splats()
    }

    fn geometry(&mut self) -> Result<Geometry, EngineError> {
        no_splats()
    }

    fn densify(&mut self, _: &DensifyPlan) -> Result<(), EngineError> {
        no_splats()
    }

    fn len(&self) -> usize {
        self.scene.splats()
    }

    fn timings(&self) -> &[PassTime] {
        self.engine.timings()
    }
}
