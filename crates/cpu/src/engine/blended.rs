//! [`Blended`]: images of splats, with what the backward pass needs.

use std::sync::Arc;

use fearless_simd::Simd;
use luxel_core::engine::{AbsoluteMeans, BlendGradient, BlendedPixels, BlendedSplats, Channels, PixelGradient, check_len};
use luxel_core::{EngineError, Real, each};
use rayon::prelude::*;

use super::screens::{BlendBuffers, GradientBuffers, ScreenView, Screens};
use crate::lanes::{LANES, Lanes, V, with_simd};
use crate::passes::blend::{self, EntrySums, blend_backward, blend_tiles, to_channels};
use crate::passes::ellipse_backward::{EllipseGradient, moments_backward};
use crate::passes::project::SQRT_HALF_LOG2_E;
use crate::passes::project_backward::BlockSums;
use crate::passes::rasterize_backward::AbsoluteSums;
use crate::passes::splat_channels::{FIRST, SplatChannels};
use crate::passes::tile_records::{Recording, TileInputs};
use crate::view::ScreenCamera;

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
        let mut blended = Self {
            channels: channels.values.to_vec(),
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
            let blended = blend::Blended { records, tiles: &blended.tiles, gradient: pixels, absolute };
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
        let (count, more) = (self.screens.splats.count, self.count.saturating_sub(FIRST));
        let range = camera * count..(camera + 1) * count;
        let numbers = count * self.count;
        // Channels that cameras share have sums over them; every other number is written once.
        let is_shared = out.channels.len() == numbers;
        let is_first = !is_shared || camera == 0;
        let channels = if is_shared { &mut out.channels[..] } else { &mut out.channels[camera * numbers..][..numbers] };
        let outs = (
            out.mean_px[range.clone()].par_chunks_mut(LANES),
            out.covariance_px2[range.clone()].par_chunks_mut(LANES),
            out.opacity[range.clone()].par_chunks_mut(LANES),
            out.absolute_mean_px[range].par_chunks_mut(LANES),
            channels.par_chunks_mut(LANES * self.count),
        );
        let splats = view.splats();
        outs.into_par_iter().enumerate().with_min_len(16).for_each(|(block, (mean_px, covariance_px2, opacity, absolute, channels))| {
            let first = block * LANES;
            let mut sums = BlockSums::ZERO;
            mean_px.fill([0.0; 2]);
            covariance_px2.fill([0.0; 3]);
            opacity.fill(0.0);
            if collects_absolute {
                absolute.fill([0.0; 2]);
            }
            if is_first {
                channels.fill(0.0);
            }
            with_simd!(self.screens.shared.level, simd => {
                sums.gather_entries(simd, splats.bins, &entries.entries, first..first + opacity.len());
                if sums.is_visible() {
                    let footprints = &splats.footprints[first..first + LANES];
                    let fields = V::transpose(each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15] lane => {
                        V::load(simd, bytemuck::cast_ref(&footprints[lane]))
                    }));
                    let gradient = block_gradient(simd, &fields, &sums.by_field(simd));
                    for lane in (0..opacity.len()).filter(|lane| sums.visible[*lane]) {
                        let at = |row: usize| gradient[row].0[lane];
                        mean_px[lane] = [at(0), at(1)];
                        covariance_px2[lane] = [at(2), at(3), at(4)];
                        opacity[lane] = at(5);
                        if collects_absolute {
                            absolute[lane] = [at(6), at(7)];
                        }
                        for (c, channel) in channels[lane * self.count..][..self.count.min(FIRST)].iter_mut().enumerate() {
                            *channel += at(8 + c);
                        }
                    }
                }
            });
            if more > 0 {
                for (lane, numbers) in splats.bins.entries(first, opacity.len()).enumerate() {
                    let out = &mut channels[lane * self.count + FIRST..][..more];
                    for entry in numbers {
                        out.iter_mut().zip(&entries.more[*entry as usize * more..]).for_each(|(sum, part)| *sum += part);
                    }
                }
            }
        });
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
