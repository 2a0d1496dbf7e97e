//! TIFF and BigTIFF in: integers of 8 and 16 bits, grey ones of 1 to 7, half, single and double
//! floats; grey or RGB, with or without alpha, of any number of extra samples; first image.
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
use ::tiff::decoder::{Decoder, DecodingResult};
use ::tiff::tags::Tag;
use ::tiff::{ColorType, TiffError};
use luxel_core::Chromaticities;

use super::colorimetry::{conversion_to_rec709, settle_profile, settle_stated};
use super::guard::check_size;
use super::samples::{Curve, LINEAR, SampleGrid, aspect_warning, depth_warnings};
use super::tiff_samples::{self, ReadSamples, explain};
use super::{DecodedImage, ReadOptions, SampleDepth, Transfer};
use crate::IoError;
use crate::input::Input;
use crate::tags::{Tags, endless_text};

/// White where none is stated.
const D65: [f32; 2] = [0.3127, 0.3290];
/// Decodes the first image.
pub(super) fn decode(input: Input<'_>, options: &ReadOptions) -> Result<DecodedImage, IoError> {
    let mut decoded = decode_samples(input, options)?;
    let Some(found) = stated(input.bytes) else {
        settle_profile(&mut decoded, input.bytes);
        return Ok(decoded);
    };
    decoded.chromaticities = Some(found);
    settle_stated(&mut decoded, "TIFF");
    Ok(decoded)
}

/// Decodes the first image as codes over the largest one, in whatever primaries.
pub(super) fn decode_codes(input: Input<'_>) -> Result<DecodedImage, IoError> {
    decode_samples(input, &ReadOptions { transfer: Some(Transfer::Linear), layer: None })
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

/// Returns the width of a pixel over its height, by the resolutions across and down.
fn pixel_aspect<R: Read + Seek>(decoder: &mut Decoder<R>) -> Option<f64> {
    let mut resolution = |tag| decoder.find_tag(tag).ok().flatten().as_ref().and_then(number).map(f64::from);
    let (across, down) = (resolution(Tag::XResolution)?, resolution(Tag::YResolution)?);
    Some(down / across)
}

/// Fax codes store an empty line as a bit, which makes a flat mask so many times smaller than the
/// same pixels in other formats.
const BILEVEL_RATIO: u64 = 32;

/// Returns the samples through their curve, in the file's primaries.
fn decode_samples(input: Input<'_>, options: &ReadOptions) -> Result<DecodedImage, IoError> {
    let failed = |error: TiffError| explain(input.name, &error);
    refuse_dng(input)?;
    // The library prints a line of its own where it meets one.
    if let Some(tag) = endless_text(input.bytes) {
        return Err(input.invalid(format!("TIFF: tag {tag} claims a text longer than the file, which is damaged; export it again")));
    }
    let mut decoder = Decoder::new(Cursor::new(input.bytes)).map_err(failed)?;
    let (width, height) = decoder.dimensions().map_err(failed)?;
    // One bit a sample is the default of the format.
    let bits = decoder.find_tag_unsigned_vec::<u16>(Tag::BitsPerSample).map_err(failed)?;
    let is_bilevel = bits.is_none_or(|bits| bits.iter().all(|bits| *bits == 1));
    let plausible_bytes = input.length() * if is_bilevel { BILEVEL_RATIO } else { 1 };
    check_size(input.name, [width, height].map(u64::from), plausible_bytes)?;
    refuse_raw(input.name, &mut decoder)?;
    let aspect = pixel_aspect(&mut decoder);
    let ReadSamples { layout, values, bits, is_premultiplied } = tiff_samples::read(input)?;
    let mut decoded = convert(input, layout, &values, is_premultiplied, options)?;
    if bits < 8 {
        decoded.depth = SampleDepth::FewBits(bits);
        decoded.warnings = depth_warnings(decoded.depth);
    }
    decoded.warnings.extend(aspect.and_then(aspect_warning));
    Ok(decoded)
}

/// Returns the linear light of the samples; `is_premultiplied` as far as the file states.
fn convert(
    input: Input<'_>,
    layout: SampleGrid,
    samples: &DecodingResult,
    is_premultiplied: Option<bool>,
    options: &ReadOptions,
) -> Result<DecodedImage, IoError> {
    let is_associated = is_premultiplied == Some(true) && layout.channels.is_multiple_of(2);
    let choose = |bits| Curve::choose(input, options, None, bits);
    // Codes that were multiplied are divided before their curve.
    let first = |curve| if is_associated { LINEAR } else { curve };
    let (depth, curve, (mut image, alpha)) = match samples {
        DecodingResult::U8(v) => {
            let curve = choose(8)?;
            (SampleDepth::Integer8, curve, layout.assemble8(input, v, first(curve))?)
        }
        DecodingResult::U16(v) => {
            let curve = choose(16)?;
            (SampleDepth::Integer16, curve, layout.assemble16(input, v, first(curve))?)
        }
        DecodingResult::F16(v) => (SampleDepth::Float, LINEAR, layout.assemble(input, v, |s| s.to_f32(), |s| s.to_f32())?),
        DecodingResult::F32(v) => (SampleDepth::Float, LINEAR, layout.assemble(input, v, |s| s, |s| s)?),
        DecodingResult::F64(v) => (SampleDepth::Float, LINEAR, layout.assemble(input, v, |s| s as f32, |s| s as f32)?),
        _ => {
            return Err(input.unsupported("TIFF: signed or 32-bit integer samples; export it as 16-bit unsigned integers or floats"));
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

/// DNG 1.7, "DNGVersion".
const DNG_VERSION: u16 = 50706;

/// Refuses DNG, of which the library does not read even the tags.
fn refuse_dng(input: Input<'_>) -> Result<(), IoError> {
    let is_dng = Tags::new(input.bytes).and_then(|tags| tags.first()).is_some_and(|ifd| ifd.has(DNG_VERSION));
    if is_dng { Err(raw(input.name)) } else { Ok(()) }
}

fn raw(name: &Path) -> IoError {
    IoError::unsupported(
        name,
        "TIFF: a camera RAW file, whose first image is a thumbnail or a mosaic; prepare the photographs (DNG), or develop it to OpenEXR or \
         16-bit TIFF",
    )
}

fn refuse_raw<R: Read + Seek>(name: &Path, decoder: &mut Decoder<R>) -> Result<(), IoError> {
    let is_dng = decoder.find_tag(Tag::Unknown(DNG_VERSION)).map_err(|error| explain(name, &error))?.is_some();
    // Bit 0 of NewSubfileType: a reduced version of another image in the file (TIFF 6.0, page 36).
    let kind: Option<u32> = decoder.find_tag_unsigned(Tag::NewSubfileType).map_err(|error| explain(name, &error))?;
    if is_dng || kind.is_some_and(|bits| bits & 1 != 0) {
        return Err(raw(name));
    }
    Ok(())
}
