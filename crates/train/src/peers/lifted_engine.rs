//! Mono-HDR-GS's scene as an engine that renders radiance: splats of captured values, and the lift
//! that makes radiance of their colours towards each camera.
//!
//! In: an engine that holds the splats and has a rasteriser with gradients, the lift. Out: the same
//! engine, whose images are of lifted colours. Everything else is the inner engine's. Degenerate:
//! cameras that are no pinholes, supersampling and deep images are refused; the scene file of a run
//! has none of these limits.

use std::sync::{Arc, PoisonError, RwLock};

use luxel_core::edit::Contributions;
use luxel_core::engine::{
    DeepImage, DensifyPlan, DensifyStats, Differentiable, Evaluations, Geometry, Layers, PassTime, SparseGradients, StepConfig,
};
use luxel_core::{Antialias, Camera, Engine, EngineError, Image, Moments, Remedy, RenderOptions, Splats, StepReport, View};

use super::lift::LiftTables;
use super::rasterised::{Rasterised, SeenWith};

/// The lift of a run as its engine and its steps share it.
#[derive(Clone)]
pub(crate) struct SharedLift(Arc<RwLock<Arc<LiftTables>>>);

impl SharedLift {
    pub(crate) fn new(tables: LiftTables) -> Self {
        Self(Arc::new(RwLock::new(Arc::new(tables))))
    }

    /// Replaces the lift.
    pub(crate) fn set(&self, tables: LiftTables) {
        *self.0.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(tables);
    }

    /// Returns the lift.
    pub(crate) fn get(&self) -> Arc<LiftTables> {
        Arc::clone(&self.0.read().unwrap_or_else(PoisonError::into_inner))
    }
}

/// An engine that renders lifted colours.
pub(crate) struct LiftedEngine {
    inner: Box<dyn Engine>,
    lift: SharedLift,
}

impl LiftedEngine {
    pub(crate) fn new(inner: Box<dyn Engine>, lift: SharedLift) -> Self {
        Self { inner, lift }
    }
}

fn refused(what: &str) -> EngineError {
    let message = format!("{what}: radiance of method mono-hdr-gs is lifted for pinhole images of one sample a pixel");
    EngineError::invalid(message).with_remedy(Remedy::advice("name the run's point_cloud.ply, its scene without the lift"))
}

impl Engine for LiftedEngine {
    fn render(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Image, EngineError> {
        camera.validate()?;
        if !camera.projection.is_pinhole() {
            return Err(refused(camera.projection.name()));
        }
        if options.raster.samples > 1 || options.raster.antialias == Antialias::Mip {
            return Err(refused("supersampling or a 3D filter"));
        }
        let splats = self.inner.splats()?;
        let Some(raster) = self.inner.differentiable() else {
            return Err(EngineError::invalid("this engine has no rasteriser that lifts colours").with_remedy(Remedy::set("device", "cpu")));
        };
        let scene = Rasterised::projected(raster, &splats, camera, SeenWith { render: options, dropout: None })?;
        let radiance = self.lift.get().apply(&scene.colors()?, scene.visible());
        let pixels = scene.blend_over(&radiance, Some(options.background))?.pixels;
        let [width, height] = camera.size_px.map(|side| side as usize);
        Image::from_pixels(width, height, pixels).ok_or_else(|| EngineError::invalid("the image is not of the camera's size"))
    }

    fn render_layers(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Layers, EngineError> {
        let image = self.render(camera, options)?;
        Ok(Layers { image, ..self.inner.render_layers(camera, options)? })
    }

    fn render_deep(&mut self, _camera: &Camera, _options: &RenderOptions, _most_samples: usize) -> Result<DeepImage, EngineError> {
        Err(refused("deep images"))
    }

    fn train_step(&mut self, _view: &View, _step: &StepConfig) -> Result<StepReport, EngineError> {
        Err(EngineError::invalid("this engine takes the gradients of its method's own steps"))
    }

    fn load(&mut self, splats: &Splats, moments: Option<&Moments>) -> Result<(), EngineError> {
        self.inner.load(splats, moments)
    }

    fn save(&mut self) -> Result<(Splats, Moments), EngineError> {
        self.inner.save()
    }

    fn contributions(&mut self, camera: &Camera, options: &RenderOptions, mask: &[f32]) -> Result<Contributions, EngineError> {
        self.inner.contributions(camera, options, mask)
    }

    fn evaluations(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Option<Evaluations>, EngineError> {
        self.inner.evaluations(camera, options)
    }

    fn apply_gradients(&mut self, gradients: &SparseGradients, step: &StepConfig) -> Result<(), EngineError> {
        self.inner.apply_gradients(gradients, step)
    }

    fn splats(&mut self) -> Result<Splats, EngineError> {
        self.inner.splats()
    }

    fn differentiable(&self) -> Option<&dyn Differentiable> {
        self.inner.differentiable()
    }

    fn check_finite(&mut self) -> Result<(), EngineError> {
        self.inner.check_finite()
    }

    fn limit_images(&mut self, bytes: u64) {
        self.inner.limit_images(bytes);
    }

    fn finish(&mut self) -> Result<(), EngineError> {
        self.inner.finish()
    }

    fn densify_stats(&mut self) -> Result<DensifyStats, EngineError> {
        self.inner.densify_stats()
    }

    fn set_densify_stats(&mut self, stats: &DensifyStats) -> Result<(), EngineError> {
        self.inner.set_densify_stats(stats)
    }

    fn geometry(&mut self) -> Result<Geometry, EngineError> {
        self.inner.geometry()
    }

    fn densify(&mut self, plan: &DensifyPlan) -> Result<(), EngineError> {
        self.inner.densify(plan)
    }

    fn len(&self) -> usize {
        self.inner.len()
    }

    fn timings(&self) -> &[PassTime] {
        self.inner.timings()
    }
}
