//! Pass `surface`: finds the distribution of depths of each pixel. It is not part of training.
//!
//! In: the tiles' sorted lists, and [`ScreenPeaks`]. Out: [`SurfaceImage`]. Splats, thresholds and
//! weights are those of `rasterize`; a splat's depth at a pixel is where its density along the
//! pixel's ray is greatest (as in Radl et al., StopThePop, 2024, for sorting). With x = ray * t, M
//! = S^-1 R^-1 from camera space and m = M mu, the squared distance |M x - m|^2 is least at t = (M
//! ray . m) / |M ray|^2, the depth of a ray whose z is 1. Degenerate: pixels beyond the image are
//! left out; a depth is no further from the centre's than [`REACH_SIGMA`] of the splat's longest
//! axis.

use fearless_simd::Simd;
use fearless_simd::prelude::*;
use luxel_core::engine::{ParameterRows, SurfaceImage, SurfacePixel};
use rayon::prelude::*;

use super::bin::ScreenSplats;
use super::project::Footprint;
use super::sort::Entry;
use super::tile_records::{TileInputs, TileRecords};
use super::visit_block::{Hit, Visitor, visit_block};
use crate::lanes::{LANES, with_simd};
use crate::store::Store;
use crate::view::{BLOCK_PX, BLOCKS, ScreenBlock, ScreenCamera, TILE_BLOCKS, TILE_PX};

/// Standard deviations along the longest axis within which the depth of a splat lies.
const REACH_SIGMA: f32 = 3.0;
/// Least axis, as a part of the longest: that of a flatter splat has no digits in f32.
const FLATTEST: f32 = 1e-4;

/// The places along a camera's rays where splats are densest.
pub(crate) struct ScreenPeaks {
    /// One for each splat; those that are culled have none.
    peaks: Vec<Peak>,
}

#[derive(Clone, Copy, Default)]
struct Peak {
    /// The rows of M, in camera space.
    rows: [[f32; 3]; 3],
    /// M times the centre.
    center: [f32; 3],
    /// Depth of the centre.
    depth: f32,
    /// Largest difference to it.
    reach: f32,
}

impl ScreenPeaks {
    /// Prepares the splats of a view.
    pub(crate) fn new(parameters: &Store, camera: &ScreenCamera, footprints: &[Footprint]) -> Self {
        let peak = |i: usize| {
            let footprint = &footprints[i];
            let is_culled = footprint.log2_threshold > footprint.log2_opacity;
            if is_culled { Peak::default() } else { Peak::new(parameters, camera, i, footprint.depth) }
        };
        Self { peaks: (0..parameters.count).into_par_iter().map(peak).collect() }
    }
}

impl Peak {
    fn new(parameters: &Store, camera: &ScreenCamera, i: usize, depth: f32) -> Self {
        let row = |row: usize, c: usize| parameters.at(row + c, i);
        let scale: [f32; 3] = std::array::from_fn(|c| row(ParameterRows::LOG_SCALE, c).exp());
        let longest = scale.into_iter().fold(0.0, f32::max);
        let [w, x, y, z] = std::array::from_fn(|c| row(ParameterRows::ROTATION, c));
        let turn = glam::Quat::from_xyzw(x, y, z, w);
        // A quaternion of length 0 turns nothing in any pass.
        let turn = if turn.length_squared() > 0.0 { turn.normalize() } else { glam::Quat::IDENTITY };
        let axes = glam::Mat3::from_quat(turn).to_cols_array_2d();
        let rotation = camera.rotation;
        let rows: [[f32; 3]; 3] = std::array::from_fn(|axis| {
            // Lengths in units of the longest axis, which keeps the squares in range.
            let inverse = 1.0 / (scale[axis] / longest).max(FLATTEST);
            std::array::from_fn(|c| inverse * dot(axes[axis], rotation[c]))
        });
        let position: [f32; 3] = std::array::from_fn(|c| row(ParameterRows::POSITION, c));
        let mean: [f32; 3] = std::array::from_fn(|c| dot(rotation[c], position) + camera.translation[c]);
        Self { rows, center: rows.map(|row| dot(row, mean)), depth, reach: REACH_SIGMA * longest }
    }

    /// Returns the depth at a ray whose z is 1.
    fn depth(&self, ray: [f32; 3]) -> f32 {
        let along = self.rows.map(|row| dot(row, ray));
        let depth = dot(along, self.center) / dot(along, along);
        let [near, far] = [self.depth - self.reach, self.depth + self.reach];
        // NaN, of lengths out of range, becomes the centre's depth.
        if depth.is_finite() { depth.max(near).min(far).max(0.0) } else { self.depth }
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Finds the distributions of all pixels.
pub(crate) fn surface(inputs: &TileInputs<'_>, records: &TileRecords, peaks: &ScreenPeaks) -> SurfaceImage {
    let TileInputs { level, camera, splats, .. } = *inputs;
    let [width, height] = camera.size_px;
    let [across, _] = camera.tiles();
    let mut image = SurfaceImage { width, height, pixels: vec![SurfacePixel::EMPTY; width * height] };
    let tile_row = |(row, band): (usize, &mut [SurfacePixel])| {
        let mut parts: [Vec<[f32; 2]>; LANES] = Default::default();
        let mut heaviest = [Heaviest::default(); LANES];
        for column in 0..across {
            let tile = row * across + column;
            records.read(inputs, tile, |record| {
                for index in 0..BLOCKS {
                    let origin_px = camera.tile_origin_px(tile);
                    let block = ScreenBlock { origin_px, index };
                    let (left, top) = (index % TILE_BLOCKS * BLOCK_PX, index / TILE_BLOCKS * BLOCK_PX);
                    let rays = std::array::from_fn(|lane| {
                        let pixel = [origin_px[0] + left + lane % BLOCK_PX, origin_px[1] + top + lane / BLOCK_PX];
                        let [x, y] = [0, 1].map(|c| (pixel[c] as f32 + 0.5 - camera.center_px[c]) / camera.focal_px[c]);
                        [x, y, 1.0]
                    });
                    let start = splats.bins.range(tile).start;
                    parts.iter_mut().for_each(Vec::clear);
                    heaviest.fill(Heaviest::default());
                    let mut lister = Lister { splats, peaks, rays, start, parts: &mut parts, heaviest: &mut heaviest };
                    with_simd!(level, simd => visit_block(simd, camera, &record.list, block, &mut lister));
                    for (lane, parts) in parts.iter_mut().enumerate() {
                        let (x, y) = (column * TILE_PX + left + lane % BLOCK_PX, top + lane / BLOCK_PX);
                        if x < width && (y + 1) * width <= band.len() {
                            band[y * width + x] = SurfacePixel { splat: heaviest[lane].splat, ..SurfacePixel::from_parts(parts) };
                        }
                    }
                }
            });
        }
    };
    image.pixels.par_chunks_mut(TILE_PX * width).enumerate().with_max_len(1).for_each(tile_row);
    image
}

/// The splat with the greatest weight in a pixel so far.
#[derive(Clone, Copy, Default)]
struct Heaviest {
    weight: f32,
    splat: Option<u32>,
}

/// A visitor that lists weights and depths of each pixel of a block.
struct Lister<'a> {
    splats: ScreenSplats<'a>,
    peaks: &'a ScreenPeaks,
    /// Rays of the pixels, with z = 1.
    rays: [[f32; 3]; LANES],
    /// First entry of the tile.
    start: usize,
    parts: &'a mut [Vec<[f32; 2]>; LANES],
    heaviest: &'a mut [Heaviest; LANES],
}

impl<S: Simd> Visitor<S> for Lister<'_> {
    #[inline(always)]
    fn visit(&mut self, entry: &Entry, hit: &Hit<S>) {
        let mut bits = hit.changed.to_bitmask();
        if bits == 0 {
            return;
        }
        let splat = self.splats.bins.splat(self.start + entry.place as usize);
        let peak = &self.peaks.peaks[splat];
        let weight = hit.weight.lanes();
        while bits != 0 {
            let lane = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            self.parts[lane].push([weight[lane], peak.depth(self.rays[lane])]);
            if weight[lane] > self.heaviest[lane].weight {
                self.heaviest[lane] = Heaviest { weight: weight[lane], splat: Some(splat as u32) };
            }
        }
    }
}
