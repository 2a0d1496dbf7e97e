//! DPX, the digital picture exchange of SMPTE ST 268: one image of 8, 10, 12 or 16 bits a sample,
//! or of 32-bit floats, grey, RGB or RGBA, from top to bottom and left to right.
//!
//! In: a file, the curve of its samples (its header's own word is seldom right, so that only
//! "linear" is taken from it). Out: light. Refused with a remedy: run lengths, separate planes,
//! video's subsampled colours, other orientations, samples packed across words.

use super::samples::{Curve, LINEAR, SampleGrid, depth_warnings};
use super::{DecodedImage, ReadOptions, SampleDepth, Transfer};
use crate::IoError;
use crate::input::Input;

/// First bytes of files with the most significant byte first, and last.
pub(super) const SIGNATURES: [&[u8]; 2] = [b"SDPX", b"XPDS"];

/// Bytes of a header that are read.
pub(super) const HEADER_BYTES: usize = 824;

/// The value of an empty field of the header.
const UNDEFINED: u32 = u32::MAX;

/// Facts of a header.
struct Header {
    is_big_endian: bool,
    size: [u32; 2],
    channels: usize,
    bits: u8,
    /// 0: packed across words; 1: filled words, padding at the low end; 2: at the high end.
    packing: u16,
    is_linear: bool,
    at: usize,
    row_padding: usize,
}

/// Bytes of a file, read in its byte order.
struct Bytes<'a> {
    bytes: &'a [u8],
    is_big_endian: bool,
}

impl Bytes<'_> {
    fn array<const N: usize>(&self, at: usize) -> Option<[u8; N]> {
        let mut bytes: [u8; N] = self.bytes.get(at..at.checked_add(N)?)?.try_into().ok()?;
        if !self.is_big_endian {
            bytes.reverse();
        }
        Some(bytes)
    }

    fn u16(&self, at: usize) -> Option<u16> {
        self.array(at).map(u16::from_be_bytes)
    }

    fn u32(&self, at: usize) -> Option<u32> {
        self.array(at).map(u32::from_be_bytes)
    }
}

impl Header {
    fn read(input: Input<'_>) -> Result<Self, IoError> {
        let is_big_endian = input.bytes.starts_with(SIGNATURES[0]);
        let short = || input.invalid(format!("DPX: cut short within its header of {HEADER_BYTES} bytes; copy it again"));
        let refused = |message: String| Err(input.unsupported(format!("DPX: {message}")));
        let all = Bytes { bytes: input.bytes, is_big_endian };
        if input.bytes.len() < HEADER_BYTES {
            return Err(short());
        }
        let u16 = |at| all.u16(at).ok_or_else(short);
        let u32 = |at| all.u32(at).ok_or_else(short);
        let u8 = |at: usize| input.bytes.get(at).copied().ok_or_else(short);
        let (orientation, elements) = (u16(768)?, u16(770)?);
        if orientation != 0 && orientation != u16::MAX {
            return refused(format!("orientation {orientation}, expected 0, left to right and top to bottom; export it so"));
        }
        if elements != 1 {
            return refused(format!("{elements} image elements, expected one with all channels; export it so"));
        }
        let channels = match u8(800)? {
            6 => 1,
            50 => 3,
            51 => 4,
            other => return refused(format!("descriptor {other}, expected 6 (grey), 50 (RGB) or 51 (RGBA); export it as RGB")),
        };
        let (bits, packing, encoding) = (u8(803)?, u16(804)?, u16(806)?);
        if encoding != 0 && encoding != u16::MAX {
            return refused("run-length encoding, expected none; export it uncompressed".to_owned());
        }
        if u32(780)? != 0 {
            return refused("signed samples, expected unsigned ones; export it so".to_owned());
        }
        let is_filled = matches!(packing, 1 | 2);
        let is_known = matches!(bits, 8 | 16 | 32) || (matches!(bits, 10 | 12) && is_filled);
        if !is_known {
            let message = format!("{bits} bits with packing {packing}, expected 8, 16 or 32, or 10 or 12 in filled words (packing 1 or 2)");
            return refused(message + "; export it as 16-bit");
        }
        let element_at = u32(808)?;
        let at = if element_at == 0 || element_at == UNDEFINED { u32(4)? } else { element_at } as usize;
        let padding = u32(812)?;
        let row_padding = if padding == UNDEFINED { 0 } else { padding as usize };
        let size = [u32(772)?, u32(776)?];
        Ok(Self { is_big_endian, size, channels, bits, packing, is_linear: u8(801)? == 2, at, row_padding })
    }

    /// Returns the bytes of a row without padding.
    fn row_bytes(&self) -> usize {
        let samples = self.size[0] as usize * self.channels;
        match self.bits {
            8 => samples.next_multiple_of(4),
            10 => samples.div_ceil(3) * 4,
            12 | 16 => samples * 2,
            _ => samples * 4,
        }
    }
}

/// Decodes a whole file.
pub(super) fn decode(input: Input<'_>, options: &ReadOptions) -> Result<DecodedImage, IoError> {
    let header = Header::read(input)?;
    input.check_size(header.size.map(u64::from))?;
    let [width, height] = header.size.map(|s| s as usize);
    let row = header.row_bytes();
    let stride = row.saturating_add(header.row_padding);
    let end = stride.checked_mul(height - 1).and_then(|n| n.checked_add(row)?.checked_add(header.at));
    if end.is_none_or(|end| end > input.bytes.len()) {
        let message =
            format!("DPX: {} bytes, too few for {width} x {height} pixels of {} bits; copy it again", input.bytes.len(), header.bits);
        return Err(input.invalid(message));
    }
    let samples = width * header.channels;
    let grid = SampleGrid { width, height, channels: header.channels };
    let source = Bytes { bytes: input.bytes, is_big_endian: header.is_big_endian };
    let row_at = |y: usize| header.at + y * stride;
    let count = samples * height;
    let (depth, curve, (image, alpha)) = if header.bits == 32 {
        let mut floats = input.zeroed::<f32>(count)?;
        for (i, value) in floats.iter_mut().enumerate() {
            *value = source.array(row_at(i / samples) + i % samples * 4).map_or(0.0, f32::from_be_bytes);
        }
        (SampleDepth::Float, LINEAR, grid.assemble(input, &floats, |v| v, |v| v)?)
    } else {
        let depth = if header.bits == 8 { SampleDepth::Integer8 } else { SampleDepth::Integer16 };
        let mut codes = input.zeroed::<u16>(count)?;
        for (i, code) in codes.iter_mut().enumerate() {
            *code = header.code(&source, row_at(i / samples), i % samples);
        }
        let stated = header.is_linear.then_some(Curve::Named(Transfer::Linear));
        let curve = Curve::choose(input, options, stated, header.bits)?;
        let largest = f64::from((1u32 << header.bits) - 1);
        let table: Vec<f32> = (0..=u16::MAX).map(|code| curve.decode(f64::from(code) / largest)).collect();
        let light = |code: u16| table.get(usize::from(code)).copied().unwrap_or(f32::NAN);
        (depth, curve, grid.assemble(input, &codes, light, |code| (f64::from(code) / largest) as f32)?)
    };
    Ok(DecodedImage {
        image,
        alpha,
        is_premultiplied: false,
        color_space: None,
        chromaticities: None,
        depth,
        is_display_coded: curve != LINEAR,
        warnings: depth_warnings(depth),
    })
}

impl Header {
    /// Returns the integer sample `i` of the row that begins at byte `row`.
    fn code(&self, source: &Bytes<'_>, row: usize, i: usize) -> u16 {
        let code = match self.bits {
            8 => source.bytes.get(row + i).map(|&code| u16::from(code)),
            10 => {
                // Three samples a word, the first in its highest bits.
                let shift = 20 - 10 * (i % 3) as u32 + if self.packing == 1 { 2 } else { 0 };
                source.u32(row + i / 3 * 4).map(|word| (word >> shift & 0x3ff) as u16)
            }
            12 => source.u16(row + i * 2).map(|word| if self.packing == 1 { word >> 4 } else { word & 0xfff }),
            _ => source.u16(row + i * 2),
        };
        code.unwrap_or_default()
    }
}

/// Returns whether the samples are floats, by the beginning of a file.
pub(super) fn is_float(head: &[u8]) -> bool {
    head.get(803) == Some(&32)
}

/// Returns width and height from the header.
pub(super) fn size(input: Input<'_>) -> Result<[u32; 2], IoError> {
    Header::read(input).map(|header| header.size)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a file of RGB samples, rows as words or samples in the byte order.
    fn file(size: [u32; 2], bits: u8, packing: u16, is_big_endian: bool, payload: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0; 2048];
        let mut put = |at: usize, field: &[u8]| {
            let mut field = field.to_vec();
            if !is_big_endian {
                field.reverse();
            }
            bytes[at..at + field.len()].copy_from_slice(&field);
        };
        put(0, b"SDPX");
        put(4, &2048u32.to_be_bytes());
        put(770, &1u16.to_be_bytes());
        put(772, &size[0].to_be_bytes());
        put(776, &size[1].to_be_bytes());
        put(800, &[50]);
        put(803, &[bits]);
        put(804, &packing.to_be_bytes());
        bytes.extend_from_slice(payload);
        bytes
    }

    const LINEAR: ReadOptions = ReadOptions { transfer: Some(Transfer::Linear), layer: None };

    fn pixels(bytes: &[u8], options: &ReadOptions) -> Result<Vec<[f32; 3]>, IoError> {
        decode(Input::new("plate.dpx", bytes), options).map(|decoded| decoded.image.pixels)
    }

    #[test]
    fn the_header_alone_tells_the_size_of_a_large_image() {
        let whole = file([8192, 4320], 10, 1, true, &[]);
        assert_eq!(size(Input::new("plate.dpx", &whole[..HEADER_BYTES])).unwrap(), [8192, 4320]);
        assert!(pixels(&whole, &LINEAR).is_err());
    }

    #[test]
    fn ten_bits_are_three_samples_a_word_in_either_byte_order() {
        let word = 1023u32 << 22 | 512 << 12 | 64 << 2;
        let expected = [[1.0, (512.0f64 / 1023.0) as f32, (64.0f64 / 1023.0) as f32]; 2];
        let big: Vec<u8> = [word; 2].iter().flat_map(|w| w.to_be_bytes()).collect();
        let little: Vec<u8> = [word; 2].iter().flat_map(|w| w.to_le_bytes()).collect();
        assert_eq!(pixels(&file([2, 1], 10, 1, true, &big), &LINEAR).unwrap(), expected);
        assert_eq!(pixels(&file([1, 2], 10, 1, false, &little), &LINEAR).unwrap(), expected);
        let low: Vec<u8> = [word >> 2; 2].iter().flat_map(|w| w.to_be_bytes()).collect();
        assert_eq!(pixels(&file([2, 1], 10, 2, true, &low), &LINEAR).unwrap(), expected);
    }

    #[test]
    fn other_depths_are_read() {
        let codes12: Vec<u8> = [4095u16 << 4, 0, 1024 << 4].iter().flat_map(|c| c.to_be_bytes()).collect();
        assert_eq!(pixels(&file([1, 1], 12, 1, true, &codes12), &LINEAR).unwrap(), [[1.0, 0.0, (1024.0f64 / 4095.0) as f32]]);
        let codes16: Vec<u8> = [65535u16, 0, 13107].iter().flat_map(|c| c.to_le_bytes()).collect();
        assert_eq!(pixels(&file([1, 1], 16, 0, false, &codes16), &LINEAR).unwrap(), [[1.0, 0.0, 0.2]]);
        assert_eq!(pixels(&file([1, 1], 8, 0, true, &[255, 0, 51, 0]), &LINEAR).unwrap(), [[1.0, 0.0, 0.2]]);
        let floats: Vec<u8> = [12.5f32, -1.0, 0.25].iter().flat_map(|c| c.to_be_bytes()).collect();
        assert_eq!(pixels(&file([1, 1], 32, 0, true, &floats), &ReadOptions::default()).unwrap(), [[12.5, -1.0, 0.25]]);
    }

    #[test]
    fn what_is_not_read_is_refused_with_a_remedy() {
        let good = file([1, 1], 10, 1, true, &[0; 4]);
        let message = |change: &dyn Fn(&mut Vec<u8>), options: &ReadOptions| {
            let mut bytes = good.clone();
            change(&mut bytes);
            pixels(&bytes, options).unwrap_err().to_string()
        };
        assert!(message(&|_| (), &ReadOptions::default()).contains("transfer curve"));
        assert!(message(&|b| b.truncate(2050), &LINEAR).contains("too few for 1 x 1 pixels"));
        assert!(message(&|b| b.truncate(100), &LINEAR).contains("cut short"));
        assert!(message(&|b| b[807] = 1, &LINEAR).contains("run-length"));
        assert!(message(&|b| b[805] = 0, &LINEAR).contains("packing 0"));
        assert!(message(&|b| b[800] = 100, &LINEAR).contains("descriptor 100"));
        assert!(message(&|b| b[771] = 3, &LINEAR).contains("3 image elements"));
        assert!(message(&|b| b[772] = 1, &LINEAR).contains("size"));
    }
}
