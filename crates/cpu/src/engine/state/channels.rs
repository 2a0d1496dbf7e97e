//! The passes of a step of a method that owns channels and loss.
//!
//! In: camera, [`ChannelStep`]. Out: gradients by the screen, from which the update follows as for
//! any step; the gradients by radiance come from the method. Degenerate: a loss that is not finite
//! leaves no gradients.

use luxel_core::engine::{
    ChannelLoss, ChannelRoles, ChannelSource, ChannelStep, MeasuredChannels, SeenSplats, SparseGradients, StatsCollection, StepConfig,
};
use luxel_core::{Pass, StepReport};

use super::{Frame, State, Update};
use crate::engine::clock::Clock;
use crate::passes::bin::ScreenSplats;
use crate::passes::blend::{Blended, ChannelGradient, ChannelPixels, EntrySums, blend_backward, blend_tiles};
use crate::passes::channel_planes::{SeenBuffers, fill_gradient, gather_channels, to_planes};
use crate::passes::project_backward::Inputs;
use crate::passes::rasterize_backward::AbsoluteSums;
use crate::passes::screen_gradients::ByScreen;
use crate::passes::sparse_update::sparse_gradients;
use crate::passes::splat_channels::{FIRST, SplatChannels};
use crate::passes::sums::EntryGradient;
use crate::passes::tile_records::{Recording, TileInputs};
use crate::view::ScreenCamera;

/// The buffers of a step with channels, kept between steps.
#[derive(Default)]
pub(super) struct ChannelFrame {
    seen: SeenBuffers,
    /// `[N, K]`.
    values: Vec<f32>,
    pixels: ChannelPixels,
    /// `[K, H, W]`.
    image: Vec<f32>,
    by_image: Vec<f32>,
    gradient: ChannelGradient,
    pub(super) sums: EntrySums,
    /// `[N, K]`.
    by_values: Vec<f32>,
    /// `[N]`.
    pub(super) by_radiance: Vec<[f32; 3]>,
}

impl ChannelFrame {
    /// Returns the memory of the largest buffers, bytes.
    pub(super) fn bytes(&self) -> usize {
        let numbers = [&self.values, &self.image, &self.by_image, &self.sums.more, &self.by_values].map(Vec::capacity);
        numbers.iter().sum::<usize>() * size_of::<f32>() + self.sums.entries.capacity() * size_of::<EntryGradient>()
    }

    fn seen(&self) -> SeenSplats<'_> {
        SeenSplats { radiance: &self.seen.radiance, visible: &self.seen.visible }
    }
}

impl State {
    /// Blends channels of the scene's splats.
    fn blend_channels(&mut self, camera: &ScreenCamera, source: &mut dyn ChannelSource) {
        self.project(camera);
        let Self { level, parameters, frame, timings, .. } = self;
        let Frame { footprints, bins, records, channels, .. } = frame;
        let (splats, count) = (parameters.count, source.count());
        let mut clock = Clock::new(timings);
        bins.fill(*level, camera, footprints);
        clock.lap(Pass::Bin);
        let on_screen = ScreenSplats { bins, footprints };
        channels.seen.read(on_screen, splats);
        channels.values.resize(splats * count, 0.0);
        source.fill(&SeenSplats { radiance: &channels.seen.radiance, visible: &channels.seen.visible }, &mut channels.values);
        clock.lap(Pass::Color);
        let values = SplatChannels { values: &channels.values, count, background: &camera.background };
        let inputs = TileInputs { level: *level, camera, splats: on_screen, recording: Recording::Changes, channels: Some(&values) };
        blend_tiles(&inputs, &values, records, &mut channels.pixels);
        channels.image.resize(count * camera.size_px[0] * camera.size_px[1], 0.0);
        to_planes(&channels.pixels, camera, count, &mut channels.image);
        clock.lap(Pass::Rasterize);
    }

    /// Renders channels, `[K, H, W]`.
    pub(in crate::engine) fn render_channels(&mut self, camera: &ScreenCamera, source: &mut dyn ChannelSource) -> Vec<f32> {
        self.blend_channels(camera, source);
        self.frame.channels.image.clone()
    }

    /// Runs the passes up to the gradients by the splats on the screen and by their radiance.
    fn channels_forward_backward(
        &mut self,
        camera: &ScreenCamera,
        method: &mut dyn ChannelStep,
        step: &StepConfig,
    ) -> (StepReport, MeasuredChannels) {
        self.blend_channels(camera, method);
        let (count, ChannelRoles { shaping, measured }) = (method.count(), method.roles());
        let Self { level, frame, timings, .. } = self;
        let Frame { footprints, bins, records, channels, .. } = frame;
        let on_screen = ScreenSplats { bins, footprints };
        let measured = if step.stats == StatsCollection::Off || shaping <= FIRST { MeasuredChannels::All } else { measured };
        let mut clock = Clock::new(timings);
        channels.by_image.resize(channels.image.len(), 0.0);
        let ChannelLoss { loss, l1, ssim } = method.compare(&channels.image, &mut channels.by_image);
        let report = StepReport { step: step.step, loss, l1, ssim, visible: bins.visible(), ..StepReport::default() };
        clock.lap(Pass::Loss);
        if !loss.is_finite() {
            return (report, measured);
        }
        fill_gradient(&mut channels.gradient, camera, count, &channels.by_image);
        let values = SplatChannels { values: &channels.values, count, background: &camera.background };
        let inputs = TileInputs { level: *level, camera, splats: on_screen, recording: Recording::Changes, channels: Some(&values) };
        let blended = Blended {
            records,
            tiles: &channels.pixels.tiles,
            gradient: &channels.gradient,
            absolute: AbsoluteSums::Skip,
            roles: ChannelRoles { shaping, measured },
        };
        blend_backward(&inputs, &values, blended, &mut channels.sums);
        channels.by_values.resize(channels.values.len(), 0.0);
        gather_channels(on_screen, &channels.sums, count, &mut channels.by_values);
        clock.lap(Pass::RasterizeBackward);
        channels.by_radiance.clear();
        channels.by_radiance.resize(channels.seen.radiance.len(), [0.0; 3]);
        let mut by_radiance = std::mem::take(&mut channels.by_radiance);
        method.backward(&channels.seen(), &channels.by_values, &mut by_radiance);
        channels.by_radiance = by_radiance;
        clock.lap(Pass::ColorBackward);
        (report, measured)
    }

    /// Runs a step, up to its deferred update.
    pub(in crate::engine) fn train_channels(
        &mut self,
        camera: &ScreenCamera,
        method: &mut dyn ChannelStep,
        step: &StepConfig,
    ) -> StepReport {
        let (report, measured) = self.channels_forward_backward(camera, method, step);
        if step.stats == StatsCollection::Off {
            self.spare.resize(0);
        }
        if report.loss.is_finite() {
            self.pending = Some(Update { camera: camera.clone(), step: *step, channels: Some(measured) });
        }
        report
    }

    /// Computes the gradients of a step, without its update.
    pub(in crate::engine) fn channel_gradients(
        &mut self,
        camera: &ScreenCamera,
        method: &mut dyn ChannelStep,
        step: &StepConfig,
    ) -> (StepReport, SparseGradients) {
        let (report, measured) = self.channels_forward_backward(camera, method, step);
        let Self { level, parameters, smoothing, frame, timings, .. } = self;
        if !report.loss.is_finite() {
            return (report, SparseGradients::none(parameters.layout));
        }
        let ChannelFrame { sums, by_radiance, .. } = &frame.channels;
        let of_entries = ByScreen::Entries(&sums.entries);
        let inputs = Inputs::new(parameters, smoothing, &frame.bins, of_entries, &step.loss).with_radiance(by_radiance, measured);
        let mut clock = Clock::new(timings);
        let gradients = sparse_gradients(*level, camera, &inputs, &parameters.lanes, step.stats, SparseGradients::none(parameters.layout));
        clock.lap(Pass::ProjectBackward);
        (report, gradients)
    }
}
