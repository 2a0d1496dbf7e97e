//! SPZ to a scene of display colours.

use std::io::Read;
use std::path::Path;

use flate2::read::GzDecoder;
use luxel_core::{Antialias, ColorModel, Scene, Splats, logit};

use super::layout::{
    AXES_EXTENSION, FLAG_ANTIALIASED, FLAG_EXTENSIONS, FileAxes, HEADER, LEGACY_HEADER, MAGIC, block_bytes, unpack_color,
    unpack_coordinate, unpack_harmonic, unpack_log_scale, unpack_opacity, unpack_rotation_first_three, unpack_rotation_smallest_three,
};
use crate::IoError;
use crate::input::Input;
use crate::local_frame::settled;
use crate::memory::check_memory;
use crate::read_file::read_file;
use crate::scene_file::{SceneFile, display_scene};

/// Bytes of splats that any file may claim, however short.
const FREE_BYTES: u64 = 64 << 20;

/// Bytes of splats that a byte of file may encode beyond that. Splats compress to a fraction of
/// what they take, equal ones to a hundredth.
const MAX_RATIO: u64 = 64;

/// Most bytes of vendors' records that are looked at behind the blocks of versions 2 and 3.
const MOST_EXTENSIONS: u64 = 1 << 16;

/// Reads a scene. Its axes become those of 3D Gaussian splatting's PLY.
///
/// # Errors
/// A missing, truncated or otherwise damaged file, or a version other than 2 to 4.
pub fn read_spz(path: &Path) -> Result<Scene, IoError> {
    read_scene_file(path).map(|file| file.scene)
}

/// Reads a scene with its warnings.
pub(crate) fn read_scene_file(path: &Path) -> Result<SceneFile, IoError> {
    decode(Input::new(path, &read_file(path)?))
}

/// Decodes a file's bytes as [`read_spz`] does; `name` is for errors.
///
/// # Errors
/// The same as [`read_spz`].
pub fn decode_spz(name: &Path, bytes: &[u8]) -> Result<Scene, IoError> {
    decode(Input::new(name, bytes)).map(|file| file.scene)
}

fn decode(input: Input<'_>) -> Result<SceneFile, IoError> {
    let Content { head, blocks, extensions } =
        if input.bytes.starts_with(&MAGIC.to_le_bytes()) { zstd_blocks(input)? } else { gzip_blocks(input)? };
    let mut warnings = Vec::new();
    let axes = match stated_axes(&extensions) {
        Some(code) => FileAxes::from_code(code).ok_or_else(|| {
            let message = format!("extension SPZ_ADOBE_coordinate_system states axes {code}, expected 1 to 16; export it again");
            input.unsupported(message)
        })?,
        None => {
            warnings.push(UNSTATED_AXES.to_owned());
            FileAxes::RIGHT_UP_BACK
        }
    };
    let mut splats = splats(&head, &blocks);
    axes.apply(&mut splats);
    let antialias = if head.flags & FLAG_ANTIALIASED == 0 { Antialias::Off } else { Antialias::Mip };
    let scene = display_scene(splats, antialias);
    Ok(SceneFile { scene: settled(scene, None), warnings })
}

/// The warning about a file that leaves its axes to convention.
const UNSTATED_AXES: &str = "the file does not state its axes: read as right, up, back, which is the format's convention; if the scene is \
                             upside down, its program kept a PLY's axes, and half a turn about x makes it right";

/// The content of a file.
struct Content {
    head: Head,
    blocks: Vec<Vec<u8>>,
    /// Records of vendors, one after another.
    extensions: Vec<u8>,
}

/// Returns the axes that a record of the extensions states; those that say nothing count as none.
fn stated_axes(extensions: &[u8]) -> Option<u32> {
    let mut rest = extensions;
    while let Some((head, after)) = rest.split_first_chunk::<8>() {
        let [kind, length] = [0, 1].map(|i| u32::from_le_bytes(head.as_chunks::<4>().0[i]));
        let (payload, after) = after.split_at_checked(length as usize)?;
        if kind == AXES_EXTENSION {
            return payload.first_chunk().map(|code| u32::from_le_bytes(*code)).filter(|code| *code != 0);
        }
        rest = after;
    }
    None
}

/// The header ahead of the blocks.
struct Head {
    version: u32,
    count: usize,
    degree: usize,
    bits: u8,
    flags: u8,
    streams: u8,
}

impl Head {
    fn parse(input: Input<'_>) -> Result<Self, IoError> {
        let invalid = |message: String| input.invalid(format_args!("header: {message}"));
        let Some((head, _)) = input.bytes.split_first_chunk::<LEGACY_HEADER>() else {
            return Err(invalid(format!("{} bytes, expected {LEGACY_HEADER} at least; the file is truncated", input.bytes.len())));
        };
        let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
        if word(0) != MAGIC {
            return Err(invalid("does not begin with NGSP: not an SPZ file".into()));
        }
        let (version, count) = (word(4), word(8));
        let [degree, bits, flags, streams] = [head[12], head[13], head[14], head[15]];
        if !(2..=4).contains(&version) {
            let message = format!("SPZ version {version}, expected 2 to 4; convert it with the program it is from");
            return Err(input.unsupported(message));
        }
        if degree > 4 {
            return Err(invalid(format!("harmonics of degree {degree}, expected 0 to 4")));
        }
        if bits > 23 {
            return Err(invalid(format!("{bits} fractional bits, expected 0 to 23")));
        }
        Ok(Self { version, count: count as usize, degree: degree.into(), bits, flags, streams })
    }

    /// Refuses more splats than the file can plausibly hold, or than the limit of memory allows.
    fn check_count(&self, input: Input<'_>) -> Result<(), IoError> {
        let claimed: u64 = self.sizes().iter().sum();
        let file_bytes = input.length();
        if claimed > FREE_BYTES.saturating_add(file_bytes.saturating_mul(MAX_RATIO)) {
            let message = format!("header: claims {} splats in a file of {file_bytes} bytes; the file is damaged or cut short", self.count);
            return Err(input.invalid(message));
        }
        // The bytes, and what they become: harmonics grow fourfold, all else by less.
        check_memory(input.name, claimed.saturating_mul(5))
    }

    /// Returns the bytes of each block.
    fn sizes(&self) -> [u64; 6] {
        block_bytes(self.version, self.degree).map(|bytes| bytes as u64 * self.count as u64)
    }
}

fn truncated(input: Input<'_>, expected: u64, found: usize) -> IoError {
    input.invalid(format_args!("{found} bytes of splats, expected {expected}; the file is truncated or its header wrong"))
}

/// Reads the blocks of versions 2 and 3.
fn gzip_blocks(input: Input<'_>) -> Result<Content, IoError> {
    let damaged = |e: std::io::Error| input.invalid(format_args!("gzip: {e}; the file is damaged or cut short"));
    let mut decoder = GzDecoder::new(input.bytes);
    let mut start = Vec::new();
    decoder.by_ref().take(LEGACY_HEADER as u64).read_to_end(&mut start).map_err(damaged)?;
    let head = Head::parse(input.with_bytes(&start))?;
    if head.version > 3 {
        return Err(input.invalid("header: version 4 inside of gzip, expected it bare; the file is damaged"));
    }
    head.check_count(input)?;
    let mut blocks = Vec::with_capacity(6);
    for size in head.sizes() {
        let mut block = Vec::new();
        // Grows with the data, never with the claim.
        decoder.by_ref().take(size).read_to_end(&mut block).map_err(damaged)?;
        if block.len() as u64 != size {
            return Err(truncated(input, size, block.len()));
        }
        blocks.push(block);
    }
    let mut extensions = Vec::new();
    if head.flags & FLAG_EXTENSIONS != 0 {
        decoder.by_ref().take(MOST_EXTENSIONS).read_to_end(&mut extensions).map_err(damaged)?;
    }
    // Only the end of the stream has the checksum and the length, which the decoder compares.
    std::io::copy(&mut decoder, &mut std::io::sink()).map_err(damaged)?;
    Ok(Content { head, blocks, extensions })
}

/// Reads the blocks of version 4.
fn zstd_blocks(input: Input<'_>) -> Result<Content, IoError> {
    let head = Head::parse(input)?;
    let invalid = |message: String| input.invalid(format_args!("header: {message}"));
    if head.version < 4 {
        return Err(invalid(format!("version {} without gzip, expected it compressed; the file is damaged", head.version)));
    }
    head.check_count(input)?;
    let bytes = input.bytes;
    let table_at = bytes.get(LEGACY_HEADER..LEGACY_HEADER + 4).and_then(|b| b.try_into().ok()).map_or(0, u32::from_le_bytes) as usize;
    let expected = head.sizes().iter().filter(|size| **size > 0).count();
    if usize::from(head.streams) != expected {
        return Err(invalid(format!("{} streams, expected {expected}", head.streams)));
    }
    let table = table_at.checked_add(16 * expected).and_then(|end| bytes.get(table_at..end));
    let Some(table) = table.filter(|_| table_at >= HEADER) else {
        return Err(invalid(format!("table of streams at byte {table_at} of {}, expected it from {HEADER} on", bytes.len())));
    };
    let extensions = if head.flags & FLAG_EXTENSIONS == 0 { Vec::new() } else { bytes.get(HEADER..table_at).unwrap_or_default().to_vec() };
    let mut rest = &bytes[table_at + table.len()..];
    let mut entries = table.chunks_exact(8).map(|b| b.try_into().map_or(0, u64::from_le_bytes));
    let mut blocks = Vec::with_capacity(6);
    for size in head.sizes() {
        if size == 0 {
            blocks.push(Vec::new());
            continue;
        }
        let (compressed, claimed) = (entries.next().unwrap_or(0), entries.next().unwrap_or(0));
        if claimed != size {
            return Err(invalid(format!("a stream of {claimed} bytes, expected {size}")));
        }
        let Some((stream, after)) = usize::try_from(compressed).ok().and_then(|n| rest.split_at_checked(n)) else {
            return Err(truncated(input, compressed, rest.len()));
        };
        rest = after;
        blocks.push(decompress(input.with_bytes(stream), size)?);
    }
    Ok(Content { head, blocks, extensions })
}

fn decompress(input: Input<'_>, size: u64) -> Result<Vec<u8>, IoError> {
    let damaged = |e: std::io::Error| input.invalid(format_args!("zstd: {e}; the file is damaged or cut short"));
    let mut block = Vec::new();
    // Grows with the data, never with the claim.
    let mut decoder = ::zstd::stream::read::Decoder::new(input.bytes).map_err(damaged)?;
    decoder.by_ref().take(size).read_to_end(&mut block).map_err(damaged)?;
    if block.len() as u64 != size {
        return Err(truncated(input, size, block.len()));
    }
    // Only the end of the stream has the checksum, if there is one.
    std::io::copy(&mut decoder, &mut std::io::sink()).map_err(damaged)?;
    Ok(block)
}

/// Decodes blocks of the right sizes to splats in the file's axes. Every byte encodes a number:
/// nothing can be wrong any more.
fn splats(head: &Head, blocks: &[Vec<u8>]) -> Splats {
    let [positions, opacities, colors, scales, rotations, harmonics] = blocks else {
        return Splats::empty(ColorModel::Sh { degree: 0 });
    };
    let color_model = ColorModel::Sh { degree: head.degree as u8 };
    let mut splats = Splats::empty(color_model);
    splats.position = positions.as_chunks::<3>().0.as_chunks::<3>().0.iter().map(|p| p.map(|c| unpack_coordinate(c, head.bits))).collect();
    splats.opacity_logit = opacities.iter().map(|o| logit(unpack_opacity(*o))).collect();
    splats.log_scale = scales.as_chunks::<3>().0.iter().map(|s| s.map(unpack_log_scale)).collect();
    let wxyz = |[x, y, z, w]: [f32; 4]| [w, x, y, z];
    splats.rotation = if head.version >= 3 {
        rotations.as_chunks::<4>().0.iter().map(|q| wxyz(unpack_rotation_smallest_three(*q))).collect()
    } else {
        rotations.as_chunks::<3>().0.iter().map(|q| wxyz(unpack_rotation_first_three(*q))).collect()
    };
    let higher = block_bytes(head.version, head.degree)[5];
    splats.sh.reserve_exact(head.count * (3 + higher));
    for (i, color) in colors.as_chunks::<3>().0.iter().enumerate() {
        splats.sh.extend(color.map(unpack_color));
        splats.sh.extend(harmonics.iter().skip(i * higher).take(higher).map(|v| unpack_harmonic(*v)));
    }
    splats
}
