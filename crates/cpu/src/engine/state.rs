//! [`State`]: the data of an engine, and its passes in their order. It uses the threads of the
//! rayon pool in which it is called.

mod batch;
mod channels;

use std::ops::Range;
use std::time::Duration;

use luxel_core::engine::{
    CameraGradient, CameraGradientChoice, DensifyPlan, DensifyStats, Geometry, MeasuredChannels, MomentFormat, ParameterRows, SavedPart,
    SparseGradients, SplatArray, StatsCollection, StepConfig,
};
use luxel_core::{EngineError, Moments, Pass, PassTime, Splats, StepReport, View};
use luxel_lanes::Level;
use rayon::prelude::*;

use self::channels::ChannelFrame;
use super::clock::{Clock, Timings};
use crate::lanes::{LANES, Lanes};
use crate::memory::Buffer;
use crate::moments::MomentStore;
use crate::passes::adam::Optimizer;
use crate::passes::bin::{Bins, ScreenSplats};
use crate::passes::camera_backward::camera_backward;
use crate::passes::densify;
use crate::passes::gain::apply_gains;
use crate::passes::loss::{LossBuffers, LossSums};
use crate::passes::project::{Footprint, resize_for};
use crate::passes::project_all::project;
use crate::passes::project_backward::Inputs;
use crate::passes::rasterize::TilePixels;
use crate::passes::rasterize_backward::{AbsoluteSums, BlockGradient, RasterizedTiles, rasterize_backward};
use crate::passes::samples::{resolve, spread};
use crate::passes::screen_gradients::{ByScreen, ScreenGradients};
use crate::passes::sort_and_rasterize::sort_and_rasterize;
use crate::passes::tile_records::{Recording, TileInputs, TileRecords};
use crate::passes::update::{NextView, Scratch, UpdateBuffers, backward_and_adam};
use crate::store::Store;
use crate::view::ScreenCamera;

/// A scene in training, with the buffers of its passes.
pub(super) struct State {
    pub(super) level: Level,
    pub(super) parameters: Store,
    moments: MomentStore,
    moment_format: MomentFormat,
    /// Memory into which the next densification builds a store. It is released in steps that
    /// collect no statistics.
    spare: Buffer,
    /// Gradients of earlier steps, whose memory the next ones have.
    spare_gradients: Vec<SparseGradients>,
    /// 3D filter by block; empty if the scene has none.
    smoothing: Vec<Lanes>,
    /// Gains of edits; empty if the scene has none, as in training.
    pub(super) gain: Vec<f32>,
    stats: DensifyStats,
    pub(super) frame: Frame,
    /// The update of the last step, deferred until the next view is known: then the update and the
    /// next projection run together, while the parameters are in the cache.
    pending: Option<Update>,
    pub(super) timings: Timings,
}

/// A deferred update. Its gradients by the screen are in [`Frame`].
struct Update {
    camera: ScreenCamera,
    step: StepConfig,
    /// Channels that statistics are of, if channels were blended; their gradients are then in
    /// [`ChannelFrame`].
    channels: Option<MeasuredChannels>,
}

/// Memory for records of tiles, unless another is set, bytes.
pub(super) const RECORD_BYTES: usize = 1 << 30;
/// Buffers that only steps need are given back by renders if they hold more, bytes.
const IDLE_BYTES: usize = 256 << 20;

/// The buffers of a step, kept between steps.
pub(super) struct Frame {
    pub(super) footprints: Vec<Footprint>,
    pub(super) bins: Bins,
    pub(super) records: TileRecords,
    pub(super) pixels: Vec<TilePixels>,
    /// With supersampling, `pixels` holds the samples, and this the pixels of the image.
    pub(super) resolved: Vec<TilePixels>,
    loss: LossBuffers,
    /// With supersampling, the gradient by the samples' radiance.
    sample_gradient: Vec<BlockGradient>,
    by_screen: ScreenGradients,
    channels: ChannelFrame,
    scratch: Scratch,
}

impl Frame {
    fn new() -> Self {
        Self {
            footprints: Vec::new(),
            bins: Bins::default(),
            records: TileRecords::with_limit(RECORD_BYTES),
            pixels: Vec::new(),
            resolved: Vec::new(),
            loss: LossBuffers::default(),
            sample_gradient: Vec::new(),
            by_screen: ScreenGradients::default(),
            channels: ChannelFrame::default(),
            scratch: Scratch::default(),
        }
    }

    /// Gives the memory back that only steps need, if it is much.
    fn release_idle(&mut self) {
        let gradients = [&self.loss.gradient, &self.sample_gradient].map(|gradient| gradient.capacity() * size_of::<BlockGradient>());
        let by_screen = self.by_screen.capacity_bytes() + self.channels.bytes();
        if self.records.kept_bytes() + by_screen + gradients.iter().sum::<usize>() > IDLE_BYTES {
            self.records.release();
            self.by_screen = ScreenGradients::default();
            self.channels = ChannelFrame::default();
            self.loss = LossBuffers::default();
            self.sample_gradient = Vec::new();
        }
    }
}

/// Returns the pixels of the image: the rasterised ones, or with supersampling their means.
pub(super) fn final_pixels<'a>(camera: &ScreenCamera, pixels: &'a [TilePixels], resolved: &'a [TilePixels]) -> &'a [TilePixels] {
    if camera.samples == 1 { pixels } else { resolved }
}

impl State {
    /// Makes a state without splats.
    pub(super) fn new() -> Self {
        let layout = ParameterRows { color_model: luxel_core::ColorModel::Sh { degree: 0 } };
        let empty = || Store::zeros(layout, 0);
        Self {
            level: Level::best(),
            parameters: empty(),
            moments: MomentStore::zeros(MomentFormat::F32, layout, 0),
            moment_format: MomentFormat::F32,
            spare: Buffer::zeros(0),
            spare_gradients: Vec::new(),
            smoothing: Vec::new(),
            gain: Vec::new(),
            stats: DensifyStats::default(),
            frame: Frame::new(),
            pending: None,
            timings: Pass::ALL.map(|pass| PassTime { pass, time: Duration::ZERO }),
        }
    }

    /// Returns the number of splats.
    pub(super) fn len(&self) -> usize {
        self.parameters.count
    }

    /// Loads a valid scene.
    pub(super) fn load(&mut self, splats: &Splats, moments: Option<&Moments>) {
        // A deferred update of the old scene is dropped.
        self.pending = None;
        self.parameters = Store::from_splats(splats);
        self.moments = match moments {
            None => MomentStore::zeros(self.moment_format, self.parameters.layout, splats.len()),
            Some(moments) => MomentStore::from_moments(self.moment_format, moments),
        };
        self.smoothing = smoothing_lanes(&splats.smoothing);
        self.gain.clone_from(&splats.gain);
        self.stats = DensifyStats::zeros(splats.len());
    }

    /// Sets how the moments of the next scene are held.
    pub(super) fn set_moment_format(&mut self, format: MomentFormat) {
        self.moment_format = format;
    }

    /// Copies the scene.
    pub(super) fn splats(&mut self) -> Splats {
        self.finish();
        let mut splats = Splats { gain: self.gain.clone(), ..self.parameters.to_splats() };
        if !self.smoothing.is_empty() {
            splats.smoothing = bytemuck::cast_slice(&self.smoothing)[..self.parameters.count].to_vec();
        }
        splats
    }

    /// Copies the scene and its moments.
    pub(super) fn save(&mut self) -> (Splats, Moments) {
        (self.splats(), self.moments.to_moments())
    }

    /// Copies an array of some splats.
    pub(super) fn save_array(&mut self, part: SavedPart, array: SplatArray, splats: Range<usize>) -> Vec<f32> {
        self.finish();
        let rows = array.rows(self.parameters.layout.color_model);
        match part {
            SavedPart::Parameters if array == SplatArray::Smoothing => {
                bytemuck::cast_slice::<_, f32>(&self.smoothing).get(splats).unwrap_or_default().to_vec()
            }
            SavedPart::Parameters => self.parameters.rows_of(rows, splats, |value| value),
            SavedPart::FirstMoments => self.moments.rows_of(false, rows, splats),
            SavedPart::SecondMoments => self.moments.rows_of(true, rows, splats),
        }
    }

    /// Replaces the parameters by those of as many splats.
    pub(super) fn replace_parameters(&mut self, splats: &Splats) {
        self.finish();
        self.parameters.fill_from(splats);
        self.smoothing = smoothing_lanes(&splats.smoothing);
        self.gain.clone_from(&splats.gain);
    }

    /// Copies what densification policy looks at.
    pub(super) fn geometry(&mut self) -> Geometry {
        self.finish();
        let at = |row: usize, i: usize| self.parameters.at(row, i);
        let triples = |row: usize| (0..self.parameters.count).map(|i| [0, 1, 2].map(|c| at(row + c, i))).collect();
        Geometry {
            position: triples(ParameterRows::POSITION),
            log_scale: triples(ParameterRows::LOG_SCALE),
            opacity_logit: (0..self.parameters.count).map(|i| at(ParameterRows::OPACITY, i)).collect(),
        }
    }

    /// Checks that all parameters are finite.
    pub(super) fn check_finite(&mut self) -> Result<(), EngineError> {
        self.finish();
        let is_finite = |lanes: &Lanes| lanes.0.iter().all(|v| v.is_finite());
        // Lanes beyond the last splat may hold anything, so the splats themselves decide.
        if self.parameters.lanes.par_iter().all(is_finite) { Ok(()) } else { Ok(self.parameters.to_splats().validate()?) }
    }

    /// Returns the current statistics.
    pub(super) fn stats(&mut self) -> &mut DensifyStats {
        self.finish();
        &mut self.stats
    }

    /// Applies a deferred update.
    pub(super) fn finish(&mut self) {
        if let Some(update) = self.pending.take() {
            self.update(&update, None);
        }
    }

    /// Applies a step's gradients, and projects the splats for the next view, if it is known.
    fn update(&mut self, Update { camera, step, channels }: &Update, next: Option<&ScreenCamera>) {
        let Self { level, parameters, moments, smoothing, stats, frame, timings, .. } = self;
        let Frame { bins, by_screen, scratch, footprints, channels: of_channels, .. } = frame;
        let mut clock = Clock::new(timings);
        resize_for(parameters, footprints);
        let next = next.map(|camera| NextView { camera, footprints });
        let inputs = match channels {
            None => Inputs::new(parameters, smoothing, bins, by_screen.by_screen(), &step.loss),
            Some(measured) => {
                let ChannelFrame { sums, by_radiance, .. } = of_channels;
                let of_entries = ByScreen::Entries(&sums.entries);
                Inputs::new(parameters, smoothing, bins, of_entries, &step.loss).with_radiance(by_radiance, *measured)
            }
        };
        let optimizer = Optimizer { parameters, moments };
        let [backward, adam, project] = backward_and_adam(*level, camera, &inputs, optimizer, step, UpdateBuffers { stats, scratch, next });
        clock.lap_shared(&[
            PassTime { pass: Pass::ProjectBackward, time: backward },
            PassTime { pass: Pass::Adam, time: adam },
            PassTime { pass: Pass::Project, time: project },
        ]);
    }

    /// Projects the splats, together with a deferred update if there is one.
    fn project(&mut self, camera: &ScreenCamera) {
        if let Some(update) = self.pending.take() {
            return self.update(&update, Some(camera));
        }
        let mut clock = Clock::new(&mut self.timings);
        project(self.level, camera, &self.parameters, &self.smoothing, &mut self.frame.footprints);
        clock.lap(Pass::Project);
    }

    /// Sets the memory for records of tiles, bytes.
    pub(super) fn set_record_bytes(&mut self, bytes: usize) {
        self.frame.records.set_limit(bytes);
    }

    /// Runs the passes up to the image, of the camera's light.
    pub(super) fn forward(&mut self, camera: &ScreenCamera, recording: Recording) {
        self.project(camera);
        apply_gains(&mut self.frame.footprints, &self.gain);
        if recording == Recording::Nothing {
            self.frame.release_idle();
        }
        let Self { level, frame, timings, .. } = self;
        let mut clock = Clock::new(timings);
        frame.bins.fill(*level, camera, &frame.footprints);
        clock.lap(Pass::Bin);
        let splats = ScreenSplats { bins: &frame.bins, footprints: &frame.footprints };
        let inputs = TileInputs { level: *level, camera, splats, recording, channels: None };
        let [sort, rasterize] = sort_and_rasterize(&inputs, &mut frame.records, &mut frame.pixels);
        clock.lap_shared(&[PassTime { pass: Pass::Sort, time: sort }, PassTime { pass: Pass::Rasterize, time: rasterize }]);
        if camera.samples > 1 {
            resolve(camera, &frame.pixels, &mut frame.resolved);
            clock.lap(Pass::Rasterize);
        }
    }

    /// Returns what records of tiles are made from, after a forward pass.
    pub(super) fn tile_inputs<'a>(&'a self, camera: &'a ScreenCamera, recording: Recording) -> TileInputs<'a> {
        let splats = ScreenSplats { bins: &self.frame.bins, footprints: &self.frame.footprints };
        TileInputs { level: self.level, camera, splats, recording, channels: None }
    }

    /// Runs the passes up to the gradients of the tiles' entries. The view has the size of the
    /// image.
    fn forward_backward(&mut self, camera: &ScreenCamera, view: &View, step: &StepConfig) -> StepReport {
        self.forward(camera, Recording::Changes);
        let Self { level, frame, timings, .. } = self;
        let mut clock = Clock::new(timings);
        let pixels = final_pixels(camera, &frame.pixels, &frame.resolved);
        let LossSums { l1, l2, ssim, by_knots, by_vignetting } =
            frame.loss.loss(*level, &camera.without_supersampling(), pixels, view, &step.loss);
        let gradient = if camera.samples == 1 {
            &frame.loss.gradient
        } else {
            spread(camera, &frame.loss.gradient, &mut frame.sample_gradient);
            &frame.sample_gradient
        };
        clock.lap(Pass::Loss);
        let absolute = match step.stats {
            StatsCollection::GradientsAndAbsolute => AbsoluteSums::Collect,
            StatsCollection::Off | StatsCollection::Gradients => AbsoluteSums::Skip,
        };
        let splats = ScreenSplats { bins: &frame.bins, footprints: &frame.footprints };
        let inputs = TileInputs { level: *level, camera, splats, recording: Recording::Changes, channels: None };
        let tiles = RasterizedTiles { records: &frame.records, pixels: &frame.pixels };
        rasterize_backward(&inputs, tiles, gradient, absolute, &mut frame.by_screen);
        clock.lap(Pass::RasterizeBackward);
        let loss = step.loss.total(l1, l2, ssim);
        StepReport { step: step.step, loss, l1, ssim, visible: frame.bins.visible(), by_knots, camera: None, by_vignetting }
    }

    /// Runs a training step, up to its deferred update. The view has the size of the image.
    pub(super) fn train_step(&mut self, camera: &ScreenCamera, view: &View, step: &StepConfig) -> StepReport {
        let mut report = self.forward_backward(camera, view, step);
        if step.camera_gradient == CameraGradientChoice::Compute {
            report.camera = Some(self.camera_backward(camera, view, step));
        }
        if step.stats == StatsCollection::Off {
            self.spare.resize(0);
        }
        self.pending = Some(Update { camera: camera.clone(), step: *step, channels: None });
        report
    }

    /// Computes the gradient by the camera from the gradients of the tiles' entries.
    fn camera_backward(&mut self, camera: &ScreenCamera, view: &View, step: &StepConfig) -> CameraGradient {
        let Self { level, parameters, smoothing, frame, timings, .. } = self;
        let inputs = Inputs::new(parameters, smoothing, &frame.bins, frame.by_screen.by_screen(), &step.loss);
        let mut clock = Clock::new(timings);
        let sums = camera_backward(*level, camera, &inputs, &parameters.lanes);
        clock.lap(Pass::ProjectBackward);
        sums.gradient(&view.camera, step.render.raster.samples)
    }

    /// Computes a step's loss and its gradient by the camera, without an update. The view has the
    /// size of the image.
    pub(super) fn camera_gradient(&mut self, camera: &ScreenCamera, view: &View, step: &StepConfig) -> StepReport {
        let report = self.forward_backward(camera, view, step);
        StepReport { camera: Some(self.camera_backward(camera, view, step)), ..report }
    }

    /// Rebuilds the scene from a plan.
    pub(super) fn densify(&mut self, plan: &DensifyPlan) -> Result<(), EngineError> {
        plan.check(self.parameters.count)?;
        self.finish();
        let Self { parameters, moments, spare, smoothing, gain, stats, timings, .. } = self;
        let mut clock = Clock::new(timings);
        moments.densify(parameters, plan, spare);
        densify::apply(parameters, plan, spare);
        let of_sources = |old: &[f32]| plan.rows.iter().filter_map(|row| old.get(row.source as usize)).copied().collect::<Vec<_>>();
        *gain = of_sources(gain);
        *smoothing = smoothing_lanes(&plan.smoothing.clone().unwrap_or_else(|| of_sources(bytemuck::cast_slice(smoothing))));
        *stats = DensifyStats::zeros(plan.rows.len());
        clock.lap(Pass::Densify);
        Ok(())
    }
}

/// Converts the 3D filter to blocks.
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
