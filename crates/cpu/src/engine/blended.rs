//! [`Blended`]: images of splats, with what the backward pass needs.

use std::sync::Arc;

use fearless_simd::Simd;
use luxel_core::engine::{
    AbsoluteMeans, BlendGradient, BlendedPixels, BlendedSplats, ChannelRoles, Channels, MeasuredChannels, PixelGradient, check_len,
};
use luxel_core::{EngineError, Real, each};
use luxel_lanes::Level;
use rayon::prelude::*;

use super::screens::{BlendBuffers, GradientBuffers, ScreenView, Screens};
use crate::lanes::{LANES, Lanes, V, with_simd};
use crate::passes::bin::ScreenSplats;
use crate::passes::blend::{self, EntrySums, blend_backward, blend_tiles, to_channels};
use crate::passes::ellipse_backward::{EllipseGradient, moments_backward};
use crate::passes::more_channels_backward::padded;
use crate::passes::project::SQRT_HALF_LOG2_E;
use crate::passes::project_backward::BlockSums;
use crate::passes::rasterize_backward::AbsoluteSums;
use crate::passes::splat_channels::{FIRST, SplatChannels};
use crate::passes::tile_records::{Recording, TileInputs};
use crate::prefetch::fetch;
use crate::view::ScreenCamera;

/// Blocks of splats whose sums are gathered together.
const CHUNK: usize = 8;

/// Buffers with larger records are freed, bytes.
const IDLE_BYTES: usize = 256 << 20;

/// Images of splats.
pub(super) struct Blended {
    screens: Arc<Screens>,
    channels: Vec<f32>,
    count: usize,
    /// `[C, K]`, or empty.
    background: Vec<f32>,
    views: Vec<BlendBuffers>,
}

impl Drop for Blended {
    fn drop(&mut self) {
        self.screens.shared.spare.numbers.give_back(std::mem::take(&mut self.channels));
        for mut buffers in self.views.drain(..) {
            if buffers.records.kept_bytes() <= IDLE_BYTES {
                self.screens.shared.spare.blends.give_back(buffers);
            }
        }
    }
}

impl Blended {
    /// Blends valid channels.
    pub(super) fn new(screens: Arc<Screens>, channels: &Channels<'_>) -> (BlendedPixels, Self) {
        let (views, [width, height]) = (screens.views.len(), screens.size_px);
        let image = width * height;
        let numbers = &screens.shared.spare.numbers;
        let mut pixels = BlendedPixels { channels: numbers.take(views * image * channels.count), alpha: numbers.take(views * image) };
        let mut copied: Vec<f32> = numbers.take(channels.values.len());
        copied.copy_from_slice(channels.values);
        let mut blended = Self {
            channels: copied,
            count: channels.count,
            background: channels.background.unwrap_or_default().to_vec(),
            views: Vec::new(),
            screens,
        };
        let outs = pixels.channels.chunks_mut(image * channels.count).zip(pixels.alpha.chunks_mut(image));
        for (n, (out, alpha)) in outs.enumerate() {
            let shared = &blended.screens.shared;
            let mut buffers = shared.spare.blends.take();
            buffers.records.limit(shared.record_bytes / views);
            let (channels, view) = (blended.channels_of(n), &blended.screens.views[n]);
            let camera = ScreenCamera { background: channels.first_background(), ..view.camera.clone() };
            let inputs = tile_inputs(&blended.screens, view, &camera, &channels);
            blend_tiles(&inputs, &channels, &mut buffers.records, &mut buffers.pixels);
            to_channels(&buffers.pixels, &camera, channels.count, out, alpha);
            blended.views.push(buffers);
        }
        (pixels, blended)
    }

    /// Returns the channels towards a camera.
    fn channels_of(&self, camera: usize) -> SplatChannels<'_> {
        let len = self.screens.splats.count * self.count;
        let is_shared = self.channels.len() == len;
        SplatChannels {
            values: if is_shared { &self.channels } else { &self.channels[camera * len..][..len] },
            count: self.count,
            background: self.background.get(camera * self.count..(camera + 1) * self.count).unwrap_or_default(),
        }
    }

    /// Differentiates all images.
    fn differentiate(&self, gradient: &PixelGradient<'_>) -> BlendGradient {
        let (screens, count) = (&self.screens, self.screens.splats.count);
        let (total, image) = (count * self.views.len(), screens.size_px.iter().product::<usize>());
        let absolute = match gradient.absolute {
            AbsoluteMeans::Skip => AbsoluteSums::Skip,
            AbsoluteMeans::Collect => AbsoluteSums::Collect,
        };
        let numbers = &screens.shared.spare.numbers;
        let mut out = BlendGradient {
            mean_px: numbers.take(total),
            covariance_px2: numbers.take(total),
            opacity: numbers.take(total),
            channels: numbers.take(self.channels.len()),
            background: Vec::new(),
            absolute_mean_px: numbers.take(total),
        };
        let mut buffers = screens.shared.spare.gradients.take();
        let GradientBuffers { pixels, entries } = &mut buffers;
        for (n, (view, BlendBuffers { records, pixels: blended })) in screens.views.iter().zip(&self.views).enumerate() {
            let channels = self.channels_of(n);
            let camera = ScreenCamera { background: channels.first_background(), ..view.camera.clone() };
            let by_channels = &gradient.channels[n * image * self.count..][..image * self.count];
            pixels.fill(&camera, self.count, by_channels, gradient.alpha.map(|alpha| &alpha[n * image..][..image]));
            if !self.background.is_empty() {
                out.background.extend(pixels.by_background(&camera, &blended.tiles, self.count));
            }
            let inputs = tile_inputs(screens, view, &camera, &channels);
            let roles = ChannelRoles { shaping: self.count, measured: MeasuredChannels::All };
            let blended = blend::Blended { records, tiles: &blended.tiles, gradient: pixels, absolute, roles };
            blend_backward(&inputs, &channels, blended, entries);
            self.gather(view, n, entries, absolute == AbsoluteSums::Collect, &mut out);
        }
        screens.shared.spare.gradients.give_back(buffers);
        if absolute == AbsoluteSums::Skip {
            numbers.give_back(std::mem::take(&mut out.absolute_mean_px).into_flattened());
        }
        out
    }

    /// Gathers the sums of entries by splat.
    fn gather(&self, view: &ScreenView, camera: usize, entries: &EntrySums, collects_absolute: bool, out: &mut BlendGradient) {
        let count = self.screens.splats.count;
        let range = camera * count..(camera + 1) * count;
        let numbers = count * self.count;
        // Channels that cameras share have sums over them; every other number is written once.
        let is_shared = out.channels.len() == numbers;
        let is_first = !is_shared || camera == 0;
        let channels = if is_shared { &mut out.channels[..] } else { &mut out.channels[camera * numbers..][..numbers] };
        let splats = CHUNK * LANES;
        let outs = (
            out.mean_px[range.clone()].par_chunks_mut(splats),
            out.covariance_px2[range.clone()].par_chunks_mut(splats),
            out.opacity[range.clone()].par_chunks_mut(splats),
            out.absolute_mean_px[range].par_chunks_mut(splats),
            channels.par_chunks_mut(splats * self.count),
        );
        let gather = Gather { level: self.screens.shared.level, splats: view.splats(), entries, count: self.count };
        let chunks = outs.into_par_iter().enumerate().with_min_len(2);
        chunks.for_each(|(chunk, (mean_px, covariance_px2, opacity, absolute_mean_px, channels))| {
            mean_px.fill([0.0; 2]);
            covariance_px2.fill([0.0; 3]);
            opacity.fill(0.0);
            if collects_absolute {
                absolute_mean_px.fill([0.0; 2]);
            }
            if is_first {
                channels.fill(0.0);
            }
            let absolute_mean_px = collects_absolute.then_some(absolute_mean_px);
            gather.chunk(chunk * splats, ChunkGradient { mean_px, covariance_px2, opacity, absolute_mean_px, channels });
        });
    }
}

/// The gradients of a chunk of splats.
struct ChunkGradient<'a> {
    mean_px: &'a mut [[f32; 2]],
    covariance_px2: &'a mut [[f32; 3]],
    opacity: &'a mut [f32],
    /// If it is wanted.
    absolute_mean_px: Option<&'a mut [[f32; 2]]>,
    /// `[splats, K]`, to which gradients are added.
    channels: &'a mut [f32],
}

/// The inputs of gathering.
struct Gather<'a> {
    level: Level,
    splats: ScreenSplats<'a>,
    entries: &'a EntrySums,
    /// Channels of a splat.
    count: usize,
}

impl Gather<'_> {
    /// Gathers the splats of a chunk from `start` on.
    fn chunk(&self, start: usize, mut out: ChunkGradient<'_>) {
        let bins = self.splats.bins;
        let end = start + out.opacity.len();
        let blocks = || (start..end).step_by(LANES).map(|first| (first, LANES.min(end - first)));
        fetch(&self.splats.footprints[start..end]);
        // Gathered for the whole chunk at once: these loads come from scattered places, and do not
        // wait for arithmetic in between.
        let mut sums = [const { BlockSums::ZERO }; CHUNK];
        with_simd!(self.level, simd => {
            for (sums, (first, len)) in sums.iter_mut().zip(blocks()) {
                sums.gather_entries(simd, bins, &self.entries.entries, first..first + len);
            }
        });
        for (sums, (first, _)) in sums.iter().zip(blocks()).filter(|(sums, _)| sums.is_visible()) {
            with_simd!(self.level, simd => {
                let footprints = &self.splats.footprints[first..first + LANES];
                let fields = V::transpose(each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15] lane => {
                    V::load(simd, bytemuck::cast_ref(&footprints[lane]))
                }));
                let gradient = block_gradient(simd, &fields, &sums.by_field(simd));
                self.store(&sums.visible, &gradient, first - start, &mut out);
            });
        }
        self.add_more(start, &mut out);
    }

    /// Stores the gradients of a block's visible splats, of which the first is number `first` of
    /// the chunk.
    fn store(&self, visible: &[bool; LANES], gradient: &[Lanes; 11], first: usize, out: &mut ChunkGradient<'_>) {
        for (lane, i) in (first..out.opacity.len()).enumerate().take(LANES).filter(|(lane, _)| visible[*lane]) {
            let at = |row: usize| gradient[row].0[lane];
            out.mean_px[i] = [at(0), at(1)];
            out.covariance_px2[i] = [at(2), at(3), at(4)];
            out.opacity[i] = at(5);
            if let Some(absolute) = &mut out.absolute_mean_px {
                absolute[i] = [at(6), at(7)];
            }
            for (c, channel) in out.channels[i * self.count..][..self.count.min(FIRST)].iter_mut().enumerate() {
                *channel += at(8 + c);
            }
        }
    }

    /// Adds the gradients by channels beyond the first three of the splats from `start` on.
    fn add_more(&self, start: usize, out: &mut ChunkGradient<'_>) {
        let more = self.count.saturating_sub(FIRST);
        if more == 0 {
            return;
        }
        let (len, block) = (out.opacity.len(), LANES * self.count);
        for (n, channels) in out.channels.chunks_mut(block).enumerate() {
            let first = n * LANES;
            let entries = self.splats.bins.entries(start + first, LANES.min(len - first));
            for (entries, channels) in entries.zip(channels.chunks_mut(self.count)) {
                for entry in entries {
                    let parts = &self.entries.more[*entry as usize * padded(more)..];
                    channels[FIRST..].iter_mut().zip(parts).for_each(|(sum, part)| *sum += part);
                }
            }
        }
    }
}
/// Returns the gradient by means, covariances, opacities, absolute means, and three channels, from
/// the sums of a block and the fields of its footprints.
#[inline(always)]
fn block_gradient<S: Simd>(simd: S, fields: &[V<S>; LANES], sums: &[V<S>; LANES]) -> [Lanes; 11] {
    let root = each!([0, 1, 2] i => fields[2 + i] * (1.0 / SQRT_HALF_LOG2_E));
    let EllipseGradient { d_mean, d_covariance } = moments_backward(root, sums);
    let [d_log_alpha, _, _, _, _, _, red, green, blue, abs_u, abs_y, ..] = *sums;
    let d_opacity = d_log_alpha / fields[5].max(V::splat(simd, -126.0)).exp2();
    // Absolute sums carry the rasteriser's constant twice: in u and v, and in its root.
    let absolute = [root[0] * abs_u * (1.0 / SQRT_HALF_LOG2_E), abs_y * (1.0 / (SQRT_HALF_LOG2_E * SQRT_HALF_LOG2_E))];
    let rows =
        [d_mean[0], d_mean[1], d_covariance[0], d_covariance[1], d_covariance[2], d_opacity, absolute[0], absolute[1], red, green, blue];
    let mut lanes = [Lanes::ZERO; 11];
    for (row, lanes) in rows.into_iter().zip(&mut lanes) {
        row.store(lanes);
    }
    lanes
}

/// Returns what records of tiles are made from.
fn tile_inputs<'a>(screens: &Screens, view: &'a ScreenView, camera: &'a ScreenCamera, channels: &'a SplatChannels<'a>) -> TileInputs<'a> {
    TileInputs { level: screens.shared.level, camera, splats: view.splats(), recording: Recording::Changes, channels: Some(channels) }
}

impl BlendedSplats for Blended {
    fn backward(&self, gradient: &PixelGradient<'_>) -> Result<BlendGradient, EngineError> {
        let pixels = self.views.len() * self.screens.size_px.iter().product::<usize>();
        check_len("gradient by channels", gradient.channels.len(), pixels * self.count)?;
        if let Some(alpha) = gradient.alpha {
            check_len("gradient by alpha", alpha.len(), pixels)?;
        }
        Ok(self.screens.shared.pool.install(|| self.differentiate(gradient)))
    }
}
