//! Tests of the PLY reader and writer.

mod bakes;
mod damaged;
mod plain;

use std::collections::HashMap;
use std::path::Path;

use luxel_core::{
    Activation, Antialias, ColorModel, ColorSpace, Cutoffs, RadianceScale, RasterConfig, SH_OFFSET, Scene, Splats, random, sh, sigmoid,
};
use proptest::prelude::*;

use super::*;
use crate::IoErrorKind;
use crate::bake::{Appearance, BakeOptions, Baked};

fn name() -> &'static Path {
    Path::new("scene.ply")
}

/// Returns a scene of `count` splats with pseudo-random values of ordinary size.
fn scene(color_model: ColorModel, count: usize, is_smoothed: bool, seed: u64) -> Scene {
    let mut counter = 0;
    let mut normal = |deviation: f32| {
        counter += 1;
        random::standard_normal(seed, counter)[0] * deviation
    };
    let mut splats = Splats::empty(color_model);
    for _ in 0..count {
        splats.position.push([0; 3].map(|_| normal(3.0)));
        splats.rotation.push([normal(1.0) + 0.01, normal(1.0), normal(1.0), normal(1.0)]);
        splats.log_scale.push([0; 3].map(|_| normal(1.0) - 3.0));
        splats.opacity_logit.push(normal(3.0));
        for m in 0..color_model.sh_coefficients() {
            splats.sh.extend([0; 3].map(|_| normal(if m == 0 { 0.7 } else { 0.2 }) + if m == 0 { 0.8 } else { 0.0 }));
        }
        splats.raw_luminance.extend((0..color_model.luminance_coefficients()).map(|m| normal(if m == 0 { 3.0 } else { 0.3 })));
        if is_smoothed {
            splats.smoothing.push(normal(0.05).abs());
        }
    }
    let antialias = if is_smoothed { Antialias::Mip } else { Antialias::Off };
    let raster = RasterConfig { cutoffs: Cutoffs::HDR, antialias, ..RasterConfig::default() };
    Scene {
        splats,
        radiance_scale: RadianceScale::new(12.345_679).unwrap(),
        color_space: ColorSpace::AcesCg,
        raster,
        edits: Vec::new(),
        world_from_local: luxel_core::Similarity::IDENTITY,
        metres_per_unit: Some(0.25),
    }
}

const LCD: ColorModel = ColorModel::Lcd { chroma_degree: 3, luminance_degree: 0, activation: Activation::Softplus };

/// Returns the file as a plain reader sees it: property names and rows of f32. Written apart from
/// the reader under test.
fn plain_view(bytes: &[u8]) -> (Vec<String>, Vec<Vec<f32>>) {
    let end = b"end_header\n";
    let at = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let head = std::str::from_utf8(&bytes[..at]).unwrap();
    assert!(head.starts_with("ply\nformat binary_little_endian 1.0\n"));
    let names: Vec<String> = head.lines().filter_map(|l| l.strip_prefix("property float ")).map(str::to_owned).collect();
    let rows = bytes[at..].chunks(4 * names.len()).map(|row| row.chunks(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect());
    (names, rows.collect())
}

/// Returns a row as name -> value.
fn row_of(bytes: &[u8], row: usize) -> HashMap<String, f32> {
    let (names, rows) = plain_view(bytes);
    names.into_iter().zip(rows[row].iter().copied()).collect()
}

fn bits(scene: &Scene) -> (Vec<u32>, String) {
    let s = &scene.splats;
    let arrays = [
        s.position.as_flattened(),
        s.rotation.as_flattened(),
        s.log_scale.as_flattened(),
        &s.opacity_logit,
        &s.sh,
        &s.raw_luminance,
        &s.smoothing,
        &s.gain,
        &[scene.radiance_scale.get()],
    ];
    (arrays.concat().iter().map(|v| v.to_bits()).collect(), format!("{:?} {:?} {:?}", s.color_model, scene.color_space, scene.raster))
}

/// Returns a plain 3D Gaussian splatting file of degree 1 in an unusual order, with values that f32
/// holds exactly.
fn plain_file(format: &str) -> Vec<u8> {
    let mut properties: Vec<(String, String)> = vec![("uchar".into(), "flag".into()), ("double".into(), "rot_3".into())];
    let names = ["opacity", "scale_2", "scale_1", "scale_0", "f_dc_2", "f_dc_1", "f_dc_0", "rot_0", "rot_1", "rot_2", "z", "y", "x"];
    properties.extend(names.map(|n| ("float".into(), n.into())));
    properties.extend((0..9).rev().map(|i| ("float".into(), format!("f_rest_{i}"))));
    let mut head = format!("ply\r\nformat {format} 1.0\r\ncomment made elsewhere\r\nelement camera 2\r\nproperty list uchar short ids\r\n");
    head += "element vertex 2\r\n";
    for (kind, property) in &properties {
        head += &format!("property {kind} {property}\r\n");
    }
    let mut file = (head + "end_header\r\n").into_bytes();
    let is_big = format == "binary_big_endian";
    let mut put = |little: &[u8]| match is_big {
        true => file.extend(little.iter().rev()),
        false => file.extend(little),
    };
    if format == "ascii" {
        file.extend(b"2 7 -8\r\n0\r\n");
        for row in 0..2 {
            let words: Vec<String> = (0..properties.len()).map(|i| format!("{}", row * 100 + i)).collect();
            file.extend(words.join(" ").bytes().chain(*b"\r\n"));
        }
        return file;
    }
    put(&[2]);
    put(&7i16.to_le_bytes());
    put(&(-8i16).to_le_bytes());
    put(&[0]);
    for row in 0..2u8 {
        put(&[row * 100]);
        put(&f64::from(row * 100 + 1).to_le_bytes());
        for i in 2..properties.len() {
            put(&(f32::from(row * 100) + i as f32).to_le_bytes());
        }
    }
    file
}

fn error_of(bytes: &[u8]) -> String {
    decode_scene_ply(name(), bytes).unwrap_err().to_string()
}

fn any_model() -> impl Strategy<Value = ColorModel> {
    let activation = prop_oneof![Just(Activation::Softplus), Just(Activation::Exp), Just(Activation::Relu)];
    prop_oneof![
        (0u8..=5).prop_map(|degree| ColorModel::Sh { degree }),
        (0u8..=5, 0u8..=3, activation).prop_map(|(chroma_degree, luminance_degree, activation)| ColorModel::Lcd {
            chroma_degree,
            luminance_degree,
            activation
        })
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_model_is_read_back_bit_for_bit(model in any_model(), count in 0usize..20, is_smoothed: bool, is_edited: bool, seed: u64, scale in 1e-6f32..1e6) {
        let mut scene = scene(model, count, is_smoothed, seed);
        scene.radiance_scale = RadianceScale::new(scale).unwrap();
        if seed.is_multiple_of(2) {
            scene.raster.cutoffs = Cutoffs::PARITY;
            scene.color_space = ColorSpace::LinearRec709;
        }
        if is_edited {
            scene.splats.gain = (0..count).map(|i| [0.0, 1.0, 0.3, 1e6][i % 4]).collect();
        }
        let bytes = encode_scene_ply(name(), &scene).unwrap();
        let read = decode_scene_ply(name(), &bytes).unwrap();
        prop_assert_eq!(bits(&read), bits(&scene));
    }

    #[test]
    fn any_bytes_give_a_scene_or_an_error(bytes: Vec<u8>, at in 0usize..4000, value: u8) {
        let _ = decode_scene_ply(name(), &bytes);
        let _ = decode_points_ply(name(), &bytes);
        let mut file = encode_scene_ply(name(), &scene(LCD, 3, true, 1)).unwrap();
        let at = at % file.len();
        file[at] = value;
        if let Ok(scene) = decode_scene_ply(name(), &file) {
            prop_assert_eq!(scene.splats.validate(), Ok(()));
        }
    }
}

#[test]
fn blocks_of_rows_join_without_a_seam() {
    let scene = scene(ColorModel::Sh { degree: 0 }, 9001, false, 3);
    let read = decode_scene_ply(name(), &encode_scene_ply(name(), &scene).unwrap()).unwrap();
    assert_eq!(read, scene);
}

#[test]
fn standard_properties_come_first_in_the_order_of_3dgs() {
    for (model, rest) in
        [(LCD, 45), (ColorModel::Sh { degree: 5 }, 45), (ColorModel::Sh { degree: 1 }, 9), (ColorModel::Sh { degree: 0 }, 0)]
    {
        let (names, _) = plain_view(&encode_scene_ply(name(), &scene(model, 2, true, 5)).unwrap());
        let mut expected: Vec<String> = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].map(str::to_owned).into();
        expected.extend((0..rest).map(|i| format!("f_rest_{i}")));
        expected.extend(["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"].map(str::to_owned));
        assert_eq!(names[..expected.len()], expected);
        // The original reader counts by prefix.
        let starting = |prefix: &str| names.iter().filter(|n| n.starts_with(prefix)).count();
        assert_eq!([starting("f_rest_"), starting("scale_"), starting("rot")], [rest, 3, 4]);
        assert!(names[expected.len()..].iter().all(|n| n.starts_with("lcd_")));
    }
}

#[test]
fn edits_are_kept_in_order_and_the_header_is_ascii() {
    let edits = ["where L < 0.05; gain 4", r#"where mask("C:\masks\a  gemälde.png", "000"); power 0.8; pivot 0.18"#].map(str::to_owned);
    let edited = Scene { edits: edits.to_vec(), ..scene(LCD, 2, false, 1) };
    let bytes = encode_scene_ply(name(), &edited).unwrap();
    assert_eq!(decode_scene_ply(name(), &bytes).unwrap(), edited);
    let end = bytes.windows(10).position(|w| w == b"end_header").unwrap();
    assert!(bytes[..end].is_ascii());
    let unwritable = Scene { edits: vec!["gain 2\nproperty float x".to_owned()], ..edited };
    let error = encode_scene_ply(name(), &unwritable).unwrap_err();
    assert!(error.to_string().contains("expected one line of text"), "{error}");

    let damaged = bytes[..end].iter().map(|b| if *b == b'<' { b'\\' } else { *b }).chain(bytes[end..].iter().copied());
    let error = decode_scene_ply(name(), &damaged.collect::<Vec<_>>()).unwrap_err().to_string();
    assert!(error.contains("\"luxel edit\"") && error.contains("not escaped as it was written"), "{error}");
}
