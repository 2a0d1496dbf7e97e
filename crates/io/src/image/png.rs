//! PNG in: 1 to 16 bits, grey, palette or RGB, with or without alpha.
//!
//! The transfer curve is the options', else cICP's, else sRGB's, else gAMA's (PNG, third edition,
//! 4.3); that of an ICC profile is not evaluated: with nothing but one, the curve must be given.
//! Primaries are cICP's, else an ICC profile's, if they are a known space's, else sRGB's, else
//! cHRM's. Samples read as codes keep the primaries they have, stated or not: a matrix is for
//! light.

use std::io::Cursor;

use image::codecs::png::PngDecoder;
use image::{ColorType, ImageDecoder, ImageError, Limits};
use luxel_core::photo::StatedCurve;
use luxel_core::{Chromaticities, ColorSpace, Remedy};

use super::colorimetry::{conversion_to_rec709, settle_profile, settle_stated};
use super::samples::{Curve, LINEAR, SampleGrid, aspect_warning, depth_warnings};
use super::{DecodedImage, ReadOptions, SampleDepth, Transfer};
use crate::IoError;
use crate::input::Input;

/// First bytes of every file.
pub(super) const SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";

/// Decodes a whole file.
pub(super) fn decode(input: Input<'_>, options: &ReadOptions) -> Result<DecodedImage, IoError> {
    let info = Info::read(input)?;
    let mut decoded = decode_samples(input, &info, options)?;
    if info.has_icc && info.named_primaries().is_none() {
        settle_profile(&mut decoded, input.bytes);
        return Ok(decoded);
    }
    decoded.chromaticities = info.chromaticities(input)?;
    settle_stated(&mut decoded, "PNG");
    Ok(decoded)
}

/// Decodes a whole file as codes over the largest one, in whatever primaries.
pub(super) fn decode_codes(input: Input<'_>) -> Result<DecodedImage, IoError> {
    decode_samples(input, &Info::read(input)?, &ReadOptions { transfer: Some(Transfer::Linear), layer: None })
}

/// Reads the primaries that a file states, by chunks or by an ICC profile of known ones (PNG, third
/// edition, 4.3).
pub(super) fn primaries(input: Input<'_>, of_profile: Option<Chromaticities>) -> Result<Option<Chromaticities>, IoError> {
    let info = Info::read(input)?;
    let stated = match of_profile {
        Some(found) if info.named_primaries().is_none() => return Ok(Some(found)),
        _ => info.chromaticities(input)?,
    };
    Ok(stated.filter(|found| conversion_to_rec709(found).is_ok()))
}

/// Returns whether a file states a curve of light beyond white.
pub(super) fn states_hdr_curve(input: Input<'_>) -> bool {
    Info::read(input).is_ok_and(|info| info.cicp.is_some_and(|[_, transfer, ..]| [16, 18].contains(&transfer)))
}

/// Returns the curve that a file states, as far as it is one of a developed picture.
pub(super) fn stated_curve(input: Input<'_>) -> Result<Option<StatedCurve>, IoError> {
    // A curve that is not read is no statement here: codes stay codes.
    Ok(match Info::read(input)?.curve(input, &ReadOptions::default()).unwrap_or_default() {
        Some(Curve::Named(Transfer::Linear)) => Some(StatedCurve::Linear),
        Some(Curve::Named(Transfer::Srgb)) => Some(StatedCurve::Srgb),
        Some(Curve::Power(exponent)) => Some(StatedCurve::Power(exponent)),
        _ => None,
    })
}

/// Returns the bits of grey samples of fewer than 8, which the decoder stretches to them.
fn few_bits(bytes: &[u8]) -> Option<u8> {
    /// Places of the bits of a sample and of the colour type, and that of grey (PNG, 11.2.1).
    const BITS: usize = 24;
    const COLOR_TYPE: usize = 25;
    const GREY: u8 = 0;
    let bits = *bytes.get(BITS).filter(|bits| **bits < 8)?;
    (bytes.get(COLOR_TYPE) == Some(&GREY)).then_some(bits)
}

/// Returns the samples through their curve, in the file's primaries.
fn decode_samples(input: Input<'_>, info: &Info, options: &ReadOptions) -> Result<DecodedImage, IoError> {
    input.check_size(info.size.map(u64::from))?;
    let failed = |error: ImageError| explain(input, &error);
    let mut limits = Limits::no_limits();
    // The decoder's own buffers: a few rows, and metadata that can't exceed the file by much more
    // than Deflate's ratio.
    let pixels = u64::from(info.size[0]) * u64::from(info.size[1]);
    limits.max_alloc = Some((64 << 20) + pixels.saturating_mul(8) + input.length());
    let decoder = PngDecoder::with_limits(Cursor::new(input.bytes), limits).map_err(failed)?;
    let color = decoder.color_type();
    let channels = color.channel_count();
    let (depth, bits) = match color {
        ColorType::L8 | ColorType::La8 | ColorType::Rgb8 | ColorType::Rgba8 => (SampleDepth::Integer8, 8),
        ColorType::L16 | ColorType::La16 | ColorType::Rgb16 | ColorType::Rgba16 => (SampleDepth::Integer16, 16),
        _ => return Err(input.unsupported(format!("PNG: colour type {color:?}; export it as RGB"))),
    };
    let chosen = Curve::choose(input, options, info.curve(input, options)?, bits)?;
    let curve = match chosen {
        Curve::Named(transfer) if info.is_narrow() => Curve::Narrow { transfer, bits },
        other => other,
    };
    let (width, height) = (info.size[0] as usize, info.size[1] as usize);
    let layout = SampleGrid { width, height, channels: channels.into() };
    let samples = width * height * usize::from(channels);
    let (image, alpha) = match depth {
        SampleDepth::Integer8 => {
            let mut buffer = input.zeroed::<u8>(samples)?;
            decoder.read_image(&mut buffer).map_err(failed)?;
            layout.assemble8(input, &buffer, curve)?
        }
        _ => {
            let mut buffer = input.zeroed::<u16>(samples)?;
            decoder.read_image(bytemuck::cast_slice_mut(&mut buffer)).map_err(failed)?;
            layout.assemble16(input, &buffer, curve)?
        }
    };
    let depth = few_bits(input.bytes).map_or(depth, SampleDepth::FewBits);
    let (is_display_coded, mut warnings) = (chosen != LINEAR, depth_warnings(depth));
    warnings.extend(info.pixel_aspect.and_then(aspect_warning));
    Ok(DecodedImage { image, alpha, is_premultiplied: false, color_space: None, chromaticities: None, depth, is_display_coded, warnings })
}

/// Returns the size from the first bytes.
pub(super) fn size(input: Input<'_>) -> Result<[u32; 2], IoError> {
    match input.bytes.get(SIGNATURE.len()..).and_then(next_chunk) {
        Some((b"IHDR", data, _)) => header_size(input, data),
        _ => Err(cut_short(input, "expected chunk IHDR at the beginning")),
    }
}

fn header_size(input: Input<'_>, data: &[u8]) -> Result<[u32; 2], IoError> {
    match data.as_chunks::<4>().0 {
        [width, height, ..] => Ok([u32::from_be_bytes(*width), u32::from_be_bytes(*height)]),
        _ => Err(cut_short(input, "chunk IHDR is too short")),
    }
}

fn cut_short(input: Input<'_>, what: &str) -> IoError {
    input.invalid(format!("PNG: {what}; the file is damaged or cut short, copy or export it again"))
}

fn explain(input: Input<'_>, error: &ImageError) -> IoError {
    match error {
        ImageError::Unsupported(_) => input.unsupported(format!("PNG: {error}; export it as RGB")),
        _ => cut_short(input, &error.to_string()),
    }
}

/// Returns the kind, content and what follows of the chunk that `bytes` begin with; its checksum is
/// left to the decoder.
fn next_chunk(bytes: &[u8]) -> Option<(&[u8; 4], &[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    let (kind, rest) = rest.split_first_chunk::<4>()?;
    let (data, rest) = rest.split_at_checked(u32::from_be_bytes(*length) as usize)?;
    let (_checksum, rest) = rest.split_first_chunk::<4>()?;
    Some((kind, data, rest))
}

/// The chunks before the pixels, as far as they concern colour.
#[derive(Clone, Debug, Default, PartialEq)]
struct Info {
    size: [u32; 2],
    /// Primaries, transfer function, matrix and whether the range is full, by ITU-T H.273.
    cicp: Option<[u8; 4]>,
    is_srgb: bool,
    has_icc: bool,
    /// Encoding exponent times 100000.
    gamma: Option<u32>,
    /// White, red, green, blue; xy times 100000.
    chromaticities: Option<[u32; 8]>,
    /// Width of a pixel over its height.
    pixel_aspect: Option<f64>,
}

impl Info {
    fn read(input: Input<'_>) -> Result<Self, IoError> {
        let mut info = Self { size: size(input)?, ..Self::default() };
        let mut rest = input.bytes.get(SIGNATURE.len()..).unwrap_or_default();
        loop {
            let Some((kind, data, after)) = next_chunk(rest) else { return Err(cut_short(input, "ends before chunk IEND")) };
            match kind {
                b"IEND" => return Ok(info),
                b"cICP" => info.cicp = data.first_chunk::<4>().copied(),
                b"sRGB" => info.is_srgb = true,
                b"iCCP" => info.has_icc = true,
                b"gAMA" => info.gamma = data.first_chunk::<4>().map(|b| u32::from_be_bytes(*b)),
                b"cHRM" => info.chromaticities = data.as_chunks::<4>().0.first_chunk::<8>().map(|v| v.map(u32::from_be_bytes)),
                b"pHYs" => {
                    let per_unit = data.as_chunks::<4>().0.first_chunk::<2>().map(|v| v.map(u32::from_be_bytes));
                    info.pixel_aspect = per_unit.map(|[across, down]| f64::from(down) / f64::from(across));
                }
                _ => {}
            }
            rest = after;
        }
    }

    /// Returns the curve that the file states, unless the options overrule it.
    fn curve(&self, input: Input<'_>, options: &ReadOptions) -> Result<Option<Curve>, IoError> {
        /// gAMA of 1 / 2.2: what writers that mean sRGB put where they write no sRGB chunk (PNG,
        /// third edition, 11.3.2.2).
        const SRGB_GAMMA: u32 = 45455;
        if options.transfer.is_some() {
            return Ok(None);
        }
        if let Some([_, transfer, matrix, _]) = self.cicp {
            if matrix != 0 {
                let message =
                    format!("PNG: chunk cICP names matrix {matrix}, expected 0 (RGB), which is the only one PNG may have; convert it");
                return Err(input.unsupported(message));
            }
            return match transfer {
                8 => Ok(Some(Curve::Named(Transfer::Linear))),
                13 => Ok(Some(Curve::Named(Transfer::Srgb))),
                16 => Ok(Some(Curve::Named(Transfer::Pq))),
                18 => Ok(Some(Curve::Named(Transfer::Hlg))),
                other => {
                    let message =
                        format!("PNG: chunk cICP names transfer function {other}, expected 8 (linear), 13 (sRGB), 16 (PQ) or 18 (HLG)");
                    let remedy = Remedy::advice("convert the image").or(Remedy::give("transfer"));
                    Err(input.unsupported(message).with_remedy(remedy))
                }
            };
        }
        Ok(match self.gamma {
            _ if self.is_srgb => Some(Curve::Named(Transfer::Srgb)),
            _ if self.has_icc => None,
            Some(SRGB_GAMMA) => Some(Curve::Named(Transfer::Srgb)),
            Some(100_000) => Some(Curve::Named(Transfer::Linear)),
            Some(gamma @ 1..) => Some(Curve::Power(100_000.0 / f64::from(gamma))),
            Some(0) | None => None,
        })
    }

    /// Returns whether codes are in the narrow range of video.
    fn is_narrow(&self) -> bool {
        self.cicp.is_some_and(|[.., full]| full == 0)
    }

    /// Returns the primaries that cICP names, if it names any.
    fn named_primaries(&self) -> Option<u8> {
        /// "Unspecified" of ITU-T H.273.
        const UNSPECIFIED: u8 = 2;
        self.cicp.map(|[primaries, ..]| primaries).filter(|primaries| *primaries != UNSPECIFIED)
    }

    /// Returns the red, green, blue and white, where the file states them.
    fn chromaticities(&self, input: Input<'_>) -> Result<Option<Chromaticities>, IoError> {
        let d65 = [0.3127, 0.3290];
        if let Some(primaries) = self.named_primaries() {
            return match primaries {
                1 => Ok(Some(ColorSpace::LinearRec709.chromaticities())),
                // Rec.601 of 625 and of 525 lines.
                5 => Ok(Some([[0.640, 0.330], [0.290, 0.600], [0.150, 0.060], d65])),
                6 => Ok(Some([[0.630, 0.340], [0.310, 0.595], [0.155, 0.070], d65])),
                9 => Ok(Some(ColorSpace::LinearRec2020.chromaticities())),
                12 => Ok(Some(ColorSpace::LinearDisplayP3.chromaticities())),
                other => Err(input.unsupported(format!(
                    "PNG: chunk cICP names colour primaries {other}, expected 1 (Rec.709), 5 or 6 (Rec.601), 9 (Rec.2020) or 12 (P3-D65); \
                     convert it"
                ))),
            };
        }
        if self.is_srgb {
            return Ok(Some(ColorSpace::LinearRec709.chromaticities()));
        }
        Ok(self.chromaticities.map(|values| {
            let [xw, yw, xr, yr, xg, yg, xb, yb] = values.map(|v| (f64::from(v) / 100_000.0) as f32);
            [[xr, yr], [xg, yg], [xb, yb], [xw, yw]]
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(info: &Info) -> Option<Curve> {
        info.curve(Input::new("a.png", &[]), &ReadOptions::default()).unwrap()
    }

    #[test]
    fn chunks_state_the_curve_in_the_standards_order() {
        let info = Info { gamma: Some(100_000), ..Info::default() };
        assert_eq!(curve(&info), Some(Curve::Named(Transfer::Linear)));
        assert_eq!(curve(&Info { gamma: Some(50_000), ..Info::default() }), Some(Curve::Power(2.0)));
        assert_eq!(curve(&Info { is_srgb: true, ..info.clone() }), Some(Curve::Named(Transfer::Srgb)));
        assert_eq!(curve(&Info { is_srgb: true, cicp: Some([1, 8, 0, 1]), ..info.clone() }), Some(Curve::Named(Transfer::Linear)));
        assert_eq!(curve(&Info { has_icc: true, ..info }), None);
        assert_eq!(curve(&Info::default()), None);
    }

    #[test]
    fn unknown_code_points_are_refused() {
        let info = Info { cicp: Some([9, 1, 0, 1]), ..Info::default() };
        let error = info.curve(Input::new("a.png", &[]), &ReadOptions::default()).unwrap_err();
        assert!(error.remedy.is_some_and(|remedy| remedy.options().eq(["transfer"])));
        assert!(Info { cicp: Some([22, 8, 0, 1]), ..info.clone() }.chromaticities(Input::new("a.png", &[])).is_err());
        // Unspecified counts as not stated.
        let silent = Info { cicp: Some([2, 13, 0, 1]), ..info };
        assert_eq!(silent.chromaticities(Input::new("a.png", &[])).unwrap(), None);
        let rec709 = ColorSpace::LinearRec709.chromaticities();
        assert_eq!(Info { is_srgb: true, ..silent }.chromaticities(Input::new("a.png", &[])).unwrap(), Some(rec709));
    }
}
