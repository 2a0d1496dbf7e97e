//! A field as an engine that renders: evaluation, rendering and measurements of speed ask any
//! engine for images. All that is about splats is refused.

use std::ops::Range;

use fearless_simd::Level;
use luxel_core::edit::Contributions;
use luxel_core::engine::{
    DensifyPlan, DensifyStats, Engine, EngineError, Geometry, PassTime, SavedPart, SplatArray, StepConfig, StepReport,
};
use luxel_core::{Camera, Image, Layers, Moments, RenderOptions, Splats, View};

use crate::error::FieldError;
use crate::field::Field;
use crate::threads::start_threads;

/// Renders a field on some threads of the processor.
pub struct FieldEngine {
    field: Field,
    threads: rayon::ThreadPool,
}

impl FieldEngine {
    /// Returns an engine for `field`. 0 threads are as many as the machine has cores.
    ///
    /// # Errors
    /// [`FieldError::Threads`].
    pub fn new(field: Field, threads: usize) -> Result<Self, FieldError> {
        Ok(Self { field, threads: start_threads(threads)? })
    }

    /// Returns the name of the instruction set that it computes with.
    pub fn instruction_set(&self) -> String {
        format!("{:?}", Level::new())
    }

    fn layers(&self, camera: &Camera, options: &RenderOptions) -> Result<Layers, EngineError> {
        camera.validate()?;
        if !camera.distortion.is_none() {
            return Err(EngineError::invalid("camera: its lens distorts; fields are rendered without distortion"));
        }
        Ok(self.threads.install(|| self.field.render(camera, options.background, options.raster.samples)))
    }
}

/// Returns the error of a request that is about splats.
fn no_splats<T>() -> Result<T, EngineError> {
    Err(EngineError::invalid("a radiance field has no splats"))
}

impl Engine for FieldEngine {
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
        Ok(self.layers(camera, options)?.image)
    }

    fn render_layers(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Layers, EngineError> {
        self.layers(camera, options)
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
        0
    }

    fn timings(&self) -> &[PassTime] {
        &[]
    }
}
