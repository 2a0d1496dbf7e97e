//! A field as an engine that renders: evaluation, rendering and measurements of speed ask any
//! engine for images.

use luxel_core::engine::{EngineError, RenderOnly};
use luxel_core::{Camera, Layers, RenderOptions};
use luxel_lanes::Level;

use crate::field::error::FieldError;
use crate::field::radiance_field::Field;
use crate::field::threads::start_threads;

/// Renders a field on some threads of the processor.
pub struct FieldEngine {
    pub(crate) field: Field,
    pub(crate) threads: rayon::ThreadPool,
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
        Level::best().name()
    }
}

impl RenderOnly for FieldEngine {
    fn no_splats(&self) -> EngineError {
        EngineError::invalid("a radiance field has no splats")
    }

    fn layers(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Layers, EngineError> {
        camera.validate()?;
        if !camera.distortion.is_none() {
            return Err(EngineError::invalid("camera: its lens distorts; fields are rendered without distortion"));
        }
        Ok(self.threads.install(|| self.field.render(camera, options.background, options.raster.samples)))
    }
}
