//! Images of every format, written by the formats' own crates and read back as linear radiance.

// Helpers of tests may fail as tests do.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

use std::io::Cursor;
use std::path::Path;

use exr::prelude::*;
use luxel_core::environment::Projection;
use luxel_core::{Camera, ColorSpace, Distortion, Image as Radiance, Remedy};
use luxel_io::{
    DecodedImage, ExrOptions, ExrSample, IoError, IoErrorKind, ReadOptions, SampleDepth, Transfer, decode_image, encode_exr, encode_png,
    image_size, read_image, write_exr, write_png,
};

const LINEAR: ReadOptions = ReadOptions { transfer: Some(Transfer::Linear), layer: None };
const SRGB: ReadOptions = ReadOptions { transfer: Some(Transfer::Srgb), layer: None };
const UNSAID: ReadOptions = ReadOptions { transfer: None, layer: None };

fn decode(bytes: &[u8], options: &ReadOptions) -> std::result::Result<DecodedImage, IoError> {
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

fn planes(image: &Radiance, store: impl Fn(Vec<f32>) -> FlatSamples) -> Vec<(&'static str, FlatSamples)> {
    [("R", 0), ("G", 1), ("B", 2)].map(|(name, c)| (name, store(image.pixels.iter().map(|p| p[c]).collect()))).into()
}

fn half(values: Vec<f32>) -> FlatSamples {
    FlatSamples::F16(values.into_iter().map(f16::from_f32).collect())
}

type ExrImage = Image<Layer<AnyChannels<FlatSamples>>>;

fn exr_image(size: (usize, usize), channels: Vec<(&str, FlatSamples)>, encoding: Encoding) -> ExrImage {
    let channels = channels.into_iter().map(|(name, samples)| AnyChannel::new(name, samples)).collect();
    Image::from_layer(Layer::new(size, LayerAttributes::named("main"), encoding, AnyChannels::sort(channels)))
}

fn exr_bytes(image: &ExrImage) -> Vec<u8> {
    let mut out = Cursor::new(Vec::new());
    image.write().non_parallel().to_buffered(&mut out).unwrap();
    out.into_inner()
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
fn exr_of_every_compression_is_read() {
    let lossless = [Compression::Uncompressed, Compression::RLE, Compression::ZIP1, Compression::ZIP16, Compression::PIZ];
    // Block codecs err by a fraction of a block's spread, here of a few units.
    let lossy = [
        (Compression::PXR24, 1e-4),
        (Compression::B44, 0.15),
        (Compression::B44A, 0.15),
        (Compression::DWAA(None), 0.15),
        (Compression::DWAB(None), 0.15),
    ];
    let all = lossless.into_iter().map(|c| (c, 0.0)).chain(lossy);
    // More lines than the largest block (256), a width that no block size divides.
    let image = radiance(37, 300);
    for (compression, tolerance) in all {
        for blocks in [Blocks::ScanLines, Blocks::Tiles(Vec2(16, 16))] {
            for store in [half, FlatSamples::F32] {
                let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
                let bytes = exr_bytes(&exr_image((37, 300), planes(&image, store), encoding));
                let decoded = decode(&bytes, &UNSAID).unwrap_or_else(|e| panic!("{compression:?} {blocks:?}: {e}"));
                assert_near(&decoded.image, &image, tolerance);
                assert_eq!((decoded.depth, decoded.color_space, decoded.alpha), (SampleDepth::Float, None, None));
            }
        }
    }
}

#[test]
fn exr_of_decreasing_line_order_is_read() {
    let image = radiance(20, 50);
    let encoding = Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Decreasing };
    let bytes = exr_bytes(&exr_image((20, 50), planes(&image, half), encoding));
    assert_eq!(decode(&bytes, &UNSAID).unwrap().image, image);
}

#[test]
fn exr_keeps_nan_infinity_negatives_and_bright_values() {
    let values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -2.0, 1e30, 0.0];
    let image = Radiance { width: 2, height: 1, pixels: vec![[values[0], values[1], values[2]], [values[3], values[4], values[5]]] };
    let bytes = encode_exr(Path::new("a.exr"), &image, &ExrOptions { sample: ExrSample::Float, ..ExrOptions::default() }).unwrap();
    let found = decode(&bytes, &UNSAID).unwrap().image;
    let bits = |image: &Radiance| image.pixels.iter().flatten().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&found), bits(&image));
}

#[test]
fn exr_uint_and_luminance_and_alpha_are_read() {
    let counts = || FlatSamples::U32(vec![0, 7, 70_000, 3]);
    let bytes =
        exr_bytes(&exr_image((2, 2), vec![("Y", counts()), ("A", FlatSamples::F32(vec![0.0, 0.5, 1.0, 0.25]))], Encoding::UNCOMPRESSED));
    let decoded = decode(&bytes, &UNSAID).unwrap();
    assert_eq!(decoded.image.pixels, [[0.0; 3], [7.0; 3], [70_000.0; 3], [3.0; 3]]);
    assert_eq!(decoded.alpha, Some(vec![0.0, 0.5, 1.0, 0.25]));
}

#[test]
fn exr_data_window_is_placed_in_the_display_window() {
    // Display windows around, inside of, beside and apart from the 4 x 3 data window.
    let image = radiance(4, 3);
    for (data, display, size) in [
        ((1, 1), (0, 0), (6, 5)),
        ((-2, -1), (0, 0), (6, 5)),
        ((-2, -1), (-5, -3), (10, 9)),
        ((0, 0), (1, 1), (2, 1)),
        ((100, 0), (0, 0), (6, 5)),
        ((-1000, 1000), (0, 0), (3, 3)),
    ] {
        for blocks in [Blocks::ScanLines, Blocks::Tiles(Vec2(2, 2))] {
            let encoding = Encoding { compression: Compression::ZIP16, blocks, line_order: LineOrder::Increasing };
            let mut file = exr_image((4, 3), planes(&image, half), encoding);
            file.layer_data.attributes.layer_position = Vec2(data.0, data.1);
            file.attributes.display_window = IntegerBounds::new(Vec2(display.0, display.1), Vec2(size.0, size.1));
            let found = decode(&exr_bytes(&file), &UNSAID).unwrap().image;
            assert_eq!((found.width, found.height), size);
            for y in 0..size.1 {
                for x in 0..size.0 {
                    let (u, v) = (x as i32 + display.0 - data.0, y as i32 + display.1 - data.1);
                    let inside = (0..4).contains(&u) && (0..3).contains(&v);
                    let expected = if inside { image.at(u as usize, v as usize) } else { [0.0; 3] };
                    assert_eq!(found.at(x, y), expected, "data {data:?} display {display:?} at {x}, {y}");
                }
            }
        }
    }
}

#[test]
fn exr_colour_is_found_by_name() {
    let image = radiance(3, 2);
    let other = || half(vec![9.0; 6]);
    let [r, g, b] = [0, 1, 2].map(|c| planes(&image, half)[c].1.clone());
    let read = |channels: Vec<(&str, FlatSamples)>| decode(&exr_bytes(&exr_image((3, 2), channels, Encoding::UNCOMPRESSED)), &UNSAID);
    // Of no layer, among others.
    let channels =
        vec![("R", r.clone()), ("G", g.clone()), ("B", b.clone()), ("normal.X", other()), ("diffuse.R", other()), ("Z", other())];
    assert_eq!(read(channels).unwrap().image, image);
    // Of the only layer that has it, although another one interleaves by name.
    let channels =
        vec![("beauty.R", r.clone()), ("beauty.G", g.clone()), ("beauty.B", b.clone()), ("beauty.depth.Z", other()), ("a.X", other())];
    assert_eq!(read(channels).unwrap().image, image);
    // Of two layers.
    let channels =
        vec![("a.R", r.clone()), ("a.G", g.clone()), ("a.B", b.clone()), ("b.R", r.clone()), ("b.G", g.clone()), ("b.B", b.clone())];
    let error = read(channels).unwrap_err();
    assert!(error.kind == IoErrorKind::Unsupported && error.message.contains("(a, b)"), "{error}");
    // Incomplete, or luminance with chroma.
    for channels in [vec![("R", r.clone()), ("G", g.clone())], vec![("Z", other())], vec![("Y", r.clone()), ("RY", g), ("BY", b)]] {
        let error = read(channels).unwrap_err();
        assert!(error.message.contains("expected R, G, B or Y"), "{error}");
    }
}

#[test]
fn exr_of_several_parts_gives_the_beauty_pass_or_the_one_asked_for() {
    let image = radiance(4, 4);
    let layer = |name: &str, channels: Vec<(&str, FlatSamples)>| {
        let mut file = exr_image((4, 4), channels, Encoding::SMALL_LOSSLESS);
        file.layer_data.attributes.layer_name = Some(name.into());
        file.layer_data
    };
    let parts = vec![
        layer("depth", vec![("Z", half(vec![1.0; 16]))]),
        layer("albedo", planes(&image, |v| half(v.into_iter().map(|x| x + 1.0).collect()))),
        layer("beauty", planes(&image, half)),
        layer("other", planes(&image, |v| half(v.into_iter().map(|x| x + 2.0).collect()))),
    ];
    let file = |parts: Vec<Layer<AnyChannels<FlatSamples>>>| {
        let file = Image::from_layers(ImageAttributes::with_size((4, 4)), Layers::from_iter(parts));
        let mut out = Cursor::new(Vec::new());
        file.write().non_parallel().to_buffered(&mut out).unwrap();
        out.into_inner()
    };
    let bytes = file(parts.clone());
    let decoded = decode(&bytes, &UNSAID).unwrap();
    assert_eq!(decoded.image, image);
    assert_eq!(decoded.warnings, ["of several parts or layers beauty is read, not albedo, other"]);
    let other = decode(&bytes, &ReadOptions { layer: Some("other".to_owned()), ..UNSAID }).unwrap();
    assert_eq!((other.image.pixels[1], other.warnings), (image.pixels[1].map(|v| v + 2.0), vec![]));
    let [depth, albedo, _, other] = <[_; 4]>::try_from(parts).unwrap();
    let error = decode(&file(vec![depth, albedo, other]), &UNSAID).unwrap_err();
    assert!(error.message.contains("several parts or layers have colour (albedo, other)"), "{error}");
    assert_eq!((error.kind, error.remedy), (IoErrorKind::Unsupported, Some(Remedy::give("layer"))));
}

#[test]
fn exr_says_what_is_odd_about_a_header() {
    // A single line is a single block in every compression.
    let image = radiance(4, 1);
    let mut file = exr_image((4, 1), planes(&image, half), Encoding::UNCOMPRESSED);
    file.attributes.pixel_aspect = 2.0;
    let bytes = exr_bytes(&file);
    assert_eq!(
        decode(&bytes, &UNSAID).unwrap().warnings,
        ["the pixel aspect ratio is 2: pixels are read as square, as cameras of data sets take them"]
    );
    // The compressions of OpenEXR 3.5: one byte behind the attribute's name, type and length.
    let at = bytes.windows(12).rposition(|w| w == b"compression\0").unwrap() + 12 + 4;
    for (number, part) in [(10, "HTJ2K"), (11, "HTJ2K"), (12, "OpenEXR 3.5"), (13, "OpenEXR 3.5")] {
        let mut newer = bytes.clone();
        newer[at] = number;
        let error = decode(&newer, &UNSAID).unwrap_err();
        assert!(error.message.contains(part) && error.kind == IoErrorKind::Unsupported, "{number}: {error}");
    }
}

#[test]
fn old_hdr_files_without_run_lengths_are_read_whatever_their_codes_are() {
    // Codes that mark runs in files that have them.
    let codes = [[1u8, 1, 1, 129], [128, 64, 32, 129], [2, 2, 32, 129], [0, 0, 0, 0], [1, 1, 1, 200], [255, 255, 255, 128]];
    let file = [&b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 3 +X 2\n"[..], codes.as_flattened()].concat();
    let light = |[r, g, b, e]: [u8; 4]| [r, g, b].map(|m| if e == 0 { 0.0 } else { f32::from(m) * 2f32.powi(i32::from(e) - 136) });
    assert_eq!(decode(&file, &UNSAID).unwrap().image.pixels, codes.map(light));
}

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

#[test]
fn a_flat_mask_in_fax_codes_is_read() {
    let (width, height) = (8192u32, 5464u32);
    // Group 4: a bit says that a line is as the white one before it; then the end of the block.
    let data = [&vec![0xff; height as usize / 8][..], &[0x00, 0x10, 0x01]].concat();
    let entries = [
        (256, width),
        (257, height),
        (258, 1),
        (259, 4),
        (262, 0),
        (273, 134),
        (277, 1),
        (278, height),
        (279, data.len() as u32),
        (266, 1),
    ];
    let mut entries: Vec<(u16, u32)> = entries.to_vec();
    entries.sort_unstable();
    let entry =
        |(tag, value): (u16, u32)| [&tag.to_le_bytes()[..], &4u16.to_le_bytes(), &1u32.to_le_bytes(), &value.to_le_bytes()].concat();
    let entries: Vec<u8> = entries.into_iter().flat_map(entry).collect();
    let file = [&b"II*\0\x08\0\0\0\x0a\0"[..], &entries, &[0; 4], &data].concat();
    let mask = luxel_io::decode_mask(Path::new("white.tif"), &file, [width as usize, height as usize]).unwrap();
    assert!(mask.weights.iter().all(|weight| *weight == 1.0));
}

#[test]
fn tiffs_of_few_bits_are_masks_and_floats_of_which_zero_is_white_are_refused() {
    // 3 x 2 pixels of one bit: 1 0 1, 0 1 1.
    let entry =
        |tag: u16, kind: u16, value: u32| [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &1u32.to_le_bytes(), &value.to_le_bytes()].concat();
    let file = |bits: u32, format: u32, photometric: u32, data: &[u8]| {
        let entries = [
            (256, 3),
            (257, 2),
            (258, bits),
            (259, 1),
            (262, photometric),
            (273, 8 + 2 + 12 * 10 + 4),
            (277, 1),
            (278, 2),
            (279, data.len() as u32),
            (339, format),
        ];
        let entries: Vec<u8> = entries.iter().flat_map(|(tag, value)| entry(*tag, 4, *value)).collect();
        [&b"II*\0\x08\0\0\0\x0a\0"[..], &entries, &[0; 4], data].concat()
    };
    let bits = decode(&file(1, 1, 1, &[0b1010_0000, 0b0110_0000]), &LINEAR).unwrap();
    assert_eq!(bits.image.pixels.iter().map(|p| p[0]).collect::<Vec<_>>(), [1.0, 0.0, 1.0, 0.0, 1.0, 1.0]);
    let four = decode(&file(4, 1, 1, &[0x0f, 0x50, 0xf0, 0xa0]), &LINEAR).unwrap();
    assert_eq!(four.image.pixels.iter().map(|p| (p[0] * 15.0).round() as u32).collect::<Vec<_>>(), [0, 15, 5, 15, 0, 10]);
    let floats: Vec<u8> = [0.0f32, 0.5, 1.0, 2.0, 3.0, 4.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(decode(&file(32, 3, 1, &floats), &UNSAID).unwrap().image.pixels[5], [4.0; 3]);
    let error = decode(&file(32, 3, 0, &floats), &UNSAID).unwrap_err();
    assert!(error.message.contains("WhiteIsZero") && error.kind == IoErrorKind::Unsupported, "{error}");
}

#[test]
fn exr_of_mip_and_rip_maps_gives_full_resolution() {
    let image = radiance(19, 11);
    let rounding_mode = exr::math::RoundingMode::Down;
    let full = Vec2(19, 11);
    for is_rip in [false, true] {
        let channel = |c: usize| {
            let samples = |size: Vec2<usize>| match size {
                Vec2(19, 11) => image.pixels.iter().map(|p| p[c]).collect(),
                size => vec![-1.0; size.area()],
            };
            if is_rip {
                let levels: Vec<_> =
                    exr::meta::rip_map_levels(rounding_mode, full).map(|(_, size)| FlatSamples::F32(samples(size))).collect();
                let level_count = Vec2(5, 4);
                Levels::Rip { rounding_mode, level_data: RipMaps { map_data: levels, level_count } }
            } else {
                let level_data = exr::meta::mip_map_levels(rounding_mode, full).map(|(_, size)| FlatSamples::F32(samples(size))).collect();
                Levels::Mip { rounding_mode, level_data }
            }
        };
        let channels = [("R", 0), ("G", 1), ("B", 2)].map(|(name, c)| AnyChannel::new(name, channel(c)));
        let encoding = Encoding { compression: Compression::ZIP16, blocks: Blocks::Tiles(Vec2(8, 8)), line_order: LineOrder::Increasing };
        let file =
            Image::from_layer(Layer::new(full, LayerAttributes::named("a"), encoding, AnyChannels::sort(channels.into_iter().collect())));
        let mut out = Cursor::new(Vec::new());
        file.write().non_parallel().to_buffered(&mut out).unwrap();
        assert_eq!(decode(&out.into_inner(), &UNSAID).unwrap().image, image, "rip maps: {is_rip}");
    }
}

#[test]
fn exr_chromaticities_are_honoured() {
    let image = Radiance::filled(2, 2, [0.5, 0.25, 2.0]);
    let read = |chromaticities: [[f32; 2]; 4]| {
        let mut file = exr_image((2, 2), planes(&image, half), Encoding::UNCOMPRESSED);
        let [red, green, blue, white] = chromaticities.map(|[x, y]| Vec2(x, y));
        file.attributes.chromaticities = Some(attribute::Chromaticities { red, green, blue, white });
        decode(&exr_bytes(&file), &UNSAID)
    };
    for space in ColorSpace::ALL {
        let decoded = read(space.chromaticities()).unwrap();
        assert_eq!((decoded.color_space, decoded.image == image, decoded.warnings.len()), (Some(space), true, 0));
        assert_eq!(decoded.chromaticities, Some(space.chromaticities()));
    }
    // Adobe RGB: the IEC 61966-2-5 matrix to XYZ, and that of Rec.709 back: 1.3983 R - 0.3983 G.
    let adobe = [[0.64, 0.33], [0.21, 0.71], [0.15, 0.06], [0.3127, 0.3290]];
    let decoded = read(adobe).unwrap();
    assert_eq!((decoded.color_space, decoded.chromaticities), (Some(ColorSpace::LinearRec709), Some(adobe)));
    assert!(decoded.warnings[0].contains("converted to linear Rec.709"), "{:?}", decoded.warnings);
    let red = 1.3983 * 0.5 - 0.3983 * 0.25;
    assert!((decoded.image.pixels[0][0] - red).abs() < 1e-3, "{}", decoded.image.pixels[0][0]);
    assert!(read([[0.0; 2]; 4]).unwrap_err().message.contains("not a colour space"));
}

#[test]
fn written_exr_holds_camera_depth_opacity_and_kind_of_map() {
    let image = radiance(4, 3);
    let camera = Camera {
        camera_from_world: Camera::pose_from_opengl(glam::DMat3::IDENTITY, glam::DVec3::new(1.0, 2.0, 3.0)),
        focal_px: glam::DVec2::new(5.0, 6.0),
        center_px: glam::DVec2::new(2.0, 1.5),
        size_px: [4, 3],
        distortion: Distortion::default(),
    };
    let ramp: Vec<f32> = (0..12).map(|i| i as f32 / 11.0).collect();
    let options = ExrOptions {
        numbers: vec![("luxel:radiance_scale".into(), 0.5)],
        camera: Some(camera),
        environment: Some(Projection::LatitudeLongitude),
        alpha: Some(ramp.clone()),
        depth: Some(ramp.iter().map(|v| 1e5 * v).collect()),
        ..ExrOptions::default()
    };
    let bytes = encode_exr(Path::new("a.exr"), &image, &options).unwrap();
    // The library's order of attributes is one by chance.
    assert!((0..8).all(|_| encode_exr(Path::new("a.exr"), &image, &options).unwrap() == bytes));
    let decoded = decode(&bytes, &UNSAID).unwrap();
    assert!(decoded.alpha.unwrap().iter().zip(&ramp).all(|(a, b)| (a - b).abs() < 1e-3));
    let meta = MetaData::read_from_buffered(Cursor::new(&bytes), true).unwrap();
    let header = &meta.headers[0];
    let names: Vec<_> = header.channels.list.iter().map(|c| (c.name.to_string(), c.sample_type)).collect();
    let half = SampleType::F16;
    let expected = [("A", half), ("B", half), ("G", half), ("R", half), ("Z", SampleType::F32)];
    assert_eq!(names, expected.map(|(name, kind)| (name.to_string(), kind)));
    let own = &header.own_attributes;
    assert_eq!(own.environment_map, Some(attribute::EnvironmentMap::LatitudeLongitude));
    // A row vector times the matrix: the eye comes to the origin.
    let m = own.world_to_camera.unwrap();
    let eye = [1.0, 2.0, 3.0, 1.0];
    let at: Vec<f32> = (0..3).map(|c| (0..4).map(|r| eye[r] * m[4 * r + c]).sum()).collect();
    assert_eq!(at, [0.0; 3]);
    assert_eq!(own.other[&Text::from("luxel:focal_px")], AttributeValue::FloatVec2(Vec2(5.0, 6.0)));
    assert_eq!(own.other[&Text::from("luxel:radiance_scale")], AttributeValue::F32(0.5));
    let short = ExrOptions { alpha: Some(vec![0.0; 3]), ..ExrOptions::default() };
    assert!(encode_exr(Path::new("a.exr"), &image, &short).unwrap_err().message.contains("3 values of opacity"));
}

#[test]
fn written_exr_reads_back_with_its_space_and_attributes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new/a.exr");
    let image = radiance(40, 33);
    for (sample, color_space) in [(ExrSample::Half, ColorSpace::LinearRec709), (ExrSample::Float, ColorSpace::AcesCg)] {
        let attributes = vec![("luxel:scene".to_string(), "desk lamp, 35 mm".to_string())];
        assert_eq!(write_exr(&path, &image, &ExrOptions { sample, color_space, attributes, ..ExrOptions::default() }).unwrap(), 0);
        let decoded = read_image(&path, &UNSAID).unwrap();
        assert_eq!((decoded.image == image, decoded.color_space), (true, Some(color_space)));
        assert_eq!(image_size(&path).unwrap(), [40, 33]);
        let meta = MetaData::read_from_file(&path, true).unwrap();
        let header = &meta.headers[0];
        assert_eq!(header.compression, Compression::ZIP16);
        assert_eq!(
            header.own_attributes.other.get(&Text::from("luxel:scene")),
            Some(&AttributeValue::Text(Text::from("desk lamp, 35 mm")))
        );
    }
}

#[test]
fn half_clamps_and_counts_what_it_cannot_hold() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let image = Radiance { width: 2, height: 1, pixels: vec![[65504.0, 65505.0, f32::INFINITY], [-1e9, f32::NAN, 1.0]] };
    assert_eq!(write_exr(&path, &image, &ExrOptions::default()).unwrap(), 3);
    let found = read_image(&path, &UNSAID).unwrap().image.pixels;
    assert_eq!((found[0], found[1][0], found[1][1].is_nan(), found[1][2]), ([65504.0; 3], -65504.0, true, 1.0));
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
fn radiance_hdr_is_read_and_its_exposure_divided_out() {
    let mut body = Vec::new();
    let pixels: Vec<_> = (0..20 * 6).map(|i| image::Rgb([i as f32, 0.5, 1000.0])).collect();
    image::codecs::hdr::HdrEncoder::new(&mut body).encode(&pixels, 20, 6).unwrap();
    let decoded = decode(&body, &UNSAID).unwrap();
    let expected = Radiance { width: 20, height: 6, pixels: pixels.iter().map(|p| p.0).collect() };
    // 8 bits of mantissa shared by the largest channel: half a step of 1024 / 256.
    for (f, e) in decoded.image.pixels.iter().zip(&expected.pixels) {
        assert!((0..3).all(|c| (f[c] - e[c]).abs() <= 4.0), "{f:?} expected {e:?}");
    }
    assert_eq!((decoded.depth, decoded.color_space), (SampleDepth::Float, None));

    // Flat pixels; (128, 64, 0) * 2^(129 - 136) = (1, 0.5, 0).
    let file = |header: &str| [header.as_bytes(), b"\n-Y 1 +X 2\n\x80\x40\x00\x81\x80\x40\x00\x81"].concat();
    for (header, expected) in [
        ("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n", [1.0, 0.5, 0.0]),
        ("#?RGBE\nFORMAT=32-bit_rle_rgbe\n", [1.0, 0.5, 0.0]),
        ("#?RADIANCE\nEXPOSURE=4\nFORMAT=32-bit_rle_rgbe\nEXPOSURE= 0.5\n", [0.5, 0.25, 0.0]),
        ("#?RADIANCE\nCOLORCORR=2 4 1\nEXPOSURE=0.5\n", [1.0, 0.25, 0.0]),
        ("#?RADIANCE\nPRIMARIES= .64 .33 .30 .60 .15 .06 .3127 .3290\n", [1.0, 0.5, 0.0]),
    ] {
        assert_eq!(decode(&file(header), &UNSAID).unwrap().image.pixels, [expected; 2], "{header}");
    }
    for header in
        ["#?RADIANCE\nEXPOSURE=0\n", "#?RADIANCE\nEXPOSURE=NaN\n", "#?RADIANCE\nPRIMARIES=1 2\n", "#?RADIANCE\nFORMAT=32-bit_rle_xyze\n"]
    {
        assert!(decode(&file(header), &UNSAID).is_err(), "{header}");
    }
    let turned = b"#?RADIANCE\n\n+X 2 -Y 1\n\x80\x40\x00\x81\x80\x40\x00\x81";
    assert_eq!(decode(turned, &UNSAID).unwrap_err().kind, IoErrorKind::Unsupported);
}

fn tiff_bytes<C: tiff::encoder::colortype::ColorType>(
    size: (u32, u32),
    data: &[C::Inner],
    compression: tiff::encoder::Compression,
) -> Vec<u8>
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    let mut out = Cursor::new(Vec::new());
    tiff::encoder::TiffEncoder::new(&mut out).unwrap().with_compression(compression).write_image::<C>(size.0, size.1, data).unwrap();
    out.into_inner()
}

#[test]
fn tiff_of_every_sample_and_compression_is_read() {
    use tiff::encoder::{Compression, colortype as kind};
    let compressions = [Compression::Uncompressed, Compression::Lzw, Compression::Deflate(Default::default()), Compression::Packbits];
    for compression in compressions {
        let float = [0.0f32, 1e-6, 1e6, f32::NAN, -3.0, f32::INFINITY];
        let decoded = decode(&tiff_bytes::<kind::RGB32Float>((2, 1), &float, compression), &UNSAID).unwrap();
        let found: Vec<u32> = decoded.image.pixels.iter().flatten().map(|v| v.to_bits()).collect();
        assert_eq!((found, decoded.depth), (float.map(f32::to_bits).to_vec(), SampleDepth::Float));

        let decoded = decode(&tiff_bytes::<kind::Gray64Float>((2, 1), &[0.5, 1e9], compression), &UNSAID).unwrap();
        assert_eq!(decoded.image.pixels, [[0.5; 3], [1e9; 3]]);
        let decoded = decode(&tiff_bytes::<kind::RGBA32Float>((1, 1), &[1.0, 2.0, 3.0, 0.5], compression), &UNSAID).unwrap();
        assert_eq!((decoded.image.pixels, decoded.alpha), (vec![[1.0, 2.0, 3.0]], Some(vec![0.5])));

        let bytes = tiff_bytes::<kind::RGB16>((2, 1), &[0, 65535, 32768, 1, 2, 3], compression);
        let decoded = decode(&bytes, &LINEAR).unwrap();
        assert_eq!(decoded.image.pixels[0], [0.0, 1.0, (32768.0f64 / 65535.0) as f32]);
        assert_eq!((decoded.depth, decoded.warnings.len()), (SampleDepth::Integer16, 0));
        assert!((decode(&bytes, &SRGB).unwrap().image.pixels[0][2] - 0.214_05).abs() < 1e-4);
        let error = decode(&bytes, &UNSAID).unwrap_err();
        assert!(error.message.contains("16-bit"), "{error}");
        assert_eq!(error.remedy, Some(Remedy::set("transfer", "linear").or(Remedy::set("transfer", "srgb"))));

        let bytes = tiff_bytes::<kind::Gray8>((2, 1), &[0, 255], compression);
        let decoded = decode(&bytes, &LINEAR).unwrap();
        assert_eq!((decoded.image.pixels, decoded.depth), (vec![[0.0; 3], [1.0; 3]], SampleDepth::Integer8));
        assert_eq!(decoded.warnings, ["8 bits: not HDR"]);
        assert!(decode(&bytes, &UNSAID).unwrap_err().message.contains("8-bit"));
    }
    let error = decode(&tiff_bytes::<kind::CMYK8>((1, 1), &[0; 4], Compression::Uncompressed), &LINEAR).unwrap_err();
    assert_eq!(error.kind, IoErrorKind::Unsupported);
}

#[test]
fn tiff_of_half_floats_is_read() {
    // The encoder has none: a hand-made little-endian file of one strip, 2 x 1 grey.
    let entry =
        |tag: u16, kind: u16, value: u32| [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &1u32.to_le_bytes(), &value.to_le_bytes()].concat();
    let (short, long) = (3, 4);
    let entries = [
        (256, long, 2),
        (257, long, 1),
        (258, short, 16),
        (259, short, 1),
        (262, short, 1),
        (273, long, 8),
        (277, short, 1),
        (278, long, 1),
        (279, long, 4),
        (339, short, 3),
    ];
    let mut bytes = b"II*\0\x0c\0\0\0".to_vec();
    bytes.extend([f16::from_f32(0.5), f16::from_f32(1000.0)].iter().flat_map(|v| v.to_le_bytes()));
    bytes.extend((entries.len() as u16).to_le_bytes());
    bytes.extend(entries.iter().flat_map(|&(tag, kind, value)| entry(tag, kind, value)));
    bytes.extend([0; 4]);
    assert_eq!(decode(&bytes, &UNSAID).unwrap().image.pixels, [[0.5; 3], [1000.0; 3]]);
}

#[test]
fn camera_raw_and_thumbnails_in_tiff_are_refused() {
    use tiff::encoder::{TiffEncoder, colortype::RGB8};
    use tiff::tags::Tag;
    for (tag, value) in [(Tag::Unknown(50706), 0x0104u32), (Tag::NewSubfileType, 1)] {
        let mut out = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut out).unwrap();
        let mut image = encoder.new_image::<RGB8>(1, 1).unwrap();
        image.encoder().write_tag(tag, value).unwrap();
        image.write_data(&[1, 2, 3]).unwrap();
        let error = decode(&out.into_inner(), &LINEAR).unwrap_err();
        assert!(error.message.contains("camera RAW"), "{error}");
    }
}

#[test]
fn primaries_of_tiff_are_settled() {
    use tiff::encoder::{Rational, TiffEncoder, colortype::RGB32Float};
    use tiff::tags::Tag;
    let bytes = |primaries: [u32; 6], white: [u32; 2]| {
        let mut out = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut out).unwrap();
        let mut image = encoder.new_image::<RGB32Float>(1, 1).unwrap();
        for (tag, values) in [(318, white.as_slice()), (319, &primaries)] {
            let values: Vec<Rational> = values.iter().map(|&n| Rational { n, d: 10_000 }).collect();
            image.encoder().write_tag(Tag::Unknown(tag), values.as_slice()).unwrap();
        }
        image.write_data(&[2.0, 2.0, 2.0]).unwrap();
        out.into_inner()
    };
    let decoded = |bytes: &[u8]| decode(bytes, &UNSAID).unwrap();
    let rec2020 = decoded(&bytes([7080, 2920, 1700, 7970, 1310, 460], [3127, 3290]));
    assert_eq!((rec2020.color_space, rec2020.image.pixels[0]), (Some(ColorSpace::LinearRec2020), [2.0; 3]));
    // DCI-P3 under its own white: converted, with a warning.
    let converted = decoded(&bytes([6800, 3200, 2650, 6900, 1500, 600], [3140, 3510]));
    assert_eq!((converted.color_space, converted.warnings.len()), (Some(ColorSpace::LinearRec709), 1));
    assert!(converted.image.pixels[0].iter().all(|c| (c - 2.0).abs() < 1e-5));
    // Tags that say nothing do not cost the image.
    let nothing = decoded(&bytes([0; 6], [0; 2]));
    assert_eq!((nothing.color_space, nothing.image.pixels[0]), (None, [2.0; 3]));
    assert!(nothing.warnings[0].contains("not a colour space"), "{:?}", nothing.warnings);
}

fn png_bytes(size: (u32, u32), data: &[u8], color: image::ExtendedColorType) -> Vec<u8> {
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
    assert_eq!(error.remedy, Some(Remedy::set("transfer", "linear").or(Remedy::set("transfer", "srgb"))), "{error}");

    let gamma = |value: u32| with_chunk(&png, b"gAMA", &value.to_be_bytes());
    assert!((middle(&gamma(100_000), &UNSAID) - linear).abs() < 1e-6);
    assert!((middle(&gamma(45_455), &UNSAID) - srgb).abs() < 1e-6);
    assert!((middle(&gamma(50_000), &UNSAID) - linear * linear).abs() < 1e-6);
    assert!((middle(&with_chunk(&png, b"sRGB", &[0]), &UNSAID) - srgb).abs() < 1e-6);
    assert!((middle(&with_chunk(&gamma(45_455), b"cICP", &[1, 8, 0, 1]), &UNSAID) - linear).abs() < 1e-6);
    // The user goes before the file.
    assert!((middle(&gamma(100_000), &SRGB) - srgb).abs() < 1e-6);
    let error = decode(&with_chunk(&png, b"cICP", &[9, 16, 0, 1]), &UNSAID).unwrap_err();
    assert!(error.remedy.is_some_and(|remedy| remedy.to_string().contains("transfer")));
    let decoded = decode(&with_chunk(&png, b"cICP", &[12, 8, 0, 1]), &UNSAID).unwrap();
    assert_eq!(decoded.color_space, Some(ColorSpace::LinearDisplayP3));
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
        tiff_bytes::<tiff::encoder::colortype::Gray32Float>((7, 5), &[0.5; 35], tiff::encoder::Compression::Uncompressed),
    ];
    for (i, bytes) in files.iter().enumerate() {
        let path = folder.path().join(format!("{i}.jpg"));
        std::fs::write(&path, bytes).unwrap();
        let decoded = read_image(&path, &UNSAID).unwrap();
        assert_eq!((decoded.image.width, decoded.image.height), (7, 5), "file {i}");
        assert_eq!(image_size(&path).unwrap(), [7, 5], "file {i}");
    }
}
