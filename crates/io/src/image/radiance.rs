//! Radiance HDR in: RGBE, run-length encoded or flat, rows from the top.
//!
//! EXPOSURE= and COLORCORR= divide, as they are the factors that the pixels were multiplied by.
//! PRIMARIES= is honoured; absent, or where its numbers make no colour space, Rec.709 is the
//! convention. XYZE and turned images are refused.

use std::io::{BufReader, Read, Seek};
use std::path::Path;

use image::codecs::hdr::{HdrDecoder, HdrMetadata};
use image::{ImageDecoder, ImageError};
use luxel_core::Image;

use super::colorimetry::settle_stated;
use super::samples::aspect_warning;
use super::{DecodedImage, SampleDepth};
use crate::IoError;
use crate::input::Input;

/// Longest header that is believed to be one.
const MAX_HEADER_BYTES: u64 = 1 << 20;

/// Decodes a whole file.
pub(super) fn decode(input: Input<'_>) -> Result<DecodedImage, IoError> {
    let decoder = open(input.name, input.bytes)?;
    let header = decoder.metadata();
    input.check_size([header.width, header.height].map(u64::from))?;
    let (width, height) = (header.width as usize, header.height as usize);
    let mut pixels = input.zeroed::<[f32; 3]>(width * height)?;
    match flat_pixels(input.bytes, width, height) {
        Some(flat) => pixels.iter_mut().zip(flat.as_chunks().0).for_each(|(pixel, rgbe)| *pixel = light(*rgbe)),
        None => decoder.read_image(bytemuck::cast_slice_mut(&mut pixels)).map_err(|e| explain(input.name, &e))?,
    }
    let mut image = Image { width, height, pixels };

    let mut warnings = Vec::new();
    let gain = gain(&header, &mut warnings);
    if gain != [1.0; 3] {
        for pixel in &mut image.pixels {
            *pixel = [0, 1, 2].map(|c| pixel[c] / gain[c]);
        }
    }
    warnings.extend(header.pixel_aspect_ratio.and_then(|height_over_width| aspect_warning(1.0 / f64::from(height_over_width))));
    let chromaticities = primaries(input, &header)?;
    let (alpha, is_premultiplied, depth, is_display_coded) = (None, false, SampleDepth::Float, false);
    let mut decoded = DecodedImage { image, alpha, is_premultiplied, color_space: None, chromaticities, depth, is_display_coded, warnings };
    settle_stated(&mut decoded, "PRIMARIES=");
    Ok(decoded)
}

/// Returns the bytes of the pixels of an old file without any run lengths: as many as pixels need,
/// and no mark of run lengths in front of them. In such a file every code is a colour, also those
/// that are marks elsewhere.
fn flat_pixels(bytes: &[u8], width: usize, height: usize) -> Option<&[u8]> {
    let blank = bytes.windows(2).position(|pair| pair == b"\n\n")? + 2;
    let rest = bytes.get(blank..)?;
    let pixels = rest.get(rest.iter().position(|byte| *byte == b'\n')? + 1..)?;
    let [high, low] = u16::try_from(width).ok()?.to_be_bytes();
    let is_flat = Some(pixels.len()) == width.checked_mul(height)?.checked_mul(4) && !pixels.starts_with(&[2, 2, high, low]);
    is_flat.then_some(pixels)
}

/// Returns the light of a pixel: mantissas of 8 bits and the exponent that they share.
fn light([r, g, b, exponent]: [u8; 4]) -> [f32; 3] {
    if exponent == 0 {
        return [0.0; 3];
    }
    let scale = 2f32.powi(i32::from(exponent) - 136);
    [r, g, b].map(|mantissa| f32::from(mantissa) * scale)
}

/// Returns the size from the header.
pub(super) fn size(name: &Path, file: impl Read + Seek) -> Result<[u32; 2], IoError> {
    let header = open(name, BufReader::new(file.take(MAX_HEADER_BYTES)))?.metadata();
    Ok([header.width, header.height])
}

/// Replaces the signature that the decoder does not know, one of two in use, by the one it knows.
fn open<R: Read>(name: &Path, mut reader: R) -> Result<HdrDecoder<impl Read>, IoError> {
    const KNOWN: &[u8] = b"#?RADIANCE";
    const OTHER: &[u8] = b"#?RGBE";
    let mut head = [0; OTHER.len()];
    reader
        .read_exact(&mut head)
        .map_err(|e| IoError::invalid(name, format!("Radiance HDR: {e}; the file is cut short, copy or export it again")))?;
    let signature = if head == OTHER { KNOWN } else { &head };
    HdrDecoder::new(signature.to_vec().chain_reader(reader)).map_err(|e| explain(name, &e))
}

/// `Read::chain` of owned bytes.
trait ChainReader {
    fn chain_reader<R: Read>(self, rest: R) -> std::io::Chain<std::io::Cursor<Vec<u8>>, R>;
}

impl ChainReader for Vec<u8> {
    fn chain_reader<R: Read>(self, rest: R) -> std::io::Chain<std::io::Cursor<Self>, R> {
        std::io::Cursor::new(self).chain(rest)
    }
}

fn explain(name: &Path, error: &ImageError) -> IoError {
    match error {
        ImageError::Unsupported(_) => {
            IoError::unsupported(name, format!("Radiance HDR: {error}; export it as RGBE with rows from the top (-Y +X)"))
        }
        _ => IoError::invalid(name, format!("Radiance HDR: {error}; the file is damaged or cut short, copy or export it again")),
    }
}

/// Returns the factors that the pixels were multiplied by, per channel. Factors that are no
/// positive numbers, such as the 0 that FreeImage writes, say nothing.
fn gain(header: &HdrMetadata, warnings: &mut Vec<String>) -> [f32; 3] {
    let exposure = header.exposure.unwrap_or(1.0);
    let (r, g, b) = header.color_correction.unwrap_or((1.0, 1.0, 1.0));
    let is_factor = |v: f32| v.is_normal() && v > 0.0;
    let mut stated = |name: &str, found: [f32; 3]| match found.into_iter().all(is_factor) {
        true => found,
        false => {
            let [r, g, b] = found;
            let found = if r == g && g == b { format!("{r}") } else { format!("{r} {g} {b}") };
            warnings.push(format!("{name}={found} is no positive factor: it is ignored"));
            [1.0; 3]
        }
    };
    let (exposure, correction) = (stated("EXPOSURE", [exposure; 3]), stated("COLORCORR", [r, g, b]));
    let gain = [0, 1, 2].map(|c| exposure[c] * correction[c]);
    stated("EXPOSURE times COLORCORR", gain)
}

/// Returns the CIE xy of red, green, blue and white.
fn primaries(input: Input<'_>, header: &HdrMetadata) -> Result<Option<[[f32; 2]; 4]>, IoError> {
    let Some((_, text)) = header.custom_attributes.iter().rfind(|(key, _)| key == "PRIMARIES") else { return Ok(None) };
    let numbers: Vec<f32> = text.split_whitespace().map_while(|word| word.parse().ok()).collect();
    match numbers.as_chunks().0 {
        &[red, green, blue, white] if numbers.len() == 8 => Ok(Some([red, green, blue, white])),
        _ => Err(input.invalid(format!("header: PRIMARIES={text}, expected eight numbers"))),
    }
}
