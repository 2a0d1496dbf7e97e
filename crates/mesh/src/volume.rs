//! A sparse volume of truncated signed distances (Curless and Levoy 1996), in blocks of voxels.
//!
//! In: weighted depth images. Out: [`Volume`]. First the blocks near a surface of any image are
//! listed, then each block is filled from all images, in their order: no result depends on threads.
//! Voxels hold the weighted mean of the distances along the axes of the cameras, positive in front
//! of the surface and cut off at the truncation, and that of the radiance of pixels that see the
//! surface there. Degenerate: a voxel that fewer than [`LEAST_VIEWS`] images see in front of their
//! surface, or within the truncation behind it, has no distance: NaN.

use std::collections::HashSet;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::frame::WeightedFrame;
use crate::lengths::{Lengths, point_at};
use crate::{LEAST_VIEWS, MeshError};

/// Voxels along the side of a block.
pub(crate) const SIDE: usize = 8;
const VOXELS: usize = SIDE * SIDE * SIDE;
/// Images whose blocks are listed at a time, which bounds the memory for lists.
const BATCH: usize = 16;

/// A place on the grid of blocks or of voxels; voxel n of an axis is centred at (n + 1/2) voxels.
pub(crate) type Place = [i32; 3];

/// A voxel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Voxel {
    /// Distance over the truncation, -1 to 1; NaN where it is unknown.
    pub(crate) distance: f32,
    /// Radiance, 0 where no image sees a surface close by.
    pub(crate) radiance: [f32; 3],
    /// Weight of the radiance.
    pub(crate) weight: f32,
}

/// Bytes of a block.
const BLOCK_BYTES: usize = VOXELS * size_of::<Voxel>();

/// A volume of distances.
pub(crate) struct Volume {
    /// Places of the blocks, in ascending order.
    pub(crate) places: Vec<Place>,
    blocks: Vec<Vec<Voxel>>,
}

impl Volume {
    /// Fuses images into a volume.
    ///
    /// # Errors
    /// It would take more than `max_bytes`.
    pub(crate) fn fuse(frames: &[WeightedFrame], lengths: &Lengths, max_bytes: u64) -> Result<Self, MeshError> {
        let max_blocks = usize::try_from(max_bytes / BLOCK_BYTES as u64).unwrap_or(usize::MAX);
        let too_large = || MeshError::TooLarge { voxel: lengths.voxel, extent: lengths.extent, limit_mebibytes: max_bytes >> 20 };
        // Beyond that, places leave the range of their numbers.
        if lengths.extent / lengths.voxel > f64::from(1 << 24) {
            return Err(too_large());
        }
        let mut places: Vec<Place> = Vec::new();
        for batch in frames.chunks(BATCH) {
            let found: Option<Vec<HashSet<Place>>> = batch.par_iter().map(|frame| places_of(frame, lengths, max_blocks)).collect();
            places.extend(found.ok_or_else(too_large)?.into_iter().flatten());
            places.par_sort_unstable();
            places.dedup();
            if places.len() > max_blocks {
                return Err(too_large());
            }
        }
        let blocks = places.par_iter().map(|place| fill(*place, frames, lengths)).collect();
        Ok(Self { places, blocks })
    }

    /// Returns the memory of all blocks.
    pub(crate) fn bytes(&self) -> u64 {
        (self.blocks.len() * BLOCK_BYTES) as u64
    }

    /// Returns the blocks at a place and behind it along each axis, x first.
    pub(crate) fn corner(&self, place: Place) -> [Option<&[Voxel]>; 8] {
        std::array::from_fn(|n| {
            let at = [0, 1, 2].map(|axis| place[axis].saturating_add((n >> axis & 1) as i32));
            self.places.binary_search(&at).ok().map(|block| self.blocks[block].as_slice())
        })
    }
}

/// Returns the places of blocks within the truncation of the surface that an image shows; `None` if
/// there are too many.
fn places_of(frame: &WeightedFrame, lengths: &Lengths, max_blocks: usize) -> Option<HashSet<Place>> {
    let block = lengths.voxel * SIDE as f64;
    let mut places = HashSet::new();
    for (pixel, weight) in frame.weight.iter().enumerate() {
        if *weight <= 0.0 {
            continue;
        }
        let depth = f64::from(frame.depth[pixel]);
        // Between rays, and between steps along a ray, blocks must not be missed.
        let footprint = depth / frame.camera.focal_px.min_element();
        let [near, far] = [(depth - lengths.truncation).max(0.0), depth + lengths.truncation].map(|z| point_at(&frame.camera, pixel, z));
        let steps = (near.distance(far) / (0.5 * block)).ceil().max(1.0);
        let reach = (0.25 * block).max(0.5 * footprint);
        for step in 0..=steps as usize {
            let point = near.lerp(far, step as f64 / steps);
            let [low, high] = [-reach, reach].map(|by| ((point + by) / block).floor().to_array().map(|v| v as i32));
            for x in low[0]..=high[0] {
                for y in low[1]..=high[1] {
                    for z in low[2]..=high[2] {
                        places.insert([x, y, z]);
                    }
                }
            }
        }
        if places.len() > max_blocks {
            return None;
        }
    }
    Some(places)
}

/// The sums of what images say about a voxel.
#[derive(Clone, Copy, Default)]
struct Sums {
    distance: f32,
    weight: f32,
    views: u32,
    radiance: [f32; 3],
    radiance_weight: f32,
}

/// Fills a block from all images.
fn fill(place: Place, frames: &[WeightedFrame], lengths: &Lengths) -> Vec<Voxel> {
    let mut sums = vec![Sums::default(); VOXELS];
    let first = DVec3::from_array(place.map(|v| (f64::from(v) * SIDE as f64 + 0.5) * lengths.voxel));
    for frame in frames {
        if frame_may_see(frame, first, lengths) {
            add(&mut sums, frame, first, lengths);
        }
    }
    let voxel = |sum: &Sums| Voxel {
        distance: if sum.views >= LEAST_VIEWS as u32 { sum.distance / sum.weight } else { f32::NAN },
        radiance: if sum.radiance_weight > 0.0 { sum.radiance.map(|c| c / sum.radiance_weight) } else { [0.0; 3] },
        weight: sum.radiance_weight,
    };
    sums.iter().map(voxel).collect()
}

/// Returns whether a block may be within the image: its bounding sphere is in front of the camera
/// and reaches into the image's pyramid.
fn frame_may_see(frame: &WeightedFrame, first: DVec3, lengths: &Lengths) -> bool {
    let half = 0.5 * (SIDE - 1) as f64 * lengths.voxel;
    let center = frame.camera.camera_from_world.transform_point3(first + half);
    let radius = half * 3.0f64.sqrt();
    if center.z < -radius || center.z - radius > lengths.max_depth + lengths.truncation {
        return false;
    }
    let [width, height] = frame.camera.size_px.map(f64::from);
    let inside = |at: f64, center_px: f64, focal_px: f64, side_px: f64| {
        // Planes through the eye and the image's borders, with their normals of length 1.
        let [low, high] = [-center_px / focal_px, (side_px - center_px) / focal_px];
        let from_low = (at - low * center.z) / low.hypot(1.0);
        let from_high = (high * center.z - at) / high.hypot(1.0);
        from_low >= -radius && from_high >= -radius
    };
    let (focal, principal) = (frame.camera.focal_px, frame.camera.center_px);
    inside(center.x, principal.x, focal.x, width) && inside(center.y, principal.y, focal.y, height)
}

/// Adds what an image says about the voxels of a block.
fn add(sums: &mut [Sums], frame: &WeightedFrame, first: DVec3, lengths: &Lengths) {
    let pose = frame.camera.camera_from_world;
    let origin = pose.transform_point3(first).as_vec3();
    let axes = [0, 1, 2].map(|axis| (lengths.voxel * pose.matrix3.col(axis)).as_vec3());
    let [focal_x, focal_y] = frame.camera.focal_px.to_array().map(|v| v as f32);
    let [center_x, center_y] = frame.camera.center_px.to_array().map(|v| v as f32);
    let [width, height] = frame.camera.size_px.map(|side| side as usize);
    let truncation = lengths.truncation as f32;
    for (n, sum) in sums.iter_mut().enumerate() {
        let [x, y, z] = [n % SIDE, n / SIDE % SIDE, n / (SIDE * SIDE)];
        let p: Vec3 = origin + x as f32 * axes[0] + y as f32 * axes[1] + z as f32 * axes[2];
        if p.z <= 0.0 {
            continue;
        }
        let (column, row) = ((focal_x * p.x / p.z + center_x).floor(), (focal_y * p.y / p.z + center_y).floor());
        if !(column >= 0.0 && row >= 0.0 && column < width as f32 && row < height as f32) {
            continue;
        }
        let pixel = row as usize * width + column as usize;
        let weight = frame.weight[pixel];
        let distance = (frame.depth[pixel] - p.z) / truncation;
        if weight <= 0.0 || distance < -1.0 {
            continue;
        }
        sum.distance += weight * distance.min(1.0);
        sum.weight += weight;
        sum.views += 1;
        if distance < 1.0 {
            // Pixels that see the surface here, and not one behind.
            let near = weight * (1.0 - distance.abs());
            sum.radiance = [0, 1, 2].map(|c| sum.radiance[c] + near * frame.radiance[pixel][c]);
            sum.radiance_weight += near;
        }
    }
}
