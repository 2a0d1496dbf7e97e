//! Mono-HDR-GS's scene as an engine that renders radiance: splats of captured values, and the lift
//! that makes radiance of their colours towards each camera.
//!
//! In: an engine that holds the splats and blends channels, the lift. Out: the same
//! engine, whose images are of lifted colours. Everything else is the inner engine's. Degenerate:
//! cameras that are no pinholes, supersampling and deep images are refused; the scene file of a run
//! has none of these limits.

use std::ops::Range;
use std::sync::{Arc, PoisonError, RwLock};

use luxel_core::edit::Contributions;
use luxel_core::engine::{
    ChannelSource, ChannelStep, DeepImage, DensifyPlan, DensifyStats, Differentiable, Evaluations, Geometry, Layers, PassTime, SavedPart,
    SeenSplats, SparseGradients, SplatArray, StepConfig,
};
use luxel_core::{
    Antialias, Camera, Cutoffs, Engine, EngineError, Image, Moments, RasterConfig, Remedy, RenderOptions, Splats, StepReport, View,
};

use super::lift::LiftTables;
use crate::captured::arithmetic::color_map::mapped;

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

/// Lifted colours as channels.
struct LiftedColors<'a>(&'a LiftTables);

impl ChannelSource for LiftedColors<'_> {
    fn count(&self) -> usize {
        3
    }

    fn fill(&mut self, splats: &SeenSplats<'_>, out: &mut [f32]) {
        out.copy_from_slice(mapped(self.0, splats).colors.as_flattened());
    }
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
        // No threshold may depend on the colours before the lift.
        let cutoffs = options.raster.cutoffs;
        let cutoffs = Cutoffs { min_contribution: f32::INFINITY, alpha_floor: cutoffs.min_alpha, ..cutoffs };
        let options = RenderOptions { raster: RasterConfig { cutoffs, ..options.raster }, ..*options };
        let planes = self.inner.render_channels(camera, &mut LiftedColors(&self.lift.get()), &options)?;
        let [width, height] = camera.size_px.map(|side| side as usize);
        let len = width * height;
        let pixels = (0..len).map(|i| [planes[i], planes[len + i], planes[2 * len + i]]).collect();
        Image::from_pixels(width, height, pixels).ok_or_else(|| EngineError::invalid("the image is not of the camera's size"))
    }

    fn render_layers(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Layers, EngineError> {
        let image = self.render(camera, options)?;
        Ok(Layers { image, ..self.inner.render_layers(camera, options)? })
    }

    fn render_normals(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Vec<[f32; 3]>, EngineError> {
        self.inner.render_normals(camera, options)
    }

    fn render_deep(&mut self, _camera: &Camera, _options: &RenderOptions, _most_samples: usize) -> Result<DeepImage, EngineError> {
        Err(refused("deep images"))
    }

    fn train_step(&mut self, _view: &View, _step: &StepConfig) -> Result<StepReport, EngineError> {
        Err(EngineError::invalid("this engine takes the gradients of its method's own steps"))
    }

    fn train_channels(&mut self, camera: &Camera, method: &mut dyn ChannelStep, step: &StepConfig) -> Result<StepReport, EngineError> {
        self.inner.train_channels(camera, method, step)
    }

    fn channel_gradients(
        &mut self,
        camera: &Camera,
        method: &mut dyn ChannelStep,
        step: &StepConfig,
    ) -> Result<(StepReport, SparseGradients), EngineError> {
        self.inner.channel_gradients(camera, method, step)
    }

    fn render_channels(
        &mut self,
        camera: &Camera,
        channels: &mut dyn ChannelSource,
        options: &RenderOptions,
    ) -> Result<Vec<f32>, EngineError> {
        self.inner.render_channels(camera, channels, options)
    }

    fn load(&mut self, splats: &Splats, moments: Option<&Moments>) -> Result<(), EngineError> {
        self.inner.load(splats, moments)
    }

    fn save(&mut self) -> Result<(Splats, Moments), EngineError> {
        self.inner.save()
    }

    fn save_array(&mut self, part: SavedPart, array: SplatArray, splats: Range<usize>) -> Result<Vec<f32>, EngineError> {
        self.inner.save_array(part, array, splats)
    }

    fn replace_parameters(&mut self, splats: &Splats) -> Result<(), EngineError> {
        self.inner.replace_parameters(splats)
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
