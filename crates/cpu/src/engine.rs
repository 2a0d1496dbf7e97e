//! [`CpuEngine`]: runs the passes over rayon's threads.

use std::time::{Duration, Instant};

use fearless_simd::Level;
use luxel_core::edit::Contributions;
use luxel_core::{
    Camera, DensifyPlan, DensifyStats, Engine, EngineError, Evaluations, Geometry, Image, Layers, Moments, Pass, RenderOptions, Splats,
    StatsCollection, StepConfig, StepReport, View,
};

use crate::lanes::{LANES, Lanes};
use crate::memory::Buffer;
use crate::passes::adam::Optimizer;
use crate::passes::bin::Bins;
use crate::passes::blend::sort_and_rasterize;
use crate::passes::changes::Changes;
use crate::passes::contribute::contribute;
use crate::passes::densify;
use crate::passes::evaluations::evaluations;
use crate::passes::loss::{LossBuffers, LossSums};
use crate::passes::project::{Footprint, project, resize_for};
use crate::passes::project_backward::Inputs;
use crate::passes::rasterize::{TilePixels, to_alpha, to_image};
use crate::passes::rasterize_backward::{AbsoluteSums, BlockGradient, rasterize_backward};
use crate::passes::samples::{resolve, spread};
use crate::passes::sort::TileList;
use crate::passes::sums::EntryGradient;
use crate::passes::update::{Scratch, backward_and_adam, gradients};
use crate::store::{Layout, Store};
use crate::view::ScreenCamera;

/// The native engine. Its results are the same bits for any number of threads.
pub struct CpuEngine {
    pool: rayon::ThreadPool,
    level: Level,
    parameters: Store,
    first: Store,
    second: Store,
    /// Memory that the next densification builds into: as much as one of the three has, while there are statistics for one.
    spare: Buffer,
    /// 3D filter by block; empty when the scene has none.
    smoothing: Vec<Lanes>,
    stats: DensifyStats,
    frame: Frame,
    /// What the last step still has to change. It waits for the next view, whose projection it makes while the parameters are in the cache.
    pending: Option<Update>,
    timings: [(Pass, Duration); Pass::ALL.len()],
}

/// A step whose gradients by the screen are in [`Frame`], and what they are to be used up with.
struct Update {
    camera: ScreenCamera,
    step: StepConfig,
}

/// Buffers of a step, kept between steps.
#[derive(Default)]
struct Frame {
    footprints: Vec<Footprint>,
    bins: Bins,
    lists: Vec<TileList>,
    pixels: Vec<TilePixels>,
    changes: Vec<Changes>,
    /// With several samples a pixel `pixels` are samples, and these the image's.
    resolved: Vec<TilePixels>,
    loss: LossBuffers,
    /// Gradient by the samples' radiance, where there are several a pixel.
    sample_gradient: Vec<BlockGradient>,
    entries: Vec<Vec<EntryGradient>>,
    scratch: Scratch,
}

/// Pixels of the image, of those that were rasterised and those that their samples were averaged to.
fn shown<'a>(camera: &ScreenCamera, pixels: &'a [TilePixels], resolved: &'a [TilePixels]) -> &'a [TilePixels] {
    if camera.samples == 1 { pixels } else { resolved }
}

impl CpuEngine {
    /// An engine on `threads` threads; 0 takes one per core.
    ///
    /// # Errors
    /// [`EngineError::Device`] if the threads can't be started.
    pub fn new(threads: usize) -> Result<Self, EngineError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|i| format!("luxel-cpu-{i}"))
            .build()
            .map_err(|e| EngineError::Device(format!("cpu: cannot start {threads} threads: {e}; lower --threads")))?;
        let layout = Layout { color_model: luxel_core::ColorModel::Sh { degree: 0 } };
        Ok(Self {
            pool,
            level: Level::new(),
            parameters: Store::zeros(layout, 0),
            first: Store::zeros(layout, 0),
            second: Store::zeros(layout, 0),
            spare: Buffer::zeros(0),
            smoothing: Vec::new(),
            stats: DensifyStats::default(),
            frame: Frame::default(),
            pending: None,
            timings: Pass::ALL.map(|pass| (pass, Duration::ZERO)),
        })
    }

    /// Threads the engine works on.
    pub fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// The instruction set in use, for people.
    pub fn instruction_set(&self) -> String {
        format!("{:?}", self.level).split(['(', ' ', '{']).next().unwrap_or_default().to_lowercase()
    }

    /// Restricts the engine to a lesser instruction set: to test that results do not hang on it, and to measure what it brings.
    ///
    /// # Errors
    /// [`EngineError::Device`] if the processor does not have it; the engine stays as it was.
    pub fn set_instruction_set(&mut self, set: InstructionSet) -> Result<(), EngineError> {
        let level = match set {
            InstructionSet::Best => Some(Level::new()),
            InstructionSet::Avx2 => avx2(),
            InstructionSet::Baseline => Some(Level::baseline()),
        };
        self.level = level.ok_or_else(|| {
            let best = self.instruction_set();
            EngineError::Device(format!(
                "cpu: instruction set avx2 is not to be had, the engine runs on {best}; use the best or the baseline"
            ))
        })?;
        Ok(())
    }

    /// Forward and backward without the update: the seam at which data-parallel training reduces gradients. Gradients in the layout of the
    /// splats; `smoothing` is empty.
    ///
    /// # Errors
    /// As [`Engine::train_step`].
    pub fn gradients(&mut self, view: &View, step: &StepConfig) -> Result<(StepReport, Splats), EngineError> {
        let (camera, report) = self.forward_backward(view, step)?;
        let Self { pool, level, parameters, smoothing, stats, frame, timings, .. } = self;
        let inputs = Inputs::new(parameters, smoothing, (&frame.bins, &frame.entries), &step.loss);
        let stats = (step.stats != StatsCollection::Off).then_some(stats);
        let lanes = pool.install(|| {
            let mut clock = Clock::new(timings);
            let lanes = gradients(*level, &camera, (&inputs, &parameters.lanes), stats);
            clock.lap(Pass::ProjectBackward);
            lanes
        });
        Ok((report, Store { lanes, ..Store::zeros(parameters.layout, parameters.count) }.to_splats()))
    }

    /// Does what the last step has left to do, and projects the splats for the next view, if there is one.
    fn update(&mut self, next: Option<&ScreenCamera>) {
        let Some(Update { camera, step }) = self.pending.take() else { return };
        let Self { pool, level, parameters, first, second, smoothing, stats, frame, timings, .. } = self;
        let Frame { bins, entries, scratch, footprints, .. } = frame;
        resize_for(parameters, footprints);
        let next = next.map(|camera| (camera, footprints.as_mut_slice()));
        let inputs = Inputs::new(parameters, smoothing, (bins, entries), &step.loss);
        pool.install(|| {
            let mut clock = Clock::new(timings);
            let optimizer = Optimizer { parameters, first, second };
            let [backward, adam, project] = backward_and_adam(*level, &camera, &inputs, optimizer, &step, (stats, scratch, next));
            clock.lap_shared(&[(Pass::ProjectBackward, backward), (Pass::Adam, adam), (Pass::Project, project)]);
        });
    }

    /// Projects the splats, with what the last step has still to change.
    fn project(&mut self, camera: &ScreenCamera) {
        if self.pending.is_some() {
            return self.update(Some(camera));
        }
        let Self { pool, level, parameters, smoothing, frame, timings, .. } = self;
        pool.install(|| {
            let mut clock = Clock::new(timings);
            project(*level, camera, parameters, smoothing, &mut frame.footprints);
            clock.lap(Pass::Project);
        });
    }

    /// Passes up to the image.
    fn forward(&mut self, camera: &ScreenCamera) {
        self.project(camera);
        let Self { pool, level, frame, timings, .. } = self;
        pool.install(|| {
            let mut clock = Clock::new(timings);
            frame.bins.fill(camera, &frame.footprints);
            clock.lap(Pass::Bin);
            let (splats, tiles) = ((&frame.bins, frame.footprints.as_slice()), (&mut frame.lists, &mut frame.pixels, &mut frame.changes));
            let [sort, rasterize] = sort_and_rasterize(*level, camera, splats, tiles);
            clock.lap_shared(&[(Pass::Sort, sort), (Pass::Rasterize, rasterize)]);
            if camera.samples > 1 {
                resolve(camera, &frame.pixels, &mut frame.resolved);
                clock.lap(Pass::Rasterize);
            }
        });
    }

    /// What [`Self::forward`] has left.
    fn image(&self, camera: &ScreenCamera) -> Image {
        to_image(shown(camera, &self.frame.pixels, &self.frame.resolved), &camera.shown())
    }

    /// Passes up to the gradients of the tiles' entries.
    fn forward_backward(&mut self, view: &View, step: &StepConfig) -> Result<(ScreenCamera, StepReport), EngineError> {
        let camera = checked_camera(&view.camera, &step.render)?;
        let size_px = camera.shown().size_px;
        if [view.image.width, view.image.height] != size_px {
            return Err(EngineError::Invalid(format!(
                "view {}: image is {} x {}, the camera expects {} x {}",
                view.name, view.image.width, view.image.height, size_px[0], size_px[1]
            )));
        }
        let pixels = size_px[0] * size_px[1];
        if view.image.pixels.len() != pixels {
            return Err(EngineError::Invalid(format!(
                "view {}: image holds {} pixels, its size says {pixels}",
                view.name,
                view.image.pixels.len()
            )));
        }
        if let Some(found) = view.mask.as_ref().map(|mask| mask.weights.len()).filter(|found| *found != pixels) {
            return Err(EngineError::Invalid(format!("view {}: mask holds {found} pixels, the image {pixels}", view.name)));
        }
        if view.mask.as_ref().is_some_and(|mask| mask.total().is_none()) {
            return Err(EngineError::Invalid(format!("view {}: mask: a weight is not a number from 0 to 1", view.name)));
        }
        self.forward(&camera);
        let Self { pool, level, frame, timings, .. } = self;
        let LossSums { l1, l2, ssim, by_knots } = pool.install(|| {
            let mut clock = Clock::new(timings);
            let pixels = shown(&camera, &frame.pixels, &frame.resolved);
            let sums = frame.loss.loss(*level, &camera.shown(), pixels, view, &step.loss);
            let gradient = if camera.samples == 1 {
                &frame.loss.gradient
            } else {
                spread(&camera, &frame.loss.gradient, &mut frame.sample_gradient);
                &frame.sample_gradient
            };
            clock.lap(Pass::Loss);
            let absolute = match step.stats {
                StatsCollection::GradientsAndAbsolute => AbsoluteSums::Collect,
                StatsCollection::Off | StatsCollection::Gradients => AbsoluteSums::Skip,
            };
            let pixels = (frame.pixels.as_slice(), gradient.as_slice());
            rasterize_backward(*level, &camera, (&frame.lists, &frame.changes), pixels, absolute, &mut frame.entries);
            clock.lap(Pass::RasterizeBackward);
            sums
        });
        let loss = step.loss.total(l1, l2, ssim);
        Ok((camera, StepReport { step: step.step, loss, l1, ssim, visible: frame.bins.visible(), by_knots }))
    }
}

/// Instruction sets an engine can be held to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InstructionSet {
    /// The best the processor has.
    Best,
    /// AVX2 with FMA (x86-64-v3), also on a processor that has AVX-512.
    Avx2,
    /// What every processor of the target has (SSE2 on x86-64, NEON on aarch64).
    Baseline,
}

#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
fn avx2() -> Option<Level> {
    Level::new().as_avx2().map(Level::Avx2)
}

#[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
fn avx2() -> Option<Level> {
    None
}

fn checked_camera(camera: &Camera, options: &RenderOptions) -> Result<ScreenCamera, EngineError> {
    if !camera.distortion.is_none() {
        return Err(EngineError::Invalid("camera: has lens distortion; undistort its image first".into()));
    }
    Ok(ScreenCamera::new(camera, options)?)
}

/// Adds the time since the last lap to a pass.
struct Clock<'a> {
    timings: &'a mut [(Pass, Duration); Pass::ALL.len()],
    last: Instant,
}

impl<'a> Clock<'a> {
    fn new(timings: &'a mut [(Pass, Duration); Pass::ALL.len()]) -> Self {
        Self { timings, last: Instant::now() }
    }

    fn lap(&mut self, pass: Pass) {
        self.lap_shared(&[(pass, Duration::from_nanos(1))]);
    }

    /// Shares the time between passes that ran together, in proportion to what each took on its threads.
    fn lap_shared(&mut self, shares: &[(Pass, Duration)]) {
        let now = Instant::now();
        let total: Duration = shares.iter().map(|(_, share)| *share).sum();
        for (pass, share) in shares {
            let part = share.as_secs_f64() / total.as_secs_f64().max(f64::MIN_POSITIVE);
            self.timings[*pass as usize].1 += (now - self.last).mul_f64(part);
        }
        self.last = now;
    }
}

impl Engine for CpuEngine {
    fn load(&mut self, splats: &Splats, moments: Option<&Moments>) -> Result<(), EngineError> {
        splats.validate()?;
        if let Some(moments) = moments {
            moments.validate_for(splats)?;
        }
        // What a last step had to change is gone.
        self.pending = None;
        self.parameters = Store::from_splats(splats);
        let zeros = || Store::zeros(self.parameters.layout, splats.len());
        (self.first, self.second) = match moments {
            None => (zeros(), zeros()),
            Some(moments) => (Store::from_splats(&moments.first), Store::from_splats(&moments.second)),
        };
        self.smoothing = smoothing_lanes(&splats.smoothing);
        self.stats = DensifyStats::zeros(splats.len());
        Ok(())
    }

    fn save(&mut self) -> Result<(Splats, Moments), EngineError> {
        self.update(None);
        let mut splats = self.parameters.to_splats();
        if !self.smoothing.is_empty() {
            splats.smoothing = bytemuck::cast_slice(&self.smoothing)[..self.parameters.count].to_vec();
        }
        let moments = Moments { first: self.first.to_splats(), second: self.second.to_splats() };
        Ok((splats, moments))
    }

    fn render(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Image, EngineError> {
        let camera = checked_camera(camera, options)?;
        self.forward(&camera);
        Ok(self.pool.install(|| self.image(&camera)))
    }

    fn render_layers(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Layers, EngineError> {
        let camera = checked_camera(camera, options)?;
        self.forward(&camera);
        let Self { pool, level, frame, .. } = self;
        Ok(pool.install(|| {
            let image_camera = camera.shown();
            let pixels = shown(&camera, &frame.pixels, &frame.resolved);
            let image = to_image(pixels, &image_camera);
            let alpha = to_alpha(pixels, &image_camera);
            // The same lists, thresholds and all, blended once more with distances for colours.
            let on_nothing = ScreenCamera { background: [0.0; 3], ..camera };
            frame.footprints.iter_mut().for_each(|footprint| footprint.radiance = [footprint.depth, 0.0, 0.0]);
            let (splats, tiles) = ((&frame.bins, frame.footprints.as_slice()), (&mut frame.lists, &mut frame.pixels, &mut frame.changes));
            sort_and_rasterize(*level, &on_nothing, splats, tiles);
            if camera.samples > 1 {
                resolve(&on_nothing, &frame.pixels, &mut frame.resolved);
            }
            let blended = to_image(shown(&camera, &frame.pixels, &frame.resolved), &image_camera);
            let depth = |(pixel, alpha): (&[f32; 3], &f32)| if *alpha > 0.0 { pixel[0] / alpha } else { f32::INFINITY };
            let depth = blended.pixels.iter().zip(&alpha).map(depth).collect();
            Layers { image, alpha, depth }
        }))
    }

    fn contributions(&mut self, camera: &Camera, options: &RenderOptions, mask: &[f32]) -> Result<Contributions, EngineError> {
        let camera = checked_camera(camera, options)?;
        let pixels = camera.shown().size_px.iter().product::<usize>();
        if mask.len() != pixels {
            return Err(EngineError::Invalid(format!("mask holds {} pixels, the camera's image {pixels}", mask.len())));
        }
        self.forward(&camera);
        let Self { pool, level, parameters, frame, .. } = self;
        Ok(pool.install(|| contribute(*level, &camera, (&frame.bins, &frame.lists), mask, parameters.count)))
    }

    fn evaluations(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Option<Evaluations>, EngineError> {
        let camera = checked_camera(camera, options)?;
        self.forward(&camera);
        let Self { pool, level, frame, .. } = self;
        Ok(Some(pool.install(|| evaluations(*level, &camera, &frame.lists))))
    }

    fn train_step(&mut self, view: &View, step: &StepConfig) -> Result<StepReport, EngineError> {
        let (camera, report) = self.forward_backward(view, step)?;
        if step.stats == StatsCollection::Off {
            self.spare.resize(0);
        }
        self.pending = Some(Update { camera, step: *step });
        Ok(report)
    }

    fn finish(&mut self) -> Result<(), EngineError> {
        self.update(None);
        Ok(())
    }

    fn densify_stats(&mut self) -> Result<DensifyStats, EngineError> {
        self.update(None);
        Ok(self.stats.clone())
    }

    fn set_densify_stats(&mut self, stats: &DensifyStats) -> Result<(), EngineError> {
        let count = self.parameters.count;
        if [stats.gradient.len(), stats.abs_gradient.len(), stats.views.len()] != [count; 3] {
            return Err(EngineError::Invalid(format!("statistics of {} splats, the scene has {count}", stats.views.len())));
        }
        self.update(None);
        self.stats = stats.clone();
        Ok(())
    }

    fn geometry(&mut self) -> Result<Geometry, EngineError> {
        self.update(None);
        let at = |row: usize, i: usize| self.parameters.at(row, i);
        let triples = |row: usize| (0..self.parameters.count).map(|i| [0, 1, 2].map(|c| at(row + c, i))).collect();
        Ok(Geometry {
            position: triples(Layout::POSITION),
            log_scale: triples(Layout::LOG_SCALE),
            opacity_logit: (0..self.parameters.count).map(|i| at(Layout::OPACITY, i)).collect(),
        })
    }

    fn densify(&mut self, plan: &DensifyPlan) -> Result<(), EngineError> {
        densify::check(plan, self.parameters.count)?;
        self.update(None);
        let Self { pool, parameters, first, second, spare, smoothing, stats, timings, .. } = self;
        pool.install(|| {
            let mut clock = Clock::new(timings);
            for moments in [first, second] {
                densify::apply_to_moments(moments, parameters, plan, spare);
            }
            densify::apply(parameters, plan, spare);
            if let Some(values) = &plan.smoothing {
                *smoothing = smoothing_lanes(values);
            } else if !smoothing.is_empty() {
                let old: &[f32] = bytemuck::cast_slice(smoothing);
                let kept: Vec<f32> = plan.rows.iter().map(|row| old[row.source as usize]).collect();
                *smoothing = smoothing_lanes(&kept);
            }
            *stats = DensifyStats::zeros(plan.rows.len());
            clock.lap(Pass::Densify);
        });
        Ok(())
    }

    fn len(&self) -> usize {
        self.parameters.count
    }

    fn timings(&self) -> &[(Pass, Duration)] {
        &self.timings
    }
}

/// The 3D filter by blocks.
fn smoothing_lanes(values: &[f32]) -> Vec<Lanes> {
    values
        .chunks(LANES)
        .map(|chunk| {
            let mut lanes = Lanes::ZERO;
            lanes.0[..chunk.len()].copy_from_slice(chunk);
            lanes
        })
        .collect()
}
