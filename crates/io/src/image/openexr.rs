//! OpenEXR in: half, float and uint channels, scan lines or tiles, every compression of the `exr`
//! crate; HTJ2K and the newer ones of OpenEXR 3.5 are refused by name.
//!
//! Out: the display window; pixels outside of the data window are 0. Which part, layer and view is
//! read: [`super::exr_layers`]. Of mip maps the full resolution. The space is that of
//! `colorInteropID`, else of the chromaticities; absent, the standard's default is Rec.709.
//!
//! Blocks are decompressed on the calling thread: panics can be contained there, and data sets
//! decode images in parallel anyway.

use std::collections::HashSet;
use std::io::{BufReader, Cursor, Read, Seek};
use std::path::Path;

use ::exr::block::chunk::TileCoordinates;
use ::exr::block::reader::ChunksReader;
use ::exr::block::{BlockIndex, UncompressedBlock};
use ::exr::compression::Compression;
use ::exr::error::Error as ExrError;
use ::exr::meta::attribute::{AttributeValue, SampleType};
use ::exr::meta::header::{Header, ImageAttributes};
use ::exr::meta::{BlockDescription, MetaData};
use ::exr::prelude::{Vec2, f16};
use luxel_core::{Chromaticities, Image};

use super::colorimetry::settle_stated;
use super::exr_blocks::check_counts;
use super::exr_header::without_idle_type;
use super::exr_layers::{ColorChannels, Picture, find_picture};
use super::interop_id::{self, InteropSpace};
use super::samples::{LINEAR, aspect_warning};
use super::{DecodedImage, ReadOptions, SampleDepth};
use crate::IoError;
use crate::input::Input;

/// Bytes in which a header is looked at for what the library does not read.
const MOST_HEADER: u64 = 1 << 16;

/// How far chromaticities of a space may be off: files round them.
const CHROMATICITY_TOLERANCE: f32 = 1.5e-3;

/// Decodes a whole file.
pub(super) fn decode(input: Input<'_>, options: &ReadOptions) -> Result<DecodedImage, IoError> {
    let (mut decoded, interop_id) = decode_with_id(input, options)?;
    if let Some(id) = interop_id {
        apply_id(input, &id, &mut decoded)?;
    }
    settle_stated(&mut decoded, "OpenEXR");
    Ok(decoded)
}

/// Decodes the samples as they are stored, in the file's primaries.
pub(super) fn decode_stored(input: Input<'_>, options: &ReadOptions) -> Result<DecodedImage, IoError> {
    decode_with_id(input, options).map(|(decoded, _)| decoded)
}

/// Decodes the samples as they are stored, and returns the name of their space, if there is one.
fn decode_with_id(input: Input<'_>, options: &ReadOptions) -> Result<(DecodedImage, Option<String>), IoError> {
    let pick = |headers: &[Header]| find_picture(input, headers, options.layer.as_deref());
    let (canvas, header, warnings) = draw(input, pick)?;
    let attributes = [&header.own_attributes.other, &header.shared_attributes.other];
    let id = attributes.into_iter().flatten().find_map(|(key, value)| match value {
        AttributeValue::Text(text) if key.eq(interop_id::ATTRIBUTE) => Some(text.to_string()),
        _ => None,
    });
    Ok((canvas.finish(&header.shared_attributes, warnings), id.filter(|id| !id.is_empty())))
}

/// Takes the space that a file's `colorInteropID` names, which goes before its chromaticities.
fn apply_id(input: Input<'_>, id: &str, decoded: &mut DecodedImage) -> Result<(), IoError> {
    match interop_id::parse(id) {
        InteropSpace::Colors { chromaticities, curve, white } => {
            let is_other = |stated: &Chromaticities| {
                let pairs = stated.as_flattened().iter().zip(chromaticities.as_flattened());
                stated.as_flattened().iter().any(|v| *v != 0.0) && pairs.clone().any(|(a, b)| (a - b).abs() > CHROMATICITY_TOLERANCE)
            };
            if let Some(stated) = decoded.chromaticities.filter(is_other) {
                let message = format!("colorInteropID {id:?} contradicts the chromaticities {stated:?}: the name is taken");
                decoded.warnings.push(message);
            }
            decoded.chromaticities = Some(chromaticities);
            if white != [1.0; 3] {
                decoded.image.pixels.iter_mut().for_each(|pixel| *pixel = [0, 1, 2].map(|c| pixel[c] / white[c]));
            }
            if curve != LINEAR {
                decoded.image.pixels.iter_mut().for_each(|pixel| *pixel = pixel.map(|v| curve.decode(v.into())));
                decoded.is_display_coded = true;
                decoded.warnings.push(format!("colorInteropID {id:?} is a space whose numbers are not light: they are decoded to it"));
            }
        }
        InteropSpace::Data => decoded.warnings.push(format!("colorInteropID is {id:?}: its numbers are no colours, and are read as light")),
        InteropSpace::Unknown => {
            let space = if decoded.chromaticities.is_some() { "its chromaticities are taken" } else { "linear-rec709 is taken for it" };
            decoded.warnings.push(format!("colorInteropID {id:?} is no name of a space that is known: {space}"));
        }
        InteropSpace::Refused => {
            let message = format!("OpenEXR: colorInteropID {id:?} is a space whose numbers are not light; export it as linear light");
            return Err(input.unsupported(message));
        }
    }
    Ok(())
}

/// Decodes the channel of depth: width and height, and its values by row.
pub(crate) fn decode_depth(input: Input<'_>) -> Result<([usize; 2], Vec<f32>), IoError> {
    let pick = |headers: &[Header]| {
        let (part, channel) = find_depth(headers).ok_or_else(|| {
            let found: Vec<String> = headers.iter().flat_map(|h| &h.channels.list).take(16).map(|c| c.name.to_string()).collect();
            input.unsupported(format!("OpenEXR: no depth, found channels {}; expected Z, depth, or a single channel", found.join(", ")))
        })?;
        Ok(Picture { part, color: ColorChannels { rgb: [channel; 3], alpha: None }, warnings: Vec::new() })
    };
    let (Canvas { image, .. }, ..) = draw(input, pick)?;
    Ok(([image.width, image.height], image.pixels.into_iter().map(|[z, ..]| z).collect()))
}

/// Names of channels of depth, and of grey pictures, the best first; the last part of a channel's
/// name counts, in any case.
const DEPTH_CHANNELS: [&str; 6] = ["z", "depth", "d", "v", "y", "r"];

/// Returns the part and the channel of depth.
fn find_depth(headers: &[Header]) -> Option<(usize, usize)> {
    let channels = || headers.iter().enumerate().flat_map(|(part, h)| h.channels.list.iter().enumerate().map(move |(i, c)| (part, i, c)));
    let named = |wanted: &str| {
        channels().find(|(.., channel)| {
            let name = channel.name.to_string();
            name.rsplit('.').next().is_some_and(|last| last.eq_ignore_ascii_case(wanted))
        })
    };
    let only = || channels().next().filter(|_| channels().count() == 1);
    DEPTH_CHANNELS.iter().find_map(|wanted| named(wanted)).or_else(only).map(|(part, channel, _)| (part, channel))
}

/// Draws the channels of the picture that `pick` finds among the headers.
fn draw(input: Input<'_>, pick: impl FnOnce(&[Header]) -> Result<Picture, IoError>) -> Result<(Canvas, Header, Vec<String>), IoError> {
    let failed = |error: ExrError| explain(input.name, &error);
    let bytes = without_idle_type(input.bytes);
    let input = input.with_bytes(&bytes);
    let reader = ::exr::block::read(Cursor::new(input.bytes), false).map_err(failed)?;
    for header in reader.headers() {
        check_header(input, header)?;
    }
    let Picture { part, color, warnings } = pick(reader.headers())?;
    let header = reader.headers().get(part).ok_or_else(|| input.invalid("header: no parts"))?.clone();

    if matches!(header.compression, Compression::HTJ2K32 | Compression::HTJ2K256) {
        return Err(input.unsupported("OpenEXR: HTJ2K compression, which is not read; export it with ZIP compression"));
    }
    if header.channels.list.iter().any(|channel| channel.sampling != Vec2(1, 1)) {
        return Err(input.unsupported("OpenEXR: subsampled channels (luminance and chroma); export it as RGB"));
    }
    // Chunk tables are read here and bound the number of blocks by the file's length: only now is
    // memory for pixels is requested.
    let full_resolution = |_: &MetaData, tile: TileCoordinates, block: BlockIndex| block.layer == part && tile.level_index == Vec2(0, 0);
    let chunks = reader.filter_chunks(false, full_resolution).map_err(failed)?;
    let mut canvas = Canvas::new(input, &header, color)?;
    let expected = chunks.len();
    let mut seen = HashSet::with_capacity(expected);
    let meta = chunks.meta_data().clone();
    for chunk in chunks {
        let chunk = chunk.map_err(failed)?;
        check_counts(input, &chunk, &meta.headers)?;
        let block = UncompressedBlock::decompress_chunk(chunk, &meta, false).map_err(failed)?;
        let at = block.index;
        if at.layer != part || at.level != Vec2(0, 0) || !seen.insert((at.pixel_position.0, at.pixel_position.1)) {
            return Err(input.invalid("chunk table: points to a wrong chunk or to one twice; the file is damaged, export it again"));
        }
        canvas.draw(&block, &header);
    }
    Ok((canvas, header, warnings))
}

/// Returns the size of the display window, from the header.
pub(super) fn size(name: &Path, mut file: impl Read + Seek) -> Result<[u32; 2], IoError> {
    let mut head = Vec::new();
    file.by_ref().take(MOST_HEADER).read_to_end(&mut head).map_err(|e| IoError::system(name, "read", &e))?;
    let mut read = MetaData::read_from_buffered(Cursor::new(without_idle_type(&head)), false);
    if read.is_err() && head.len() as u64 == MOST_HEADER {
        file.rewind().map_err(|e| IoError::system(name, "read", &e))?;
        read = MetaData::read_from_buffered(BufReader::new(file), false);
    }
    let meta = read.map_err(|error| explain(name, &error))?;
    let header = meta.headers.first().ok_or_else(|| IoError::invalid(name, "header: no parts"))?;
    let Vec2(width, height) = header.shared_attributes.display_window.size;
    Ok([width, height].map(|side| u32::try_from(side).unwrap_or(u32::MAX)))
}

/// Words an error of the decoder.
pub(super) fn explain(name: &Path, error: &ExrError) -> IoError {
    match error {
        ExrError::NotSupported(what) if what.contains("unknown compression") => IoError::unsupported(
            name,
            "OpenEXR: a compression of OpenEXR 3.5 or newer (LJ2K, ZSTD), which is not read; export it with ZIP compression",
        ),
        ExrError::NotSupported(what) => {
            IoError::unsupported(name, format!("OpenEXR: {what}; export it as flat scan lines with ZIP compression"))
        }
        ExrError::Invalid(what) => {
            IoError::invalid(name, format!("OpenEXR: {what}; the file is damaged or cut short, copy or export it again"))
        }
        ExrError::Io(error) => IoError::invalid(name, format!("OpenEXR: {error}; the file is cut short, copy or export it again")),
        ExrError::Aborted => IoError::invalid(name, "OpenEXR: reading was aborted"),
    }
}

/// Refuses absurd windows and blocks before anything is allocated for them.
fn check_header(input: Input<'_>, header: &Header) -> Result<(), IoError> {
    let Vec2(width, height) = header.layer_size;
    let Vec2(display_width, display_height) = header.shared_attributes.display_window.size;
    input.check_size([width as u64, height as u64])?;
    input.check_size([display_width as u64, display_height as u64])?;
    let pixels = match header.blocks {
        BlockDescription::Tiles(tiles) => tiles.tile_size.0.saturating_mul(tiles.tile_size.1),
        BlockDescription::ScanLines => width.saturating_mul(header.compression.scan_lines_per_block()),
    };
    input.check_block(pixels.saturating_mul(header.channels.bytes_per_pixel) as u64)
}

/// The display window while blocks of the data window are drawn onto it.
struct Canvas {
    image: Image,
    alpha: Option<Vec<f32>>,
    /// Data window's corner as seen from the display window's, pixels.
    offset: [i64; 2],
    color: ColorChannels,
}

impl Canvas {
    fn new(input: Input<'_>, header: &Header, color: ColorChannels) -> Result<Self, IoError> {
        let display = header.shared_attributes.display_window;
        let Vec2(width, height) = display.size;
        let data = header.own_attributes.layer_position;
        Ok(Self {
            image: Image { width, height, pixels: input.zeroed(width * height)? },
            alpha: color.alpha.map(|_| input.zeroed(width * height)).transpose()?,
            offset: [i64::from(data.0) - i64::from(display.position.0), i64::from(data.1) - i64::from(display.position.1)],
            color,
        })
    }

    fn draw(&mut self, block: &UncompressedBlock, header: &Header) {
        let Self { image, alpha, offset, color } = self;
        let width = image.width;
        for line in block.lines(&header.channels) {
            let at = line.location;
            let channels = [0, 1, 2].map(|c| color.rgb[c] == at.channel);
            let is_alpha = color.alpha == Some(at.channel);
            let Some(sample_type) = header.channels.list.get(at.channel).map(|channel| channel.sample_type) else { continue };
            let y = at.position.1 as i64 + offset[1];
            if !(channels.contains(&true) || is_alpha) || y < 0 || y >= image.height as i64 {
                continue;
            }
            let row = y as usize * width;
            let first_x = at.position.0 as i64 + offset[0];
            let mut put = |i: usize, value: f32| {
                let x = first_x + i as i64;
                if x < 0 || x >= width as i64 {
                    return;
                }
                let target = row + x as usize;
                if is_alpha {
                    if let Some(alpha) = alpha.as_mut().and_then(|alpha| alpha.get_mut(target)) {
                        *alpha = value;
                    }
                } else if let Some(pixel) = image.pixels.get_mut(target) {
                    for (component, _) in pixel.iter_mut().zip(channels).filter(|(_, is_here)| *is_here) {
                        *component = value;
                    }
                }
            };
            // Decompressed samples are in the machine's byte order.
            match sample_type {
                SampleType::F16 => line.value.as_chunks().0.iter().enumerate().for_each(|(i, &b)| put(i, f16::from_ne_bytes(b).to_f32())),
                SampleType::F32 => line.value.as_chunks().0.iter().enumerate().for_each(|(i, &b)| put(i, f32::from_ne_bytes(b))),
                SampleType::U32 => line.value.as_chunks().0.iter().enumerate().for_each(|(i, &b)| put(i, u32::from_ne_bytes(b) as f32)),
            }
        }
    }

    fn finish(self, attributes: &ImageAttributes, mut warnings: Vec<String>) -> DecodedImage {
        let Self { image, alpha, .. } = self;
        warnings.extend(aspect_warning(attributes.pixel_aspect.into()));
        let chromaticities = attributes.chromaticities.map(|c| [c.red, c.green, c.blue, c.white].map(|Vec2(x, y)| [x, y]));
        DecodedImage {
            image,
            alpha,
            is_premultiplied: true,
            color_space: None,
            chromaticities,
            depth: SampleDepth::Float,
            is_display_coded: false,
            warnings,
        }
    }
}
