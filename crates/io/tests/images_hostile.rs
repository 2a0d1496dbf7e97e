//! Damaged, truncated and lying image files: an error that says what is wrong, never a panic, never
//! memory on a claim.

// Helpers of tests may fail as tests do.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

use std::io::Cursor;
use std::path::Path;
use std::sync::OnceLock;

use luxel_core::Image;
use luxel_io::{ExrOptions, ExrSample, IoErrorKind, ReadOptions, Transfer, decode_image, encode_exr, encode_png, image_size, read_image};
use proptest::prelude::*;

const LINEAR: ReadOptions = ReadOptions { transfer: Some(Transfer::Linear), layer: None };

/// Returns a whole file of each kind, by name.
fn files() -> &'static [(&'static str, Vec<u8>)] {
    static FILES: OnceLock<Vec<(&str, Vec<u8>)>> = OnceLock::new();
    FILES.get_or_init(make_files)
}

fn make_files() -> Vec<(&'static str, Vec<u8>)> {
    let (width, height) = (24usize, 40usize);
    let noise = |i: usize| ((i * 2_654_435_761) >> 7) as u8;
    let pixels: Vec<[f32; 3]> = (0..width * height).map(|i| [0, 1, 2].map(|c| f32::from(noise(3 * i + c)) * 0.5)).collect();
    let bytes: Vec<u8> = (0..3 * width * height).map(noise).collect();
    let image = Image { width, height, pixels: pixels.clone() };
    let (w, h) = (width as u32, height as u32);
    let exr = |sample| encode_exr(Path::new("a"), &image, &ExrOptions { sample, ..ExrOptions::default() }).unwrap();
    let mut hdr = Vec::new();
    let rgb: Vec<_> = pixels.iter().map(|&p| image::Rgb(p)).collect();
    image::codecs::hdr::HdrEncoder::new(&mut hdr).encode(&rgb, width, height).unwrap();
    let tiff = |compression| {
        let mut out = Cursor::new(Vec::new());
        let mut encoder = tiff::encoder::TiffEncoder::new(&mut out).unwrap().with_compression(compression);
        encoder.write_image::<tiff::encoder::colortype::RGB32Float>(w, h, pixels.as_flattened()).unwrap();
        out.into_inner()
    };
    let mut jpeg = Vec::new();
    image::codecs::jpeg::JpegEncoder::new(&mut jpeg).encode(&bytes, w, h, image::ExtendedColorType::Rgb8).unwrap();
    vec![
        ("exr half zip", exr(ExrSample::Half)),
        ("exr float zip", exr(ExrSample::Float)),
        ("exr tiled piz", tiled_exr(&image)),
        ("hdr", hdr),
        ("tiff", tiff(tiff::encoder::Compression::Uncompressed)),
        ("tiff lzw", tiff(tiff::encoder::Compression::Lzw)),
        ("png", encode_png(width, height, &bytes).unwrap()),
        ("jpeg", jpeg),
        ("npy", npy(&image)),
        ("dpx", dpx(&image)),
    ]
}

fn npy(image: &Image) -> Vec<u8> {
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}, {}, 3), }}\n", image.height, image.width);
    let samples: Vec<u8> = image.pixels.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
    [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes(), &samples].concat()
}

fn dpx(image: &Image) -> Vec<u8> {
    let mut header = vec![0; 2048];
    let size = [image.width as u32, image.height as u32].map(u32::to_be_bytes);
    let (first_pixel, elements) = (2048u32.to_be_bytes(), 1u16.to_be_bytes());
    let fields: [(usize, &[u8]); 7] =
        [(0, b"SDPX"), (4, &first_pixel), (770, &elements), (772, &size[0]), (776, &size[1]), (800, &[50]), (803, &[32])];
    for (at, field) in fields {
        header[at..at + field.len()].copy_from_slice(field);
    }
    let samples = image.pixels.as_flattened().iter().flat_map(|v| v.to_be_bytes());
    header.into_iter().chain(samples).collect()
}

fn tiled_exr(image: &Image) -> Vec<u8> {
    use exr::prelude::{
        Blocks, Compression, Encoding, Image as Exr, Layer, LayerAttributes, LineOrder, SpecificChannels, Vec2, WritableImage,
    };
    let pixel = |at: Vec2<usize>| (image.at(at.0, at.1)[0], image.at(at.0, at.1)[1], image.at(at.0, at.1)[2]);
    let encoding = Encoding { compression: Compression::PIZ, blocks: Blocks::Tiles(Vec2(16, 16)), line_order: LineOrder::Increasing };
    let layer = Layer::new((image.width, image.height), LayerAttributes::named("a"), encoding, SpecificChannels::rgb(pixel));
    let mut out = Cursor::new(Vec::new());
    Exr::from_layer(layer).write().non_parallel().to_buffered(&mut out).unwrap();
    out.into_inner()
}

#[test]
fn truncated_files_are_errors_at_every_place() {
    for (kind, whole) in files() {
        let full = decode_image(Path::new(kind), whole, &LINEAR).unwrap().image;
        // Every byte of header and end, and 200 places between.
        let middle = (0..200).map(|i| i * whole.len() / 200);
        for length in (0..whole.len().min(400)).chain(middle).chain(whole.len().saturating_sub(100)..whole.len()) {
            match decode_image(Path::new(kind), &whole[..length], &LINEAR) {
                Err(error) => {
                    assert!(!error.message.contains("decoder failed"), "{kind} cut to {length} of {} panics: {error}", whole.len());
                }
                // What is cut off may be padding: then nothing may be missing.
                Ok(decoded) => assert_eq!(decoded.image, full, "{kind} cut to {length} of {} is read in part", whole.len()),
            }
        }
    }
}

#[test]
fn damaged_bytes_do_not_panic() {
    for (kind, whole) in files() {
        for place in (0..whole.len()).step_by((whole.len() / 150).max(1)).chain(0..300.min(whole.len())) {
            for value in [0, 0xff, 0x80] {
                let mut damaged = whole.clone();
                damaged[place] = value;
                // Damage within the samples may go unnoticed; what matters is that it returns.
                let _ = decode_image(Path::new(kind), &damaged, &LINEAR);
            }
        }
    }
}

/// Replaces the only occurrence of `from`.
fn patched(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    let at: Vec<_> = bytes.windows(from.len()).enumerate().filter(|(_, window)| *window == from).map(|(i, _)| i).collect();
    assert!(!at.is_empty(), "pattern not found");
    let mut out = bytes.to_vec();
    for i in at {
        out[i..i + to.len()].copy_from_slice(to);
    }
    out
}

#[test]
fn huge_claims_are_refused_without_memory() {
    let exr = &files()[0].1;
    // Windows are four i32: x min, y min, x max, y max, inclusive.
    let window = |x: i32, y: i32| [0, 0, x, y].map(i32::to_le_bytes).concat();
    // A side, and then a product, just beyond what a file of this length may claim.
    let claims = [(65_536, 0), (12_287, 12_287)];
    let folder = tempfile::tempdir().unwrap();
    for (x, y) in claims {
        let lie = patched(exr, &window(23, 39), &window(x, y));
        let error = decode_image(Path::new("lie.exr"), &lie, &LINEAR).unwrap_err();
        assert!(!error.message.contains("decoder failed"), "{x} x {y}: {error}");
        let path = folder.path().join("lie.exr");
        std::fs::write(&path, &lie).unwrap();
        assert!(image_size(&path).is_err(), "{x} x {y}");
    }
    for size in ["-Y 4608 +X 4608", "-Y 1 +X 65537", "-Y 0 +X 5"] {
        let lie = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n{size}\n\x02\x02");
        assert!(decode_image(Path::new("lie.hdr"), lie.as_bytes(), &LINEAR).is_err(), "{size}");
    }
    let png = encode_png(3, 2, &[0; 18]).unwrap();
    for side in [4608u32, 5000] {
        let size = [side.to_be_bytes(), side.to_be_bytes()].concat();
        let lie = patched(&png, &[0, 0, 0, 3, 0, 0, 0, 2], &size);
        let error = decode_image(Path::new("lie.png"), &lie, &LINEAR).unwrap_err();
        assert!(error.message.contains(&side.to_string()), "{error}");
    }
    let tiff = &files().iter().find(|(kind, _)| *kind == "tiff").unwrap().1;
    for side in [15_360u32] {
        let mut lie = tiff.clone();
        // Width and length, tags 256 and 257, one long each.
        for tag in [256u16, 257] {
            let entry = [&tag.to_le_bytes()[..], &[4, 0, 1, 0, 0, 0]].concat();
            let at = lie.windows(8).position(|window| window == entry).unwrap();
            lie[at + 8..at + 12].copy_from_slice(&side.to_le_bytes());
        }
        let error = decode_image(Path::new("lie.tif"), &lie, &LINEAR).unwrap_err();
        assert!(!error.message.contains("decoder failed"), "{error}");
    }
}

/// Returns a file of DWA blocks, and the places of their heads.
fn dwa_exr(image: &Image) -> (Vec<u8>, Vec<usize>) {
    use exr::prelude::{
        Blocks, Compression, Encoding, Image as Exr, Layer, LayerAttributes, LineOrder, SpecificChannels, Vec2, WritableImage, f16,
    };
    let pixel = |at: Vec2<usize>| {
        let [r, g, b] = image.at(at.0, at.1).map(f16::from_f32);
        (r, g, b)
    };
    let encoding = Encoding { compression: Compression::DWAA(None), blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let layer = Layer::new((image.width, image.height), LayerAttributes::named("a"), encoding, SpecificChannels::rgb(pixel));
    let mut out = Cursor::new(Vec::new());
    Exr::from_layer(layer).write().non_parallel().to_buffered(&mut out).unwrap();
    let bytes = out.into_inner();
    let word = |at: usize| bytes.get(at..at + 8).map_or(u64::MAX, |b| u64::from_le_bytes(b.try_into().unwrap()));
    // The table of blocks has their offsets; a block begins with its line and its length, of four
    // bytes each.
    let heads = (0..bytes.len()).filter_map(|at| usize::try_from(word(at)).ok()).filter(|at| *at < bytes.len() && word(at + 8) == 2);
    let heads = heads.map(|at| at + 8).collect();
    (bytes, heads)
}

#[test]
fn counts_in_dwa_blocks_are_held_against_the_block() {
    let image = Image { width: 64, height: 64, pixels: (0..64 * 64).map(|i| [i as f32 * 1e-3, 0.5, 1.0]).collect() };
    let (whole, heads) = dwa_exr(&image);
    assert_eq!(heads.len(), 2, "blocks of 32 lines");
    decode_image(Path::new("a.exr"), &whole, &LINEAR).unwrap();
    for head in heads {
        // The counters: bytes without loss, of runs, in runs, AC and DC coefficients.
        for counter in [1, 6, 7, 8, 9] {
            // More than the block has, and no more than any memory.
            let claim = 1u64 << 17;
            let mut lie = whole.clone();
            lie[head + 8 * counter..head + 8 * counter + 8].copy_from_slice(&claim.to_le_bytes());
            let error = decode_image(Path::new("lie.exr"), &lie, &LINEAR).unwrap_err();
            assert!(error.message.contains(&format!("claims {claim} ")), "counter {counter}, {claim}: {error}");
        }
    }
}

#[test]
fn a_text_longer_than_a_tiff_is_refused() {
    let mut lie = files().iter().find(|(kind, _)| *kind == "tiff").unwrap().1.clone();
    // The number of bytes in each strip, tag 279, as a text.
    let at = lie.windows(3).position(|window| window == [23, 1, 4]).unwrap();
    lie[at + 2] = 2;
    let longer = lie.len() as u32 + 1;
    lie[at + 4..at + 8].copy_from_slice(&longer.to_le_bytes());
    let error = decode_image(Path::new("lie.tif"), &lie, &LINEAR).unwrap_err();
    assert!(error.message.contains("tag 279 claims a text longer than the file"), "{error}");
}

#[test]
fn missing_empty_and_foreign_files_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let missing = read_image(&folder.path().join("no.exr"), &LINEAR).unwrap_err();
    assert_eq!(missing.kind, IoErrorKind::System);
    assert!(missing.to_string().contains("no.exr"), "{missing}");
    assert!(read_image(folder.path(), &LINEAR).unwrap_err().message.contains("not a regular file"));
    let empty = decode_image(Path::new("a.exr"), &[], &LINEAR).unwrap_err();
    assert!(empty.message.contains("empty"), "{empty}");
    for (bytes, part) in [(&b"GIF89a....."[..], "GIF"), (b"\x01\x02\x03\x04", "01 02 03 04")] {
        let foreign = decode_image(Path::new("a.exr"), bytes, &LINEAR).unwrap_err();
        assert_eq!(foreign.kind, IoErrorKind::Unsupported);
        assert!(foreign.message.contains(part) && foreign.message.contains("OpenEXR"), "{foreign}");
    }
}

const MAGICS: [&[u8]; 9] = [
    &[0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0],
    b"#?RADIANCE\n",
    b"#?RGBE\n\n-Y ",
    b"II*\0\x08\0\0\0",
    b"MM\0*\0\0\0\x08",
    b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR",
    &[0xff, 0xd8, 0xff],
    b"SDPX\0\0\x08\0",
    b"XPDS\0\x08\0\0",
];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn random_bytes_behind_a_magic_number_do_not_panic(magic in 0..MAGICS.len(), tail in prop::collection::vec(any::<u8>(), 0..600)) {
        let bytes = [MAGICS[magic], &tail].concat();
        let _ = decode_image(Path::new("random"), &bytes, &LINEAR);
    }

    #[test]
    fn spliced_files_do_not_panic(which in 0..files().len(), cut in 0.0..1.0f64, skip in 0..64usize, insert in prop::collection::vec(any::<u8>(), 0..16)) {
        let (kind, whole) = &files()[which];
        let at = (cut * whole.len() as f64) as usize;
        let rest = whole.get(at + skip..).unwrap_or_default();
        let bytes = [&whole[..at], &insert, rest].concat();
        let _ = decode_image(Path::new(kind), &bytes, &LINEAR);
    }
}
