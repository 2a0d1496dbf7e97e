use std::path::Path;

use proptest::prelude::*;

use super::lossless_jpeg::tests::encode as encode_lossless_jpeg;
use luxel_core::Chromaticities;
use luxel_core::photo::*;

use super::*;
use crate::IoErrorKind;
use crate::icc::tests::display_p3;
use crate::image::{ReadOptions, Transfer, decode_image};
use crate::input::Input;

/// Returns a TIFF's first directory, for tests: entries of (tag, type, count, bytes), values that
/// do not fit behind it, then data.
fn tiff(entries: &[(u16, u16, u32, Vec<u8>)], data: &[u8]) -> Vec<u8> {
    let mut sorted = entries.to_vec();
    sorted.sort_by_key(|e| e.0);
    let data_at = 8 + 2 + 12 * sorted.len() + 4;
    let mut values_at = data_at + data.len();
    let mut out = b"II*\0\x08\0\0\0".to_vec();
    out.extend((sorted.len() as u16).to_le_bytes());
    let mut values: Vec<u8> = Vec::new();
    for (tag, kind, count, value) in &sorted {
        out.extend(tag.to_le_bytes());
        out.extend(kind.to_le_bytes());
        out.extend(count.to_le_bytes());
        if value.len() <= 4 {
            let mut inline = value.clone();
            inline.resize(4, 0);
            out.extend(inline);
        } else {
            out.extend((values_at as u32).to_le_bytes());
            values_at += value.len();
            values.extend(value);
        }
    }
    out.extend([0; 4]);
    out.extend(data);
    out.extend(values);
    out
}

fn shorts(values: &[u16]) -> (u16, u32, Vec<u8>) {
    (3, values.len() as u32, values.iter().flat_map(|v| v.to_le_bytes()).collect())
}

pub(super) fn longs(values: &[u32]) -> (u16, u32, Vec<u8>) {
    (4, values.len() as u32, values.iter().flat_map(|v| v.to_le_bytes()).collect())
}

fn rationals(values: &[(u32, u32)]) -> (u16, u32, Vec<u8>) {
    (5, values.len() as u32, values.iter().flat_map(|(n, d)| [n.to_le_bytes(), d.to_le_bytes()].concat()).collect())
}

/// Entries of a DNG of one chunk.
pub(super) struct Dng {
    entries: Vec<(u16, u16, u32, Vec<u8>)>,
    data: Vec<u8>,
}

impl Dng {
    pub(super) fn new(width: u32, height: u32, per_pixel: u16, bits: u16, compression: u16, data: Vec<u8>) -> Self {
        let mut dng = Self { entries: Vec::new(), data };
        dng.set(256, longs(&[width])).set(257, longs(&[height])).set(258, shorts(&vec![bits; usize::from(per_pixel)]));
        dng.set(259, shorts(&[compression])).set(262, shorts(&[if per_pixel == 1 { 32803 } else { 34892 }]));
        dng.set(277, shorts(&[per_pixel])).set(278, longs(&[height]));
        let length = dng.data.len() as u32;
        dng.set(273, longs(&[0])).set(279, longs(&[length]));
        dng.set(50706, (1, 4, vec![1, 4, 0, 0])).set(271, (2, 6, b"Luxel\0".to_vec())).set(272, (2, 5, b"Test\0".to_vec()));
        if per_pixel == 1 {
            dng.set(33421, shorts(&[2, 2])).set(33422, (1, 4, vec![0, 1, 1, 2]));
        }
        dng
    }

    pub(super) fn set(&mut self, tag: u16, (kind, count, value): (u16, u32, Vec<u8>)) -> &mut Self {
        self.entries.retain(|e| e.0 != tag);
        self.entries.push((tag, kind, count, value));
        self
    }

    pub(super) fn bytes(&mut self) -> Vec<u8> {
        let at = 8 + 2 + 12 * self.entries.len() + 4;
        let tag = if self.entries.iter().any(|e| e.0 == 324) { 324 } else { 273 };
        self.set(tag, longs(&[at as u32]));
        tiff(&self.entries, &self.data)
    }
}

pub(super) fn decode(bytes: &[u8]) -> Result<RawPixels, IoError> {
    match decode_photo(Path::new("a.dng"), bytes)? {
        Photo::Raw(pixels) => Ok(pixels),
        other => panic!("expected RAW, got {other:?}"),
    }
}

pub(super) fn codes(count: usize, largest: usize) -> Vec<u16> {
    (0..count).map(|i| ((i * 7919 + i * i * 31) % (largest + 1)) as u16).collect()
}

pub(super) fn little_endian(codes: &[u16]) -> Vec<u8> {
    codes.iter().flat_map(|c| c.to_le_bytes()).collect()
}

#[test]
fn uncompressed_linear_raw_comes_back_to_the_code() {
    let expected = codes(6 * 4 * 3, 65535);
    let mut dng = Dng::new(6, 4, 3, 16, 1, little_endian(&expected));
    dng.set(50714, shorts(&[64, 65, 66])).set(50717, shorts(&[60000; 3]));
    let pixels = decode(&dng.bytes()).unwrap();
    assert_eq!((pixels.width, pixels.height, pixels.cell), (6, 4, None));
    assert_eq!((pixels.codes, pixels.white), (expected, 60000.0));
    assert_eq!(pixels.black[..3], [64.0, 65.0, 66.0]);
}

#[test]
fn packed_bits_are_unpacked() {
    for bits in [10u16, 12, 14] {
        let expected = codes(5 * 3, (1 << bits) - 1);
        let mut data = Vec::new();
        for row in expected.chunks(5) {
            let text: String = row.iter().map(|c| format!("{c:0width$b}", width = usize::from(bits))).collect();
            let padded = format!("{text:0<width$}", width = text.len().div_ceil(8) * 8);
            data.extend((0..padded.len() / 8).map(|i| u8::from_str_radix(&padded[8 * i..8 * i + 8], 2).unwrap()));
        }
        let pixels = decode(&Dng::new(5, 3, 1, bits, 1, data).bytes()).unwrap();
        assert_eq!(pixels.codes, expected, "{bits} bits");
        assert_eq!(pixels.white, ((1u32 << bits) - 1) as f32);
    }
}

#[test]
fn lossless_jpeg_holds_bayer_tiles_as_two_components() {
    let expected = codes(8 * 6, 4095);
    let mut dng = Dng::new(8, 6, 1, 12, 7, encode_lossless_jpeg(&expected, 4, 2, 1));
    let pixels = decode(&dng.bytes()).unwrap();
    assert_eq!((pixels.codes, pixels.cell), (expected, Some([0, 1, 1, 2])));
    let rgb = codes(8 * 6 * 3, 4095);
    assert_eq!(decode(&Dng::new(8, 6, 3, 12, 7, encode_lossless_jpeg(&rgb, 8, 3, 7)).bytes()).unwrap().codes, rgb);
}

/// Returns a DNG of one of [`JPEG_XL`]'s tiles.
fn jpeg_xl_dng(bits: u16, hex: &str) -> Dng {
    let data: Vec<u8> = (0..hex.len() / 2).map(|i| u8::from_str_radix(&hex[2 * i..2 * i + 2], 16).unwrap()).collect();
    let mut dng = Dng::new(8, 8, 3, bits, 52546, data);
    let length = dng.data.len() as u32;
    dng.set(322, longs(&[8])).set(323, longs(&[8])).set(324, longs(&[0])).set(325, longs(&[length]));
    dng
}

#[test]
fn jpeg_xl_tiles_of_any_depth_come_on_the_scale_of_16_bits() {
    for (bits, hex) in JPEG_XL {
        let largest = (1u32 << bits) - 1;
        let stored = (0..8u32)
            .flat_map(|y| (0..8u32).flat_map(move |x| (0..3u32).map(move |c| x * 37 + y * 101 + c * 211 + x * y * 7)))
            .map(|v| v % (1 << bits));
        let expected: Vec<u16> = stored.map(|v| (f64::from(v) / f64::from(largest) * 65535.0).round() as u16).collect();
        // Their white level is on that scale too, stated or not.
        for white in [None, Some(65535), Some(60000)] {
            let mut dng = jpeg_xl_dng(bits, hex);
            if let Some(white) = white {
                dng.set(50717, longs(&[white; 3])).set(50714, longs(&[528; 3]));
            }
            let pixels = decode(&dng.bytes()).unwrap();
            assert_eq!((&pixels.codes, pixels.white), (&expected, white.unwrap_or(65535) as f32), "{bits} bits");
        }
    }
}

#[test]
fn rows_and_columns_in_fields_are_put_in_order() {
    for (width, height, rows, columns) in [(8usize, 6usize, 2usize, 2usize), (7, 5, 2, 2), (7, 5, 3, 2), (6, 4, 1, 2), (6, 4, 4, 1)] {
        let expected = codes(width * height, 65535);
        // All rows that begin a cell, then all second ones; columns likewise. As many fields as
        // there are rows are refused.
        let of = |fields: usize, length: usize| -> Vec<usize> {
            let fields = if fields < length { fields } else { 1 };
            (0..fields).flat_map(|field| (field..length).step_by(fields)).collect()
        };
        let (from_y, from_x) = (of(rows, height), of(columns, width));
        let places = from_y.iter().flat_map(|y| from_x.iter().map(move |x| y * width + x));
        let stored: Vec<u16> = places.map(|i| expected[i]).collect();
        let mut dng = Dng::new(width as u32, height as u32, 1, 16, 1, little_endian(&stored));
        dng.set(50975, shorts(&[rows as u16])).set(52547, shorts(&[columns as u16]));
        assert_eq!(decode(&dng.bytes()).unwrap().codes, expected, "{width} x {height} of {rows} x {columns}");
    }
}

#[test]
fn tiles_beyond_what_the_file_can_hold_are_refused() {
    for (compression, data) in [(1, vec![0; 128]), (7, encode_lossless_jpeg(&codes(8 * 8, 4095), 4, 2, 1)), (52546, vec![0; 128])] {
        let mut dng = Dng::new(8, 8, 1, 12, compression, data);
        let length = dng.data.len() as u32;
        dng.set(322, longs(&[65520])).set(323, longs(&[65520])).set(324, longs(&[0])).set(325, longs(&[length]));
        let error = decode(&dng.bytes()).unwrap_err();
        assert!(error.message.contains("tiles of 65520 x 65520 pixels"), "{error}");
    }
}

#[test]
fn black_that_varies_by_row_and_column_is_subtracted() {
    let rational =
        |values: &[i32]| (10, values.len() as u32, values.iter().flat_map(|v| [v.to_le_bytes(), 1i32.to_le_bytes()].concat()).collect());
    let stored: Vec<u16> = (0..4 * 4).map(|i| 1000 + 10 * i as u16).collect();
    let read = |tag: u16, deltas: &[i32]| {
        let mut dng = Dng::new(4, 4, 1, 16, 1, little_endian(&stored));
        dng.set(50714, shorts(&[64])).set(50717, shorts(&[1120])).set(tag, rational(deltas));
        decode(&dng.bytes())
    };
    // One pedestal in all rows is a black level.
    let even = read(50716, &[256; 4]).unwrap();
    assert_eq!((even.black, &even.codes), ([320.0; 4], &stored));
    // Rows of one colour share theirs; what single rows add is taken off their codes, but not off
    // saturated ones.
    let rows = read(50716, &[10, 20, 30, 40]).unwrap();
    assert_eq!(rows.black, [84.0, 84.0, 94.0, 94.0]);
    let expected: Vec<u16> = stored
        .iter()
        .enumerate()
        .map(|(i, c)| {
            if i < 8 {
                c + 10
            } else if *c >= 1120 {
                *c
            } else {
                c - 10
            }
        })
        .collect();
    assert_eq!(rows.codes, expected);
    let columns = read(50715, &[0, 8, 0, 8]).unwrap();
    assert_eq!((columns.black, &columns.codes), ([64.0, 72.0, 64.0, 72.0], &stored));
    let error = read(50715, &[1, 2]).unwrap_err();
    assert!(error.message.contains("BlackLevelDeltaH has 2 numbers, expected 4"), "{error}");
}

#[test]
fn the_crop_turns_the_mosaic_with_it() {
    let stored = codes(8 * 6, 1000);
    let mut dng = Dng::new(8, 6, 1, 16, 1, little_endian(&stored));
    dng.set(50829, longs(&[1, 0, 6, 8])).set(50719, longs(&[1, 0])).set(50720, longs(&[4, 4]));
    dng.set(50713, shorts(&[2, 2])).set(50714, shorts(&[1, 2, 3, 4]));
    let pixels = decode(&dng.bytes()).unwrap();
    // The active area begins in row 1, the crop a column further: the cell, which counts from the
    // area, begins with its second column.
    assert_eq!((pixels.width, pixels.height, pixels.cell), (4, 4, Some([1, 0, 2, 1])));
    assert_eq!(pixels.black, [2.0, 1.0, 4.0, 3.0]);
    assert_eq!(pixels.codes[..4], stored[9..13]);
}

#[test]
fn linearisation_tables_go_first() {
    let mut dng = Dng::new(2, 1, 3, 8, 1, vec![0, 1, 2, 3, 200, 1]);
    dng.set(50712, shorts(&[0, 10, 40, 90]));
    assert_eq!(decode(&dng.bytes()).unwrap().codes, [0, 10, 40, 90, 90, 10]);
}

#[test]
fn what_the_file_asks_for_and_is_not_done_is_listed() {
    let mut dng = Dng::new(2, 2, 3, 16, 1, vec![0; 24]);
    dng.set(52525, (7, 8, vec![1; 8])).set(50730, (10, 1, [(-1i32).to_le_bytes(), 2i32.to_le_bytes()].concat()));
    dng.set(50728, rationals(&[(1, 2), (1, 1), (6, 10)])).set(33434, rationals(&[(1, 50)])).set(34855, shorts(&[400]));
    let info = photo_info(Path::new("a.dng"), &dng.bytes()).unwrap();
    assert_eq!((info.kind, info.size_px), (PhotoKind::Raw, [2, 2]));
    assert_eq!((info.exif.seconds, info.exif.iso, info.exif.camera_name()), (Some(0.02), Some(400.0), Some("Luxel Test".into())));
    let raw = info.raw.unwrap();
    assert_eq!((raw.baseline_exposure_ev, raw.as_shot_neutral), (-0.5, Some([0.5, 1.0, 0.6])));
    assert_eq!(raw.not_applied, ["profile gain table map"]);
}

#[test]
fn what_cannot_be_read_is_named() {
    // Tags with their values, and the note about a file that has them.
    let cases = [
        (259, shorts(&[34892]), "lossy JPEG", IoErrorKind::Unsupported),
        (259, shorts(&[8]), "compression 8", IoErrorKind::Unsupported),
        (339, shorts(&[3]), "floating-point", IoErrorKind::Unsupported),
        (258, shorts(&[32; 3]), "32 bits", IoErrorKind::Unsupported),
        (50720, longs(&[5, 2]), "a crop of 5 x 2", IoErrorKind::Invalid),
        (50714, shorts(&[65535]), "not below white", IoErrorKind::Invalid),
        (262, shorts(&[2]), "no mosaic or LinearRaw", IoErrorKind::Invalid),
        (279, longs(&[40]), "cut short", IoErrorKind::Invalid),
        (317, shorts(&[2]), "predictor 2", IoErrorKind::Unsupported),
        (50974, shorts(&[2, 2]), "in blocks of [2, 2]", IoErrorKind::Unsupported),
    ];
    for (tag, value, part, kind) in cases {
        let mut dng = Dng::new(4, 2, 3, 16, 1, vec![0; 48]);
        let error = decode(&dng.set(tag, value).bytes()).unwrap_err();
        assert!(error.message.contains(part) && error.kind == kind, "{part}: {error}");
    }
    let mut x_trans = Dng::new(6, 6, 1, 16, 1, vec![0; 72]);
    x_trans.set(33421, shorts(&[6, 6])).set(33422, (1, 36, vec![1; 36]));
    assert!(decode(&x_trans.bytes()).unwrap_err().message.contains("expected a Bayer cell"));
    let error = photo_info(Path::new("IMG_1.CR3"), b"anything").unwrap_err();
    assert!(error.message.contains("DNG converter") && error.kind == IoErrorKind::Unsupported);
}

#[test]
fn codes_of_pictures_come_back() {
    let rgb: Vec<u8> = (0..4 * 3 * 3).map(|i| (i * 7) as u8).collect();
    let png = crate::encode_png(4, 3, &rgb).unwrap();
    match decode_photo(Path::new("a.png"), &png).unwrap() {
        Photo::Developed { width: 4, height: 3, codes: Codes::U8(found) } => assert_eq!(found, rgb),
        other => panic!("{other:?}"),
    }
    let jpeg = crate::encode_jpeg(4, 3, &[200; 36], 95).unwrap();
    assert_eq!(photo_info(Path::new("a.jpg"), &jpeg).unwrap().kind, PhotoKind::Developed);
    match decode_photo(Path::new("a.jpg"), &jpeg).unwrap() {
        Photo::Developed { codes: Codes::U8(found), .. } => assert!(found.iter().all(|c| c.abs_diff(200) < 3)),
        other => panic!("{other:?}"),
    }
}

/// Returns `png` with a chunk behind its header.
fn with_chunk(png: &[u8], kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let body = [kind, data].concat();
    let mut crc = flate2::Crc::new();
    crc.update(&body);
    [&png[..33], &(data.len() as u32).to_be_bytes(), &body, &crc.sum().to_be_bytes(), &png[33..]].concat()
}

#[test]
fn codes_of_a_png_stay_and_its_primaries_are_told() {
    use ::image::ImageEncoder;
    let rgb: Vec<u8> = (0..4 * 3 * 3).map(|i| (i * 7) as u8).collect();
    let mut png = Vec::new();
    ::image::codecs::png::PngEncoder::new(&mut png).write_image(&rgb, 4, 3, ::image::ExtendedColorType::Rgb8).unwrap();
    // Primaries of no space with a name: those of DCI-P3 under its own white.
    let dci_p3 = [[0.680, 0.320], [0.265, 0.690], [0.150, 0.060], [0.314, 0.351]];
    let chrm = |[red, green, blue, white]: Chromaticities| -> Vec<u8> {
        [white, red, green, blue].as_flattened().iter().flat_map(|v| ((v * 100_000.0).round() as u32).to_be_bytes()).collect()
    };
    let p3 = ColorSpace::LinearDisplayP3.chromaticities();
    let rec601 = [[0.630, 0.340], [0.310, 0.595], [0.155, 0.070], [0.3127, 0.3290]];
    let cases = [
        (png.clone(), None),
        (with_chunk(&png, b"cHRM", &chrm(dci_p3)), Some(dci_p3)),
        (with_chunk(&png, b"cICP", &[12, 13, 0, 1]), Some(p3)),
        (with_chunk(&png, b"cICP", &[9, 13, 0, 1]), Some(ColorSpace::LinearRec2020.chromaticities())),
        (with_chunk(&png, b"cICP", &[6, 6, 0, 1]), Some(rec601)),
        (with_chunk(&png, b"cICP", &[2, 2, 0, 1]), None),
    ];
    for (bytes, primaries) in cases {
        assert_eq!(photo_info(Path::new("a.png"), &bytes).unwrap().primaries, primaries);
        match decode_photo(Path::new("a.png"), &bytes).unwrap() {
            Photo::Developed { codes: Codes::U8(found), .. } => assert_eq!(found, rgb, "{primaries:?}"),
            other => panic!("{other:?}"),
        }
    }
    // Invalid primaries concern light alone.
    let unknown = with_chunk(&png, b"cICP", &[22, 13, 0, 1]);
    assert!(decode_photo(Path::new("a.png"), &unknown).is_ok() && photo_info(Path::new("a.png"), &unknown).is_err());
    // Zeros of a program that knew none.
    assert_eq!(photo_info(Path::new("a.png"), &with_chunk(&png, b"cHRM", &[0; 32])).unwrap().primaries, None);
    // An ICC profile goes between cICP and the rest.
    let stated = |bytes: &[u8]| stated_primaries(Input::new("a.png", bytes), Some(p3)).unwrap();
    assert_eq!(stated(&with_chunk(&png, b"cHRM", &chrm(dci_p3))), Some(p3));
    assert_eq!(stated(&with_chunk(&png, b"cICP", &[6, 6, 0, 1])), Some(rec601));
}

#[test]
fn images_of_a_data_set_have_the_primaries_of_their_profile() {
    use ::image::ImageEncoder;
    let mut png = Vec::new();
    ::image::codecs::png::PngEncoder::new(&mut png).write_image(&[0, 128, 255], 1, 1, ::image::ExtendedColorType::Rgb8).unwrap();
    let with_profile = |red_x: f64| {
        let mut deflated = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
        std::io::Write::write_all(&mut deflated, &display_p3(red_x)).unwrap();
        with_chunk(&png, b"iCCP", &[&b"icc\0\0"[..], &deflated.finish().unwrap()].concat())
    };
    let read = |bytes: &[u8]| {
        let options = ReadOptions { transfer: Some(Transfer::Srgb), layer: None };
        decode_image(Path::new("a.png"), bytes, &options).unwrap()
    };
    let known = read(&with_profile(0.5151));
    assert_eq!((known.color_space, known.image), (Some(ColorSpace::LinearDisplayP3), read(&png).image));
    let unknown = read(&with_profile(0.61));
    assert_eq!(unknown.color_space, None);
    assert!(unknown.warnings.iter().any(|w| w.contains("ICC profile (Display P3) is not applied")), "{:?}", unknown.warnings);
    // cICP takes precedence.
    let named = read(&with_chunk(&with_profile(0.5151), b"cICP", &[9, 13, 0, 1]));
    assert_eq!(named.color_space, Some(ColorSpace::LinearRec2020));
}

#[test]
fn exif_of_a_jpeg_is_read() {
    let exif_at = 8 + 2 + 12 * 2 + 4;
    let mut block = tiff(&[(0x010f, 2, 4, b"Lux\0".to_vec()), (0x8769, 4, 1, (exif_at as u32).to_le_bytes().to_vec())], &[]);
    // The Exif directory: exposure time and f-number, with their values behind.
    let values_at = (exif_at + 2 + 24 + 4) as u32;
    block.extend(2u16.to_le_bytes());
    for (i, tag) in [0x829au16, 0x829d].iter().enumerate() {
        block.extend(tag.to_le_bytes());
        block.extend([5, 0, 1, 0, 0, 0]);
        block.extend((values_at + 8 * i as u32).to_le_bytes());
    }
    block.extend([0; 4]);
    block.extend([1u32, 250, 28, 10].iter().flat_map(|v| v.to_le_bytes()));
    let mut jpeg = vec![0xff, 0xd8, 0xff, 0xe1];
    jpeg.extend((block.len() as u16 + 8).to_be_bytes());
    jpeg.extend(b"Exif\0\0");
    jpeg.extend(&block);
    jpeg.extend(&crate::encode_jpeg(2, 2, &[9; 12], 90).unwrap()[2..]);
    let info = photo_info(Path::new("a.jpg"), &jpeg).unwrap();
    assert_eq!((info.exif.seconds, info.exif.f_number, info.exif.make.as_deref()), (Some(0.004), Some(2.8), Some("Lux")));
}

/// Lossless JPEG XL of libjxl, 8 x 8 pixels of RGB: bits, and the file.
const JPEG_XL: [(u16, &str); 3] = [
    (
        10,
        "ff0a415040d1220804010024044b18938e8383099108b72a0a0a1d46351a39888d8e8e88888e2d62a37181f801d0856c4b5673572a2bda425c87514b\
        06ad4a9fd9b65a48cf2bb42bdbc127b7634aa636b565d482d1d486902791a3e68b0c11389f2637e4f9db7a0ea0cbb7fe2a803537ab4bd862f4941f7b\
        35b269f2c29207269da50dcb19974c964a48f621cb9aa564b2c45132d259d2b0f411aa0da18809470c2319225039bd51233706fce24e016b68758c06\
        6c9eae06a254561880a6d36920cb148523fa74b59453652ad2300d41352647145919b6ebc3efe6728bf51a2b66ec1750ef7260ca7d0349195b780910\
        2a2c934c1403bcbeb78a49da97f8638a39de9b088bbc04bb8418d4674ffc0adb6d77c080f200",
    ),
    (
        12,
        "ff0a416040d1220804010014034b2835963e501809052344225a382286d171bee8e88818c63086b19117881fc001460000a6b794d590bc58288d308c\
        148de50121872e5d1982e3132b0a68e3f0d2321f1ac4e82ec5087a9d23cd0854677b3800ac69712a2b2bb190545d1a291ac113420e919032c4342457\
        94fa01f0453ca56588b103df11f402d23b13a8ce0ee7065831bdd3525622cf50a1340a52513484624e1c65e89104ae88b524e0cb664acb103dc5a323\
        e831ea7526508db8990db0d263b937490d105914136e0dc382c802049c02",
    ),
    (
        16,
        "0000000c4a584c200d0a870a00000014667479706a786c20000000006a786c20000000096a786c6c0a000000db6a786c63ff0a41f00350b408080401\
        0014034b2835963e501809052344225a382286d171bee8e88818c63086b19117881fc001460000a6b794d590bc58288d308c148de50121872e5d1982\
        e3132b0a68e3f0d2321f1ac4e82ec5087a9d23cd0854677b3800ac69712a2b2bb190545d1a291ac113420e919032c434245794fa01f0453ca56588b1\
        03df11f402d23b13a8ce0ee7065831bdd3525622cf50a1340a52513484624e1c65e89104ae88b524e0cb664acb103dc5a323e831ea7526508db8990d\
        b0d263b937490d105914136e0dc382c802049c02",
    ),
];

proptest! {
    #[test]
    fn any_damage_of_a_dng_is_an_error_or_an_image(at: prop::sample::Index, byte: u8, cut: prop::sample::Index, kind in 0usize..3) {
        let mut bytes = match kind {
            0 => Dng::new(8, 6, 1, 12, 7, encode_lossless_jpeg(&codes(48, 4095), 4, 2, 1)).bytes(),
            1 => Dng::new(6, 4, 3, 16, 1, little_endian(&codes(72, 65535))).bytes(),
            _ => jpeg_xl_dng(12, JPEG_XL[1].1).bytes(),
        };
        let _ = decode_photo(Path::new("a.dng"), &bytes[..cut.index(bytes.len())]);
        let at = at.index(bytes.len());
        bytes[at] = byte;
        let _ = photo_info(Path::new("a.dng"), &bytes);
        let _ = decode_photo(Path::new("a.dng"), &bytes);
    }

    #[test]
    fn any_bytes_are_no_panic(bytes: Vec<u8>, ending in prop::sample::select(vec!["dng", "jpg", "png", "tif", "exr"])) {
        let name = format!("a.{ending}");
        let _ = photo_info(Path::new(&name), &bytes);
        let _ = decode_photo(Path::new(&name), &bytes);
    }
}
