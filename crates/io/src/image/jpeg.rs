//! JPEG in: 8 bits, grey, RGB, YCbCr or CMYK. Read as of sRGB's curve, which is what JFIF and Exif
//! require of a JPEG without a profile; primaries are an ICC profile's, if they are a known
//! space's. A gain map makes light beyond white of it ([`super::gain_map`]).
//!
//! The decoder pads a truncated file; that a file is complete is therefore checked
//! by its markers.

use std::io::Cursor;

use image::codecs::jpeg::JpegDecoder;
use image::{ColorType, ImageDecoder, ImageError};

use super::colorimetry::settle_profile;
use super::gain_map;
use super::jpeg_markers::{Markers, segments};
use super::samples::{Curve, LINEAR, NOT_HDR, SampleGrid, aspect_warning};
use super::{DecodedImage, ReadOptions, SampleDepth, Transfer};
use crate::IoError;
use crate::input::Input;

/// Returns the samples as they are.
pub(super) fn samples(input: Input<'_>) -> Result<(SampleGrid, Vec<u8>), IoError> {
    let markers = Markers::read(input.bytes);
    let size = markers.size.ok_or_else(|| damaged(input, "no frame header with a size"))?;
    input.check_size(size.map(u64::from))?;
    if !markers.is_complete {
        return Err(damaged(input, "no end-of-image marker"));
    }
    let decoder = JpegDecoder::new(Cursor::new(input.bytes)).map_err(|e| explain(input, &e))?;
    let (width, height) = decoder.dimensions();
    if [width, height] != size {
        return Err(damaged(input, "several frame headers of different sizes"));
    }
    let color = decoder.color_type();
    let channels = match color {
        ColorType::L8 | ColorType::Rgb8 => color.channel_count(),
        _ => return Err(input.unsupported(format!("JPEG: colour type {color:?}; export it as 8-bit RGB"))),
    };
    let layout = SampleGrid { width: width as usize, height: height as usize, channels: channels.into() };
    let mut samples = input.zeroed::<u8>(layout.width * layout.height * layout.channels)?;
    decoder.read_image(&mut samples).map_err(|e| explain(input, &e))?;
    Ok((layout, samples))
}

/// Returns the width, height and codes of red, green and blue.
pub(super) fn codes(input: Input<'_>) -> Result<(usize, usize, Vec<u8>), IoError> {
    let (layout, samples) = samples(input)?;
    let rgb = if layout.channels == 1 { samples.iter().flat_map(|v| [*v; 3]).collect() } else { samples };
    Ok((layout.width, layout.height, rgb))
}

/// Decodes a whole file.
pub(super) fn decode(input: Input<'_>, options: &ReadOptions) -> Result<DecodedImage, IoError> {
    let (layout, samples) = samples(input)?;
    let mut warnings = vec![NOT_HDR.to_string()];
    if options.transfer.is_none() {
        warnings.push("JPEG read as sRGB, its standard transfer curve".to_string());
    }
    let curve = Curve::Named(options.transfer.unwrap_or(Transfer::Srgb));
    let (image, alpha) = layout.assemble8(input, &samples, curve)?;
    let mut decoded = DecodedImage {
        image,
        alpha,
        is_premultiplied: false,
        color_space: None,
        chromaticities: None,
        depth: SampleDepth::Integer8,
        is_display_coded: curve != LINEAR,
        warnings,
    };
    if options.transfer.is_none() {
        gain_map::apply(input.bytes, |picture| self::samples(input.with_bytes(picture)), &mut decoded.image, &mut decoded.warnings)?;
    }
    decoded.warnings.extend(aspect(input.bytes).and_then(aspect_warning));
    settle_profile(&mut decoded, input.bytes);
    Ok(decoded)
}

/// Returns the width of a pixel over its height, by the densities that JFIF's segment states.
fn aspect(bytes: &[u8]) -> Option<f64> {
    const APP0: u8 = 0xe0;
    segments(bytes).find_map(|(marker, content)| match content.strip_prefix(b"JFIF\0")? {
        [_, _, _, x1, x0, y1, y0, ..] if marker == APP0 => {
            let [across, down] = [[*x1, *x0], [*y1, *y0]].map(|density| f64::from(u16::from_be_bytes(density)));
            Some(down / across)
        }
        _ => None,
    })
}

/// Returns the size from the frame header.
pub(super) fn size(input: Input<'_>) -> Result<[u32; 2], IoError> {
    Markers::read(input.bytes).size.ok_or_else(|| damaged(input, "no frame header with a size"))
}

fn damaged(input: Input<'_>, what: &str) -> IoError {
    input.invalid(format!("JPEG: {what}; the file is damaged or cut short, copy or export it again"))
}

fn explain(input: Input<'_>, error: &ImageError) -> IoError {
    match error {
        ImageError::Unsupported(_) => input.unsupported(format!("JPEG: {error}; export it as 8-bit RGB")),
        _ => damaged(input, &error.to_string()),
    }
}
