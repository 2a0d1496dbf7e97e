//! Errors of meshes.

/// The reason why depth images make no mesh.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MeshError {
    /// There are too few images to fuse.
    #[error("{found} depth images, expected at least {expected}: a surface counts where several see it")]
    TooFewFrames {
        /// Number of images.
        found: usize,
        /// Number of images that have to see a surface.
        expected: usize,
    },
    /// An image is not one of a pinhole of its size, or its arrays differ in length.
    #[error("depth image {index}: {reason}")]
    Frame {
        /// Number of the image, from 0.
        index: usize,
        /// The property found and the one expected.
        reason: String,
    },
    /// No pixel of any image shows a surface.
    #[error("no pixel shows a surface: coverage is below {least_alpha} everywhere, or depths have no end")]
    NoSurface {
        /// Coverage from which on a pixel shows something.
        least_alpha: f32,
    },
    /// A length is not a positive finite number.
    #[error("{name} is {value}, expected a length above 0")]
    Length {
        /// Name of the length.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// The volume would take more memory than allowed.
    #[error("voxels of {voxel:.3e} make a volume of more than {limit_mebibytes} MiB, the limit; the scene is about {extent:.3e} across")]
    TooLarge {
        /// Side of a voxel.
        voxel: f64,
        /// Diagonal of the scene.
        extent: f64,
        /// Memory allowed.
        limit_mebibytes: u64,
    },
    /// No place is seen at the same depth by enough images.
    #[error("no place is seen at the same depth by {least} of the {frames} depth images")]
    Empty {
        /// Number of images.
        frames: usize,
        /// Number of images that have to see a surface.
        least: usize,
    },
    /// All of the surface is in small islands.
    #[error("all {islands} parts of the surface are less than {min_island:.3e} across, the size from which on they are kept")]
    OnlyIslands {
        /// Number of islands.
        islands: usize,
        /// Diagonal from which on an island is kept.
        min_island: f64,
    },
}

impl MeshError {
    /// Returns the error with its lengths in another unit, of which one of these has `unit`.
    #[must_use]
    pub fn scaled(self, unit: f64) -> Self {
        match self {
            Self::Length { name, value } => Self::Length { name, value: unit * value },
            Self::TooLarge { voxel, extent, limit_mebibytes } => {
                Self::TooLarge { voxel: unit * voxel, extent: unit * extent, limit_mebibytes }
            }
            Self::OnlyIslands { islands, min_island } => Self::OnlyIslands { islands, min_island: unit * min_island },
            other => other,
        }
    }
}
