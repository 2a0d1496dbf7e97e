//! Blended channels between tiles and planes, and what a scene's splats give to channels and get
//! back from them.
//!
//! In: pixels of tiles, sums of entries. Out: planes `[K, H, W]` of an image; from planes, the
//! gradient block by block; by splat, radiance `[N]` and gradients by channels `[N, K]`.
//! Degenerate: blocks that hang over the image have gradients of 0 beyond it.

use luxel_core::each;
use rayon::prelude::*;

use super::bin::ScreenSplats;
use super::blend::{ChannelGradient, ChannelPixels, EntrySums};
use super::more_channels_backward::padded;
use super::splat_channels::FIRST;
use crate::lanes::{LANES, Lanes};
use crate::view::{BLOCK_PX, BLOCKS, ScreenCamera, TILE_BLOCKS, TILE_PX, block_of};

/// Splats of a chunk of work.
const CHUNK: usize = 128 * LANES;

/// Writes the pixels to planes `[K, H, W]`.
pub(crate) fn to_planes(pixels: &ChannelPixels, camera: &ScreenCamera, count: usize, planes: &mut [f32]) {
    let [width, height] = camera.size_px;
    let (across, more) = (camera.tiles()[0], count - FIRST);
    planes.par_chunks_mut(width * height).enumerate().for_each(|(channel, plane)| {
        for (y, row) in plane.chunks_mut(width).enumerate() {
            for (column, out) in row.chunks_mut(BLOCK_PX).enumerate() {
                let tile = y / TILE_PX * across + column / TILE_BLOCKS;
                let (block, lane) = block_of(column % TILE_BLOCKS * BLOCK_PX, y % TILE_PX);
                let lanes = if channel < FIRST {
                    &pixels.tiles[tile].0[block].radiance[channel]
                } else {
                    &pixels.more[(tile * BLOCKS + block) * more + channel - FIRST]
                };
                let row = &lanes.0.as_chunks::<BLOCK_PX>().0[lane / BLOCK_PX];
                match out.first_chunk_mut() {
                    Some(out) => *out = *row,
                    None => out.copy_from_slice(&row[..out.len()]),
                }
            }
        }
    });
}

/// Reads the gradient by planes `[K, H, W]`; there is none by alpha.
pub(crate) fn fill_gradient(gradient: &mut ChannelGradient, camera: &ScreenCamera, count: usize, planes: &[f32]) {
    let (more, [width, height]) = (count - FIRST, camera.size_px);
    let [across, down] = camera.tiles().map(|tiles| tiles * TILE_PX / BLOCK_PX);
    gradient.first.resize(across * down, [Lanes::ZERO; FIRST]);
    gradient.more.resize(across * down * more, Lanes::ZERO);
    gradient.alpha.clear();
    let at = |block: usize, channel: usize| {
        let (x, y) = (block % across * BLOCK_PX, block / across * BLOCK_PX);
        let mut lanes = Lanes::ZERO;
        let columns = BLOCK_PX.min(width.saturating_sub(x));
        if columns > 0 {
            for row in 0..BLOCK_PX.min(height.saturating_sub(y)) {
                let from = &planes[channel * width * height + (y + row) * width + x..][..columns];
                let out = &mut lanes.0.as_chunks_mut::<BLOCK_PX>().0[row];
                match from.first_chunk() {
                    Some(from) => *out = *from,
                    None => out[..columns].copy_from_slice(from),
                }
            }
        }
        lanes
    };
    gradient.first.par_iter_mut().enumerate().with_min_len(across).for_each(|(block, out)| {
        *out = each!([0, 1, 2] c => at(block, c));
    });
    if more > 0 {
        gradient.more.par_chunks_mut(more).enumerate().with_min_len(across).for_each(|(block, out)| {
            out.iter_mut().enumerate().for_each(|(c, out)| *out = at(block, FIRST + c));
        });
    }
}

/// Splats as a view shows them: radiance `[N]`, 0 where it does not show the splat, and whether it
/// does.
#[derive(Default)]
pub(crate) struct SeenBuffers {
    pub(crate) radiance: Vec<[f32; 3]>,
    pub(crate) visible: Vec<bool>,
}

impl SeenBuffers {
    /// Reads the first `count` splats.
    pub(crate) fn read(&mut self, splats: ScreenSplats<'_>, count: usize) {
        self.radiance.resize(count, [0.0; 3]);
        self.visible.resize(count, false);
        let outs = self.radiance.par_chunks_mut(CHUNK).zip(self.visible.par_chunks_mut(CHUNK)).enumerate();
        outs.for_each(|(chunk, (radiance, visible))| {
            for (block, (radiance, visible)) in radiance.chunks_mut(LANES).zip(visible.chunks_mut(LANES)).enumerate() {
                let first = chunk * CHUNK + block * LANES;
                let footprints = &splats.footprints[first..];
                let entries = splats.bins.entries(first, visible.len());
                for (((radiance, visible), entries), footprint) in radiance.iter_mut().zip(visible).zip(entries).zip(footprints) {
                    *visible = !entries.is_empty();
                    *radiance = if *visible { footprint.radiance } else { [0.0; 3] };
                }
            }
        });
    }
}

/// Gathers the gradients by `count` channels by splat, `[N, K]`: sums over the entries of each in
/// the order of its tiles.
pub(crate) fn gather_channels(splats: ScreenSplats<'_>, sums: &EntrySums, count: usize, out: &mut [f32]) {
    let more = count - FIRST;
    let width = padded(more);
    out.par_chunks_mut(CHUNK * count).enumerate().for_each(|(chunk, out)| {
        for (block, out) in out.chunks_mut(LANES * count).enumerate() {
            let entries = splats.bins.entries(chunk * CHUNK + block * LANES, out.len() / count);
            for (entries, out) in entries.zip(out.chunks_mut(count)) {
                let mut first = [0.0; FIRST];
                let (of_first, others) = out.split_at_mut(FIRST);
                others.fill(0.0);
                for entry in entries {
                    let entry = *entry as usize;
                    let radiance = sums.entries[entry].radiance;
                    each!([0, 1, 2] c => first[c] += radiance[c]);
                    others.iter_mut().zip(&sums.more[entry * width..][..more]).for_each(|(sum, part)| *sum += part);
                }
                of_first.copy_from_slice(&first);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use luxel_core::RenderOptions;

    use super::*;
    use crate::passes::rasterize::TilePixels;
    use crate::passes::rasterize_backward::block_in_image;
    use crate::rays::Lenses;

    #[test]
    fn planes_of_any_size_pass_through_blocks() {
        for size_px in [[37, 22], [3, 2], [32, 32], [1, 33]] {
            let camera = luxel_core::Camera {
                camera_from_world: glam::DAffine3::IDENTITY,
                focal_px: glam::DVec2::splat(20.0),
                center_px: glam::DVec2::splat(1.0),
                size_px,
                distortion: luxel_core::Distortion::default(),
                projection: luxel_core::CameraProjection::Pinhole,
            };
            let camera = ScreenCamera::new(&camera, &RenderOptions::default(), &mut Lenses::default()).unwrap();
            for count in [3, 5] {
                let len = count * camera.size_px[0] * camera.size_px[1];
                let planes: Vec<f32> = (0..len).map(|i| i as f32).collect();
                let mut gradient = ChannelGradient::default();
                fill_gradient(&mut gradient, &camera, count, &planes);
                // Pixels of tiles with the same numbers.
                let [across, down] = camera.tiles();
                let mut pixels = ChannelPixels::default();
                for tile in 0..across * down {
                    let blocks = (0..BLOCKS).map(|block| block_in_image(tile, block, across));
                    let mut tile_pixels = TilePixels::default();
                    for (pixels_of_block, block) in tile_pixels.0.iter_mut().zip(blocks) {
                        pixels_of_block.radiance = gradient.first[block];
                        pixels.more.extend_from_slice(&gradient.more[block * (count - FIRST)..][..count - FIRST]);
                    }
                    pixels.tiles.push(tile_pixels);
                }
                let mut again = vec![-1.0; len];
                to_planes(&pixels, &camera, count, &mut again);
                assert_eq!(again, planes, "{size_px:?}, {count} channels");
            }
        }
    }
}
