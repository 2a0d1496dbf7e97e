//! PNG.

use super::*;

/// A PNG of `width` x `height` white pixels of one bit.
fn white_bits(width: u32, height: u32) -> Vec<u8> {
    use std::io::Write;
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |kind: &[u8; 4], data: &[u8]| {
        let mut crc = flate2::Crc::new();
        crc.update(kind);
        crc.update(data);
        out.extend((data.len() as u32).to_be_bytes());
        out.extend(kind);
        out.extend(data);
        out.extend(crc.sum().to_be_bytes());
    };
    let row = [&[0u8][..], &vec![0xff; width.div_ceil(8) as usize]].concat();
    let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    (0..height).for_each(|_| packed.write_all(&row).unwrap());
    chunk(b"IHDR", &[&width.to_be_bytes()[..], &height.to_be_bytes(), &[1, 0, 0, 0, 0]].concat());
    chunk(b"IDAT", &packed.finish().unwrap());
    chunk(b"IEND", &[]);
    out
}

#[test]
fn flat_pictures_pack_well_and_are_read() {
    let bytes = white_bits(8192, 5464);
    assert!(bytes.len() < 13_000, "{}", bytes.len());
    let mask = luxel_io::decode_mask(Path::new("white.png"), &bytes, [8192, 5464]).unwrap();
    assert!(mask.weights.iter().all(|weight| *weight == 1.0));
}

pub(super) fn png_bytes(size: (u32, u32), data: &[u8], color: image::ExtendedColorType) -> Vec<u8> {
    use image::ImageEncoder;
    let mut out = Vec::new();
    image::codecs::png::PngEncoder::new(&mut out).write_image(data, size.0, size.1, color).unwrap();
    out
}

/// Returns `png` with a chunk behind its header.
fn with_chunk(png: &[u8], kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let body = [kind, data].concat();
    let crc = body
        .iter()
        .fold(!0u32, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 }));
    let chunk = [&(data.len() as u32).to_be_bytes()[..], &body, &(!crc).to_be_bytes()].concat();
    [&png[..33], &chunk, &png[33..]].concat()
}

#[test]
fn png_transfer_is_said_or_read_but_not_guessed() {
    use image::ExtendedColorType as Kind;
    let samples: Vec<u8> = [0u16, 65535, 32768].iter().flat_map(|v| v.to_ne_bytes()).collect();
    let png = png_bytes((1, 1), &samples, Kind::Rgb16);
    let middle = |bytes: &[u8], options: &ReadOptions| decode(bytes, options).unwrap().image.pixels[0][2];
    let (linear, srgb) = (0.500_007_6, 0.214_048_6);
    assert!((middle(&png, &LINEAR) - linear).abs() < 1e-6);
    assert!((middle(&png, &SRGB) - srgb).abs() < 1e-6);
    let error = decode(&png, &UNSAID).unwrap_err();
    assert!(error.remedy.as_ref().is_some_and(|remedy| remedy.options().eq(["transfer"; 2])), "{error}");

    let gamma = |value: u32| with_chunk(&png, b"gAMA", &value.to_be_bytes());
    assert!((middle(&gamma(100_000), &UNSAID) - linear).abs() < 1e-6);
    assert!((middle(&gamma(45_455), &UNSAID) - srgb).abs() < 1e-6);
    assert!((middle(&gamma(50_000), &UNSAID) - linear * linear).abs() < 1e-6);
    assert!((middle(&with_chunk(&png, b"sRGB", &[0]), &UNSAID) - srgb).abs() < 1e-6);
    assert!((middle(&with_chunk(&gamma(45_455), b"cICP", &[1, 8, 0, 1]), &UNSAID) - linear).abs() < 1e-6);
    // The user goes before the file.
    assert!((middle(&gamma(100_000), &SRGB) - srgb).abs() < 1e-6);
    let error = decode(&with_chunk(&png, b"cICP", &[9, 1, 0, 1]), &UNSAID).unwrap_err();
    assert!(error.remedy.is_some_and(|remedy| remedy.to_string().contains("transfer")));
    let decoded = decode(&with_chunk(&png, b"cICP", &[12, 8, 0, 1]), &UNSAID).unwrap();
    assert_eq!(decoded.color_space, Some(ColorSpace::LinearDisplayP3));
    // Curves of light beyond white, and the narrow range of video.
    for (transfer, curve) in [(16, Transfer::Pq), (18, Transfer::Hlg)] {
        let light = |sample: f64| curve.light(sample) as f32;
        let middle = |full: u8| middle(&with_chunk(&png, b"cICP", &[9, transfer, 0, full]), &UNSAID);
        let sample = f64::from(linear);
        assert!((middle(1) / light(sample) - 1.0).abs() < 1e-4, "{curve}: {}", middle(1));
        let narrow = (sample * 65535.0 / 256.0 - 16.0) / 219.0;
        assert!((middle(0) / light(narrow) - 1.0).abs() < 1e-4, "{curve}: {}", middle(0));
    }
}

#[test]
fn png_of_every_layout_is_read() {
    use image::ExtendedColorType as Kind;
    for (kind, data, expected, alpha) in [
        (Kind::L8, vec![255, 0], [[1.0; 3], [0.0; 3]], None),
        (Kind::La8, vec![255, 51, 0, 255], [[1.0; 3], [0.0; 3]], Some(vec![0.2, 1.0])),
        (Kind::Rgb8, vec![255, 0, 51, 0, 0, 0], [[1.0, 0.0, 0.2], [0.0; 3]], None),
        (Kind::Rgba8, vec![255, 0, 51, 0, 0, 0, 0, 255], [[1.0, 0.0, 0.2], [0.0; 3]], Some(vec![0.0, 1.0])),
        (Kind::L16, vec![255; 4], [[1.0; 3], [1.0; 3]], None),
        (Kind::La16, vec![255; 8], [[1.0; 3], [1.0; 3]], Some(vec![1.0, 1.0])),
        (Kind::Rgba16, vec![255; 16], [[1.0; 3], [1.0; 3]], Some(vec![1.0, 1.0])),
    ] {
        let decoded = decode(&png_bytes((2, 1), &data, kind), &LINEAR).unwrap();
        assert_eq!((decoded.image.pixels.as_slice(), decoded.alpha), (&expected[..], alpha), "{kind:?}");
        assert_eq!(decoded.warnings.contains(&"8 bits: not HDR".to_string()), decoded.depth == SampleDepth::Integer8);
    }
}

#[test]
fn preview_png_says_that_it_is_srgb() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    write_png(&path, 2, 1, &[0, 255, 128, 1, 2, 3]).unwrap();
    let decoded = read_image(&path, &UNSAID).unwrap();
    assert_eq!(decoded.color_space, Some(ColorSpace::LinearRec709));
    assert!((decoded.image.pixels[0][2] - 0.215_86).abs() < 1e-4);
    assert_eq!(image_size(&path).unwrap(), [2, 1]);
}
