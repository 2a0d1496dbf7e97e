//! OpenEXR: what is read, and what is written.

use exr::prelude::*;

use super::*;

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
        let is_chroma = error.message.contains("luminance and chroma (Y, RY, BY); export it as RGB");
        assert!(is_chroma || error.message.contains("expected R, G, B or Y"), "{error}");
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
        [
            "the pixel aspect ratio is 2.0000: pixels are read as square, as cameras of data sets take them; resize the image if it looks squeezed"
        ]
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
    // Zeros of a program that knew none count as none.
    let unknown = read([[0.0; 2]; 4]).unwrap();
    assert_eq!((unknown.color_space, unknown.image == image), (None, true));
    assert!(unknown.warnings[0].contains("not a colour space"), "{:?}", unknown.warnings);
    // CIE XYZ, whose primaries have y of 0, with white of equal energy.
    let xyz = read([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [1.0 / 3.0, 1.0 / 3.0]]).unwrap();
    assert_eq!(xyz.color_space, Some(ColorSpace::LinearRec709));
    // Bradford from E to D65 after it: the sum of a row is what white has.
    let [r, _, b] = xyz.image.pixels[0];
    assert!(r.is_finite() && b > r, "{:?}", xyz.image.pixels[0]);
}

#[test]
fn the_name_of_a_space_goes_before_its_chromaticities() {
    let image = Radiance::filled(2, 2, [0.5, 0.25, 2.0]);
    let read = |id: &str, chromaticities: Option<[[f32; 2]; 4]>| {
        let mut file = exr_image((2, 2), planes(&image, half), Encoding::UNCOMPRESSED);
        file.attributes.chromaticities = chromaticities.map(|found| {
            let [red, green, blue, white] = found.map(|[x, y]| Vec2(x, y));
            attribute::Chromaticities { red, green, blue, white }
        });
        let value = AttributeValue::Text(Text::from(id));
        file.layer_data.attributes.other.insert(Text::from("colorInteropID"), value);
        decode(&exr_bytes(&file), &UNSAID)
    };
    for (id, space) in [("lin_ap1_scene", ColorSpace::AcesCg), ("lin_rec2020_scene", ColorSpace::LinearRec2020)] {
        let decoded = read(id, None).unwrap();
        assert_eq!((decoded.color_space, decoded.image == image, decoded.warnings.len()), (Some(space), true, 0), "{id}");
    }
    let contradicted = read("lin_ap1_scene", Some(ColorSpace::LinearRec709.chromaticities())).unwrap();
    assert_eq!(contradicted.color_space, Some(ColorSpace::AcesCg));
    assert!(contradicted.warnings[0].contains("contradicts"), "{:?}", contradicted.warnings);
    // Not light: decoded, or refused.
    let display = read("srgb_rec709_display", None).unwrap();
    assert!((display.image.pixels[0][0] - 0.214_041).abs() < 1e-5 && display.warnings[0].contains("decoded"), "{:?}", display.warnings);
    assert!(read("pq_rec2020_display", None).unwrap_err().message.contains("pq_rec2020_display"));
    for (id, part) in [("data", "no colours"), ("studio_log", "no name of a space")] {
        let decoded = read(id, None).unwrap();
        assert_eq!((decoded.color_space, decoded.image == image), (None, true));
        assert!(decoded.warnings[0].contains(part), "{:?}", decoded.warnings);
    }
    // White of XYZ under D65.
    let [x, y] = [0.3127f32, 0.3290];
    let white = Radiance::filled(1, 1, [x / y, 1.0, (1.0 - x - y) / y]);
    let mut file = exr_image((1, 1), planes(&white, FlatSamples::F32), Encoding::UNCOMPRESSED);
    let value = AttributeValue::Text(Text::from("lin_ciexyzd65_scene"));
    file.layer_data.attributes.other.insert(Text::from("colorInteropID"), value);
    let decoded = decode(&exr_bytes(&file), &UNSAID).unwrap();
    assert!(decoded.image.pixels[0].iter().all(|v| (v - 1.0).abs() < 1e-4), "{:?}", decoded.image.pixels[0]);
}

#[test]
fn written_files_name_their_space() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    for (space, id) in [(ColorSpace::AcesCg, "lin_ap1_scene"), (ColorSpace::DisplaySrgb, "srgb_rec709_display")] {
        write_exr(&path, &radiance(4, 3), &ExrOptions { color_space: space, ..ExrOptions::default() }).unwrap();
        assert_eq!(luxel_io::read_exr_attributes(&path).unwrap().texts["colorInteropID"], id);
    }
}

#[test]
fn written_exr_holds_camera_depth_opacity_normals_and_kind_of_map() {
    let image = radiance(4, 3);
    let camera = Camera {
        camera_from_world: Camera::pose_from_opengl(glam::DMat3::IDENTITY, glam::DVec3::new(1.0, 2.0, 3.0)),
        focal_px: glam::DVec2::new(5.0, 6.0),
        center_px: glam::DVec2::new(2.0, 1.5),
        size_px: [4, 3],
        distortion: Distortion::default(),
        projection: luxel_core::CameraProjection::Pinhole,
    };
    let ramp: Vec<f32> = (0..12).map(|i| i as f32 / 11.0).collect();
    let options = ExrOptions {
        numbers: vec![("luxel:radiance_scale".into(), 0.5)],
        camera: Some(camera.clone()),
        environment: Some(Projection::LatitudeLongitude),
        alpha: Some(ramp.clone()),
        depth: Some(ramp.iter().map(|v| 1e5 * v).collect()),
        normals: Some(vec![[0.6, 0.0, -0.8]; 12]),
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
    let (half, float) = (SampleType::F16, SampleType::F32);
    let expected = [("A", half), ("B", half), ("G", half), ("N.X", float), ("N.Y", float), ("N.Z", float), ("R", half), ("Z", float)];
    assert_eq!(names, expected.map(|(name, kind)| (name.to_string(), kind)));
    let own = &header.own_attributes;
    assert_eq!(own.environment_map, Some(attribute::EnvironmentMap::LatitudeLongitude));
    // A row vector times the matrix: the eye comes to the origin.
    let m = own.world_to_camera.unwrap();
    let eye = [1.0, 2.0, 3.0, 1.0];
    let at: Vec<f32> = (0..3).map(|c| (0..4).map(|r| eye[r] * m[4 * r + c]).sum()).collect();
    assert_eq!(at, [0.0; 3]);
    // Where the camera sees a point, as shares of the image.
    let point = camera.camera_from_world.inverse().transform_point3(glam::DVec3::new(0.3, -0.2, 2.0));
    let (m, row) = (own.world_to_normalized_device.unwrap(), point.extend(1.0).as_vec4().to_array());
    let [x, y, _, w] = [0, 1, 2, 3].map(|c| (0..4).map(|r| row[r] * m[4 * r + c]).sum::<f32>());
    let (at_px, _) = camera.project(point).unwrap();
    assert!((f64::from(x / w) * 4.0 - at_px.x).abs() < 1e-5 && (f64::from(y / w) * 3.0 - at_px.y).abs() < 1e-5, "{x} {y} {w}, {at_px}");
    assert_eq!(own.other[&Text::from("luxel:focal_px")], AttributeValue::FloatVec2(Vec2(5.0, 6.0)));
    assert_eq!(own.other[&Text::from("luxel:radiance_scale")], AttributeValue::F32(0.5));
    let short = ExrOptions { alpha: Some(vec![0.0; 3]), ..ExrOptions::default() };
    assert!(encode_exr(Path::new("a.exr"), &image, &short).unwrap_err().message.contains("3 values of a channel"));
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
fn further_channels_keep_their_numbers_and_the_order_of_names() {
    let image = Radiance::filled(2, 1, [1.0, 2.0, 3.0]);
    let planes = vec![
        ExrPlane { name: "id".to_owned(), values: PlaneValues::Whole(vec![7, u32::MAX]) },
        ExrPlane { name: "forward.u".to_owned(), values: PlaneValues::Float(vec![-0.5, 1e6]) },
    ];
    let bytes = encode_exr(Path::new("a.exr"), &image, &ExrOptions { planes, ..ExrOptions::default() }).unwrap();
    let file = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer().all_attributes();
    let layer = file.from_buffered(Cursor::new(bytes)).unwrap().layer_data;
    let channels = &layer.channel_data.list;
    let names: Vec<String> = channels.iter().map(|channel| channel.name.to_string()).collect();
    assert_eq!(names, ["B", "G", "R", "forward.u", "id"]);
    assert_eq!(channels[4].sample_data, FlatSamples::U32(vec![7, u32::MAX]));
    assert_eq!(channels[3].sample_data, FlatSamples::F32(vec![-0.5, 1e6]));
}
