//! What the passes need of a camera, in f32.

use luxel_core::engine::JACOBIAN_MARGIN;
use luxel_core::{Antialias, Camera, CameraError, Cutoffs, MAX_SAMPLES, RenderOptions};

/// Side of a block, pixels: its 16 pixels are a vector of [`crate::lanes::LANES`], row-major.
pub(crate) const BLOCK_PX: usize = 4;
/// Blocks along the side of a tile.
pub(crate) const TILE_BLOCKS: usize = 8;
/// Side of a tile, pixels.
pub(crate) const TILE_PX: usize = BLOCK_PX * TILE_BLOCKS;
/// Blocks of a tile, row-major.
pub(crate) const BLOCKS: usize = TILE_BLOCKS * TILE_BLOCKS;

/// A camera and the options it renders with. With several samples a pixel it is that of the samples.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScreenCamera {
    /// Rows of the rotation of camera_from_world.
    pub(crate) rotation: [[f32; 3]; 3],
    pub(crate) translation: [f32; 3],
    pub(crate) eye: [f32; 3],
    pub(crate) focal_px: [f32; 2],
    pub(crate) center_px: [f32; 2],
    pub(crate) size_px: [usize; 2],
    /// Of these along the side of a pixel of the image.
    pub(crate) samples: usize,
    /// Range of x/z (and y/z) in which the Jacobian is evaluated.
    pub(crate) slope_min: [f32; 2],
    pub(crate) slope_max: [f32; 2],
    pub(crate) cutoffs: Cutoffs,
    pub(crate) antialias: Antialias,
    pub(crate) background: [f32; 3],
    pub(crate) active_degree: usize,
}

impl ScreenCamera {
    pub(crate) fn new(camera: &Camera, options: &RenderOptions) -> Result<Self, CameraError> {
        let samples = options.raster.samples.clamp(1, MAX_SAMPLES);
        let camera = camera.upscaled(samples.into());
        camera.validate()?;
        let pose = camera.camera_from_world;
        let rows = pose.matrix3.transpose().to_cols_array_2d();
        let focal = camera.focal_px.to_array();
        let center = camera.center_px.to_array();
        let size = camera.size_px.map(f64::from);
        let margin = [0, 1].map(|i| JACOBIAN_MARGIN * size[i] / (2.0 * focal[i]));
        Ok(Self {
            rotation: rows.map(|row| row.map(|v| v as f32)),
            translation: pose.translation.to_array().map(|v| v as f32),
            eye: camera.eye().to_array().map(|v| v as f32),
            focal_px: focal.map(|v| v as f32),
            center_px: center.map(|v| v as f32),
            size_px: camera.size_px.map(|s| s as usize),
            samples: samples.into(),
            slope_min: [0, 1].map(|i| (-center[i] / focal[i] - margin[i]) as f32),
            slope_max: [0, 1].map(|i| ((size[i] - center[i]) / focal[i] + margin[i]) as f32),
            cutoffs: options.raster.cutoffs,
            antialias: options.raster.antialias,
            background: options.background,
            active_degree: options.active_degree,
        })
    }

    /// Of the image, for what looks at nothing but its size.
    pub(crate) fn shown(&self) -> Self {
        Self { size_px: self.size_px.map(|s| s / self.samples), samples: 1, ..*self }
    }

    /// Tiles across and down.
    pub(crate) fn tiles(&self) -> [usize; 2] {
        self.size_px.map(|s| s.div_ceil(TILE_PX))
    }

    /// Top left pixel of a tile.
    #[inline(always)]
    pub(crate) fn tile_origin_px(&self, tile: usize) -> [usize; 2] {
        let across = self.tiles()[0];
        [tile % across * TILE_PX, tile / across * TILE_PX]
    }
}

/// Block (of a tile) and lane (of the block) of a tile's pixel.
#[inline(always)]
pub(crate) fn block_of(x: usize, y: usize) -> (usize, usize) {
    (y / BLOCK_PX * TILE_BLOCKS + x / BLOCK_PX, y % BLOCK_PX * BLOCK_PX + x % BLOCK_PX)
}

// The pixels of a block are a vector.
const _: () = assert!(BLOCK_PX * BLOCK_PX == crate::lanes::LANES);
