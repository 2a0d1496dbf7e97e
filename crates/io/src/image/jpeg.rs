//! JPEG in: 8 bits, grey, RGB, YCbCr or CMYK. Read as of sRGB's curve, which is what JFIF and Exif
//! require of a JPEG without a profile; primaries are an ICC profile's, if they are a known
//! space's. A gain map makes light beyond white of it ([`super::gain_map`]).
//!
//! The decoder pads a truncated file; that a file is complete is therefore checked
//! by its markers.

use std::io::Cursor;
use std::path::Path;

use image::codecs::jpeg::JpegDecoder;
use image::{ColorType, ImageDecoder, ImageError};

use super::colorimetry::settle_profile;
use super::gain_map;
use super::guard::{check_size, zeroed};
use super::samples::{Curve, LINEAR, NOT_HDR, SampleGrid, aspect_warning};
use super::{DecodedImage, ReadOptions, SampleDepth, Transfer};
use crate::IoError;

/// Returns the samples as they are.
pub(super) fn samples(name: &Path, bytes: &[u8]) -> Result<(SampleGrid, Vec<u8>), IoError> {
    let markers = Markers::read(bytes);
    let size = markers.size.ok_or_else(|| damaged(name, "no frame header with a size"))?;
    check_size(name, size.map(u64::from), bytes.len() as u64)?;
    if !markers.is_complete {
        return Err(damaged(name, "no end-of-image marker"));
    }
    let decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(|e| explain(name, &e))?;
    let (width, height) = decoder.dimensions();
    if [width, height] != size {
        return Err(damaged(name, "several frame headers of different sizes"));
    }
    let color = decoder.color_type();
    let channels = match color {
        ColorType::L8 | ColorType::Rgb8 => color.channel_count(),
        _ => return Err(IoError::unsupported(name, format!("JPEG: colour type {color:?}; export it as 8-bit RGB"))),
    };
    let layout = SampleGrid { width: width as usize, height: height as usize, channels: channels.into() };
    let mut samples = zeroed::<u8>(name, layout.width * layout.height * layout.channels)?;
    decoder.read_image(&mut samples).map_err(|e| explain(name, &e))?;
    Ok((layout, samples))
}

/// Returns the width, height and codes of red, green and blue.
pub(super) fn codes(name: &Path, bytes: &[u8]) -> Result<(usize, usize, Vec<u8>), IoError> {
    let (layout, samples) = samples(name, bytes)?;
    let rgb = if layout.channels == 1 { samples.iter().flat_map(|v| [*v; 3]).collect() } else { samples };
    Ok((layout.width, layout.height, rgb))
}

/// Decodes a whole file.
pub(super) fn decode(name: &Path, bytes: &[u8], options: &ReadOptions) -> Result<DecodedImage, IoError> {
    let (layout, samples) = samples(name, bytes)?;
    let mut warnings = vec![NOT_HDR.to_string()];
    if options.transfer.is_none() {
        warnings.push("JPEG read as sRGB, its standard transfer curve".to_string());
    }
    let curve = Curve::Named(options.transfer.unwrap_or(Transfer::Srgb));
    let (image, alpha) = layout.assemble8(name, &samples, curve)?;
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
        gain_map::apply(name, bytes, &mut decoded.image, &mut decoded.warnings)?;
    }
    decoded.warnings.extend(aspect(bytes).and_then(aspect_warning));
    settle_profile(&mut decoded, bytes);
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

/// Returns the segments of a picture up to its entropy-coded data: marker and content.
pub(super) fn segments(bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    const START_OF_SCAN: u8 = 0xda;
    let mut rest = bytes.get(2..).unwrap_or_default();
    std::iter::from_fn(move || {
        let (marker, after) = next_marker(rest)?;
        let (content, after) = segment(after).filter(|_| marker != START_OF_SCAN)?;
        rest = after;
        Some((marker, content))
    })
}

/// Returns the length of the picture that bytes begin with, up to its end-of-image marker.
pub(super) fn whole_length(bytes: &[u8]) -> Option<usize> {
    let mut rest = bytes.strip_prefix(&[0xff, 0xd8])?;
    while let Some((marker, after)) = next_marker(rest) {
        rest = after;
        match marker {
            0xd9 => return Some(bytes.len() - rest.len()),
            0x01 | 0xd0..=0xd8 => {}
            _ => (_, rest) = segment(rest)?,
        }
    }
    None
}

/// Returns the size from the frame header.
pub(super) fn size(name: &Path, bytes: &[u8]) -> Result<[u32; 2], IoError> {
    Markers::read(bytes).size.ok_or_else(|| damaged(name, "no frame header with a size"))
}

fn damaged(name: &Path, what: &str) -> IoError {
    IoError::invalid(name, format!("JPEG: {what}; the file is damaged or cut short, copy or export it again"))
}

fn explain(name: &Path, error: &ImageError) -> IoError {
    match error {
        ImageError::Unsupported(_) => IoError::unsupported(name, format!("JPEG: {error}; export it as 8-bit RGB")),
        _ => damaged(name, &error.to_string()),
    }
}

/// The content of the markers of ITU-T T.81 (annex B).
#[derive(Clone, Debug, Default, PartialEq)]
struct Markers {
    size: Option<[u32; 2]>,
    /// Whether the end-of-image marker is there.
    is_complete: bool,
}

impl Markers {
    /// Walks as far as the bytes make sense.
    fn read(bytes: &[u8]) -> Self {
        let mut markers = Self::default();
        // Behind the start-of-image marker, which the format was recognised by.
        let mut rest = bytes.get(2..).unwrap_or_default();
        while let Some((marker, after)) = next_marker(rest) {
            rest = after;
            match marker {
                0xd9 => {
                    markers.is_complete = true;
                    break;
                }
                // Stand-alone: TEM, restarts, start of image.
                0x01 | 0xd0..=0xd8 => continue,
                _ => {}
            }
            let Some((segment, after)) = segment(rest) else { break };
            match (marker, segment) {
                // Frame headers are C0 to CF without the tables among them: precision, height,
                // width.
                (0xc0..=0xcf, &[_, h1, h0, w1, w0, ..]) if !matches!(marker, 0xc4 | 0xc8 | 0xcc) => {
                    let [height, width] = [[h1, h0], [w1, w0]].map(|side| u32::from(u16::from_be_bytes(side)));
                    markers.size = markers.size.or(Some([width, height]));
                }
                _ => {}
            }
            rest = after;
        }
        markers
    }
}

/// Returns the next marker's code, skipping entropy-coded data (where FF is followed by 00) and
/// fill bytes.
fn next_marker(bytes: &[u8]) -> Option<(u8, &[u8])> {
    let mut rest = bytes;
    loop {
        let at = rest.iter().position(|&b| b == 0xff)?;
        rest = rest.get(at + 1..)?;
        match rest.first()? {
            0x00 => rest = rest.get(1..)?,
            0xff => {}
            &marker => return Some((marker, rest.get(1..)?)),
        }
    }
}

/// Returns a marker's segment (its length counts itself) and what follows.
fn segment(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<2>()?;
    rest.split_at_checked(usize::from(u16::from_be_bytes(*length)).checked_sub(2)?)
}
