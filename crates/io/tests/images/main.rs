//! Images of every format, written by the formats' own crates and read back as linear radiance.

// Helpers of tests may fail as tests do.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod exr_files;
mod hdr_files;
mod plates;
mod png_files;
mod tiff_files;

use std::io::Cursor;
use std::path::Path;

use luxel_core::environment::Projection;
use luxel_core::{Camera, ColorSpace, Distortion, Image as Radiance, Remedy};
use luxel_io::{
    DecodedImage, ExrOptions, ExrPlane, ExrSample, IoError, IoErrorKind, PlaneValues, ReadOptions, SampleDepth, Transfer, decode_image,
    encode_exr, encode_png, image_size, read_image, write_exr, write_png,
};

const LINEAR: ReadOptions = ReadOptions { transfer: Some(Transfer::Linear), layer: None };
const SRGB: ReadOptions = ReadOptions { transfer: Some(Transfer::Srgb), layer: None };
const UNSAID: ReadOptions = ReadOptions { transfer: None, layer: None };

fn decode(bytes: &[u8], options: &ReadOptions) -> Result<DecodedImage, IoError> {
    decode_image(Path::new("test image"), bytes, options)
}

/// Returns values that half holds exactly, across the range, and smooth enough for lossy codecs.
fn radiance(width: usize, height: usize) -> Radiance {
    let pixel = |i: usize| {
        let (x, y) = (i % width, i / width);
        [x as f32 * 0.25, y as f32 * 2.0 + 0.5, 0.125 * (x + y) as f32]
    };
    Radiance { width, height, pixels: (0..width * height).map(pixel).collect() }
}

fn assert_near(found: &Radiance, expected: &Radiance, relative: f32) {
    assert_eq!((found.width, found.height), (expected.width, expected.height));
    for (i, (f, e)) in found.pixels.iter().zip(&expected.pixels).enumerate() {
        for c in 0..3 {
            assert!((f[c] - e[c]).abs() <= relative * e[c].abs().max(1.0), "pixel {i} channel {c}: {} expected {}", f[c], e[c]);
        }
    }
}

#[test]
fn images_that_cannot_be_written_are_errors_and_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    for image in [Radiance::default(), Radiance { width: 2, height: 2, pixels: vec![[0.0; 3]; 3] }] {
        assert!(write_exr(&path, &image, &ExrOptions::default()).is_err());
    }
    let unnamed = ExrOptions { attributes: vec![(String::new(), "value".into())], ..ExrOptions::default() };
    assert!(write_exr(&path, &radiance(2, 2), &unnamed).is_err());
    assert!(write_png(&path, 2, 2, &[0; 11]).is_err());
    assert!(encode_png(usize::MAX, 2, &[0; 12]).is_err());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn jpeg_is_srgb_by_its_standard() {
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 100)
        .encode(&[128; 16 * 8 * 3], 16, 8, image::ExtendedColorType::Rgb8)
        .unwrap();
    let decoded = decode(&bytes, &UNSAID).unwrap();
    assert!((decoded.image.pixels[5][0] - 0.215_86).abs() < 5e-3, "{:?}", decoded.image.pixels[5]);
    assert!(decoded.warnings.iter().any(|w| w.contains("sRGB")) && decoded.warnings.iter().any(|w| w.contains("not HDR")));
    let decoded = decode(&bytes, &LINEAR).unwrap();
    assert!((decoded.image.pixels[5][0] - 128.0 / 255.0).abs() < 1e-2);
    assert_eq!(decoded.warnings, ["8 bits: not HDR"]);
}

#[test]
fn formats_are_recognised_by_content_and_sizes_by_headers() {
    let folder = tempfile::tempdir().unwrap();
    let image = radiance(7, 5);
    let mut hdr = Vec::new();
    image::codecs::hdr::HdrEncoder::new(&mut hdr).encode(&[image::Rgb([1.0; 3]); 35], 7, 5).unwrap();
    let mut jpeg = Vec::new();
    image::codecs::jpeg::JpegEncoder::new(&mut jpeg).encode(&[9; 35], 7, 5, image::ExtendedColorType::L8).unwrap();
    let files = [
        encode_exr(Path::new("a"), &image, &ExrOptions::default()).unwrap(),
        hdr,
        jpeg,
        encode_png(7, 5, &[0; 105]).unwrap(),
        tiff_files::tiff_bytes::<tiff::encoder::colortype::Gray32Float>((7, 5), &[0.5; 35], tiff::encoder::Compression::Uncompressed),
        plates::dpx([7, 5], 32, &[0; 4 * 3 * 35]),
    ];
    for (i, bytes) in files.iter().enumerate() {
        let path = folder.path().join(format!("{i}.jpg"));
        std::fs::write(&path, bytes).unwrap();
        let decoded = read_image(&path, &UNSAID).unwrap();
        assert_eq!((decoded.image.width, decoded.image.height), (7, 5), "file {i}");
        assert_eq!(image_size(&path).unwrap(), [7, 5], "file {i}");
    }
}
