//! Engines that render and hold no scene of splats: of radiance fields, of anchors.
//!
//! In: what renders ([`RenderOnly`]). Out: an [`Engine`], which evaluation, rendering and
//! measurements of speed ask for images. All that is about stored splats is refused with the error
//! of the renderer.

use std::ops::Range;

use super::{
    DeepImage, DensifyPlan, DensifyStats, Engine, EngineError, Evaluations, Geometry, Layers, PassTime, RenderOptions, SavedPart,
    SplatArray, StepConfig, StepReport,
};
use crate::edit::Contributions;
use crate::{Camera, Image, Moments, Splats, View};

/// A renderer without stored splats. Its images, units and errors are those of [`Engine`].
pub trait RenderOnly: Send {
    /// Returns the error of a request that is about stored splats.
    fn no_splats(&self) -> EngineError;

    /// Renders radiance as [`Engine::render_layers`] does.
    ///
    /// # Errors
    /// Those of [`Engine::render_layers`].
    fn layers(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Layers, EngineError>;

    /// Renders radiance as [`Engine::render`] does.
    ///
    /// # Errors
    /// Those of [`Engine::render`].
    fn image(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Image, EngineError> {
        Ok(self.layers(camera, options)?.image)
    }

    /// Renders normals, as [`Engine::render_normals`] does.
    ///
    /// # Errors
    /// Those of [`Engine::render_normals`]; that of a renderer that blends no splats.
    fn normals(&mut self, _camera: &Camera, _options: &RenderOptions) -> Result<Vec<[f32; 3]>, EngineError> {
        Err(self.no_splats())
    }

    /// Lists what pixels are blended from, as [`Engine::render_deep`] does.
    ///
    /// # Errors
    /// Those of [`Engine::render_deep`]; that of a renderer that blends no splats.
    fn deep_image(&mut self, _camera: &Camera, _options: &RenderOptions, _most_samples: usize) -> Result<DeepImage, EngineError> {
        Err(self.no_splats())
    }

    /// Counts evaluations of splats, as [`Engine::evaluations`] does.
    ///
    /// # Errors
    /// Those of [`Engine::evaluations`].
    fn count_evaluations(&mut self, _camera: &Camera, _options: &RenderOptions) -> Result<Option<Evaluations>, EngineError> {
        Ok(None)
    }

    /// Returns the number of splats that images can be blended from.
    fn splat_count(&self) -> usize {
        0
    }

    /// Returns the time spent in each pass, if images have passes.
    fn pass_times(&self) -> &[PassTime] {
        &[]
    }
}

impl<R: RenderOnly> Engine for R {
    fn load(&mut self, _: &Splats, _: Option<&Moments>) -> Result<(), EngineError> {
        Err(self.no_splats())
    }

    fn save(&mut self) -> Result<(Splats, Moments), EngineError> {
        Err(self.no_splats())
    }

    fn save_array(&mut self, _: SavedPart, _: SplatArray, _: Range<usize>) -> Result<Vec<f32>, EngineError> {
        Err(self.no_splats())
    }

    fn render(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Image, EngineError> {
        self.image(camera, options)
    }

    fn render_layers(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Layers, EngineError> {
        self.layers(camera, options)
    }

    fn render_normals(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Vec<[f32; 3]>, EngineError> {
        self.normals(camera, options)
    }

    fn render_deep(&mut self, camera: &Camera, options: &RenderOptions, most_samples: usize) -> Result<DeepImage, EngineError> {
        self.deep_image(camera, options, most_samples)
    }

    fn evaluations(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Option<Evaluations>, EngineError> {
        self.count_evaluations(camera, options)
    }

    fn contributions(&mut self, _: &Camera, _: &RenderOptions, _: &[f32]) -> Result<Contributions, EngineError> {
        Err(self.no_splats())
    }

    fn train_step(&mut self, _: &View, _: &StepConfig) -> Result<StepReport, EngineError> {
        Err(self.no_splats())
    }

    fn densify_stats(&mut self) -> Result<DensifyStats, EngineError> {
        Err(self.no_splats())
    }

    fn set_densify_stats(&mut self, _: &DensifyStats) -> Result<(), EngineError> {
        Err(self.no_splats())
    }

    fn geometry(&mut self) -> Result<Geometry, EngineError> {
        Err(self.no_splats())
    }

    fn densify(&mut self, _: &DensifyPlan) -> Result<(), EngineError> {
        Err(self.no_splats())
    }

    fn len(&self) -> usize {
        self.splat_count()
    }

    fn timings(&self) -> &[PassTime] {
        self.pass_times()
    }
}
