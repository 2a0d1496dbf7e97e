//! Images out: OpenEXR for radiance, PNG for previews. Files are there whole or not at all.

use std::io::Cursor;
use std::path::Path;

use ::exr::error::Error as ExrError;
use ::exr::image::{Blocks, Encoding, Image as ExrImage, Layer};
use ::exr::meta::attribute::{AttributeValue, Chromaticities, Compression, EnvironmentMap, LineOrder, Text};
use ::exr::meta::header::LayerAttributes;
use ::exr::prelude::{Vec2, WritableImage};
use glam::{DMat3, DMat4, DVec2, DVec3, DVec4};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use luxel_core::environment::Projection;
use luxel_core::{Camera, Image};

use super::display_encoding::DisplayEncoding;
use super::exr_header::sort_attributes;
use super::exr_lines::ImageChannels;
use super::exr_options::{ExrOptions, out_of_range};
use super::interop_id;
use super::png_chunks::insert;
use crate::{IoError, write_atomically};

/// Writes R, G, B (and A, Z and N if there are any) with ZIP compression in blocks of 16 lines.
/// Returns how many values were above the range of [`ExrSample::Half`](crate::ExrSample::Half) and
/// are written as its largest number.
///
/// ```
/// use luxel_core::Image;
/// use luxel_io::{ExrOptions, ReadOptions, read_image, write_exr};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("lamp.exr");
/// // Radiance is not clamped: 300 stays 300.
/// let image = Image::filled(4, 2, [300.0, 0.25, 0.0]);
/// write_exr(&path, &image, &ExrOptions::default())?;
/// assert_eq!(read_image(&path, &ReadOptions::default())?.image, image);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The system's, or the image is empty or an attribute's name is empty or longer than 255 bytes.
pub fn write_exr(path: &Path, image: &Image, options: &ExrOptions) -> Result<usize, IoError> {
    let bytes = encode_exr(path, image, options)?;
    write_atomically(path, |out| out.write_all(&bytes).map_err(|e| IoError::system(path, "write", &e)))?;
    Ok(out_of_range(image, options.sample))
}

/// Encodes an image as [`write_exr`] writes it, into memory; `name` is for messages only. Equal
/// images and options give equal bytes.
///
/// # Errors
/// The same as [`write_exr`].
pub fn encode_exr(name: &Path, image: &Image, options: &ExrOptions) -> Result<Vec<u8>, IoError> {
    let (width, height) = (image.width, image.height);
    if width == 0 || height == 0 || image.pixels.len() != width * height {
        return Err(IoError::invalid(name, format!("{} pixels in an image of {width} x {height}, nothing to write", image.pixels.len())));
    }
    let count = image.pixels.len();
    let lengths = [options.alpha.as_ref().map(Vec::len), options.depth.as_ref().map(Vec::len), options.normals.as_ref().map(Vec::len)];
    let mut lengths = lengths.into_iter().flatten().chain(options.planes.iter().map(|plane| plane.values.len()));
    if let Some(found) = lengths.find(|found| *found != count) {
        return Err(IoError::invalid(name, format!("{found} values of a channel for {count} pixels")));
    }
    let encoding = Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let attributes = attributes(options).map_err(|message| IoError::invalid(name, message))?;
    let layer = Layer::new((width, height), attributes, encoding, ImageChannels::new(image, options));
    let mut file = ExrImage::from_layer(layer);
    let [red, green, blue, white] = options.color_space.chromaticities().map(|[x, y]| Vec2(x, y));
    file.attributes.chromaticities = Some(Chromaticities { red, green, blue, white });
    let writer = file.write();
    let writer = if image.pixels.len() < PARALLEL_PIXELS { writer.non_parallel() } else { writer };
    let mut out = Cursor::new(Vec::new());
    writer.to_buffered(&mut out).map_err(|error| match error {
        ExrError::Io(error) => IoError::system(name, "write", &error),
        other => IoError::invalid(name, format!("OpenEXR: {other}")),
    })?;
    let mut bytes = out.into_inner();
    sort_attributes(&mut bytes);
    Ok(bytes)
}

/// Returns everything but the pixels.
pub(super) fn attributes(options: &ExrOptions) -> Result<LayerAttributes, String> {
    let mut attributes = LayerAttributes { software_name: Some(Text::from("Luxel")), ..LayerAttributes::default() };
    let wrong = || "attribute names need 1 to 255 bytes, names and values Latin letters".to_owned();
    let key = |key: &str| Text::new_or_none(key).filter(|_| !key.is_empty() && key.len() <= 255).ok_or_else(wrong);
    for (name, value) in &options.attributes {
        attributes.other.insert(key(name)?, AttributeValue::Text(Text::new_or_none(value).ok_or_else(wrong)?));
    }
    for (name, value) in &options.numbers {
        attributes.other.insert(key(name)?, AttributeValue::F32(*value));
    }
    // The newer of two statements of the space: programs take another one where it is absent.
    let space = Text::new_or_none(interop_id::name(options.color_space)).ok_or_else(wrong)?;
    attributes.other.insert(Text::from(interop_id::ATTRIBUTE), AttributeValue::Text(space));
    attributes.frames_per_second = options.frames_per_second.and_then(|rate| Some((i32::try_from(rate).ok()?, 1)));
    attributes.environment_map = options.environment.map(|projection| match projection {
        Projection::LatitudeLongitude => EnvironmentMap::LatitudeLongitude,
        Projection::Cube => EnvironmentMap::Cube,
    });
    if let Some(camera) = &options.camera {
        attributes.world_to_camera = Some(world_to_camera(camera));
        for (name, v) in [("luxel:focal_px", camera.focal_px), ("luxel:center_px", camera.center_px)] {
            attributes.other.insert(key(name)?, AttributeValue::FloatVec2(Vec2(v.x as f32, v.y as f32)));
        }
        if camera.projection.is_pinhole() {
            attributes.world_to_normalized_device = Some(world_to_ndc(camera));
            let ScreenWindow { center, width } = ScreenWindow::new(camera);
            (attributes.screen_window_center, attributes.screen_window_width) = (center, width);
        } else {
            let name = Text::new_or_none(camera.projection.name()).ok_or_else(wrong)?;
            attributes.other.insert(key("luxel:projection")?, AttributeValue::Text(name));
        }
    }
    Ok(attributes)
}

/// Returns the camera matrix: OpenEXR's matrices take row vectors; its cameras look along -z, y up.
fn world_to_camera(camera: &Camera) -> [f32; 16] {
    let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let pose = camera.camera_from_world;
    let columns = DMat4::from_mat3_translation(flip * pose.matrix3, flip * pose.translation);
    // Columns of the one are rows of the other.
    columns.to_cols_array().map(|v| v as f32)
}

/// Returns the matrix to shares of the image, x right and y down, behind a division by the last
/// coordinate; z is one over the distance along the viewing axis.
fn world_to_ndc(camera: &Camera) -> [f32; 16] {
    let size_px = DVec2::from_array(camera.size_px.map(f64::from));
    let (focal, center) = (camera.focal_px / size_px, camera.center_px / size_px);
    let lens = DMat4::from_cols(
        DVec4::new(focal.x, 0.0, 0.0, 0.0),
        DVec4::new(0.0, focal.y, 0.0, 0.0),
        DVec4::new(center.x, center.y, 0.0, 1.0),
        DVec4::new(0.0, 0.0, 1.0, 0.0),
    );
    (lens * DMat4::from(camera.camera_from_world)).to_cols_array().map(|v| v as f32)
}

/// The part of the plane at distance 1 from a pinhole that the image shows; y points up.
struct ScreenWindow {
    center: Vec2<f32>,
    width: f32,
}

impl ScreenWindow {
    fn new(camera: &Camera) -> Self {
        let size_px = DVec2::from_array(camera.size_px.map(f64::from));
        let center = (0.5 * size_px - camera.center_px) / camera.focal_px;
        Self { center: Vec2(center.x as f32, -center.y as f32), width: (size_px.x / camera.focal_px.x) as f32 }
    }
}

/// Pixels from which on compression is worth a pool of threads.
const PARALLEL_PIXELS: usize = 1 << 20;

/// Returns a JPEG of `width * height` sRGB pixels, row-major, of a quality from 1 to 100.
///
/// # Errors
/// The number of bytes is not `3 * width * height`, or a side is above 65535 pixels.
pub fn encode_jpeg(width: usize, height: usize, rgb8: &[u8], quality: u8) -> Result<Vec<u8>, IoError> {
    let name = Path::new("preview.jpg");
    let expected = width.checked_mul(height).and_then(|n| n.checked_mul(3));
    let (Ok(width16), Ok(height16), true) = (u16::try_from(width), u16::try_from(height), expected == Some(rgb8.len())) else {
        return Err(IoError::invalid(name, format!("{} bytes for {width} x {height} pixels, expected 3 per pixel", rgb8.len())));
    };
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality)
        .write_image(rgb8, width16.into(), height16.into(), ExtendedColorType::Rgb8)
        .map_err(|e| IoError::invalid(name, format!("JPEG: {e}")))?;
    Ok(bytes)
}

/// Writes an 8-bit sRGB preview of `width * height` pixels, row-major.
///
/// # Errors
/// The system's, or the number of bytes is not `3 * width * height`.
pub fn write_png(path: &Path, width: usize, height: usize, rgb8: &[u8]) -> Result<(), IoError> {
    write_display_png(path, [width, height], rgb8, Some(DisplayEncoding::default()))
}

/// Writes an 8-bit preview of `[width, height]` pixels, row-major, for a display; the file does not
/// say which if that is `None`.
///
/// # Errors
/// Those of [`write_png`].
pub fn write_display_png(path: &Path, [width, height]: [usize; 2], rgb8: &[u8], display: Option<DisplayEncoding>) -> Result<(), IoError> {
    let bytes = encode(width, height, rgb8, display).map_err(|e| IoError::invalid(path, e.message))?;
    write_atomically(path, |out| out.write_all(&bytes).map_err(|e| IoError::system(path, "write", &e)))
}

/// Encodes an image as [`write_png`] writes it, into memory.
///
/// ```
/// use std::path::Path;
///
/// use luxel_io::{ReadOptions, Transfer, decode_image, encode_png};
///
/// let png = encode_png(1, 1, &[255, 0, 255])?;
/// // Integer samples need a transfer curve if the file states none.
/// let options = ReadOptions { transfer: Some(Transfer::Srgb), layer: None };
/// assert_eq!(decode_image(Path::new("a.png"), &png, &options)?.image.pixels, [[1.0, 0.0, 1.0]]);
/// # Ok::<(), luxel_io::IoError>(())
/// ```
///
/// # Errors
/// The same as [`write_png`].
pub fn encode_png(width: usize, height: usize, rgb8: &[u8]) -> Result<Vec<u8>, IoError> {
    encode(width, height, rgb8, Some(DisplayEncoding::default()))
}

fn encode(width: usize, height: usize, rgb8: &[u8], display: Option<DisplayEncoding>) -> Result<Vec<u8>, IoError> {
    let name = Path::new("preview.png");
    let size = (u32::try_from(width).ok(), u32::try_from(height).ok());
    let expected = width.checked_mul(height).and_then(|n| n.checked_mul(3));
    let (Some(width32), Some(height32), true) = (size.0, size.1, expected == Some(rgb8.len())) else {
        return Err(IoError::invalid(name, format!("{} bytes for {width} x {height} pixels, expected 3 per pixel", rgb8.len())));
    };
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(rgb8, width32, height32, ExtendedColorType::Rgb8)
        .map_err(|e| IoError::invalid(name, format!("PNG: {e}")))?;
    // So that viewers do not guess.
    insert(&mut bytes, display.map_or_else(Vec::new, DisplayEncoding::png_chunks));
    Ok(bytes)
}
