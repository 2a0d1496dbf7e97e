//! HDR PNG: 16 bits, Rec.2020, the perceptual quantizer (SMPTE ST 2084).
//!
//! In: codes, row-major, and the light levels of the image. Out: a PNG whose chunk `cICP` names
//! primaries and curve (ITU-T H.273), `mDCV` the volume that the codes cover (SMPTE ST 2086) and
//! `cLLI` the brightest channel and the mean of the brightest channels (CTA-861.3); all from the
//! third edition of the PNG specification. A viewer that knows none of them shows a pale picture.

use std::path::Path;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use luxel_core::ColorSpace;

use super::png_chunks::{chunk, insert};
use crate::IoError;

/// BT.2020 primaries, the PQ curve, RGB, full range.
const CICP: [u8; 4] = [9, 16, 0, 1];
/// Luminance of `mDCV` and `cLLI` is in parts of 1 cd/m2.
const PARTS: f64 = 10_000.0;
/// Chromaticities of `mDCV` are in parts of 1.
const CHROMATICITY_PARTS: f32 = 50_000.0;
/// Largest luminance of the curve, and the smallest that `mDCV` can state, cd/m2.
const RANGE_NITS: [f64; 2] = [0.0001, 10_000.0];

/// The light levels of an HDR image, cd/m2.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LightLevels {
    /// The brightest channel of any pixel (MaxCLL).
    pub max: f64,
    /// The mean over the pixels of their brightest channel (MaxFALL of a single image).
    pub mean: f64,
}

/// Encodes `width * height` pixels of PQ codes in Rec.2020.
///
/// # Errors
/// The number of codes is not `3 * width * height`, or a side is too long.
pub fn encode_png_pq(width: usize, height: usize, codes: &[u16], levels: LightLevels) -> Result<Vec<u8>, IoError> {
    let name = Path::new("view.png");
    let size = (u32::try_from(width).ok(), u32::try_from(height).ok());
    let expected = width.checked_mul(height).and_then(|n| n.checked_mul(3));
    let (Some(width32), Some(height32), true) = (size.0, size.1, expected == Some(codes.len())) else {
        return Err(IoError::invalid(name, format!("{} codes for {width} x {height} pixels, expected 3 per pixel", codes.len())));
    };
    let mut bytes = Vec::new();
    // The encoder takes the machine's order of bytes.
    let native: &[u8] = bytemuck::cast_slice(codes);
    PngEncoder::new(&mut bytes)
        .write_image(native, width32, height32, ExtendedColorType::Rgb16)
        .map_err(|e| IoError::invalid(name, format!("PNG: {e}")))?;
    let chunks = [chunk(*b"cICP", &CICP), chunk(*b"mDCV", &mastering()), chunk(*b"cLLI", &light(levels))].concat();
    insert(&mut bytes, chunks);
    Ok(bytes)
}

fn mastering() -> Vec<u8> {
    let chromaticities = ColorSpace::LinearRec2020.chromaticities();
    let points = chromaticities.as_flattened().iter().flat_map(|v| ((v * CHROMATICITY_PARTS).round() as u16).to_be_bytes());
    let [least, most] = RANGE_NITS.map(parts);
    points.chain(most).chain(least).collect()
}

fn light(LightLevels { max, mean }: LightLevels) -> Vec<u8> {
    [max, mean].into_iter().flat_map(parts).collect()
}

fn parts(nits: f64) -> [u8; 4] {
    ((nits * PARTS).round() as u32).to_be_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_and_codes_are_those_of_the_specification() {
        let codes = [0, 1, 256, 0x1234, 65535, 32768];
        let png = encode_png_pq(2, 1, &codes, LightLevels { max: 203.0, mean: 10.5 }).unwrap();
        let content = |kind: &[u8]| {
            let at = png.windows(4).position(|window| window == kind).unwrap();
            let length = u32::from_be_bytes(png[at - 4..at].try_into().unwrap()) as usize;
            png[at + 4..at + 4 + length].to_vec()
        };
        assert_eq!(content(b"cICP"), [9, 16, 0, 1]);
        // Red 0.708, 0.292, green 0.170, 0.797, blue 0.131, 0.046, white 0.3127, 0.3290.
        let words: Vec<u16> = content(b"mDCV")[..16].chunks(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect();
        assert_eq!(words, [35400, 14600, 8500, 39850, 6550, 2300, 15635, 16450]);
        assert_eq!(content(b"mDCV")[16..], [5, 0xf5, 0xe1, 0, 0, 0, 0, 1]);
        assert_eq!(content(b"cLLI"), [&2_030_000u32.to_be_bytes()[..], &105_000u32.to_be_bytes()].concat());
        let position = |kind: &[u8]| png.windows(4).position(|window| window == kind).unwrap();
        assert!(position(b"cICP") < position(b"IDAT") && position(b"cLLI") < position(b"IDAT"));
        let read = ::image::load_from_memory(&png).unwrap().into_rgb16();
        assert_eq!(read.into_raw(), codes);
        assert!(encode_png_pq(2, 1, &codes[..5], LightLevels::default()).is_err());
    }
}
