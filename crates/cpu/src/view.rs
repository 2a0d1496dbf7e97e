//! The camera as the passes use it, in f32; tiles and blocks of pixels.
//!
//! In: [`Camera`], [`RenderOptions`]. Out: [`ScreenCamera`]. Degenerate: an invalid camera is an
//! error, and the number of samples is clamped to the range that core allows.

use std::sync::Arc;

use fearless_simd::Simd;
use luxel_core::engine::{BlendOptions, Dropout, JACOBIAN_MARGIN, MatrixCamera, ParameterRows};
use luxel_core::{Antialias, Camera, CameraError, Cutoffs, MAX_SAMPLES, Real, RenderOptions, each};

use crate::lanes::{Lanes, V, dot};
use crate::rays::{Lenses, RayTable};
pub(crate) use crate::tiles::{BLOCK_PX, BLOCKS, TILE_BLOCKS, TILE_PX};

/// The treatment of splats smaller than a pixel: see [`Antialias`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScreenFilter {
    /// Dilation of the screen covariance.
    pub(crate) dilation_px2: f32,
    /// Whether opacity shrinks by as much as dilation widens a splat.
    pub(crate) compensates_opacity: bool,
    /// Whether the 3D filter of the scene applies.
    pub(crate) smooths: bool,
}

impl ScreenFilter {
    fn new(antialias: Antialias) -> Self {
        Self {
            dilation_px2: antialias.dilation_px2(),
            compensates_opacity: antialias.compensates_opacity(),
            smooths: antialias == Antialias::Mip,
        }
    }
}

/// A camera with its render options. With supersampling, its pixels are the samples.
#[derive(Clone, Debug)]
pub(crate) struct ScreenCamera {
    /// Rows of the rotation of camera_from_world.
    pub(crate) rotation: [[f32; 3]; 3],
    pub(crate) translation: [f32; 3],
    pub(crate) eye: [f32; 3],
    pub(crate) focal_px: [f32; 2],
    pub(crate) center_px: [f32; 2],
    pub(crate) size_px: [usize; 2],
    /// Samples along the side of an image pixel.
    pub(crate) samples: usize,
    /// Range of x/z (and y/z) in which the Jacobian is evaluated.
    pub(crate) slope_min: [f32; 2],
    pub(crate) slope_max: [f32; 2],
    pub(crate) cutoffs: Cutoffs,
    pub(crate) filter: ScreenFilter,
    pub(crate) background: [f32; 3],
    pub(crate) active_degree: usize,
    /// Splats that are left out.
    pub(crate) dropout: Option<Dropout>,
    /// Number of the light that is rendered, 0 for the first: see [`luxel_core::Mix`].
    pub(crate) light: usize,
    /// The rays of the pixels; `None` for a pinhole.
    pub(crate) rays: Option<Arc<RayTable>>,
}

impl ScreenCamera {
    /// Converts a camera; `lenses` keeps the rays of those that were used last.
    pub(crate) fn new(camera: &Camera, options: &RenderOptions, lenses: &mut Lenses) -> Result<Self, CameraError> {
        let samples = options.raster.samples.clamp(1, MAX_SAMPLES);
        let camera = camera.upscaled(samples.into());
        camera.validate()?;
        let rays = (!camera.projection.is_pinhole()).then(|| lenses.rays(&camera));
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
            filter: ScreenFilter::new(options.raster.antialias),
            background: options.background,
            active_degree: options.active_degree,
            dropout: None,
            light: 0,
            rays,
        })
    }

    /// Converts a camera that is a matrix. The background is zero.
    pub(crate) fn from_matrix(camera: &MatrixCamera, options: &BlendOptions) -> Self {
        let MatrixCamera { camera_from_world: rows, focal_px: focal, center_px: center } = *camera;
        let size = options.size_px.map(|side| side as f32);
        let margin = [0, 1].map(|i| JACOBIAN_MARGIN as f32 * size[i] / (2.0 * focal[i]));
        Self {
            rotation: rows.map(|[x, y, z, _]| [x, y, z]),
            translation: rows.map(|[.., offset]| offset),
            // Only colours need it, which are given.
            eye: [0.0; 3],
            focal_px: focal,
            center_px: center,
            size_px: options.size_px.map(|side| side as usize),
            samples: 1,
            slope_min: [0, 1].map(|i| -center[i] / focal[i] - margin[i]),
            slope_max: [0, 1].map(|i| (size[i] - center[i]) / focal[i] + margin[i]),
            cutoffs: Cutoffs {
                min_contribution: f32::INFINITY,
                alpha_floor: options.cutoffs.min_alpha,
                // A depth of zero would divide by zero.
                near: options.cutoffs.near.max(f32::MIN_POSITIVE),
                ..options.cutoffs
            },
            filter: ScreenFilter { dilation_px2: options.dilation_px2, compensates_opacity: options.compensates_opacity, smooths: false },
            background: [0.0; 3],
            active_degree: 0,
            dropout: None,
            light: 0,
            rays: None,
        }
    }

    /// Returns the camera for light `light` of `lights`, whose images add to the image: each has
    /// its part of the background.
    pub(crate) fn for_light(&self, light: usize, lights: usize) -> Self {
        Self { light, background: self.background.map(|c| c / lights as f32), ..self.clone() }
    }

    /// Returns the camera of the image's own pixels. Only its size may be used: the other fields
    /// still belong to the samples.
    pub(crate) fn without_supersampling(&self) -> Self {
        Self { size_px: self.size_px.map(|s| s / self.samples), samples: 1, ..self.clone() }
    }

    /// Returns the number of tiles across and down.
    pub(crate) fn tiles(&self) -> [usize; 2] {
        self.size_px.map(|s| s.div_ceil(TILE_PX))
    }

    /// Returns the top left pixel of a tile.
    #[inline(always)]
    pub(crate) fn tile_origin_px(&self, tile: usize) -> [usize; 2] {
        let across = self.tiles()[0];
        [tile % across * TILE_PX, tile / across * TILE_PX]
    }
}

/// Returns the block (of a tile) and the lane (of the block) of a tile's pixel.
#[inline(always)]
pub(crate) fn block_of(x: usize, y: usize) -> (usize, usize) {
    (y / BLOCK_PX * TILE_BLOCKS + x / BLOCK_PX, y % BLOCK_PX * BLOCK_PX + x % BLOCK_PX)
}

/// A block of a tile, by number, with its place on the screen.
#[derive(Clone, Copy)]
pub(crate) struct ScreenBlock {
    /// Top left pixel of the tile.
    pub(crate) origin_px: [usize; 2],
    /// Number of the block within the tile.
    pub(crate) index: usize,
}

/// Directions from the camera to the splats of a block.
pub(crate) struct ViewDirection<S: Simd> {
    /// Unit vectors.
    pub(crate) unit: [V<S>; 3],
    /// Reciprocals of the distances.
    pub(crate) inverse_distance: V<S>,
}

impl<S: Simd> ViewDirection<S> {
    /// Computes the directions from the position rows of a block.
    #[inline(always)]
    pub(crate) fn new(simd: S, camera: &ScreenCamera, rows: &[Lanes]) -> Self {
        let offset = each!([0, 1, 2] i => V::load(simd, &rows[ParameterRows::POSITION + i]) - camera.eye[i]);
        let inverse_distance = V::splat(simd, 1.0) / dot(offset, offset).max(V::splat(simd, 1e-30)).sqrt();
        Self { unit: each!([0, 1, 2] i => { let v = offset[i]; v * inverse_distance }), inverse_distance }
    }
}
