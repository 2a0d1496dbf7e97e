//! [`CpuEngine`]: checks its arguments, and runs the passes on rayon's threads.
//!
//! In and out: see [`Engine`]. Degenerate: invalid splats, views and plans are errors, and leave
//! the engine unchanged.

mod blended;
mod clock;
mod differentiable;
mod lights;
mod projected;
mod screens;
mod spare;
mod state;

use std::ops::Range;
use std::sync::Arc;

use luxel_core::edit::Contributions;
use luxel_core::engine::{
    ChannelSource, ChannelStep, DeepImage, DensifyPlan, DensifyStats, Differentiable, Evaluations, Geometry, MomentFormat, SavedPart,
    SparseGradients, SplatArray, StepConfig, SurfaceImage, check_channels, check_range, tile_memory,
};
use luxel_core::{
    Camera, ColorModel, Engine, EngineError, Image, Layers, Moments, PassTime, Remedy, RenderOptions, Splats, StepReport, View,
};
use luxel_lanes::Level;

use self::screens::SpareBuffers;
use self::state::{RECORD_BYTES, State};
use crate::rays::Lenses;
use crate::store::StoreShape;
use crate::view::ScreenCamera;

/// The CPU engine. Its results are the same bits for any number of threads.
pub struct CpuEngine {
    pool: Arc<rayon::ThreadPool>,
    state: State,
    lenses: Lenses,
    spare: Arc<SpareBuffers>,
    /// Memory for the records of tiles, bytes.
    record_bytes: usize,
}

impl CpuEngine {
    /// Makes an engine on `threads` threads; 0 means one per core.
    ///
    /// # Errors
    /// [`EngineError::Device`] if the threads can't be started.
    pub fn new(threads: usize) -> Result<Self, EngineError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|i| format!("luxel-cpu-{i}"))
            .spawn_handler(luxel_lanes::start_thread)
            .build()
            .map_err(|e| EngineError::device(format!("cpu: cannot start {threads} threads: {e}")).with_remedy(Remedy::lower("threads")))?;
        Ok(Self { pool: Arc::new(pool), state: State::new(), lenses: Lenses::default(), spare: Arc::default(), record_bytes: RECORD_BYTES })
    }

    /// Returns the number of threads.
    pub fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// Returns the name of the instruction set in use, for display.
    pub fn instruction_set(&self) -> String {
        self.state.level.name()
    }

    /// Restricts the engine to a smaller instruction set, to test that results do not depend on it
    /// and to measure what it gains.
    ///
    /// # Errors
    /// [`EngineError::Device`] if the processor does not have it; the engine is then unchanged.
    pub fn set_instruction_set(&mut self, set: InstructionSet) -> Result<(), EngineError> {
        let level = match set {
            InstructionSet::Best => Some(Level::best()),
            InstructionSet::Avx2 => Level::avx2(),
            InstructionSet::Baseline => Some(Level::baseline()),
        };
        self.state.level = level.ok_or_else(|| {
            let best = self.instruction_set();
            EngineError::device(format!("cpu: the processor has no instruction set avx2, the engine runs on {best}"))
                .with_remedy(Remedy::set("instruction_set", "best").or(Remedy::set("instruction_set", "baseline")))
        })?;
        Ok(())
    }

    /// Sets how much a step may keep about its tiles from the forward to the backward pass, bytes;
    /// 1 GiB unless set. What does not fit is computed twice, with the same bits. Of gradients a
    /// step keeps half as much, or makes them band by band.
    pub fn set_tile_memory(&mut self, bytes: usize) {
        self.record_bytes = bytes;
        self.state.set_record_bytes(bytes);
    }

    /// Runs the forward and backward passes without the update, and returns the gradients in the
    /// layout of the splats; `smoothing` is empty. The step's statistics are added to the scene's.
    /// [`Engine::view_gradients`] leaves out the splats that the view does not show.
    ///
    /// # Errors
    /// The errors of [`Engine::train_step`].
    pub fn gradients(&mut self, view: &View, step: &StepConfig) -> Result<(StepReport, Splats), EngineError> {
        self.state.check_trainable()?;
        let camera = checked_view(view, step, &mut self.lenses)?;
        Ok(self.pool.install(|| self.state.gradients(&camera, view, step)))
    }
}

/// An instruction set that an engine can be restricted to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InstructionSet {
    /// The best that the processor has.
    Best,
    /// AVX2 with FMA (x86-64-v3), even if the processor has AVX-512.
    Avx2,
    /// The set that every processor of the target has (SSE2 on x86-64, NEON on aarch64).
    Baseline,
}

/// Bytes of a sample in the tiles, and of a pixel in the image with its layers.
const SAMPLE_BYTES: u64 = 16;
const PIXEL_BYTES: u64 = 24;
/// Bytes of a sample's ray, with its share of the cones.
const RAY_BYTES: u64 = 14;
/// Images that take no more are not worth the question.
const SMALL_BYTES: u64 = 64 << 20;

/// Asks the system for the memory of an image at once, and gives it back: an allocation that fails
/// within a pass would end the process.
fn check_room(camera: &Camera, options: &RenderOptions) -> Result<(), EngineError> {
    let [width, height] = camera.size_px;
    let samples = u64::from(options.raster.samples).pow(2);
    let sample_bytes = SAMPLE_BYTES + if camera.projection.is_pinhole() { 0 } else { RAY_BYTES };
    let bytes = (u64::from(width) * u64::from(height)).saturating_mul(samples * sample_bytes + PIXEL_BYTES);
    let has_room = || usize::try_from(bytes).is_ok_and(|bytes| Vec::<u8>::new().try_reserve_exact(bytes).is_ok());
    if bytes <= SMALL_BYTES || has_room() {
        return Ok(());
    }
    let message = format!("cpu: an image of {width} x {height} pixels takes {bytes} bytes of memory, which the system refuses");
    Err(EngineError::device(message).with_remedy(Remedy::advice("render a smaller image")))
}

/// Returns the camera for the passes, after checking it.
fn checked_camera(camera: &Camera, options: &RenderOptions, lenses: &mut Lenses) -> Result<ScreenCamera, EngineError> {
    if !camera.distortion.is_none() {
        return Err(EngineError::invalid("camera: has lens distortion; undistort its image first"));
    }
    check_room(camera, options)?;
    Ok(ScreenCamera::new(camera, options, lenses)?)
}

/// Returns the camera of a view, after checking that image and mask have its size.
fn checked_view(view: &View, step: &StepConfig, lenses: &mut Lenses) -> Result<ScreenCamera, EngineError> {
    view.validate()?;
    Ok(ScreenCamera { dropout: step.dropout, ..checked_camera(&view.camera, &step.render, lenses)? })
}

/// Returns the camera of a method's step or image, after checking both.
fn channel_camera(
    camera: &Camera,
    source: &dyn ChannelSource,
    options: &RenderOptions,
    lenses: &mut Lenses,
) -> Result<ScreenCamera, EngineError> {
    check_channels(source, &options.raster.cutoffs)?;
    if !camera.projection.is_pinhole() || options.raster.samples > 1 {
        let message = format!(
            "channels: expected a pinhole camera and 1 sample a pixel, found a camera of projection {} and {} samples a side",
            camera.projection.name(),
            options.raster.samples
        );
        return Err(EngineError::invalid(message));
    }
    checked_camera(camera, options, lenses)
}

impl Engine for CpuEngine {
    fn load(&mut self, splats: &Splats, moments: Option<&Moments>) -> Result<(), EngineError> {
        splats.validate()?;
        if let Some(moments) = moments {
            moments.validate_for(splats)?;
        }
        self.state.load(splats, moments);
        Ok(())
    }

    fn save(&mut self) -> Result<(Splats, Moments), EngineError> {
        Ok(self.pool.install(|| self.state.save()))
    }

    fn save_array(&mut self, part: SavedPart, array: SplatArray, splats: Range<usize>) -> Result<Vec<f32>, EngineError> {
        check_range(&splats, self.len())?;
        Ok(self.pool.install(|| self.state.save_array(part, array, splats)))
    }

    fn replace_parameters(&mut self, splats: &Splats) -> Result<(), EngineError> {
        splats.validate()?;
        let (found, expected) = ((splats.len(), splats.color_model), (self.len(), self.state.parameters.layout.color_model));
        if found != expected {
            let of = |(count, model): (usize, ColorModel)| format!("{count} {} splats", model.name());
            return Err(EngineError::invalid(format!("parameters are of {}, the scene has {}", of(found), of(expected))));
        }
        self.pool.install(|| self.state.replace_parameters(splats));
        Ok(())
    }

    fn render(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Image, EngineError> {
        let camera = checked_camera(camera, options, &mut self.lenses)?;
        Ok(self.pool.install(|| self.state.render(&camera)))
    }

    fn render_layers(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Layers, EngineError> {
        let camera = checked_camera(camera, options, &mut self.lenses)?;
        Ok(self.pool.install(|| self.state.render_layers(&camera)))
    }

    fn render_normals(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Vec<[f32; 3]>, EngineError> {
        let camera = checked_camera(camera, options, &mut self.lenses)?;
        Ok(self.pool.install(|| self.state.render_normals(&camera)))
    }

    fn render_deep(&mut self, camera: &Camera, options: &RenderOptions, most_samples: usize) -> Result<DeepImage, EngineError> {
        let camera = checked_camera(camera, options, &mut self.lenses)?;
        self.pool.install(|| self.state.render_deep(&camera, most_samples))
    }

    fn render_surface(&mut self, camera: &Camera, options: &RenderOptions) -> Result<SurfaceImage, EngineError> {
        let camera = checked_camera(camera, options, &mut self.lenses)?;
        self.pool.install(|| self.state.render_surface(&camera))
    }

    fn contributions(&mut self, camera: &Camera, options: &RenderOptions, mask: &[f32]) -> Result<Contributions, EngineError> {
        let camera = checked_camera(camera, options, &mut self.lenses)?;
        let pixels = camera.without_supersampling().size_px.iter().product::<usize>();
        if mask.len() != pixels {
            return Err(EngineError::invalid(format!("mask holds {} pixels, the camera's image {pixels}", mask.len())));
        }
        Ok(self.pool.install(|| self.state.contributions(&camera, mask)))
    }

    fn evaluations(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Option<Evaluations>, EngineError> {
        let camera = checked_camera(camera, options, &mut self.lenses)?;
        Ok(Some(self.pool.install(|| self.state.evaluations(&camera))))
    }

    fn train_step(&mut self, view: &View, step: &StepConfig) -> Result<StepReport, EngineError> {
        self.state.check_trainable()?;
        let camera = checked_view(view, step, &mut self.lenses)?;
        Ok(self.pool.install(|| self.state.train_step(&camera, view, step)))
    }

    fn train_channels(&mut self, camera: &Camera, method: &mut dyn ChannelStep, step: &StepConfig) -> Result<StepReport, EngineError> {
        self.state.check_trainable()?;
        let camera = channel_camera(camera, method, &step.render, &mut self.lenses)?;
        let camera = ScreenCamera { dropout: step.dropout, ..camera };
        Ok(self.pool.install(|| self.state.train_channels(&camera, method, step)))
    }

    fn channel_gradients(
        &mut self,
        camera: &Camera,
        method: &mut dyn ChannelStep,
        step: &StepConfig,
    ) -> Result<(StepReport, SparseGradients), EngineError> {
        self.state.check_trainable()?;
        let camera = channel_camera(camera, method, &step.render, &mut self.lenses)?;
        let camera = ScreenCamera { dropout: step.dropout, ..camera };
        Ok(self.pool.install(|| self.state.channel_gradients(&camera, method, step)))
    }

    fn render_channels(
        &mut self,
        camera: &Camera,
        channels: &mut dyn ChannelSource,
        options: &RenderOptions,
    ) -> Result<Vec<f32>, EngineError> {
        let camera = channel_camera(camera, channels, options, &mut self.lenses)?;
        Ok(self.pool.install(|| self.state.render_channels(&camera, channels)))
    }

    fn camera_gradient(&mut self, view: &View, step: &StepConfig) -> Result<StepReport, EngineError> {
        self.state.check_trainable()?;
        let camera = checked_view(view, step, &mut self.lenses)?;
        Ok(self.pool.install(|| self.state.camera_gradient(&camera, view, step)))
    }

    fn view_gradients(&mut self, view: &View, step: &StepConfig) -> Result<(StepReport, SparseGradients), EngineError> {
        self.state.check_trainable()?;
        let camera = checked_view(view, step, &mut self.lenses)?;
        Ok(self.pool.install(|| self.state.view_gradients(&camera, view, step)))
    }

    fn reuse_gradients(&mut self, gradients: SparseGradients) {
        self.state.reuse_gradients(gradients);
    }

    fn apply_gradients(&mut self, gradients: &SparseGradients, step: &StepConfig) -> Result<(), EngineError> {
        let StoreShape { layout, count } = self.state.shape();
        gradients.check(layout, count)?;
        self.pool.install(|| self.state.apply_gradients(gradients, step));
        Ok(())
    }

    fn splats(&mut self) -> Result<Splats, EngineError> {
        Ok(self.pool.install(|| self.state.splats()))
    }

    fn set_moment_format(&mut self, format: MomentFormat) -> Result<(), EngineError> {
        self.state.set_moment_format(format);
        Ok(())
    }

    fn differentiable(&self) -> Option<&dyn Differentiable> {
        Some(self)
    }

    fn limit_images(&mut self, bytes: u64) {
        self.set_tile_memory(self.record_bytes.min(usize::try_from(tile_memory(bytes)).unwrap_or(usize::MAX)));
    }

    fn check_finite(&mut self) -> Result<(), EngineError> {
        self.pool.install(|| self.state.check_finite())
    }

    fn finish(&mut self) -> Result<(), EngineError> {
        self.pool.install(|| self.state.finish());
        Ok(())
    }

    fn densify_stats(&mut self) -> Result<DensifyStats, EngineError> {
        Ok(self.pool.install(|| self.state.stats().clone()))
    }

    fn set_densify_stats(&mut self, stats: &DensifyStats) -> Result<(), EngineError> {
        stats.check(self.len())?;
        self.pool.install(|| self.state.stats().clone_from(stats));
        Ok(())
    }

    fn geometry(&mut self) -> Result<Geometry, EngineError> {
        Ok(self.pool.install(|| self.state.geometry()))
    }

    fn densify(&mut self, plan: &DensifyPlan) -> Result<(), EngineError> {
        self.pool.install(|| self.state.densify(plan))
    }

    fn len(&self) -> usize {
        self.state.len()
    }

    fn timings(&self) -> &[PassTime] {
        &self.state.timings
    }
}
