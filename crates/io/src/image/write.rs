//! Images out: OpenEXR for radiance, PNG for previews. Files are there whole or not at all.

use std::io::Cursor;
use std::path::Path;

use ::exr::error::Error as ExrError;
use ::exr::image::{AnyChannel, AnyChannels, Blocks, Encoding, FlatSamples, Image as ExrImage, Layer};
use ::exr::meta::attribute::{AttributeValue, Chromaticities, Compression, LineOrder, Text};
use ::exr::meta::header::LayerAttributes;
use ::exr::prelude::{Vec2, WritableImage, f16};
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use luxel_core::{ColorSpace, Image};

use crate::{IoError, WriteSeek, write_atomically};

/// Precision of a written OpenEXR file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ExrSample {
    /// 16 bits: 11 of mantissa, up to 65504.
    #[default]
    Half,
    /// 32 bits, as in memory.
    Float,
}

/// How to write an OpenEXR file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ExrOptions {
    /// Precision.
    pub sample: ExrSample,
    /// Space of the pixels; its chromaticities are written.
    pub color_space: ColorSpace,
    /// Further string attributes: name and value.
    pub attributes: Vec<(String, String)>,
}

/// Largest finite number of [`ExrSample::Half`].
pub const HALF_MAX: f32 = 65504.0;

/// Writes R, G, B with ZIP compression in blocks of 16 lines. Returns how many values were above the range of
/// [`ExrSample::Half`] and are written as its largest number.
///
/// # Errors
/// The system's, or the image is empty or an attribute's name is empty or longer than 255 bytes.
pub fn write_exr(path: &Path, image: &Image, options: &ExrOptions) -> Result<usize, IoError> {
    write_atomically(path, |out| encode_exr_to(path, image, options, out))?;
    Ok(out_of_range(image, options.sample))
}

/// [`write_exr`] into memory; `name` is for messages only.
///
/// # Errors
/// As [`write_exr`].
pub fn encode_exr(name: &Path, image: &Image, options: &ExrOptions) -> Result<Vec<u8>, IoError> {
    let mut out = Cursor::new(Vec::new());
    encode_exr_to(name, image, options, &mut out)?;
    Ok(out.into_inner())
}

fn out_of_range(image: &Image, sample: ExrSample) -> usize {
    match sample {
        ExrSample::Half => image.pixels.as_flattened().iter().filter(|value| value.abs() > HALF_MAX).count(),
        ExrSample::Float => 0,
    }
}

fn encode_exr_to(name: &Path, image: &Image, options: &ExrOptions, out: &mut (dyn WriteSeek + '_)) -> Result<(), IoError> {
    let (width, height) = (image.width, image.height);
    if width == 0 || height == 0 || image.pixels.len() != width * height {
        return Err(IoError::invalid(name, format!("{} pixels in an image of {width} x {height}, nothing to write", image.pixels.len())));
    }
    let mut attributes = LayerAttributes { software_name: Some(Text::from("Luxel")), ..LayerAttributes::default() };
    for (key, value) in &options.attributes {
        let key = Text::new_or_none(key).filter(|_| !key.is_empty() && key.len() <= 255);
        let value = Text::new_or_none(value);
        let (Some(key), Some(value)) = (key, value) else {
            return Err(IoError::invalid(name, "attribute names need 1 to 255 bytes, names and values Latin letters"));
        };
        attributes.other.insert(key, AttributeValue::Text(value));
    }
    let encoding = Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let plane = |c: usize| match options.sample {
        ExrSample::Half => FlatSamples::F16(image.pixels.iter().map(|pixel| to_half(pixel[c])).collect()),
        ExrSample::Float => FlatSamples::F32(image.pixels.iter().map(|pixel| pixel[c]).collect()),
    };
    let channels = [("R", 0), ("G", 1), ("B", 2)].map(|(channel, c)| AnyChannel::new(channel, plane(c)));
    let layer = Layer::new((width, height), attributes, encoding, AnyChannels::sort(channels.into_iter().collect()));
    let mut file = ExrImage::from_layer(layer);
    let [red, green, blue, white] = options.color_space.chromaticities().map(|[x, y]| Vec2(x, y));
    file.attributes.chromaticities = Some(Chromaticities { red, green, blue, white });
    let writer = file.write();
    let writer = if image.pixels.len() < PARALLEL_PIXELS { writer.non_parallel() } else { writer };
    writer.to_buffered(&mut *out).map_err(|error| match error {
        ExrError::Io(error) => IoError::system(name, "write", &error),
        other => IoError::invalid(name, format!("OpenEXR: {other}")),
    })
}

/// Pixels from which on compression is worth a pool of threads.
const PARALLEL_PIXELS: usize = 1 << 20;

/// Nearest half; what is out of range becomes the largest one, so that no infinity comes about.
fn to_half(value: f32) -> f16 {
    f16::from_f32(if value.is_nan() { value } else { value.clamp(-HALF_MAX, HALF_MAX) })
}

/// Writes an 8-bit sRGB preview of `width * height` pixels, row-major.
///
/// # Errors
/// The system's, or the number of bytes is not `3 * width * height`.
pub fn write_png(path: &Path, width: usize, height: usize, rgb8: &[u8]) -> Result<(), IoError> {
    let bytes = encode_png(width, height, rgb8).map_err(|e| IoError::invalid(path, e.message))?;
    write_atomically(path, |out| out.write_all(&bytes).map_err(|e| IoError::system(path, "write", &e)))
}

/// [`write_png`] into memory.
///
/// # Errors
/// As [`write_png`].
pub fn encode_png(width: usize, height: usize, rgb8: &[u8]) -> Result<Vec<u8>, IoError> {
    /// Where the header chunk ends: signature 8, length 4, kind 4, content 13, checksum 4.
    const AFTER_HEADER: usize = 33;
    /// Length, kind, rendering intent "perceptual", checksum: so that viewers do not guess the curve.
    const SRGB_CHUNK: [u8; 13] = *b"\x00\x00\x00\x01sRGB\x00\xae\xce\x1c\xe9";
    let name = Path::new("preview.png");
    let size = (u32::try_from(width).ok(), u32::try_from(height).ok());
    let expected = width.checked_mul(height).and_then(|n| n.checked_mul(3));
    let (Some(width32), Some(height32), true) = (size.0, size.1, expected == Some(rgb8.len())) else {
        return Err(IoError::invalid(name, format!("{} bytes for {width} x {height} pixels, expected 3 a pixel", rgb8.len())));
    };
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(rgb8, width32, height32, ExtendedColorType::Rgb8)
        .map_err(|e| IoError::invalid(name, format!("PNG: {e}")))?;
    if bytes.len() > AFTER_HEADER {
        bytes.splice(AFTER_HEADER..AFTER_HEADER, SRGB_CHUNK);
    }
    Ok(bytes)
}
