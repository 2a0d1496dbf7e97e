//! A file's bytes to a depth map.

use std::path::Path;

use super::{DepthMap, pfm};
use crate::IoError;
use crate::image::{SampleDepth, decode_codes, guard, npy, openexr};
use crate::input::Input;

/// First bytes of OpenEXR.
const EXR: &[u8] = &[0x76, 0x2f, 0x31, 0x01];
/// First bytes of NumPy's arrays.
const NPY: &[u8] = b"\x93NUMPY";

/// Decodes a depth map; `name` is for errors.
///
/// # Errors
/// A damaged file, a file without depth, or an image of 8 bits, which is a preview.
pub fn decode_depth_map(name: &Path, bytes: &[u8]) -> Result<DepthMap, IoError> {
    let input = Input::new(name, bytes);
    let (size_px, values, integer_bits) = if pfm::is_pfm(bytes) {
        let (size, values) = pfm::decode(input)?;
        (size, values, None)
    } else if bytes.starts_with(EXR) {
        let (size, values) = guard::contain(name, || openexr::decode_depth(input))?;
        (size, values, None)
    } else if bytes.starts_with(NPY) {
        let (size, values) = npy::decode_depth(input)?;
        (size, values, None)
    } else {
        let decoded = decode_codes(name, bytes)?;
        let size = [decoded.image.width, decoded.image.height];
        let first = |largest: f32| decoded.image.pixels.iter().map(|[v, ..]| v * largest).collect::<Vec<f32>>();
        match decoded.depth {
            SampleDepth::Float => (size, first(1.0), None),
            SampleDepth::Integer16 => {
                // Codes are whole numbers, which division by the largest one blurs.
                let codes = first(f32::from(u16::MAX)).into_iter().map(f32::round).collect();
                (size, codes, Some(16))
            }
            low @ (SampleDepth::Integer8 | SampleDepth::FewBits(_)) => {
                let bits = low.integer_bits().unwrap_or(8);
                return Err(input.unsupported(format!(
                    "an image of {bits} bits, expected 16 or floating point: so few are a picture of depth; export the numbers"
                )));
            }
        }
    };
    let values = values.into_iter().map(|v: f32| if v.is_finite() && v > 0.0 { v } else { 0.0 }).collect();
    Ok(DepthMap { size_px, values, integer_bits })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn npy(descr: &str, shape: &str, samples: &[u8]) -> Vec<u8> {
        let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
        let header = format!("{header:<117}\n");
        [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes(), samples].concat()
    }

    fn decode(bytes: &[u8]) -> Result<DepthMap, IoError> {
        decode_depth_map(Path::new("d"), bytes)
    }

    #[test]
    fn arrays_of_numbers_are_maps() {
        let floats: Vec<u8> = [1.5f32, f32::NAN, -2.0, 0.0, f32::INFINITY, 7.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let expected = DepthMap { size_px: [3, 2], values: vec![1.5, 0.0, 0.0, 0.0, 0.0, 7.0], integer_bits: None };
        for shape in ["(2, 3)", "(2, 3, 1)", "(1, 2, 3)"] {
            assert_eq!(decode(&npy("<f4", shape, &floats)).unwrap(), expected);
        }
        let doubles: Vec<u8> = [1.5f64, 2.5].iter().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(decode(&npy("<f8", "(1, 2)", &doubles)).unwrap().values, [1.5, 2.5]);
        let codes: Vec<u8> = [1000u16, 65535].iter().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(decode(&npy("<u2", "(2, 1)", &codes)).unwrap().values, [1000.0, 65535.0]);
        assert!(decode(&npy("<i4", "(2, 3)", &floats)).unwrap_err().message.contains("'descr' is '<i4'"));
        assert!(decode(&npy("<f4", "(6,)", &floats)).unwrap_err().message.contains("'shape' is (6,), expected (height, width)"));
        assert!(decode(&npy("<f4", "(2, 4)", &floats)).unwrap_err().message.contains("expected 32 for 4 x 2"));
    }

    #[test]
    fn pngs_of_16_bits_hold_whole_numbers_and_8_bits_are_refused() {
        let mut bytes = std::io::Cursor::new(Vec::new());
        let codes: Vec<u16> = (0..64).map(|i| i * 1024 + 7).collect();
        image::ImageBuffer::<image::Luma<u16>, _>::from_raw(8, 8, codes.clone())
            .unwrap()
            .write_to(&mut bytes, image::ImageFormat::Png)
            .unwrap();
        let map = decode(bytes.get_ref()).unwrap();
        assert_eq!(map.values, codes.iter().map(|code| f32::from(*code)).collect::<Vec<_>>());
        assert_eq!((map.size_px, map.integer_bits), ([8, 8], Some(16)));
        let mut bytes = std::io::Cursor::new(Vec::new());
        image::GrayImage::new(8, 8).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        assert!(decode(bytes.get_ref()).unwrap_err().message.starts_with("an image of 8 bits, expected 16"));
    }

    fn exr(channels: &[&str]) -> Vec<u8> {
        use exr::prelude::*;
        let channel = |(i, name): (usize, &&str)| AnyChannel::new(*name, FlatSamples::F32((0..6).map(|v| (10 * i + v) as f32).collect()));
        let list = AnyChannels::sort(channels.iter().enumerate().map(channel).collect());
        let mut out = std::io::Cursor::new(Vec::new());
        Image::from_channels((3, 2), list).write().non_parallel().to_buffered(&mut out).unwrap();
        out.into_inner()
    }

    #[test]
    fn the_channel_of_depth_is_found() {
        for (channels, first) in [
            (&["Z"][..], 0.0),
            (&["A", "B", "G", "R", "Z"], 40.0),
            (&["depth.Z", "rgba.R"], 0.0),
            (&["R", "G", "B"], 0.0),
            (&["Distance"], 0.0),
        ] {
            let map = decode(&exr(channels)).unwrap();
            assert_eq!((map.size_px, map.values[1]), ([3, 2], first + 1.0), "{channels:?}");
        }
        assert!(decode(&exr(&["N.X", "N.W"])).unwrap_err().message.contains("no depth, found channels N.W, N.X"));
    }

    proptest! {
        #[test]
        fn damage_gives_a_map_or_an_error(at: prop::sample::Index, byte: u8) {
            for whole in [exr(&["Z"]), npy("<f4", "(2, 3)", &[0; 24])] {
                let mut bytes = whole;
                let at = at.index(bytes.len());
                bytes[at] = byte;
                let _ = decode(&bytes);
            }
        }
    }
}
