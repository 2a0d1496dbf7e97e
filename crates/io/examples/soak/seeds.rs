//! Small valid files of every format.

use std::io::Cursor;
use std::path::Path;

use exr::prelude::{
    Blocks, Compression, Encoding, Image as Exr, Layer, LayerAttributes, LineOrder, SpecificChannels, Vec2, WritableImage, f16,
};
use luxel_core::engine::DensifyStats;
use luxel_core::{Activation, ColorModel, ColorSpace, Image, Moments, RadianceScale, RasterConfig, Scene, Snapshot, Splats, synthetic};
use luxel_io::{
    Appearance, BakeOptions, Baked, SpzVersion, encode_baked_ply, encode_checkpoint, encode_glb, encode_jpeg, encode_png, encode_scene_ply,
    encode_sog, encode_spz, encode_usda, encode_usdc,
};

use crate::readers::SEPARATOR;

pub(crate) const WIDTH: usize = 20;
pub(crate) const HEIGHT: usize = 36;

fn name() -> &'static Path {
    Path::new("seed")
}

fn bytes(count: usize) -> Vec<u8> {
    (0..count).map(|i| ((i * 2_654_435_761) >> 9) as u8).collect()
}

fn picture() -> Image {
    let values = bytes(3 * WIDTH * HEIGHT);
    let pixels = values.as_chunks::<3>().0.iter().map(|rgb| rgb.map(|v| f32::from(v) * 0.03)).collect();
    Image { width: WIDTH, height: HEIGHT, pixels }
}

pub(crate) fn exr() -> Vec<Vec<u8>> {
    let picture = picture();
    let file = |compression, blocks| {
        let pixel = |at: Vec2<usize>| {
            let [r, g, b] = picture.at(at.0, at.1).map(f16::from_f32);
            (r, g, b)
        };
        let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
        let layer = Layer::new((WIDTH, HEIGHT), LayerAttributes::named("a"), encoding, SpecificChannels::rgb(pixel));
        let mut out = Cursor::new(Vec::new());
        Exr::from_layer(layer).write().non_parallel().to_buffered(&mut out).expect("a picture can be written");
        out.into_inner()
    };
    let methods = [
        Compression::Uncompressed,
        Compression::RLE,
        Compression::ZIP1,
        Compression::ZIP16,
        Compression::PIZ,
        Compression::PXR24,
        Compression::B44,
        Compression::DWAA(None),
        Compression::DWAB(None),
    ];
    let lines = methods.map(|compression| file(compression, Blocks::ScanLines));
    let tiles = [Compression::ZIP16, Compression::DWAA(None)].map(|compression| file(compression, Blocks::Tiles(Vec2(16, 16))));
    [&lines[..], &tiles[..]].concat()
}

pub(crate) fn hdr() -> Vec<Vec<u8>> {
    let rgb: Vec<_> = picture().pixels.into_iter().map(image::Rgb).collect();
    let mut out = Vec::new();
    image::codecs::hdr::HdrEncoder::new(&mut out).encode(&rgb, WIDTH, HEIGHT).expect("a picture can be written");
    vec![out]
}

pub(crate) fn tiff() -> Vec<Vec<u8>> {
    use tiff::encoder::{Compression, DeflateLevel, TiffEncoder, colortype};
    let (width, height) = (WIDTH as u32, HEIGHT as u32);
    let picture = picture();
    let file = |compression, is_integer: bool| {
        let mut out = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut out).expect("an encoder").with_compression(compression);
        let written = if is_integer {
            encoder.write_image::<colortype::RGB8>(width, height, &bytes(3 * WIDTH * HEIGHT))
        } else {
            encoder.write_image::<colortype::RGB32Float>(width, height, picture.pixels.as_flattened())
        };
        written.expect("a picture can be written");
        out.into_inner()
    };
    let methods = [Compression::Uncompressed, Compression::Lzw, Compression::Deflate(DeflateLevel::Fast), Compression::Packbits];
    methods.into_iter().flat_map(|method| [file(method, false), file(method, true)]).collect()
}

pub(crate) fn png() -> Vec<Vec<u8>> {
    vec![encode_png(WIDTH, HEIGHT, &bytes(3 * WIDTH * HEIGHT)).expect("a picture can be written")]
}

/// Returns a PNG of 16-bit grey: distances in whole units.
pub(crate) fn grey16() -> Vec<u8> {
    use image::ImageEncoder;
    let mut file = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut file);
    let (width, height) = (WIDTH as u32, HEIGHT as u32);
    encoder.write_image(&bytes(2 * WIDTH * HEIGHT), width, height, image::ExtendedColorType::L16).expect("a picture can be written");
    file
}

pub(crate) fn jpeg() -> Vec<Vec<u8>> {
    let picture = encode_jpeg(WIDTH, HEIGHT, &bytes(3 * WIDTH * HEIGHT), 85).expect("a picture can be written");
    // With a gain map behind it.
    let xmp = "<x:xmpmeta xmlns:x=\"adobe:ns:meta/\" xmlns:hdrgm=\"http://ns.adobe.com/hdr-gain-map/1.0/\" hdrgm:Version=\"1.0\" hdrgm:GainMapMax=\"2\"/>";
    let content = [&b"http://ns.adobe.com/xap/1.0/\0"[..], xmp.as_bytes()].concat();
    let segment = [&[0xff, 0xe1], &(content.len() as u16 + 2).to_be_bytes()[..], &content].concat();
    let map = [&picture[..2], &segment, &picture[2..]].concat();
    vec![picture.clone(), [picture, map].concat()]
}

pub(crate) fn array(header: &str, samples: &[u8]) -> Vec<u8> {
    let header = format!("{header:<117}\n");
    [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes(), samples].concat()
}

pub(crate) fn npy() -> Vec<Vec<u8>> {
    let samples: Vec<u8> = picture().pixels.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
    vec![array(&format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({HEIGHT}, {WIDTH}, 3), }}"), &samples)]
}

/// Returns DNGs of one strip without compression, a mosaic and linear colour.
pub(crate) fn dng() -> Vec<Vec<u8>> {
    let shorts = |values: &[u16]| (3u16, values.len() as u32, values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>());
    let longs = |values: &[u32]| (4u16, values.len() as u32, values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>());
    let file = |per_pixel: u16| {
        let data = bytes(2 * usize::from(per_pixel) * WIDTH * HEIGHT);
        let mut entries = vec![
            (256u16, longs(&[WIDTH as u32])),
            (257, longs(&[HEIGHT as u32])),
            (258, shorts(&vec![16; per_pixel.into()])),
            (259, shorts(&[1])),
            (262, shorts(&[if per_pixel == 1 { 32803 } else { 34892 }])),
            (271, (2, 6, b"Luxel\0".to_vec())),
            (272, (2, 5, b"Test\0".to_vec())),
            (277, shorts(&[per_pixel])),
            (278, longs(&[HEIGHT as u32])),
            (279, longs(&[data.len() as u32])),
            (50706, (1, 4, vec![1, 4, 0, 0])),
        ];
        if per_pixel == 1 {
            entries.extend([(33421, shorts(&[2, 2])), (33422, (1, 4, vec![0, 1, 1, 2]))]);
        }
        let data_at = 8 + 2 + 12 * (entries.len() as u32 + 1) + 4;
        entries.push((273, longs(&[data_at])));
        entries.sort_by_key(|entry| entry.0);
        let mut out = b"II*\0\x08\0\0\0".to_vec();
        out.extend((entries.len() as u16).to_le_bytes());
        let mut values = Vec::new();
        for (tag, (kind, count, value)) in entries {
            out.extend(tag.to_le_bytes());
            out.extend(kind.to_le_bytes());
            out.extend(count.to_le_bytes());
            let mut inline = value.clone();
            if value.len() > 4 {
                inline = (data_at + (data.len() + values.len()) as u32).to_le_bytes().to_vec();
                values.extend(value);
            }
            inline.resize(4, 0);
            out.extend(inline);
        }
        out.extend([0; 4]);
        [out, data, values].concat()
    };
    vec![file(1), file(3)]
}

fn scene() -> Scene {
    let lcd = ColorModel::Lcd { chroma_degree: 1, luminance_degree: 0, activation: Activation::Softplus };
    Scene {
        splats: synthetic::room(5, 7).with_color_model(lcd).expect("a room of harmonics has every model"),
        radiance_scale: RadianceScale::new(2.0).expect("a scale"),
        color_space: ColorSpace::LinearRec709,
        raster: RasterConfig::default(),
        edits: Vec::new(),
        world_from_local: luxel_core::Similarity::IDENTITY,
        metres_per_unit: None,
    }
}

fn baked(appearance: Appearance) -> Baked {
    Baked::new(&scene(), &BakeOptions { appearance, max_degree: 1 })
}

fn linear() -> Appearance {
    Appearance::Linear { color_space: ColorSpace::LinearRec709, exposure_ev: 0.0 }
}

pub(crate) fn ply() -> Vec<Vec<u8>> {
    let exact = encode_scene_ply(name(), &scene()).expect("a scene can be written");
    let plain = encode_baked_ply(name(), &baked(linear())).expect("a scene can be written");
    vec![exact, plain]
}

pub(crate) fn usd() -> Vec<Vec<u8>> {
    [linear(), Appearance::PREVIEW].map(|look| encode_usda(name(), &baked(look)).expect("a scene can be written")).to_vec()
}

pub(crate) fn usd_binary() -> Vec<Vec<u8>> {
    [linear(), Appearance::PREVIEW].map(|look| encode_usdc(name(), &baked(look)).expect("a scene can be written")).to_vec()
}

pub(crate) fn glb() -> Vec<Vec<u8>> {
    let exact = encode_glb(name(), &baked(Appearance::PREVIEW), Some(&scene())).expect("a scene can be written");
    let plain = encode_glb(name(), &baked(linear()), None).expect("a scene can be written");
    vec![exact, plain]
}

pub(crate) fn sog() -> Vec<Vec<u8>> {
    vec![encode_sog(name(), &baked(Appearance::PREVIEW)).expect("a scene can be written")]
}

pub(crate) fn spz() -> Vec<Vec<u8>> {
    let baked = baked(Appearance::PREVIEW);
    [SpzVersion::V2, SpzVersion::V3, SpzVersion::V4]
        .map(|version| encode_spz(name(), &baked, version).expect("a scene can be written"))
        .to_vec()
}

pub(crate) fn checkpoint() -> Vec<Vec<u8>> {
    let scene = scene();
    let moments = |splats: &Splats| Moments::zeros(splats.color_model, splats.len());
    let snapshot = Snapshot {
        moments: moments(&scene.splats),
        stats: DensifyStats::zeros(scene.splats.len()),
        average: Some(scene.splats.clone()),
        state_json: "{\"step\":7}".into(),
        scene,
    };
    vec![encode_checkpoint(name(), &snapshot).expect("a checkpoint can be written")]
}

pub(crate) fn tensors() -> Vec<Vec<u8>> {
    let head = br#"{"net.weight":{"dtype":"F32","shape":[2,2],"data_offsets":[0,16]},"net.bias":{"dtype":"F32","shape":[1],"data_offsets":[16,20]}}"#;
    vec![[&(head.len() as u64).to_le_bytes()[..], head, &[0; 20]].concat()]
}

pub(crate) fn colmap_text() -> Vec<Vec<u8>> {
    let cameras = "1 PINHOLE 40 30 50 50 20 15\n2 OPENCV 40 30 50 50 20 15 0.01 0 0 0\n";
    let images = "1 1 0 0 0 0 0 1 1 a.png\n10.5 9 1 3 4 -1\n2 1 0 0 0 0.5 0 1 2 b.png\n\n";
    let points = "1 0.5 0.25 -1 200 100 50 0.4 1 0\n";
    let separator = String::from_utf8_lossy(SEPARATOR);
    vec![[cameras, images, points].join(&separator).into_bytes()]
}

pub(crate) fn colmap_binary() -> Vec<Vec<u8>> {
    let mut cameras = 1u64.to_le_bytes().to_vec();
    cameras.extend(1u32.to_le_bytes());
    cameras.extend(1i32.to_le_bytes());
    cameras.extend([40u64, 30].map(u64::to_le_bytes).concat());
    cameras.extend([50.0f64, 50.0, 20.0, 15.0].map(f64::to_le_bytes).concat());
    let mut images = 1u64.to_le_bytes().to_vec();
    images.extend(1u32.to_le_bytes());
    images.extend([1.0f64, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0].map(f64::to_le_bytes).concat());
    images.extend(1u32.to_le_bytes());
    images.extend(b"a.png\0");
    images.extend(1u64.to_le_bytes());
    images.extend([10.5f64, 9.0].map(f64::to_le_bytes).concat());
    images.extend(1u64.to_le_bytes());
    let mut points = 1u64.to_le_bytes().to_vec();
    points.extend(1u64.to_le_bytes());
    points.extend([0.5f64, 0.25, -1.0].map(f64::to_le_bytes).concat());
    points.extend([200, 100, 50]);
    points.extend(0.4f64.to_le_bytes());
    points.extend(1u64.to_le_bytes());
    points.extend([1u32, 0].map(u32::to_le_bytes).concat());
    vec![[cameras, images, points].join(SEPARATOR)]
}

const POSE: &str = "[[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]";

pub(crate) fn transforms() -> Vec<Vec<u8>> {
    let frame = format!(r#"{{"file_path": "images/a.exr", "transform_matrix": {POSE}}}"#);
    let shared = r#""fl_x": 50, "fl_y": 51, "cx": 20, "cy": 15, "w": 40, "h": 30, "k1": 0.01, "camera_model": "OPENCV""#;
    let one = format!(r#"{{{shared}, "frames": [{frame}]}}"#);
    let angle = format!(r#"{{"camera_angle_x": 0.7, "frames": [{frame}]}}"#);
    vec![one.into_bytes(), angle.into_bytes()]
}

pub(crate) fn camera_path() -> Vec<Vec<u8>> {
    let frames = format!(r#"{{"fl_x": 50, "w": 40, "h": 30, "frames": [{{"file_path": "a.exr", "transform_matrix": {POSE}}}]}}"#);
    let path = r#"{"render_height": 30, "render_width": 40, "camera_path": [{"camera_to_world": [1,0,0,1, 0,1,0,2, 0,0,1,3, 0,0,0,1], "fov": 50}]}"#;
    vec![frames.into_bytes(), path.as_bytes().to_vec()]
}

pub(crate) fn camera() -> Vec<Vec<u8>> {
    vec![
        br#"{"width": 40, "height": 30, "fx": 50.5, "fy": 51, "cx": 20, "cy": 14.5, "near": 0.01,
"world_to_camera": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"#
            .to_vec(),
    ]
}

pub(crate) fn split() -> Vec<Vec<u8>> {
    vec![br#"{"train": ["000", "001"], "test": ["002"]}"#.to_vec()]
}

pub(crate) fn exposures() -> Vec<Vec<u8>> {
    vec![br#"{"train/r_0_0.png": 0.125, "r_0_1.png": 0.5, "r_0_2": 2}"#.to_vec()]
}

pub(crate) fn poses() -> Vec<Vec<u8>> {
    let row = |seconds: f64| [0.0, 1.0, 0.0, 0.5, 8.0, -1.0, 0.0, 0.0, 0.0, 16.0, 0.0, 0.0, 1.0, 4.0, 20.0, 1.0, 9.0, seconds];
    let samples: Vec<u8> = [row(0.125), row(2.0)].concat().into_iter().flat_map(f64::to_le_bytes).collect();
    vec![array("{'descr': '<f8', 'fortran_order': False, 'shape': (2, 18), }", &samples)]
}
