//! Tests of the PLY reader and writer.

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

/// Returns the display colour of a row towards `direction`, as a viewer computes it but unclamped.
fn display_color(row: &HashMap<String, f32>, direction: [f32; 3]) -> [f32; 3] {
    let rest = row.keys().filter(|k| k.starts_with("f_rest_")).count() / 3;
    let mut y = [0.0; sh::MAX_COEFFICIENTS];
    sh::basis(3, direction, &mut y);
    [0, 1, 2].map(|c| {
        let higher: f32 = (0..rest).map(|m| row[&format!("f_rest_{}", c * rest + m)] * y[m + 1]).sum();
        SH_OFFSET + y[0] * row[&format!("f_dc_{c}")] + higher
    })
}

fn unit(seed: u64, index: u64) -> [f32; 3] {
    let v = random::standard_normal(seed, index);
    let n = v.iter().map(|c| c * c).sum::<f32>().sqrt();
    v.map(|c| c / n)
}

#[test]
fn baked_colours_are_never_negative() {
    for model in [LCD, ColorModel::Sh { degree: 4 }, ColorModel::Lcd { chroma_degree: 2, luminance_degree: 3, activation: Activation::Exp }]
    {
        let bytes = encode_scene_ply(name(), &scene(model, 40, false, 11)).unwrap();
        for splat in 0..40 {
            let row = row_of(&bytes, splat);
            for i in 0..1000 {
                let color = display_color(&row, unit(13, i));
                assert!(color.iter().all(|c| *c > -1e-5), "splat {splat} of {}: {color:?}", model.name());
            }
        }
    }
}

#[test]
fn bake_of_a_constant_grey_scene_is_middle_grey_whatever_its_radiance() {
    for radiance in [1e-4, 0.3, 1e4] {
        let (dc, raw) = LCD.constant([radiance; 3]);
        let mut scene = scene(LCD, 10, false, 2);
        scene.color_space = ColorSpace::LinearRec709;
        for splat in scene.splats.sh.chunks_exact_mut(3 * LCD.sh_coefficients()) {
            splat.fill(0.0);
            splat[..3].copy_from_slice(&dc);
        }
        scene.splats.raw_luminance.fill(raw);
        let row = row_of(&encode_scene_ply(name(), &scene).unwrap(), 4);
        let color = display_color(&row, [0.0, 0.6, 0.8]);
        // AgX has its pivot there: half of the encoded range.
        assert!(color.iter().all(|c| (c - 0.5).abs() < 0.005), "{radiance}: {color:?}");
    }
}

#[test]
fn bake_follows_the_tone_mapped_radiance() {
    // Smooth view dependence (degree 1 in both parts) survives the fit of degree 1 under the curve
    // within a few 8-bit steps.
    let model = ColorModel::Lcd { chroma_degree: 1, luminance_degree: 1, activation: Activation::Softplus };
    let mut scene = scene(model, 30, false, 21);
    scene.color_space = ColorSpace::LinearRec709;
    let k = 3 * model.sh_coefficients();
    for splat in scene.splats.sh.chunks_exact_mut(k) {
        splat[..3].iter_mut().for_each(|v| *v = 1.0 + 0.2 * *v);
        splat[3..].iter_mut().for_each(|v| *v *= 0.2);
    }
    let bytes = encode_scene_ply(name(), &scene).unwrap();
    let mut brightest = [0f32; 2];
    for i in 0..30 {
        let row = row_of(&bytes, i);
        for d in 0..50 {
            let direction = unit(3, d);
            let (radiance, color) = (scene.splats.radiance(i, direction), display_color(&row, direction));
            if radiance[1] > brightest[0] {
                brightest = [radiance[1], color[1]];
            }
            // A channel that is brighter in radiance by far is not darker on the screen.
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                assert!(radiance[a] < 1.5 * radiance[b] || color[a] > color[b] - 0.02, "splat {i}: {radiance:?} shown as {color:?}");
            }
        }
    }
    assert!(brightest[1] > 0.7, "{brightest:?}");
}

#[test]
fn smoothing_is_applied_to_the_standard_scale_and_opacity_only() {
    let mut scene = scene(LCD, 1, true, 7);
    scene.splats.log_scale[0] = [0.1f32.ln(), 0.2f32.ln(), 0.01f32.ln()];
    scene.splats.opacity_logit[0] = 1.5;
    scene.splats.smoothing[0] = 0.05;
    let bytes = encode_scene_ply(name(), &scene).unwrap();
    let row = row_of(&bytes, 0);
    let widened = |s: f32| (s * s + 0.0025).sqrt();
    let expected = [0.1, 0.2, 0.01].map(|s| widened(s).ln());
    for (i, expected) in expected.into_iter().enumerate() {
        assert!((row[&format!("scale_{i}")] - expected).abs() < 1e-5);
    }
    let ratio = 0.1 * 0.2 * 0.01 / (widened(0.1) * widened(0.2) * widened(0.01));
    assert!((sigmoid(row["opacity"]) - sigmoid(1.5) * ratio).abs() < 1e-5);
    assert_eq!(decode_scene_ply(name(), &bytes).unwrap(), scene);
}

#[test]
fn a_bake_of_other_geometry_is_what_is_shown_and_the_model_stays() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    for is_smoothed in [false, true] {
        let scene = scene(LCD, 5, is_smoothed, 8);
        let mut baked = Baked::new(&scene, &BakeOptions { appearance: Appearance::PREVIEW, max_degree: 3 });
        baked.scene.splats.log_scale[2] = [-1.0, -2.0, -3.0];
        baked.scene.splats.opacity_logit[2] = 0.75;
        write_exact_ply(&path, &scene, &baked).unwrap();
        let row = row_of(&std::fs::read(&path).unwrap(), 2);
        assert_eq!(["opacity", "scale_0", "scale_1", "scale_2"].map(|name| row[name]), [0.75, -1.0, -2.0, -3.0]);
        assert_eq!(read_scene_ply(&path).unwrap(), scene);
    }
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

#[test]
fn plain_files_of_all_formats_orders_and_types_are_read_alike() {
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let read = decode_scene_ply(name(), &plain_file(format)).unwrap_or_else(|e| panic!("{format}: {e}"));
        assert_eq!(
            (read.radiance_scale, read.raster),
            (RadianceScale::ONE, RasterConfig { cutoffs: Cutoffs::PARITY, antialias: Antialias::Off, ..RasterConfig::default() })
        );
        let s = &read.splats;
        assert_eq!((s.color_model, s.len()), (ColorModel::Sh { degree: 1 }, 2));
        assert_eq!(s.position, [[14.0, 13.0, 12.0], [114.0, 113.0, 112.0]], "{format}");
        assert_eq!(s.rotation[0], [9.0, 10.0, 11.0, 1.0]);
        assert_eq!((s.log_scale[1], s.opacity_logit[1]), ([105.0, 104.0, 103.0], 102.0));
        // f_rest_i is 23 - i; the file is channel-major: channel c's coefficient m is f_rest_{3 c +
        // m - 1}.
        assert_eq!(s.sh_of(0), [8.0, 7.0, 6.0, 23.0, 20.0, 17.0, 22.0, 19.0, 16.0, 21.0, 18.0, 15.0]);
        assert_eq!(s.validate(), Ok(()));
    }
}

#[test]
fn mip_splatting_filter_is_honoured() {
    let text = String::from_utf8(plain_file("ascii")).unwrap();
    let text = text.replace("property uchar flag", "property float filter_3D");
    let read = decode_scene_ply(name(), text.as_bytes()).unwrap();
    assert_eq!(read.splats.smoothing, [0.0, 100.0]);
    assert_eq!(read.raster.antialias, Antialias::Mip);
}

fn error_of(bytes: &[u8]) -> String {
    decode_scene_ply(name(), bytes).unwrap_err().to_string()
}

#[test]
fn files_cut_anywhere_are_refused() {
    let files = [encode_scene_ply(name(), &scene(LCD, 2, true, 1)).unwrap(), plain_file("binary_big_endian"), plain_file("ascii")];
    for (kind, file) in files.iter().enumerate() {
        // Text may lose the end of its last number unnoticed.
        let whole = if kind == 2 { file.len() - 5 } else { file.len() };
        for length in 0..whole {
            assert!(decode_scene_ply(name(), &file[..length]).is_err(), "file {kind} cut at byte {length}");
        }
    }
    let file = &files[0];
    assert!(error_of(&file[..file.len() - 1]).contains("vertex 1: file ends at byte"), "{}", error_of(&file[..file.len() - 1]));
}

#[test]
fn absurd_counts_are_refused_without_allocating() {
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let text = format!("ply\nformat {format} 1.0\nelement vertex {}\n", 1_000_000);
        let plain =
            ["x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "f_dc_0", "f_dc_1", "f_dc_2"];
        let properties: String = plain.iter().map(|p| format!("property float {p}\n")).collect();
        let file = text.clone() + &properties + "end_header\n0 0 0\n";
        let error = error_of(file.as_bytes());
        assert!(error.contains("expected 1000000 rows"), "{error}");
        assert!(decode_points_ply(name(), file.as_bytes()).is_err());
        // The same claim for an element on the way, with and without lists.
        for way in ["property float a", "property list int double a", ""] {
            let file = format!("ply\nformat {format} 1.0\nelement face {}\n{way}\nelement vertex 1\n{properties}end_header\n", 1_000_000);
            assert!(decode_scene_ply(name(), file.as_bytes()).is_err());
        }
    }
}

#[test]
fn errors_name_vertex_property_and_remedy() {
    let text = String::from_utf8(plain_file("ascii")).unwrap();
    let broken = |from: &str, to: &str| {
        assert!(text.contains(from), "{from:?} is not in the file");
        error_of(text.replace(from, to).as_bytes())
    };
    assert_eq!(broken(" 114 ", " abc "), "scene.ply: vertex 1: property \"x\" is \"abc\", expected a number");
    assert!(broken("f_rest_8", "f_rust_8").contains("8 properties f_rest_*, expected 0, 9, 24"));
    assert!(broken("float opacity", "float opacities").contains("no property \"opacity\""));
    assert!(broken("ply\r\n", "plx\r\n").contains("not a PLY file"));
    assert!(broken("ascii 1.0", "ascii 2.0").contains("line 2: format \"ascii 2.0\", expected"));
    assert!(broken("float opacity", "half opacity").contains("unknown type \"half\""));
    assert!(broken("element vertex", "element vortex").contains("no element \"vertex\""));
    assert!(broken("float opacity", "list uchar float opacity").contains("property \"opacity\" is a list"));
}

#[test]
fn rows_with_a_number_that_is_not_finite_are_left_out_and_counted() {
    let text = String::from_utf8(plain_file("ascii")).unwrap();
    let whole = decode_scene_ply(name(), text.as_bytes()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    for (from, to) in [(" 102 ", " nan "), (" 114 ", " 1e99 ")] {
        assert!(text.contains(from));
        std::fs::write(&path, text.replace(from, to)).unwrap();
        let file = crate::read_scene_file(&path).unwrap();
        let kept = (0..whole.splats.len() as u32).filter(|i| *i != 1);
        assert_eq!(file.scene.splats, whole.splats.select(kept));
        assert_eq!(file.warnings, [format!("left out, with a number that is NaN or infinite: 1 of {} splats", whole.splats.len())]);
    }
}

#[test]
fn rows_without_a_rotation_are_left_out_and_most_of_a_file_is_said() {
    let text = String::from_utf8(plain_file("ascii")).unwrap();
    let whole = decode_scene_ply(name(), text.as_bytes()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    let read = |text: &str| {
        std::fs::write(&path, text).unwrap();
        crate::read_scene_file(&path)
    };
    let damaged = text.replace(" 109 110 111 ", " 0 0 0 ").replace("100 101 ", "100 0 ");
    let file = read(&damaged).unwrap();
    assert_eq!(file.scene.splats, whole.splats.select((0..whole.splats.len() as u32).filter(|i| *i != 1)));
    assert!(file.warnings[0].contains("no quaternion") && file.warnings[0].ends_with(&format!("1 of {} splats", whole.splats.len())));
    // Rows of zeros behind, as an allocation that was not filled leaves them.
    let (count, columns) = (whole.splats.len(), text.lines().filter(|line| line.starts_with("property")).count());
    let zeros = format!("{}\n", vec!["0"; columns].join(" ")).repeat(9);
    let padded = text.replace(&format!("element vertex {count}"), &format!("element vertex {}", count + 9)) + &zeros;
    let file = read(&padded).unwrap();
    assert_eq!(file.scene.splats, whole.splats);
    assert!(file.warnings[0].contains("padded?"), "{:?}", file.warnings);
}

#[test]
fn colours_of_points_and_comments_of_anti_aliasing_are_read() {
    let geometry = "x y z opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let file = |comment: &str, kind: &str, row: &str| {
        let floats: String = geometry.split(' ').map(|n| format!("property float {n}\n")).collect();
        let colors: String = ["red", "green", "blue"].map(|n| format!("property {kind} {n}\n")).concat();
        let head = format!("ply\nformat ascii 1.0\n{comment}element vertex 1\n{floats}{colors}end_header\n");
        decode_scene_ply(name(), format!("{head}0 0 0 0 0 0 0 1 0 0 0 {row}\n").as_bytes()).unwrap()
    };
    for (kind, row) in [("uchar", "255 0 51"), ("float", "1 0 0.2")] {
        let scene = file("", kind, row);
        let color = scene.splats.radiance(0, [0.0, 0.0, 1.0]);
        assert!(color.iter().zip([1.0, 0.0, 0.2]).all(|(a, b)| (a - b).abs() < 1e-5), "{color:?}");
        assert_eq!((scene.color_space, scene.raster.antialias), (ColorSpace::DisplaySrgb, Antialias::Off));
    }
    for comment in ["comment SplatRenderMode: mip\n", "comment antialiased 1\n"] {
        assert_eq!(file(comment, "uchar", "1 2 3").raster.antialias, Antialias::Mip, "{comment}");
    }
    assert_eq!(file("comment antialiased 0\n", "uchar", "1 2 3").raster.antialias, Antialias::Off);
}

#[test]
fn bytes_behind_the_last_row_are_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    for format in ["ascii", "binary_little_endian"] {
        let mut file = plain_file(format);
        let rows = decode_scene_ply(name(), &file).unwrap().splats.len();
        file.extend_from_slice(b"\n");
        std::fs::write(&path, &file).unwrap();
        assert_eq!(crate::read_scene_file(&path).unwrap().warnings, [""; 0]);
        file.resize(file.len() + 99, b'1');
        std::fs::write(&path, &file).unwrap();
        let warnings = crate::read_scene_file(&path).unwrap().warnings;
        let expected = format!("left out, behind the {rows} rows of \"vertex\" that the header counts: 100 bytes; is that number right?");
        assert_eq!(warnings, [expected]);
    }
}

#[test]
fn flat_splats_of_2dgs_are_read_as_thin_ones() {
    let text = String::from_utf8(plain_file("ascii")).unwrap();
    // The property of that place is another program's.
    let flat = text.replace("scale_2", "area");
    assert_ne!(flat, text);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    std::fs::write(&path, &flat).unwrap();
    let file = crate::read_scene_file(&path).unwrap();
    for [a, b, c] in &file.scene.splats.log_scale {
        assert!((c - (a.min(*b) - 1000f32.ln())).abs() < 1e-3, "{a} {b} {c}");
    }
    assert!(file.warnings[0].contains("flat splats of 2DGS"), "{:?}", file.warnings);
    assert!(error_of(text.replace("scale_1", "area").as_bytes()).contains("no property \"scale_1\""));
}

#[test]
fn a_byte_order_mark_is_left_out() {
    let text = String::from_utf8(plain_file("ascii")).unwrap();
    let marked = format!("\u{feff}{text}");
    assert_eq!(decode_scene_ply(name(), marked.as_bytes()).unwrap(), decode_scene_ply(name(), text.as_bytes()).unwrap());
}

#[test]
fn damaged_comments_are_refused_rather_than_the_bake_taken_for_radiance() {
    let file = encode_scene_ply(name(), &scene(LCD, 0, false, 1)).unwrap();
    let text = String::from_utf8(file).unwrap();
    let broken = |from: &str, to: &str| {
        assert!(text.contains(from), "{from:?} is not in the file");
        decode_scene_ply(name(), text.replace(from, to).as_bytes()).unwrap_err()
    };
    assert!(broken("comment luxel", "comment luxury").to_string().contains("a tool dropped them"));
    assert_eq!(broken("luxel scene 1", "luxel scene 3").kind, IoErrorKind::Unsupported);
    for (from, to) in [
        ("luxel scene 1", "luxel scene one"),
        ("acescg", "srgb"),
        ("\"chroma_degree\":3", "\"chroma_degree\":9"),
        ("luxel color_model", "luxel colour_model"),
        ("radiance_scale 1", "radiance_scale -1"),
        ("\"antialias\":\"off\"", "\"antialias\":\"on\""),
        ("\"near\":0.01", "\"near\":-3"),
        ("property float lcd_c_7\n", ""),
    ] {
        assert_eq!(broken(from, to).kind, IoErrorKind::Invalid, "{from} -> {to}");
    }
}

#[test]
fn gains_of_edits_are_beside_the_model_and_in_the_light_of_the_display_layer() {
    let plain = scene(ColorModel::Sh { degree: 2 }, 5, false, 7);
    let mut edited = plain.clone();
    edited.splats.gain = vec![1.0, 4.0, 0.25, 0.0, 1.0];
    let version = |scene: &Scene| {
        let bytes = encode_scene_ply(name(), scene).unwrap();
        let text = String::from_utf8_lossy(&bytes).into_owned();
        (bytes, text.lines().find_map(|line| line.strip_prefix("comment luxel scene ")).unwrap().to_owned())
    };
    let ((bytes, new), (before, old)) = (version(&edited), version(&plain));
    assert_eq!((new.as_str(), old.as_str()), ("2", "1"));
    for row in 0..5 {
        let (after, before) = (row_of(&bytes, row), row_of(&before, row));
        assert!(!before.contains_key("lcd_gain"));
        assert_eq!(after["lcd_gain"], edited.splats.gain[row]);
        assert_eq!((after["lcd_s_0"], after["opacity"]), (before["lcd_s_0"], before["opacity"]));
    }
    // Black in the display layer.
    let black = row_of(&bytes, 3);
    assert!((SH_OFFSET + sh::C0 * black["f_dc_0"]).abs() < 1e-3, "{}", black["f_dc_0"]);
    let mut damaged = bytes.clone();
    let (names, _) = plain_view(&bytes);
    let end = damaged.len();
    let at = end - 4 * (names.len() - names.iter().position(|name| name == "lcd_gain").unwrap());
    damaged[at..at + 4].copy_from_slice(&(-2.0f32).to_le_bytes());
    let error = decode_scene_ply(name(), &damaged).unwrap_err().to_string();
    assert!(error.contains("vertex 4: property \"lcd_gain\" is -2, expected a gain of 0 or more"), "{error}");
}

#[test]
fn scenes_that_could_not_be_read_back_are_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("point_cloud/iteration_7/point_cloud.ply");
    let good = scene(LCD, 3, false, 1);
    write_scene_ply(&path, &good).unwrap();
    let broken: [fn(&mut Scene); 7] = [
        |s| s.splats.rotation[1] = [0.0; 4],
        |s| s.splats.sh[5] = f32::NAN,
        |s| s.splats.opacity_logit.truncate(2),
        |s| s.splats.smoothing = vec![-1.0; 3],
        |s| s.splats.gain = vec![1.0, -1.0, 1.0],
        |s| s.splats.gain = vec![2.0; 2],
        |s| s.raster.cutoffs.near = f32::NAN,
    ];
    for break_it in broken {
        let mut scene = good.clone();
        break_it(&mut scene);
        assert!(write_scene_ply(&path, &scene).is_err());
    }
    assert_eq!(read_scene_ply(&path).unwrap(), good);
    assert_eq!(read_scene_ply(folder.path()).unwrap_err().kind, IoErrorKind::Invalid);
    assert_eq!(read_scene_ply(&folder.path().join("absent.ply")).unwrap_err().kind, IoErrorKind::System);
}

#[test]
fn points_carry_positions_and_colours_of_any_type() {
    let file = |colors: &str, row: &str| {
        format!("ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty float y\nproperty int z\n{colors}end_header\n{row}\n")
    };
    let rgb = |kind: &str| ["red", "green", "blue"].map(|c| format!("property {kind} {c}\n")).concat();
    let read = |colors: &str, row: &str| decode_points_ply(name(), file(colors, row).as_bytes()).unwrap().points;
    assert_eq!(read("", "1.5 2 -3"), [([1.5, 2.0, -3.0], None)]);
    assert_eq!(read(&rgb("uchar"), "1 2 3 4 5 255"), [([1.0, 2.0, 3.0], Some([4, 5, 255]))]);
    assert_eq!(read(&rgb("float"), "1 2 3 0 0.5 1"), [([1.0, 2.0, 3.0], Some([0, 128, 255]))]);
    assert_eq!(read(&rgb("ushort"), "1 2 3 0 32896 65535"), [([1.0, 2.0, 3.0], Some([0, 128, 255]))]);
    let error = decode_points_ply(name(), file("", "1 inf 3").as_bytes()).unwrap_err().to_string();
    assert_eq!(error, "scene.ply: vertex 0: property \"y\" is inf, expected a finite number");
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

#[test]
fn bakes_alone_read_back_as_what_they_are() {
    let scene = scene(LCD, 9, true, 5);
    for appearance in [Appearance::PREVIEW, Appearance::Linear { color_space: ColorSpace::LinearRec2020, exposure_ev: 1.0 }] {
        let mut baked = Baked::new(&scene, &BakeOptions { appearance, max_degree: 2 });
        let bytes = encode_baked_ply(name(), &baked).unwrap();
        assert_eq!(decode_scene_ply(name(), &bytes).unwrap(), baked.scene);
        let header = String::from_utf8_lossy(&bytes[..600]).into_owned();
        assert!(header.contains("comment luxel baked {\"version\":1"), "{header}");
        // In the file's own world, and out of it again.
        let turn = glam::DMat3::from_cols(glam::DVec3::X, glam::DVec3::NEG_Y, glam::DVec3::NEG_Z);
        let before = baked.scene.splats.position.clone();
        baked.transform(&luxel_core::Similarity::turn(turn).unwrap());
        let bytes = encode_baked_ply(name(), &baked).unwrap();
        assert_eq!(decode_scene_ply(name(), &bytes).unwrap().splats.position, before);
    }
}

#[test]
fn an_exact_file_with_a_bake_of_choice_reads_back_to_the_bit() {
    let mut scene = scene(LCD, 9, true, 5);
    let appearance = Appearance::Display { tonemap: luxel_core::tone::Tonemap::Reinhard, exposure_ev: -1.0 };
    let mut baked = Baked::new(&scene, &BakeOptions { appearance, max_degree: 1 });
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    write_exact_ply(&path, &scene, &baked).unwrap();
    assert_eq!(crate::read_scene(&path).unwrap(), scene);
    let bytes = std::fs::read(&path).unwrap();
    let text = String::from_utf8_lossy(&bytes);
    let (header, _) = text.split_once("end_header\n").unwrap();
    assert!(header.contains("curve reinhard") && header.contains("f_rest_8\n") && !header.contains("f_rest_9\n"), "{header}");
    // A world so small that the data set's has no numbers for it.
    baked.file_from_world = luxel_core::Similarity::new(glam::DMat3::IDENTITY, 1.2e-38, glam::DVec3::ZERO).unwrap();
    scene.splats.position[7] = [9.0; 3];
    write_exact_ply(&path, &scene, &baked).unwrap();
    let error = crate::read_scene(&path).unwrap_err();
    assert!(error.message.contains("in the world of the data set") && error.kind == IoErrorKind::Invalid, "{error}");
}

#[test]
fn infinite_opacities_of_other_programs_are_bounded() {
    let names =
        ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
    let properties: String = names.map(|n| format!("property float {n}\n")).concat();
    let file = |opacity: &str| {
        let head = format!("ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n");
        decode_scene_ply(name(), format!("{head}0 0 0 0 0 0 {opacity} 0 0 0 1 0 0 0\n").as_bytes())
    };
    assert!(sigmoid(file("inf").unwrap().splats.opacity_logit[0]) > 0.99999);
    assert!(sigmoid(file("-inf").unwrap().splats.opacity_logit[0]) < 0.00001);
    assert!(file("nan").unwrap_err().to_string().contains("\"opacity\" is NaN"));
}
