//! Choices of a written OpenEXR file: precision, channels beside radiance, attributes.

use ::exr::prelude::f16;
use luxel_core::environment::Projection;
use luxel_core::{Camera, ColorSpace, Image};

/// Precision of a written OpenEXR file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ExrSample {
    /// 16 bits: 11 of mantissa, up to 65504.
    #[default]
    Half,
    /// 32 bits, as in memory.
    Float,
}

impl ExrSample {
    /// Returns half floats, or 32 bits where a value of the image is beyond their range.
    ///
    /// ```
    /// use luxel_core::Image;
    /// use luxel_io::ExrSample;
    ///
    /// assert_eq!(ExrSample::smallest_for(&Image::filled(1, 1, [65504.0; 3])), ExrSample::Half);
    /// assert_eq!(ExrSample::smallest_for(&Image::filled(1, 1, [1e5; 3])), ExrSample::Float);
    /// ```
    pub fn smallest_for(image: &Image) -> Self {
        if out_of_range(image, Self::Half) > 0 { Self::Float } else { Self::Half }
    }
}

/// How to write an OpenEXR file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExrOptions {
    /// Precision.
    pub sample: ExrSample,
    /// Space of the pixels; its chromaticities are written, and its name as `colorInteropID`.
    pub color_space: ColorSpace,
    /// Further string attributes: name and value.
    pub attributes: Vec<(String, String)>,
    /// Further attributes that are numbers: name and value.
    pub numbers: Vec<(String, f32)>,
    /// Camera of the image: `worldToCamera` (axes right, up, back), the lens in `luxel:focal_px`
    /// and `luxel:center_px`, `worldToNDC` and the screen window if it is a pinhole, else
    /// `luxel:projection`.
    pub camera: Option<Camera>,
    /// Frame rate of a sequence that the image is part of: `framesPerSecond`.
    pub frames_per_second: Option<u32>,
    /// Projection of an image that is a map of directions.
    pub environment: Option<Projection>,
    /// Channel A, `[H*W]`: linear opacity; colours should be premultiplied by it.
    pub alpha: Option<Vec<f32>>,
    /// Channel Z, `[H*W]`, always of 32 bits: distance along the viewing axis, world units.
    pub depth: Option<Vec<f32>>,
    /// Channels N.X, N.Y, N.Z, `[H*W]`, always of 32 bits: unit normals of the world.
    pub normals: Option<Vec<[f32; 3]>>,
    /// Further channels, always of 32 bits.
    pub planes: Vec<ExrPlane>,
}

/// A channel beside radiance.
#[derive(Clone, Debug, PartialEq)]
pub struct ExrPlane {
    /// Its name, with its layer: `forward.u`.
    pub name: String,
    /// Its values.
    pub values: PlaneValues,
}

/// Values of a channel, `[H*W]`, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub enum PlaneValues {
    /// Floats.
    Float(Vec<f32>),
    /// Unsigned integers.
    Whole(Vec<u32>),
}

impl PlaneValues {
    /// Returns the number of values.
    pub(super) fn len(&self) -> usize {
        match self {
            Self::Float(values) => values.len(),
            Self::Whole(values) => values.len(),
        }
    }
}

/// Largest finite number of [`ExrSample::Half`].
pub const HALF_MAX: f32 = 65504.0;

/// Returns the nearest half; values out of range become the largest one, so that no infinity
/// comes about.
pub(super) fn to_half(value: f32) -> f16 {
    f16::from_f32(if value.is_nan() { value } else { value.clamp(-HALF_MAX, HALF_MAX) })
}

pub(super) fn out_of_range(image: &Image, sample: ExrSample) -> usize {
    match sample {
        ExrSample::Half => image.pixels.as_flattened().iter().filter(|value| value.abs() > HALF_MAX).count(),
        ExrSample::Float => 0,
    }
}
