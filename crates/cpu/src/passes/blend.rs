//! Passes `sort`, `rasterize` and `rasterize_backward` for splats with any number of channels.
//!
//! In: binned footprints, [`SplatChannels`]. Out: pixels of all channels, and records of the tiles;
//! backward, sums over pixels for each entry of a tile. The first three channels take the way of
//! radiance, the others that of [`super::more_channels`]. Degenerate: fewer than three channels are
//! filled up with zeros.

use luxel_core::each;
use luxel_core::engine::{ChannelRoles, MeasuredChannels};
use rayon::prelude::*;

use super::more_channels::BlendChannels;
use super::more_channels_backward::{DifferentiateChannels, FirstThree, padded};
use super::rasterize::{TilePixels, rasterize, rasterize_more};
use super::rasterize_backward::{AbsoluteSums, BlockGradient, TileBackward, block_in_image, differentiate_more, differentiate_tile};
use super::screen_gradients::resize;
use super::sort::Tile;
use super::splat_channels::{FIRST, SplatChannels};
use super::sums::EntryGradient;
use super::tile_records::{Recording, TileInputs, TileRecords, Workbench};
use crate::lanes::{LANES, Lanes};
use crate::view::{BLOCKS, ScreenCamera, TILE_BLOCKS, TILE_PX, block_of};

/// The pixels of all tiles.
#[derive(Default)]
pub(crate) struct ChannelPixels {
    /// The first three channels, and the transmittance.
    pub(crate) tiles: Vec<TilePixels>,
    /// The others, `[tiles, blocks, E]`.
    pub(super) more: Vec<Lanes>,
}

/// Sorts and blends all tiles, and keeps their records.
pub(crate) fn blend_tiles(inputs: &TileInputs<'_>, channels: &SplatChannels<'_>, records: &mut TileRecords, pixels: &mut ChannelPixels) {
    let TileInputs { level, camera, splats, .. } = *inputs;
    let [across, down] = camera.tiles();
    let (tiles, width) = (across * down, BLOCKS * channels.more());
    pixels.tiles.resize(tiles, TilePixels::default());
    // A chunk of no rows is none: without other channels each tile has one row for nothing.
    pixels.more.resize(tiles * width.max(1), Lanes::ZERO);
    let background = channels.more_background();
    let (slots, shelf) = records.begin(tiles, Recording::Changes);
    let outs = pixels.tiles.par_iter_mut().zip(pixels.more.par_chunks_mut(width.max(1)));
    slots.par_iter_mut().zip(outs).enumerate().with_max_len(1).for_each(|(index, (slot, (pixels, more)))| {
        let Workbench { buffers, record: of_thread, colors, .. } = &mut *shelf.bench();
        let record = slot.record(of_thread, Recording::Changes);
        record.list.sort(level, camera, splats, index, buffers);
        channels.color_entries(splats.bins, index, &mut record.list);
        let tile = Tile { index, list: &record.list };
        if width == 0 {
            rasterize(level, camera, tile, pixels, Some(&mut record.changes));
        } else {
            channels.collect_more(splats.bins, index, &record.list.entries, colors);
            let mut more = BlendChannels { colors, background: &background, pixels: more, first: 0 };
            rasterize_more(level, camera, tile, pixels, &mut record.changes, &mut more);
        }
        slot.keep(of_thread, shelf);
    });
}

/// Converts the pixels to an image `[H, W, K]`, and to alpha `[H, W]`.
pub(crate) fn to_channels(pixels: &ChannelPixels, camera: &ScreenCamera, count: usize, out: &mut [f32], alpha: &mut [f32]) {
    let [width, _] = camera.size_px;
    let (across, more) = (camera.tiles()[0], count.saturating_sub(FIRST));
    let rows = out.par_chunks_mut(width * count).zip(alpha.par_chunks_mut(width)).enumerate();
    rows.for_each(|(y, (row, alpha))| {
        for (column, (out, alpha)) in row.chunks_mut(BLOCK * count).zip(alpha.chunks_mut(BLOCK)).enumerate() {
            let tile = y / TILE_PX * across + column / TILE_BLOCKS;
            let (block, lane) = block_of(column % TILE_BLOCKS * BLOCK, y % TILE_PX);
            let from = &pixels.tiles[tile].0[block];
            let lanes = lane..lane + alpha.len();
            for (alpha, transmittance) in alpha.iter_mut().zip(&from.transmittance.0[lanes.clone()]) {
                *alpha = 1.0 - transmittance;
            }
            if count == FIRST {
                for (lane, pixel) in lanes.zip(out.as_chunks_mut::<FIRST>().0) {
                    *pixel = each!([0, 1, 2] c => from.radiance[c].0[lane]);
                }
                continue;
            }
            for (lane, pixel) in lanes.zip(out.chunks_mut(count)) {
                let (first, others) = pixel.split_at_mut(count.min(FIRST));
                for (out, channel) in first.iter_mut().zip(&from.radiance) {
                    *out = channel.0[lane];
                }
                for (out, channel) in others.iter_mut().zip(&pixels.more[(tile * BLOCKS + block) * more..]) {
                    *out = channel.0[lane];
                }
            }
        }
    });
}

/// The gradient by the pixels, block by block, row by row of blocks over whole tiles.
#[derive(Default)]
pub(crate) struct ChannelGradient {
    pub(super) first: Vec<BlockGradient>,
    /// `[blocks, E]`.
    pub(super) more: Vec<Lanes>,
    /// Empty if there is none.
    pub(super) alpha: Vec<Lanes>,
}

impl ChannelGradient {
    /// Converts a gradient `[H, W, K]`, and one by alpha `[H, W]`.
    pub(crate) fn fill(&mut self, camera: &ScreenCamera, count: usize, channels: &[f32], alpha: Option<&[f32]>) {
        let (more, [width, height]) = (count.saturating_sub(FIRST), camera.size_px);
        let [across, down] = camera.tiles().map(|tiles| tiles * TILE_PX / BLOCK);
        self.first.resize(across * down, [Lanes::ZERO; FIRST]);
        self.more.resize(across * down * more, Lanes::ZERO);
        self.alpha.resize(if alpha.is_some() { across * down } else { 0 }, Lanes::ZERO);
        // Pixels beyond the image are finished: their gradients are never used, but must be finite.
        let pixel = |block: usize, lane: usize| {
            let (x, y) = (block % across * BLOCK + lane % BLOCK, block / across * BLOCK + lane / BLOCK);
            (x < width && y < height).then_some(y * width + x)
        };
        let at = |block: usize, channel: usize| {
            Lanes(std::array::from_fn(|lane| pixel(block, lane).map_or(0.0, |pixel| channels[pixel * count + channel])))
        };
        self.first.par_iter_mut().enumerate().with_min_len(64).for_each(|(block, out)| {
            let (x, y) = (block % across * BLOCK, block / across * BLOCK);
            if count == FIRST && x + BLOCK <= width && y + BLOCK <= height {
                for row in 0..BLOCK {
                    let (pixels, _) = channels[((y + row) * width + x) * FIRST..][..BLOCK * FIRST].as_chunks::<FIRST>();
                    for (lane, pixel) in (row * BLOCK..).zip(pixels) {
                        each!([0, 1, 2] c => out[c].0[lane] = pixel[c]);
                    }
                }
            } else {
                *out = each!([0, 1, 2] c => if c < count { at(block, c) } else { Lanes::ZERO });
            }
        });
        if more > 0 {
            self.more.par_chunks_mut(more).enumerate().for_each(|(block, out)| {
                out.iter_mut().enumerate().for_each(|(c, out)| *out = at(block, FIRST + c));
            });
        }
        if let Some(alpha) = alpha {
            self.alpha.par_iter_mut().enumerate().for_each(|(block, out)| {
                *out = Lanes(std::array::from_fn(|lane| pixel(block, lane).map_or(0.0, |pixel| alpha[pixel])));
            });
        }
    }

    /// Returns the gradient by the background, `[K]`.
    pub(crate) fn by_background(&self, camera: &ScreenCamera, tiles: &[TilePixels], count: usize) -> Vec<f32> {
        let (across, more) = (camera.tiles()[0], count.saturating_sub(FIRST));
        let of_tile = |(tile, pixels): (usize, &TilePixels)| {
            let mut sums = vec![0.0; count];
            for (block, pixels) in pixels.0.iter().enumerate() {
                let n = block_in_image(tile, block, across);
                let gradients = self.first[n].iter().take(count).chain(&self.more[n * more..][..more]);
                for (sum, gradient) in sums.iter_mut().zip(gradients) {
                    let products = gradient.0.iter().zip(&pixels.transmittance.0).map(|(g, t)| f64::from(*g) * f64::from(*t));
                    *sum += products.sum::<f64>();
                }
            }
            sums
        };
        let of_tiles: Vec<Vec<f64>> = tiles.par_iter().enumerate().map(of_tile).collect();
        (0..count).map(|c| of_tiles.iter().map(|sums| sums[c]).sum::<f64>() as f32).collect()
    }
}

/// Side of a block, pixels.
const BLOCK: usize = crate::view::BLOCK_PX;
const _: () = assert!(BLOCK * BLOCK == LANES);

/// Sums over pixels for each entry, in the order of the bins.
#[derive(Default)]
pub(crate) struct EntrySums {
    pub(crate) entries: Vec<EntryGradient>,
    /// Gradients by the other channels, `[entries, E]` with E rounded up by [`padded`].
    pub(crate) more: Vec<f32>,
}

/// The results of blending, and the gradient by them.
#[derive(Clone, Copy)]
pub(crate) struct Blended<'a> {
    pub(crate) records: &'a TileRecords,
    pub(crate) tiles: &'a [TilePixels],
    pub(crate) gradient: &'a ChannelGradient,
    pub(crate) absolute: AbsoluteSums,
    pub(crate) roles: ChannelRoles,
}

/// Differentiates all tiles.
pub(crate) fn blend_backward(
    inputs: &TileInputs<'_>,
    channels: &SplatChannels<'_>,
    Blended { records, tiles, gradient, absolute, roles }: Blended<'_>,
    out: &mut EntrySums,
) {
    let bins = inputs.splats.bins;
    let (across, width) = (inputs.camera.tiles()[0], padded(channels.more()));
    resize(&mut out.entries, bins.len());
    resize(&mut out.more, bins.len() * width);
    let background = channels.more_background();
    let (mut rest, mut rest_more) = (out.entries.as_mut_slice(), out.more.as_mut_slice());
    let outs: Vec<(&mut [EntryGradient], &mut [f32])> = (0..tiles.len())
        .map(|tile| {
            let len = bins.range(tile).len();
            (rest.split_off_mut(..len).unwrap_or_default(), rest_more.split_off_mut(..len * width).unwrap_or_default())
        })
        .collect();
    outs.into_par_iter().zip(tiles).enumerate().with_max_len(1).for_each(|(tile, ((out, more), pixels))| {
        out.fill(EntryGradient::default());
        let work = TileBackward::new(tile, across, pixels, &gradient.first, absolute);
        if width == 0 && gradient.alpha.is_empty() {
            records.read(inputs, tile, |record| differentiate_tile(inputs, record, &work, out));
            return;
        }
        more.fill(0.0);
        let blocks: [usize; BLOCKS] = std::array::from_fn(|block| block_in_image(tile, block, across));
        records.read(inputs, tile, |record| {
            let mut colors = Vec::new();
            channels.collect_more(bins, tile, &record.list.entries, &mut colors);
            let parts = MoreParts { colors: &colors, background: &background, gradient, blocks: &blocks };
            match roles.measured {
                MeasuredChannels::All => {
                    differentiate_more(inputs, record, &work, out, &mut parts.differentiate::<false>(roles, more));
                }
                MeasuredChannels::FirstThree => {
                    differentiate_more(inputs, record, &work, out, &mut parts.differentiate::<true>(roles, more));
                }
            }
        });
    });
}

/// The parts of a tile's [`DifferentiateChannels`].
#[derive(Clone, Copy)]
struct MoreParts<'a> {
    colors: &'a [f32],
    background: &'a [f32],
    gradient: &'a ChannelGradient,
    blocks: &'a [usize; BLOCKS],
}

impl<'a> MoreParts<'a> {
    fn differentiate<const MEASURES_FIRST: bool>(
        self,
        roles: ChannelRoles,
        sums: &'a mut [f32],
    ) -> DifferentiateChannels<'a, MEASURES_FIRST> {
        let Self { colors, background, gradient, blocks } = self;
        DifferentiateChannels {
            colors,
            background,
            gradient: &gradient.more,
            alpha: &gradient.alpha,
            blocks,
            block: 0,
            shaping: roles.shaping.saturating_sub(FIRST).min(background.len()),
            first: FirstThree::ZERO,
            sums,
        }
    }
}
