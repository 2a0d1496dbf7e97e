//! Triangle meshes from depth images with cameras.
//!
//! In: [`DepthFrame`]s in any unit, [`FusionOptions`]. Out: a [`TriangleMesh`] in the coordinates
//! of the cameras, with normals and radiance, and a [`FusionReport`]. Depths become truncated
//! signed distances in a sparse volume, weighted by how sure they are; the surface is extracted
//! where several images agree, rid of small islands and holes, and simplified. Lengths follow from
//! the images, unless given. A [`Grid`] of values has surfaces of its own. Equal input gives equal
//! bits for any number of threads. Degenerate: images that agree on nothing are an error.
//!
//! ```
//! use glam::{DAffine3, DVec2};
//! use luxel_core::{Camera, CameraProjection, Distortion};
//! use luxel_mesh::{DepthFrame, FusionOptions, fuse};
//!
//! // A wall at depth 2, seen three times.
//! let wall = DepthFrame {
//!     camera: Camera {
//!         camera_from_world: DAffine3::IDENTITY,
//!         focal_px: DVec2::splat(32.0),
//!         center_px: DVec2::splat(16.0),
//!         size_px: [32, 32],
//!         distortion: Distortion::default(),
//!         projection: CameraProjection::Pinhole,
//!     },
//!     depth: vec![2.0; 32 * 32],
//!     spread: vec![0.0; 32 * 32],
//!     alpha: vec![1.0; 32 * 32],
//!     radiance: vec![[5.0; 3]; 32 * 32],
//! };
//! let (mesh, _) = fuse(vec![wall.clone(), wall.clone(), wall], &FusionOptions::default())?;
//! assert!(mesh.positions.iter().all(|[_, _, z]| (z - 2.0).abs() < 1e-4));
//! # Ok::<(), luxel_mesh::MeshError>(())
//! ```

mod clean;
mod error;
mod extract;
mod fill;
mod frame;
mod lengths;
mod level_set;
mod simplify;
mod triangle_mesh;
mod volume;

use rayon::prelude::*;

pub use self::error::MeshError;
pub use self::frame::{DepthFrame, LEAST_ALPHA};
use self::frame::{WeightLengths, WeightedFrame};
pub use self::lengths::Lengths;
pub use self::level_set::Grid;
pub use self::triangle_mesh::TriangleMesh;
use self::volume::Volume;

/// Images that have to see a place for it to be known.
pub const LEAST_VIEWS: usize = 3;

/// Diagonal of the smallest island that is kept, in voxels, unless given.
const MIN_ISLAND_VOXELS: f64 = 16.0;

/// Diagonal of the largest hole that is filled, in voxels, unless given.
const MAX_HOLE_VOXELS: f64 = 32.0;

/// Options of a fusion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusionOptions {
    /// Side of a voxel, in the unit of the cameras; `None` for what the images resolve.
    pub voxel: Option<f64>,
    /// Depth up to which pixels count; `None` for where a pixel becomes much larger than a voxel.
    pub max_depth: Option<f64>,
    /// Islands whose bounding box has a shorter diagonal are removed; `None` for 16 voxels.
    pub min_island: Option<f64>,
    /// Flat holes whose bounding box has a shorter diagonal are filled; `None` for 32 voxels.
    pub max_hole: Option<f64>,
    /// Number of triangles to simplify the mesh to; `None` for all.
    pub triangles: Option<usize>,
    /// Memory that the volume may take, bytes.
    pub max_bytes: u64,
}

impl Default for FusionOptions {
    fn default() -> Self {
        Self { voxel: None, max_depth: None, min_island: None, max_hole: None, triangles: None, max_bytes: 2 << 30 }
    }
}

/// The lengths and counts of a fusion.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct FusionReport {
    /// Lengths that were used.
    pub lengths: Lengths,
    /// Memory of the volume, bytes.
    pub volume_bytes: u64,
    /// Islands that were removed.
    pub islands_removed: usize,
    /// Holes that were filled.
    pub holes_filled: usize,
    /// Triangles before simplification.
    pub triangles_before: usize,
}

/// Fuses depth images into a mesh.
///
/// # Errors
/// Too few images; images that are not of undistorted pinholes or of another size than their
/// cameras; lengths that are not above 0; a volume beyond the memory; no surface.
pub fn fuse(frames: Vec<DepthFrame>, options: &FusionOptions) -> Result<(TriangleMesh, FusionReport), MeshError> {
    if frames.len() < LEAST_VIEWS {
        return Err(MeshError::TooFewFrames { found: frames.len(), expected: LEAST_VIEWS });
    }
    let count = frames.len();
    frames.iter().enumerate().try_for_each(|(index, frame)| frame.check(index))?;
    let lengths = Lengths::measure(&frames, options)?;
    let of_weights = WeightLengths { depth: lengths.median_depth, spread: lengths.median_spread, max_depth: lengths.max_depth };
    let frames: Vec<WeightedFrame> = frames.into_par_iter().map(|frame| WeightedFrame::new(frame, of_weights)).collect();
    let volume = Volume::fuse(&frames, &lengths, options.max_bytes)?;
    drop(frames);
    let volume_bytes = volume.bytes();
    let mut mesh = extract::extract(&volume, lengths.voxel);
    drop(volume);
    if mesh.triangles.is_empty() {
        return Err(MeshError::Empty { frames: count, least: LEAST_VIEWS });
    }
    let min_island = options.min_island.unwrap_or(MIN_ISLAND_VOXELS * lengths.voxel);
    let islands_removed = clean::remove_islands(&mut mesh, min_island);
    if mesh.triangles.is_empty() {
        return Err(MeshError::OnlyIslands { islands: islands_removed, min_island });
    }
    let holes_filled = fill::fill_holes(&mut mesh, options.max_hole.unwrap_or(MAX_HOLE_VOXELS * lengths.voxel));
    let triangles_before = mesh.triangles.len();
    options.triangles.into_iter().for_each(|triangles| simplify::simplify(&mut mesh, triangles));
    Ok((mesh, FusionReport { lengths, volume_bytes, islands_removed, holes_filled, triangles_before }))
}
