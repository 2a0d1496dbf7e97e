//! Lengths of a fusion: all follow from the images, so that they scale with the scene.
//!
//! In: depth images, and lengths that are given. Out: [`Lengths`]. Degenerate: images without a
//! pixel that shows a surface are an error.

use glam::DVec3;
use luxel_core::Camera;

use crate::frame::{DepthFrame, LEAST_ALPHA};
use crate::{FusionOptions, MeshError};

/// Pixels of an image that are looked at, about.
const SAMPLES: usize = 4096;
/// Voxels across the scene's diagonal.
const VOXELS_ACROSS: f64 = 256.0;
/// Share of points that lie below and above the box of the scene, along each axis.
const OUTSIDE: f64 = 0.01;
/// Depths beyond this many medians are not part of the scene's box: the horizon of a yard.
const FAR_MEDIANS: f64 = 4.0;
/// Side of a pixel's footprint, in voxels, at the depth limit.
const COARSEST_PIXEL: f64 = 4.0;
/// Truncation in voxels, at least.
const TRUNCATION_VOXELS: f64 = 3.0;
/// Truncation in median spreads of depth, at least: the surfaces of different views have to
/// overlap.
const TRUNCATION_SPREADS: f64 = 0.7;

/// Lengths of a fusion, in the unit of the cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lengths {
    /// Diagonal of the box that holds all but outliers of the points seen, without those much
    /// farther than most.
    pub extent: f64,
    /// Side of a voxel.
    pub voxel: f64,
    /// Distance from the surface at which distances are cut off.
    pub truncation: f64,
    /// Depth up to which pixels count.
    pub max_depth: f64,
    /// Median depth of all pixels.
    pub median_depth: f64,
    /// Median spread of depths of all pixels.
    pub median_spread: f64,
}

impl Lengths {
    /// Measures the images; lengths that are given stay.
    ///
    /// # Errors
    /// Given lengths that are no lengths; images without a surface.
    pub fn measure(frames: &[DepthFrame], options: &FusionOptions) -> Result<Self, MeshError> {
        for (name, length) in [("voxel", options.voxel), ("max_depth", options.max_depth)] {
            if let Some(value) = length.filter(|value| !(value.is_finite() && *value > 0.0)) {
                return Err(MeshError::Length { name, value });
            }
        }
        let (mut points, mut depths, mut spreads, mut footprints) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for frame in frames {
            let stride = (frame.depth.len() / SAMPLES).max(1);
            for pixel in (0..frame.depth.len()).step_by(stride).filter(|pixel| frame.shows_surface(*pixel)) {
                let depth = f64::from(frame.depth[pixel]);
                if options.max_depth.is_some_and(|most| depth > most) {
                    continue;
                }
                points.push((point_at(&frame.camera, pixel, depth), depth));
                depths.push(depth);
                spreads.push(f64::from(frame.spread[pixel]));
                footprints.push(depth / frame.camera.focal_px.min_element());
            }
        }
        let (Some(median_depth), Some(median_spread), Some(footprint)) =
            (quantile(&mut depths, 0.5), quantile(&mut spreads, 0.5), quantile(&mut footprints, 0.5))
        else {
            return Err(MeshError::NoSurface { least_alpha: LEAST_ALPHA });
        };
        points.retain(|(_, depth)| *depth <= FAR_MEDIANS * median_depth);
        let side = |axis: usize| {
            let mut places: Vec<f64> = points.iter().map(|(point, _)| point[axis]).collect();
            Some(quantile(&mut places, 1.0 - OUTSIDE)? - quantile(&mut places, OUTSIDE)?)
        };
        let extent = (0..3).filter_map(side).map(|side| side * side).sum::<f64>().sqrt().max(footprint);
        let voxel = options.voxel.unwrap_or((extent / VOXELS_ACROSS).max(footprint));
        let focal_px = frames.iter().map(|frame| frame.camera.focal_px.min_element()).fold(0.0, f64::max);
        Ok(Self {
            extent,
            voxel,
            truncation: (TRUNCATION_VOXELS * voxel).max(TRUNCATION_SPREADS * median_spread),
            // At least what half of all pixels show, however small voxels are.
            max_depth: options.max_depth.unwrap_or((COARSEST_PIXEL * voxel * focal_px).max(2.0 * median_depth)),
            median_depth,
            median_spread,
        })
    }
}

impl Lengths {
    /// Returns the lengths in another unit, of which one of these has `unit`.
    #[must_use]
    pub fn scaled(self, unit: f64) -> Self {
        Self {
            extent: unit * self.extent,
            voxel: unit * self.voxel,
            truncation: unit * self.truncation,
            max_depth: unit * self.max_depth,
            median_depth: unit * self.median_depth,
            median_spread: unit * self.median_spread,
        }
    }
}

/// Returns the point that a pixel sees at a depth.
pub(crate) fn point_at(camera: &Camera, pixel: usize, depth: f64) -> DVec3 {
    let width = camera.size_px[0] as usize;
    let at = glam::DVec2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
    let ray = ((at - camera.center_px) / camera.focal_px).extend(1.0);
    let pose = camera.camera_from_world;
    pose.matrix3.transpose() * (depth * ray - pose.translation)
}

/// Returns the value below which this share of all lies; sorts them.
fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    values.get(((values.len() as f64 * share) as usize).min(values.len().saturating_sub(1))).copied()
}
