//! Differentiable rasterisation for programs that own the loss and the optimiser, in two stages:
//! splats to ellipses on the screen, and ellipses to pixels of any number of channels.
//!
//! In: splats with activated parameters, cameras as matrices, channels of each splat. Out: images,
//! and gradients by everything that went in. The stages are apart so that a program can look at the
//! ellipses, add a loss on them, and read their gradients: densification needs those of the means.
//! Each stage returns a handle that owns what its backward pass needs. Handles outlive the engine's
//! later work, and a backward pass may run more than once.
//!
//! Numbers are in f32. Gradients by splats are sums over cameras, from the first to the last: the
//! same bits for any number of threads. Degenerate: splats with a number that is not finite are
//! culled and have zero gradients.

use super::{Cutoffs, EngineError};
use crate::{ColorModel, MAX_SIDE_PX};

/// Splats with the parameters that the rasteriser sees, after any activation.
#[derive(Clone, Copy, Debug)]
pub struct ActivatedSplats<'a> {
    /// World units, `[N]`.
    pub position: &'a [[f32; 3]],
    /// Quaternions w, x, y, z of any length, `[N]`.
    pub rotation: &'a [[f32; 4]],
    /// Standard deviations along the axes, world units, `[N]`; may be 0.
    pub scale: &'a [[f32; 3]],
    /// Opacities, 0 to 1, `[N]`.
    pub opacity: &'a [f32],
}

impl ActivatedSplats<'_> {
    /// Returns the number of splats.
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// Returns whether there are no splats.
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }

    /// Checks that all arrays have the same length.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] names the array and both lengths.
    pub fn validate(&self) -> Result<(), EngineError> {
        let lengths = [("rotations", self.rotation.len()), ("scales", self.scale.len()), ("opacities", self.opacity.len())];
        lengths.into_iter().try_for_each(|(name, len)| check_len(name, len, self.len()))
    }
}

/// A pinhole camera whose map from the world is any affine one, as optimisers of poses make them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatrixCamera {
    /// Rows of the map from world to camera; x right, y down, z forward.
    pub camera_from_world: [[f32; 4]; 3],
    /// Focal lengths.
    pub focal_px: [f32; 2],
    /// Principal point; pixel centres are at +0.5.
    pub center_px: [f32; 2],
}

/// Settings that decide which splats are blended, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlendOptions {
    /// Width and height of every image.
    pub size_px: [u32; 2],
    /// Limits at which the rasteriser stops. No threshold depends on channels:
    /// `min_contribution` is ignored here.
    pub cutoffs: Cutoffs,
    /// Depth beyond which splats are culled, world units.
    pub far: f32,
    /// Splats are culled if neither of their radii is larger.
    pub min_radius_px: f32,
    /// Dilation of the screen covariance, px^2.
    pub dilation_px2: f32,
    /// Whether opacity shrinks by as much as dilation widens a splat.
    pub compensates_opacity: bool,
}

impl BlendOptions {
    /// The limits of gsplat 1.5 with its defaults, for images of a size.
    pub fn gsplat(size_px: [u32; 2]) -> Self {
        Self { size_px, cutoffs: Cutoffs::GSPLAT, far: 1e10, min_radius_px: 0.0, dilation_px2: 0.3, compensates_opacity: false }
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] names the option, its range and its value.
    pub fn validate(&self) -> Result<(), EngineError> {
        let [width, height] = self.size_px;
        if self.size_px.iter().any(|side| *side == 0 || *side > MAX_SIDE_PX) {
            let message = format!("image size {width} x {height}, expected 1 to {MAX_SIDE_PX} pixels a side");
            return Err(EngineError::invalid(message));
        }
        let at_least_zero = [
            ("near plane", self.cutoffs.near),
            ("far plane", self.far),
            ("smallest radius", self.min_radius_px),
            ("dilation", self.dilation_px2),
        ];
        match at_least_zero.into_iter().find(|(_, value)| value.is_nan() || *value < 0.0) {
            Some((name, value)) => Err(EngineError::invalid(format!("{name} is {value}, expected 0 or more"))),
            None => Ok(()),
        }
    }
}

/// Splats on the screens of all cameras, `[C, N]` each, camera by camera. Zero where a splat is
/// culled.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ScreenEllipses {
    /// Centres, pixels.
    pub mean_px: Vec<[f32; 2]>,
    /// Covariance with dilation: xx, xy, yy; px^2.
    pub covariance_px2: Vec<[f32; 3]>,
    /// Inverse of the covariance: xx, xy, yy; px^-2.
    pub conic: Vec<[f32; 3]>,
    /// Distance along the viewing axis, world units.
    pub depth: Vec<f32>,
    /// Opacity, with compensation if it is on.
    pub opacity: Vec<f32>,
    /// Half the sides of a box around all pixels that the splat may change; whole numbers, 0 if
    /// culled.
    pub radius_px: Vec<[i32; 2]>,
}

/// The numbers that a splat's shape is differentiated by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ShapeParameters {
    /// Rotation and scale.
    #[default]
    RotationAndScale,
    /// The covariance in the world.
    Covariance,
}

/// Whether a backward pass computes the gradient by the cameras.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CameraMatrices {
    /// It does.
    #[default]
    Differentiate,
    /// It does not, which saves time.
    Skip,
}

/// The gradient by [`ScreenEllipses`]; absent parts are zero.
#[derive(Clone, Copy, Debug, Default)]
pub struct EllipseGradient<'a> {
    /// By the centres.
    pub mean_px: Option<&'a [[f32; 2]]>,
    /// By the covariance; the off-diagonal number stands for both entries.
    pub covariance_px2: Option<&'a [[f32; 3]]>,
    /// By the inverse of the covariance, in the same way.
    pub conic: Option<&'a [[f32; 3]]>,
    /// By the depth.
    pub depth: Option<&'a [f32]>,
    /// By the opacity on the screen.
    pub opacity: Option<&'a [f32]>,
    /// Parameters of the splats' shapes that the gradient is wanted by.
    pub shape: ShapeParameters,
    /// Whether [`SplatGradient::camera_from_world`] is wanted.
    pub cameras: CameraMatrices,
}

/// The gradient by [`ActivatedSplats`] and cameras.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SplatGradient {
    /// `[N]`.
    pub position: Vec<[f32; 3]>,
    /// By the quaternion as it was given, `[N]`; empty if the covariance was wanted.
    pub rotation: Vec<[f32; 4]>,
    /// `[N]`; empty if the covariance was wanted.
    pub scale: Vec<[f32; 3]>,
    /// By the covariance in the world, xx, xy, xz, yy, yz, zz, of which the off-diagonal numbers
    /// stand for both entries; world units^-2, `[N]`. Empty unless wanted.
    pub covariance: Vec<[f32; 6]>,
    /// `[N]`.
    pub opacity: Vec<f32>,
    /// By [`MatrixCamera::camera_from_world`], each of the twelve numbers by itself, `[C]`; empty
    /// unless wanted.
    pub camera_from_world: Vec<[[f32; 4]; 3]>,
}

/// The channels that are blended.
#[derive(Clone, Copy, Debug)]
pub struct Channels<'a> {
    /// Any numbers, `[N, K]` for all cameras, or `[C, N, K]`.
    pub values: &'a [f32],
    /// K, at least 1.
    pub count: usize,
    /// Numbers behind the splats, `[C, K]`; zero if absent.
    pub background: Option<&'a [f32]>,
}

/// Blended images.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BlendedPixels {
    /// `[C, H, W, K]`.
    pub channels: Vec<f32>,
    /// Coverage by splats, 0 to 1, `[C, H, W]`.
    pub alpha: Vec<f32>,
}

/// Whether a backward pass sums absolute gradients by the means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AbsoluteMeans {
    /// It does not.
    #[default]
    Skip,
    /// It does, over pixels, as AbsGS (Ye et al. 2024).
    Collect,
}

/// The gradient by [`BlendedPixels`].
#[derive(Clone, Copy, Debug)]
pub struct PixelGradient<'a> {
    /// `[C, H, W, K]`.
    pub channels: &'a [f32],
    /// `[C, H, W]`; zero if absent.
    pub alpha: Option<&'a [f32]>,
    /// Whether [`BlendGradient::absolute_mean_px`] is wanted.
    pub absolute: AbsoluteMeans,
}

/// The gradient by what was blended. The parts by ellipses are `[C, N]` as [`ScreenEllipses`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BlendGradient {
    /// By the centres.
    pub mean_px: Vec<[f32; 2]>,
    /// By the covariance; the off-diagonal number stands for both entries.
    pub covariance_px2: Vec<[f32; 3]>,
    /// By the opacity on the screen.
    pub opacity: Vec<f32>,
    /// By the channels, in their layout.
    pub channels: Vec<f32>,
    /// By the background, `[C, K]`; empty if none was given.
    pub background: Vec<f32>,
    /// Sums over pixels of absolute gradients by the centres; empty unless wanted.
    pub absolute_mean_px: Vec<[f32; 2]>,
}

/// Colours that depend on the direction from which a splat is seen.
#[derive(Clone, Copy, Debug)]
pub struct DirectionalColors<'a> {
    /// The formula that turns coefficients into radiance.
    pub model: ColorModel,
    /// Highest degree evaluated.
    pub active_degree: usize,
    /// World units, `[N]`.
    pub position: &'a [[f32; 3]],
    /// Centres of the cameras, world units, `[C]`.
    pub eye: &'a [[f32; 3]],
    /// Harmonics, `[N, K, 3]` or `[C, N, K, 3]`, K at least what the model has.
    pub sh: &'a [f32],
    /// K.
    pub sh_per_splat: usize,
    /// Raw luminance of the model, `[N, M]` with the model's M; empty if it has none.
    pub raw_luminance: &'a [f32],
    /// Whether a camera sees a splat, `[C, N]`: colours of others are zero and have no gradient.
    /// All are evaluated if absent.
    pub visible: Option<&'a [bool]>,
}

impl DirectionalColors<'_> {
    /// Checks lengths and degrees.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] names the array and both lengths.
    pub fn validate(&self) -> Result<(), EngineError> {
        let (count, needed) = (self.position.len(), self.model.sh_coefficients());
        if !self.model.is_valid() || self.sh_per_splat < needed {
            let message = format!("{} harmonics per splat, but {} needs {needed}", self.sh_per_splat, self.model.name());
            return Err(EngineError::invalid(message));
        }
        let sh = 3 * self.sh_per_splat * count;
        if self.sh.len() != sh * self.eye.len() {
            check_len("harmonics", self.sh.len(), sh)?;
        }
        check_len("raw luminance", self.raw_luminance.len(), count * self.model.luminance_coefficients())?;
        self.visible.map_or(Ok(()), |visible| check_len("visibility", visible.len(), count * self.eye.len()))
    }
}

/// The gradient by [`DirectionalColors`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ColorGradient {
    /// Through the direction, `[N]`.
    pub position: Vec<[f32; 3]>,
    /// Through the direction, `[C]`.
    pub eye: Vec<[f32; 3]>,
    /// In the layout of the harmonics.
    pub sh: Vec<f32>,
    /// In the layout of the raw luminance.
    pub raw_luminance: Vec<f32>,
}

/// Checks the length of an array.
///
/// # Errors
/// [`EngineError::Invalid`] names the array and both lengths.
pub fn check_len(name: &str, found: usize, expected: usize) -> Result<(), EngineError> {
    if found == expected {
        Ok(())
    } else {
        Err(EngineError::invalid(format!("{name}: expected {expected} numbers or rows, found {found}")))
    }
}

/// A rasteriser with gradients.
pub trait Differentiable {
    /// Projects splats to the screens of cameras.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] for arrays of different lengths, and options and cameras out of
    /// range; [`EngineError::Device`] if there is not enough memory.
    fn project(
        &self,
        splats: &ActivatedSplats<'_>,
        cameras: &[MatrixCamera],
        options: &BlendOptions,
    ) -> Result<(ScreenEllipses, Box<dyn ProjectedSplats>), EngineError>;

    /// Evaluates colours towards cameras: linear radiance, `[C, N]`.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] for arrays of wrong lengths.
    fn colors(&self, colors: &DirectionalColors<'_>) -> Result<Vec<[f32; 3]>, EngineError>;

    /// Returns the gradient by what colours are made of, from that by the colours, `[C, N]`.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] for arrays of wrong lengths.
    fn colors_backward(&self, colors: &DirectionalColors<'_>, gradient: &[[f32; 3]]) -> Result<ColorGradient, EngineError>;

    /// Takes the memory of a result that is no longer needed, for a later result of the same size.
    /// Optional: fresh memory costs as much time as a pass over it.
    fn recycle(&self, numbers: Vec<f32>);
}

/// Splats on screens, with what blending and the backward pass need.
pub trait ProjectedSplats: Send + Sync {
    /// Blends the ellipses front to back.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] for arrays of wrong lengths; [`EngineError::Device`] if there is
    /// not enough memory.
    fn blend(&self, channels: &Channels<'_>) -> Result<(BlendedPixels, Box<dyn BlendedSplats>), EngineError>;

    /// Returns the gradient by splats and cameras, from that by the ellipses.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] for arrays of wrong lengths.
    fn backward(&self, gradient: &EllipseGradient<'_>) -> Result<SplatGradient, EngineError>;
}

/// Blended images, with what the backward pass needs.
pub trait BlendedSplats: Send + Sync {
    /// Returns the gradient by what was blended, from that by the pixels.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] for arrays of wrong lengths.
    fn backward(&self, gradient: &PixelGradient<'_>) -> Result<BlendGradient, EngineError>;
}
