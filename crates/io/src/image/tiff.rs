//! TIFF and BigTIFF in: integers of 8 and 16 bits, grey ones of 1, 2 and 4, half, single and double
//! floats; grey or RGB, with or without alpha; first image.
//!
//! Whether colours are multiplied by alpha is stated by ExtraSamples (TIFF 6.0, page 31); where it
//! says neither, as elsewhere: floats are, integers are not. Integers were multiplied as codes:
//! they are divided before their curve, and multiplied again as light.
//!
//! Primaries are those of PrimaryChromaticities and WhitePoint (page 83); where these make no
//! colour space, a warning says so. Without them an ICC profile's are, if they are a known space's;
//! its curve is not evaluated.
//!
//! Camera RAW files are TIFF as well: their first image is a thumbnail, which is refused rather
//! than read in silence.

use std::io::{BufReader, Cursor, Read, Seek};
use std::path::Path;

use ::tiff::decoder::ifd::Value;
use ::tiff::decoder::{Decoder, DecodingResult, Limits};
use ::tiff::tags::Tag;
use ::tiff::{ColorType, TiffError};
use luxel_core::Chromaticities;

use super::colorimetry::{conversion_to_rec709, settle_profile, settle_space};
use super::guard::{check_block, check_size};
use super::samples::{Curve, LINEAR, SampleGrid, depth_warnings};
use super::{DecodedImage, ReadOptions, SampleDepth, Transfer};
use crate::IoError;
use crate::memory::check_memory;
use crate::tags::endless_text;

/// Bytes of the widest sample (f64) times the most channels.
const MAX_PIXEL_BYTES: usize = 32;

/// Bytes per pixel of what the samples become: f32 of three channels and of alpha.
const OUTPUT_BYTES: u64 = 16;

/// Values of ExtraSamples.
const ASSOCIATED_ALPHA: u16 = 1;
const UNASSOCIATED_ALPHA: u16 = 2;
/// Value of PhotometricInterpretation.
const WHITE_IS_ZERO: u16 = 0;
/// White where none is stated.
const D65: [f32; 2] = [0.3127, 0.3290];
/// Decodes the first image.
pub(super) fn decode(name: &Path, bytes: &[u8], options: &ReadOptions) -> Result<DecodedImage, IoError> {
    let mut decoded = decode_samples(name, bytes, options)?;
    let Some(found) = stated(bytes) else {
        settle_profile(&mut decoded, bytes);
        return Ok(decoded);
    };
    match settle_space(&mut decoded.image, &found, &mut decoded.warnings) {
        Ok(space) => (decoded.chromaticities, decoded.color_space) = (Some(found), Some(space)),
        Err(reason) => decoded.warnings.push(format!("TIFF: {reason}; they are ignored")),
    }
    Ok(decoded)
}

/// Decodes the first image as codes over the largest one, in whatever primaries.
pub(super) fn decode_codes(name: &Path, bytes: &[u8]) -> Result<DecodedImage, IoError> {
    decode_samples(name, bytes, &ReadOptions { transfer: Some(Transfer::Linear), layer: None })
}

/// Returns whether the samples of the first image are floating-point numbers.
pub(super) fn is_float(file: impl Read + Seek) -> bool {
    const FLOAT: u16 = 3;
    let formats =
        Decoder::new(BufReader::new(file)).ok().and_then(|mut d| d.find_tag_unsigned_vec::<u16>(Tag::SampleFormat).ok().flatten());
    formats.is_some_and(|formats| formats.first() == Some(&FLOAT))
}

/// Returns the CIE xy of red, green, blue and white that the first image states, if they make a
/// colour space.
pub(super) fn primaries(bytes: &[u8]) -> Option<Chromaticities> {
    stated(bytes).filter(|found| conversion_to_rec709(found).is_ok())
}

/// Reads the chromaticities that the tags of an image of colours state, whether they make a colour
/// space or not.
fn stated(bytes: &[u8]) -> Option<Chromaticities> {
    const WHITE_POINT: Tag = Tag::Unknown(318);
    const PRIMARY_CHROMATICITIES: Tag = Tag::Unknown(319);
    if endless_text(bytes).is_some() {
        return None;
    }
    let mut decoder = Decoder::new(Cursor::new(bytes)).ok()?;
    let mut values = |tag| match decoder.find_tag(tag).ok().flatten()? {
        Value::List(values) => values.iter().map(number).collect::<Option<Vec<f32>>>(),
        _ => None,
    };
    let [xr, yr, xg, yg, xb, yb] = values(PRIMARY_CHROMATICITIES)?.try_into().ok()?;
    let white = values(WHITE_POINT).and_then(|white| white.try_into().ok()).unwrap_or(D65);
    let is_grey = matches!(decoder.colortype(), Ok(ColorType::Gray(_) | ColorType::GrayA(_)));
    (!is_grey).then_some([[xr, yr], [xg, yg], [xb, yb], white])
}

/// Returns a number of a kind that fractions are written as.
fn number(value: &Value) -> Option<f32> {
    match *value {
        Value::Rational(n, d) => Some((f64::from(n) / f64::from(d)) as f32),
        Value::Float(v) => Some(v),
        Value::Double(v) => Some(v as f32),
        _ => None,
    }
}

/// Fax codes store an empty line as a bit, which makes a flat mask so many times smaller than the
/// same pixels in other formats.
const BILEVEL_RATIO: u64 = 32;

/// Returns the samples through their curve, in the file's primaries.
fn decode_samples(name: &Path, bytes: &[u8], options: &ReadOptions) -> Result<DecodedImage, IoError> {
    let failed = |error: TiffError| explain(name, &error);
    // The library prints a line of its own where it meets one.
    if let Some(tag) = endless_text(bytes) {
        return Err(IoError::invalid(
            name,
            format!("TIFF: tag {tag} claims a text longer than the file, which is damaged; export it again"),
        ));
    }
    let mut decoder = Decoder::new(Cursor::new(bytes)).map_err(failed)?;
    let (width, height) = decoder.dimensions().map_err(failed)?;
    // One bit a sample is the default of the format.
    let bits = decoder.find_tag_unsigned_vec::<u16>(Tag::BitsPerSample).map_err(failed)?;
    let is_bilevel = bits.is_none_or(|bits| bits.iter().all(|bits| *bits == 1));
    let plausible_bytes = bytes.len() as u64 * if is_bilevel { BILEVEL_RATIO } else { 1 };
    check_size(name, [width, height].map(u64::from), plausible_bytes)?;
    refuse_raw(name, &mut decoder)?;
    let color = decoder.colortype().map_err(failed)?;
    let bits = color.bit_depth();
    let is_white_zero = decoder.find_tag_unsigned::<u16>(Tag::PhotometricInterpretation).map_err(failed)? == Some(WHITE_IS_ZERO);
    if is_white_zero && is_float(Cursor::new(bytes)) {
        return Err(IoError::unsupported(
            name,
            "TIFF: floating-point samples of which 0 is white (WhiteIsZero), which are no light; export it with 0 for black (BlackIsZero)",
        ));
    }
    let channels = match color {
        ColorType::Gray(_) => 1,
        ColorType::GrayA(_) | ColorType::Multiband { num_samples: 2, .. } => 2,
        ColorType::RGB(_) => 3,
        ColorType::RGBA(_) => 4,
        _ => return Err(IoError::unsupported(name, format!("TIFF: colour type {color:?}; export it as RGB"))),
    };
    let layout = SampleGrid { width: width as usize, height: height as usize, channels };
    let sample_bytes = u64::from(bits.div_ceil(8)) * channels as u64;
    check_memory(name, u64::from(width) * u64::from(height) * (sample_bytes + OUTPUT_BYTES))?;
    // The library fills its memory before it decodes.
    let stored_bytes = (u64::from(width) * u64::from(height)).saturating_mul(u64::from(bits) * channels as u64).div_ceil(8);
    check_block(name, stored_bytes, bytes.len() as u64)?;
    let extra = decoder.find_tag_unsigned_vec::<u16>(Tag::ExtraSamples).map_err(failed)?.unwrap_or_default();

    let mut limits = Limits::default();
    limits.decoding_buffer_size = (layout.width * layout.height).saturating_mul(MAX_PIXEL_BYTES);
    limits.intermediate_buffer_size = limits.decoding_buffer_size.max(1 << 20);
    limits.ifd_value_size = bytes.len().max(1 << 20);
    let mut decoder = decoder.with_limits(limits);
    let mut samples = DecodingResult::U8(Vec::new());
    let plan = decoder.read_image_to_buffer(&mut samples).map_err(failed)?;
    if plan.planes > 1 {
        return Err(IoError::unsupported(name, "TIFF: channels in separate planes; export it with interleaved channels"));
    }
    let is_premultiplied = match extra.first() {
        Some(&ASSOCIATED_ALPHA) => Some(true),
        Some(&UNASSOCIATED_ALPHA) => Some(false),
        _ => None,
    };
    if let (DecodingResult::U8(packed), true) = (&mut samples, bits < 8) {
        *packed = unpacked(packed, layout, bits);
    }
    convert(name, layout, &samples, is_premultiplied, options)
}

/// Returns the 8-bit codes of grey samples of 1, 2 or 4 bits, whose rows begin with a byte.
fn unpacked(packed: &[u8], layout: SampleGrid, bits: u8) -> Vec<u8> {
    let (bits, width) = (usize::from(bits.max(1)), layout.width);
    let most = (1u16 << bits) - 1;
    let code = |row: &[u8], x: usize| {
        let at = x * bits;
        let byte = u16::from(row.get(at / 8).copied().unwrap_or(0));
        // At most 255.
        ((byte >> (8 - bits - at % 8) & most) * 255 / most) as u8
    };
    packed.chunks((width * bits).div_ceil(8).max(1)).flat_map(|row| (0..width).map(move |x| code(row, x))).collect()
}

/// Returns the linear light of the samples; `is_premultiplied` as far as the file states.
fn convert(
    name: &Path,
    layout: SampleGrid,
    samples: &DecodingResult,
    is_premultiplied: Option<bool>,
    options: &ReadOptions,
) -> Result<DecodedImage, IoError> {
    let is_associated = is_premultiplied == Some(true) && layout.channels.is_multiple_of(2);
    let choose = |bits| Curve::choose(name, options, None, bits);
    // Codes that were multiplied are divided before their curve.
    let first = |curve| if is_associated { LINEAR } else { curve };
    let (depth, curve, (mut image, alpha)) = match samples {
        DecodingResult::U8(v) => {
            let curve = choose(8)?;
            (SampleDepth::Integer8, curve, layout.assemble8(name, v, first(curve))?)
        }
        DecodingResult::U16(v) => {
            let curve = choose(16)?;
            (SampleDepth::Integer16, curve, layout.assemble16(name, v, first(curve))?)
        }
        DecodingResult::F16(v) => (SampleDepth::Float, LINEAR, layout.assemble(name, v, |s| s.to_f32(), |s| s.to_f32())?),
        DecodingResult::F32(v) => (SampleDepth::Float, LINEAR, layout.assemble(name, v, |s| s, |s| s)?),
        DecodingResult::F64(v) => (SampleDepth::Float, LINEAR, layout.assemble(name, v, |s| s as f32, |s| s as f32)?),
        _ => {
            return Err(IoError::unsupported(
                name,
                "TIFF: signed or 32-bit integer samples; export it as 16-bit unsigned integers or floats",
            ));
        }
    };
    if let Some(alpha) = alpha.as_ref().filter(|_| is_associated && curve != LINEAR) {
        for (pixel, &alpha) in image.pixels.iter_mut().zip(alpha) {
            *pixel = pixel.map(|code| if alpha > 0.0 { curve.decode((code / alpha).min(1.0).into()) * alpha } else { 0.0 });
        }
    }
    let is_premultiplied = is_premultiplied.unwrap_or(depth == SampleDepth::Float);
    let (is_display_coded, warnings) = (curve != LINEAR, depth_warnings(depth));
    Ok(DecodedImage { image, alpha, is_premultiplied, color_space: None, chromaticities: None, depth, is_display_coded, warnings })
}

/// Returns the size of the first image.
pub(super) fn size(name: &Path, file: impl Read + Seek) -> Result<[u32; 2], IoError> {
    let mut decoder = Decoder::new(BufReader::new(file)).map_err(|error| explain(name, &error))?;
    let (width, height) = decoder.dimensions().map_err(|error| explain(name, &error))?;
    refuse_raw(name, &mut decoder)?;
    Ok([width, height])
}

fn explain(name: &Path, error: &TiffError) -> IoError {
    match error {
        TiffError::UnsupportedError(_) => IoError::unsupported(name, format!("TIFF: {error}; export it as RGB with Deflate compression")),
        _ => IoError::invalid(name, format!("TIFF: {error}; the file is damaged or cut short, copy or export it again")),
    }
}

fn refuse_raw<R: Read + Seek>(name: &Path, decoder: &mut Decoder<R>) -> Result<(), IoError> {
    /// DNG 1.7, "DNGVersion".
    const DNG_VERSION: Tag = Tag::Unknown(50706);
    let is_dng = decoder.find_tag(DNG_VERSION).map_err(|error| explain(name, &error))?.is_some();
    // Bit 0 of NewSubfileType: a reduced version of another image in the file (TIFF 6.0, page 36).
    let kind: Option<u32> = decoder.find_tag_unsigned(Tag::NewSubfileType).map_err(|error| explain(name, &error))?;
    if is_dng || kind.is_some_and(|bits| bits & 1 != 0) {
        return Err(IoError::unsupported(
            name,
            "TIFF: a camera RAW file, whose first image is a thumbnail; develop it to OpenEXR or 16-bit TIFF",
        ));
    }
    Ok(())
}
