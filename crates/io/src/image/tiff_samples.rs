//! The samples of a TIFF's first image, of any number of channels, as their file has them.
//!
//! The library drops the samples that it takes for no colour before it undoes a predictor, and
//! counts a tile's rows by colours alone; it knows no FillOrder, and leaves samples below a byte
//! packed. Here all samples are declared alike, and everything else is done on what it
//! returns: channels are chosen, planes are interleaved, bits are unpacked.
//!
//! In: the bytes of a file. Out: codes or floats `[H, W, C]`, C of 1 (grey) or 3 (RGB), with one
//! more where there is an opacity. Extra samples that are no opacity, such as saved selections, are
//! left out.
//!
//! Degenerate: an extra sample of a file without ExtraSamples is an opacity, as programs write
//! them.

use std::borrow::Cow;
use std::io::{BufReader, Cursor, Read, Seek};
use std::path::Path;

use ::tiff::decoder::{Decoder, DecodingResult, Limits};
use ::tiff::tags::Tag;
use ::tiff::{ColorType, TiffError};

use super::samples::SampleGrid;
use crate::IoError;
use crate::input::Input;
use crate::memory::check_memory;
use crate::tags::set_number;

/// Bytes of the widest sample, an f64.
const MAX_SAMPLE_BYTES: usize = 8;

/// Bytes per pixel of what the samples become: f32 of three channels and of alpha.
const OUTPUT_BYTES: u64 = 16;

/// Values of ExtraSamples.
const ASSOCIATED_ALPHA: u16 = 1;
const UNASSOCIATED_ALPHA: u16 = 2;

/// Values of PhotometricInterpretation.
const WHITE_IS_ZERO: u16 = 0;
const BLACK_IS_ZERO: u16 = 1;
const RGB: u16 = 2;

/// Value of PlanarConfiguration for a plane of each channel.
const SEPARATE_PLANES: u16 = 2;

/// Value of FillOrder for bytes whose lowest bit comes first.
const LOWEST_BIT_FIRST: u16 = 2;

/// Samples of the channels that are read.
pub(super) struct ReadSamples {
    pub(super) layout: SampleGrid,
    /// Codes, of 16 bits where the file has fewer than 8, or floats.
    pub(super) values: DecodingResult,
    /// Bits of a sample in the file.
    pub(super) bits: u8,
    /// Whether colours are multiplied by alpha, as far as the file states.
    pub(super) is_premultiplied: Option<bool>,
}

/// The channels of an image.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Channels {
    /// Samples of a pixel.
    stored: usize,
    /// Indices of those that are read: grey or red, green, blue; then opacity.
    picked: Vec<usize>,
    is_premultiplied: Option<bool>,
}

impl Channels {
    /// Returns the channels of `colors` and `extra` samples; `stated` are the values of
    /// ExtraSamples, where there are any.
    fn new(colors: usize, extra: usize, stated: Option<&[u16]>) -> Self {
        let is_alpha = |kind: &u16| [ASSOCIATED_ALPHA, UNASSOCIATED_ALPHA].contains(kind);
        let alpha = match stated {
            Some(stated) => stated.iter().take(extra).position(is_alpha),
            None => (extra == 1).then_some(0),
        };
        let is_premultiplied = alpha.and_then(|at| stated?.get(at).copied()).map(|kind| kind == ASSOCIATED_ALPHA);
        let picked = (0..colors).chain(alpha.map(|at| colors + at)).collect();
        Self { stored: colors + extra, picked, is_premultiplied }
    }

    /// Returns whether the library reads them as they are stored.
    fn is_plain(&self, color: ColorType) -> bool {
        usize::from(color.num_samples()) == self.stored
    }
}

/// Reads the samples of the first image of `bytes`, whose header is sound.
pub(super) fn read(input: Input<'_>) -> Result<ReadSamples, IoError> {
    let failed = |error: TiffError| explain(input.name, &error);
    let mut decoder = Decoder::new(Cursor::new(input.bytes)).map_err(failed)?;
    let (width, height) = decoder.dimensions().map_err(failed)?;
    let color = decoder.colortype().map_err(failed)?;
    let bits = color.bit_depth();
    let is_separate = decoder.find_tag_unsigned(Tag::PlanarConfiguration).map_err(failed)? == Some(SEPARATE_PLANES);
    let is_tiled = decoder.find_tag(Tag::TileOffsets).map_err(failed)?.is_some();
    let channels = channels(input, &mut decoder, color)?;
    if is_separate && is_tiled && channels.stored > 1 {
        return Err(input.unsupported("TIFF: tiles of channels in separate planes; export it with interleaved channels, or in strips"));
    }
    let pixels = u64::from(width) * u64::from(height);
    let sample_bytes = u64::from(bits.div_ceil(8)) * channels.stored as u64;
    let ordered = in_order(input, &mut decoder)?;
    let source = as_equal_samples(ordered, &channels, color);
    let copied = if matches!(source, Cow::Owned(_)) { input.length() } else { 0 };
    check_memory(input.name, pixels.saturating_mul(sample_bytes + OUTPUT_BYTES).saturating_add(copied))?;
    // The library fills its memory before it decodes.
    let stored_bytes = pixels.saturating_mul(u64::from(bits) * channels.stored as u64).div_ceil(8);
    input.check_block(stored_bytes)?;

    let mut limits = Limits::default();
    limits.decoding_buffer_size = (width as usize * height as usize).saturating_mul(MAX_SAMPLE_BYTES * channels.stored);
    limits.intermediate_buffer_size = limits.decoding_buffer_size.max(1 << 20);
    limits.ifd_value_size = input.bytes.len().max(1 << 20);
    let mut decoder = Decoder::new(Cursor::new(source.as_ref())).map_err(failed)?.with_limits(limits);
    let mut values = DecodingResult::U8(Vec::new());
    decoder.read_image_to_buffer(&mut values).map_err(failed)?;
    let size = [width as usize, height as usize];
    if let (DecodingResult::U8(packed), true) = (&values, bits < 8) {
        let row = if is_separate { size[0] } else { size[0] * channels.stored };
        values = DecodingResult::U16(unpacked(packed, row, bits));
    }
    let layout = SampleGrid { width: size[0], height: size[1], channels: channels.picked.len() };
    let picked = Picked { pixels: size[0] * size[1], channels: &channels, is_separate };
    Ok(ReadSamples { layout, values: picked.of(values), bits, is_premultiplied: channels.is_premultiplied })
}

/// Returns the channels of the first image; an error for colours other than grey and RGB.
fn channels<R: Read + Seek>(input: Input<'_>, decoder: &mut Decoder<R>, color: ColorType) -> Result<Channels, IoError> {
    let failed = |error: TiffError| explain(input.name, &error);
    let photometric = decoder.find_tag_unsigned::<u16>(Tag::PhotometricInterpretation).map_err(failed)?;
    let refused = || input.unsupported(format!("TIFF: colour type {color:?}; export it as RGB"));
    if photometric == Some(WHITE_IS_ZERO) && is_float(Cursor::new(input.bytes)) {
        return Err(input.unsupported(
            "TIFF: floating-point samples of which 0 is white (WhiteIsZero), which are no light; export it with 0 for black (BlackIsZero)",
        ));
    }
    let colors = match (photometric, color) {
        (Some(RGB), ColorType::RGB(_) | ColorType::RGBA(_)) => 3,
        (Some(WHITE_IS_ZERO | BLACK_IS_ZERO), ColorType::Gray(_) | ColorType::GrayA(_) | ColorType::Multiband { .. }) => 1,
        _ => return Err(refused()),
    };
    let stored = decoder.find_tag_unsigned::<u16>(Tag::SamplesPerPixel).map_err(failed)?.map_or(1, usize::from);
    let stated = decoder.find_tag_unsigned_vec::<u16>(Tag::ExtraSamples).map_err(failed)?;
    let extra = stored.checked_sub(colors).ok_or_else(refused)?;
    // Grey of several channels is no picture, unless its file says which of them is grey.
    if extra > 1 && stated.as_ref().map_or(0, Vec::len) != extra {
        return Err(refused());
    }
    Ok(Channels::new(colors, extra, stated.as_deref()))
}

/// Returns the file with the highest bit of each byte of its samples first.
fn in_order<'a, R: Read + Seek>(input: Input<'a>, decoder: &mut Decoder<R>) -> Result<Cow<'a, [u8]>, IoError> {
    const UNCOMPRESSED: u16 = 1;
    const LZW: u16 = 5;
    const JPEG: [u16; 2] = [6, 7];
    const OTHERS: [u16; 3] = [8, 32_946, 32_773];
    let failed = |error: TiffError| explain(input.name, &error);
    if decoder.find_tag_unsigned(Tag::FillOrder).map_err(failed)? != Some(LOWEST_BIT_FIRST) {
        return Ok(input.bytes.into());
    }
    let compression = decoder.find_tag_unsigned::<u16>(Tag::Compression).map_err(failed)?.unwrap_or(UNCOMPRESSED);
    match compression {
        UNCOMPRESSED..=LZW => {}
        // Bytes of JPEG have their own order (TIFF Technical Note 2).
        other if JPEG.contains(&other) => return Ok(input.bytes.into()),
        other if OTHERS.contains(&other) => {}
        other => {
            let message = format!("TIFF: bytes with the lowest bit first (FillOrder 2) in compression {other}; export it with FillOrder 1");
            return Err(input.unsupported(message));
        }
    }
    let mut list = |tag| decoder.find_tag_unsigned_vec::<u64>(tag).map(Option::unwrap_or_default).map_err(failed);
    let starts = [list(Tag::StripOffsets)?, list(Tag::TileOffsets)?].concat();
    let counts = [list(Tag::StripByteCounts)?, list(Tag::TileByteCounts)?].concat();
    let mut blocks: Vec<[u64; 2]> = starts.into_iter().zip(counts).map(|(start, count)| [start, start.saturating_add(count)]).collect();
    blocks.sort_unstable();
    let mut ordered = input.bytes.to_vec();
    let mut done = 0u64;
    for [start, end] in blocks {
        // Blocks may share bytes.
        let range = usize::try_from(start.max(done)).ok().zip(usize::try_from(end.min(input.length())).ok());
        if let Some(block) = range.and_then(|(start, end)| ordered.get_mut(start..end)) {
            block.iter_mut().for_each(|byte| *byte = byte.reverse_bits());
        }
        done = done.max(end);
    }
    Ok(ordered.into())
}

/// Returns the file as one of samples without a meaning, which the library returns all of, where it
/// would leave some out.
fn as_equal_samples<'a>(bytes: Cow<'a, [u8]>, channels: &Channels, color: ColorType) -> Cow<'a, [u8]> {
    if channels.is_plain(color) {
        return bytes;
    }
    let mut changed = bytes.into_owned();
    set_number(&mut changed, Tag::PhotometricInterpretation.to_u16(), BLACK_IS_ZERO);
    changed.into()
}

/// Returns the 16-bit codes of samples of 1 to 7 bits, which 8 do not hold exactly, in rows of
/// `row` samples that begin with a byte.
fn unpacked(packed: &[u8], row: usize, bits: u8) -> Vec<u16> {
    let bits = usize::from(bits.clamp(1, 7));
    let most = (1u32 << bits) - 1;
    let code = |bytes: &[u8], x: usize| {
        let byte = |at: usize| u32::from(bytes.get(at).copied().unwrap_or(0));
        let at = x * bits;
        let pair = byte(at / 8) << 8 | byte(at / 8 + 1);
        let sample = pair >> (16 - bits - at % 8) & most;
        // At most 65535; to the nearest code.
        ((sample * 65535 + most / 2) / most) as u16
    };
    packed.chunks((row * bits).div_ceil(8).max(1)).flat_map(|bytes| (0..row).map(move |x| code(bytes, x))).collect()
}

/// The channels to take of all that are stored.
struct Picked<'a> {
    pixels: usize,
    channels: &'a Channels,
    is_separate: bool,
}

impl Picked<'_> {
    /// Returns the samples of the picked channels, interleaved. Kinds that are not read stay as
    /// they are.
    fn of(&self, values: DecodingResult) -> DecodingResult {
        match values {
            DecodingResult::U8(v) => DecodingResult::U8(self.interleaved(v)),
            DecodingResult::U16(v) => DecodingResult::U16(self.interleaved(v)),
            DecodingResult::F16(v) => DecodingResult::F16(self.interleaved(v)),
            DecodingResult::F32(v) => DecodingResult::F32(self.interleaved(v)),
            DecodingResult::F64(v) => DecodingResult::F64(self.interleaved(v)),
            other => other,
        }
    }

    fn interleaved<T: Copy>(&self, samples: Vec<T>) -> Vec<T> {
        let Channels { stored, picked, .. } = self.channels;
        let is_all = picked.len() == *stored && (!self.is_separate || *stored == 1);
        if is_all || samples.len() != self.pixels * stored {
            return samples;
        }
        let [pixel, channel] = if self.is_separate { [1, self.pixels] } else { [*stored, 1] };
        (0..self.pixels)
            .flat_map(|i| picked.iter().map(move |c| (i, *c)))
            .filter_map(|(i, c)| samples.get(i * pixel + c * channel).copied())
            .collect()
    }
}

/// Returns whether the samples of the first image are floating-point numbers.
pub(super) fn is_float(file: impl Read + Seek) -> bool {
    const FLOAT: u16 = 3;
    let formats =
        Decoder::new(BufReader::new(file)).ok().and_then(|mut d| d.find_tag_unsigned_vec::<u16>(Tag::SampleFormat).ok().flatten());
    formats.is_some_and(|formats| formats.first() == Some(&FLOAT))
}

/// Words an error of the library.
pub(super) fn explain(name: &Path, error: &TiffError) -> IoError {
    match error {
        TiffError::UnsupportedError(_) => IoError::unsupported(name, format!("TIFF: {error}; export it as RGB with Deflate compression")),
        _ => IoError::invalid(name, format!("TIFF: {error}; the file is damaged or cut short, copy or export it again")),
    }
}
