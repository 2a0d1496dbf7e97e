use std::path::Path;

use luxel_core::{Activation, ColorModel, ColorSpace, RadianceScale, RasterConfig, Scene, Similarity, synthetic};
use proptest::prelude::*;

use super::*;
use crate::IoError;
use crate::bake::{Appearance, BakeOptions, Baked};

fn name() -> &'static Path {
    Path::new("scene.glb")
}

fn scene(is_smoothed: bool) -> Scene {
    let lcd = ColorModel::Lcd { chroma_degree: 2, luminance_degree: 1, activation: Activation::Softplus };
    let mut splats = synthetic::room(30, 9).with_color_model(lcd).unwrap();
    if is_smoothed {
        splats.smoothing = vec![0.01; splats.len()];
        splats.gain = (0..splats.len()).map(|i| [1.0, 0.0, 7.5][i % 3]).collect();
    }
    Scene {
        splats,
        radiance_scale: RadianceScale::new(300.0).unwrap(),
        color_space: ColorSpace::AcesCg,
        raster: RasterConfig::default(),
        edits: Vec::new(),
        world_from_local: Similarity::IDENTITY,
        metres_per_unit: Some(0.25),
    }
}

fn baked(scene: &Scene, appearance: Appearance) -> Baked {
    Baked::new(scene, &BakeOptions { appearance, max_degree: 3 })
}

const LINEAR: Appearance = Appearance::Linear { color_space: ColorSpace::LinearRec709, exposure_ev: 0.0 };

#[test]
fn the_exact_model_reads_back_to_the_bit() {
    for is_smoothed in [false, true] {
        let scene = Scene { edits: vec!["where all; gain 2".into()], ..scene(is_smoothed) };
        let bytes = encode_glb(name(), &baked(&scene, Appearance::PREVIEW), Some(&scene)).unwrap();
        let mut back = decode_glb(name(), &bytes).unwrap();
        // glTF's rotations have length 1.
        for (a, b) in back.splats.rotation.iter_mut().zip(&scene.splats.rotation) {
            let length = b.iter().map(|q| q * q).sum::<f32>().sqrt();
            assert!((0..4).all(|c| (a[c] - b[c] / length).abs() < 1e-6));
            *a = *b;
        }
        assert_eq!(back, scene);
    }
}

/// A short buffer of zeros, which every attribute of 64 meshes names: rotations, opacities and
/// colours of two degrees.
#[test]
fn many_meshes_of_one_accessor_are_refused() {
    let count = 20_000;
    let accessor = |width: usize| {
        let kind = ["", "SCALAR", "", "VEC3", "VEC4"][width];
        serde_json::json!({ "bufferView": 0, "componentType": 5121, "normalized": true, "count": count, "type": kind })
    };
    let mut attributes = serde_json::Map::new();
    let named = [
        ("POSITION", 1),
        ("KHR_gaussian_splatting:ROTATION", 2),
        ("KHR_gaussian_splatting:SCALE", 1),
        ("KHR_gaussian_splatting:OPACITY", 0),
    ];
    attributes.extend(named.map(|(name, index)| (name.to_owned(), index.into())));
    for (degree, n) in (0..=3).flat_map(|degree| (0..=2 * degree).map(move |n| (degree, n))) {
        attributes.insert(format!("KHR_gaussian_splatting:SH_DEGREE_{degree}_COEF_{n}"), 1.into());
    }
    let primitive = serde_json::json!({ "attributes": attributes, "mode": 0, "extensions": { "KHR_gaussian_splatting": {} } });
    let document = serde_json::json!({
        "asset": { "version": "2.0" }, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": vec![primitive; 64] }],
        "accessors": [accessor(1), accessor(3), accessor(4)],
        "bufferViews": [{ "buffer": 0, "byteLength": 4 * count }], "buffers": [{ "byteLength": 4 * count }],
    });
    let mut json = serde_json::to_vec(&document).unwrap();
    json.resize(json.len().next_multiple_of(4), b' ');
    let bin = vec![255u8; 4 * count];
    let chunk = |kind: &[u8; 4], content: &[u8]| [&(content.len() as u32).to_le_bytes(), &kind[..], content].concat();
    let chunks = [chunk(b"JSON", &json), chunk(b"BIN\0", &bin)].concat();
    let bytes = [&b"glTF"[..], &2u32.to_le_bytes(), &(12 + chunks.len() as u32).to_le_bytes(), &chunks].concat();
    let error = decode_glb(name(), &bytes).unwrap_err();
    assert!(error.message.contains("too many of them name the same accessors"), "{error}");
}

#[test]
fn bakes_read_back_as_what_they_are() {
    let scene = scene(true);
    for appearance in [Appearance::PREVIEW, LINEAR] {
        let baked = baked(&scene, appearance);
        let back = decode_glb(name(), &encode_glb(name(), &baked, None).unwrap()).unwrap();
        let space = if appearance == LINEAR { ColorSpace::LinearRec709 } else { ColorSpace::DisplaySrgb };
        assert_eq!((back.splats.sh, back.raster, back.color_space), (baked.scene.splats.sh, baked.scene.raster, space));
    }
    let acescg = Appearance::Linear { color_space: ColorSpace::AcesCg, exposure_ev: 0.0 };
    assert!(encode_glb(name(), &baked(&scene, acescg), None).unwrap_err().message.contains("expected linear-rec709"));
}

/// Writes `scene` to files whose world is turned: as a display bake, and with the exact model.
fn turned_files(scene: &Scene, turn: glam::DMat3) -> [Vec<u8>; 2] {
    let turn = Similarity::turn(turn).unwrap();
    let (mut moved, mut baked) = (scene.clone(), baked(scene, Appearance::PREVIEW));
    baked.transform(&turn);
    turn.apply(&mut moved.splats);
    [None, Some(&moved)].map(|exact| encode_glb(name(), &baked, exact).unwrap())
}

#[test]
fn the_files_world_is_undone() {
    let turn = glam::DMat3::from_cols(glam::DVec3::X, glam::DVec3::NEG_Y, glam::DVec3::NEG_Z);
    let original = scene(false);
    for bytes in turned_files(&original, turn) {
        assert_eq!(decode_glb(name(), &bytes).unwrap().splats.position, original.splats.position);
    }
}

#[test]
fn nodes_stand_in_the_files_world() {
    // z is up in the data set, y in the file: ten up there is ten along z here.
    let turn = glam::DMat3::from_cols(glam::DVec3::X, glam::DVec3::NEG_Z, glam::DVec3::Y);
    let original = scene(false);
    for bytes in turned_files(&original, turn) {
        let bytes = with_json(&bytes, |json| json.replace("\"mesh\":0", "\"mesh\":0,\"translation\":[0,10,0]"));
        let (back, before) = (decode_glb(name(), &bytes).unwrap().splats.position[4], original.splats.position[4]);
        assert!([0.0, 0.0, 10.0].iter().zip(0..3).all(|(up, c)| (back[c] - before[c] - up).abs() < 1e-5), "{before:?} {back:?}");
    }
}

#[test]
fn sizes_that_cannot_be_read_back_are_refused() {
    let mut scene = scene(false);
    scene.splats.log_scale[7][1] = 100.0;
    for exact in [None, Some(&scene)] {
        let error = encode_glb(name(), &baked(&scene, LINEAR), exact).unwrap_err();
        assert!(error.message.contains("log scale of splat 7"), "{error}");
    }
}

fn with_json(bytes: &[u8], change: impl Fn(String) -> String) -> Vec<u8> {
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let json = change(String::from_utf8(bytes[20..20 + length].to_vec()).unwrap());
    let mut out = bytes[..12].to_vec();
    out.extend((json.len() as u32).to_le_bytes());
    out.extend(CHUNK_JSON.to_le_bytes());
    out.extend(json.as_bytes());
    out.extend(&bytes[20 + length..]);
    out
}

/// Reads `scene` back from a file whose node has `members` instead of its mesh.
fn with_node(scene: &Scene, members: &str) -> Result<Scene, IoError> {
    let bytes = encode_glb(name(), &baked(scene, LINEAR), None).unwrap();
    decode_glb(name(), &with_json(&bytes, |json| json.replace("\"mesh\":0", members)))
}

#[test]
fn nodes_move_their_splats() {
    let scene = scene(false);
    let node = |members: &str| with_node(&scene, members);
    let moved = node("\"mesh\":0,\"translation\":[1,2,3],\"scale\":[2,2,2]").unwrap();
    let (a, b) = (moved.splats.position[4], scene.splats.position[4]);
    assert!((0..3).all(|c| (a[c] - (2.0 * b[c] + [1.0, 2.0, 3.0][c])).abs() < 1e-5));
    assert!(node("\"mesh\":0,\"scale\":[2,1,2]").unwrap_err().message.contains("unevenly"));
    assert!(node("\"mesh\":0,\"scale\":[1,1,-1]").unwrap_err().message.contains("mirrors"));
    assert!(node("\"mesh\":7").unwrap_err().message.contains("mesh 7 does not exist"));
    assert!(node("\"children\":[0]").unwrap_err().message.contains("circles"));
    assert!(node("\"camera\":0").unwrap_err().message.contains("no primitive"));
}

#[test]
fn a_nodes_matrix_may_be_rounded() {
    let scene = scene(false);
    let by = |matrix: &str| with_node(&scene, &format!("\"mesh\":0,\"matrix\":{matrix}"));
    // A sixth of half a turn about z.
    let position = by("[0.866,0.5,0,0,-0.5,0.866,0,0,0,0,1,0,0,0,0,1]").unwrap().splats.position[4];
    let ([x, y, z], (sin, cos)) = (scene.splats.position[4], std::f32::consts::FRAC_PI_6.sin_cos());
    assert!([cos * x - sin * y, sin * x + cos * y, z].iter().zip(position).all(|(a, b)| (a - b).abs() < 1e-3), "{position:?}");
    for wrong in ["[1,0,0,0,0.1,1,0,0,0,0,1,0,0,0,0,1]", "[1,0,0,0,0,1.1,0,0,0,0,1,0,0,0,0,1]", "[0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,1]"] {
        assert!(by(wrong).unwrap_err().message.contains("shears"));
    }
}

#[test]
fn a_nodes_rotation_may_be_rounded() {
    let scene = scene(false);
    let turned = |rotation: &str| with_node(&scene, &format!("\"mesh\":0,\"rotation\":{rotation}"));
    let position = turned("[0.7071,0,0,0.7071]").unwrap().splats.position[4];
    let [x, y, z] = scene.splats.position[4];
    assert!([x, -z, y].iter().zip(position).all(|(a, b)| (a - b).abs() < 1e-5), "{position:?}");
    for rotation in ["[1,0,0,1]", "[0,0,0,0]", "[1e300,0,0,1e300]"] {
        let error = turned(rotation).unwrap_err();
        assert!(error.message.contains("node 0: rotation") && error.message.contains("of length 1"), "{error}");
    }
}

#[test]
fn without_a_scene_each_node_is_read_once() {
    let original = scene(false);
    let bytes = encode_glb(name(), &baked(&original, LINEAR), None).unwrap();
    let with = |change: &dyn Fn(&mut serde_json::Map<String, serde_json::Value>)| {
        let changed = with_json(&bytes, |json| {
            let mut document: serde_json::Value = serde_json::from_str(&json).unwrap();
            change(document.as_object_mut().unwrap());
            document.to_string()
        });
        decode_glb(name(), &changed)
    };
    let back = with(&|document| {
        document.remove("scene");
        document.remove("scenes");
        document.insert("nodes".into(), serde_json::json!([{ "mesh": 0 }, { "children": [0] }]));
    });
    assert_eq!(back.unwrap().splats.len(), original.splats.len());
    let error = with(&|document| drop(document.insert("scene".into(), 7.into()))).unwrap_err();
    assert!(error.message.contains("scene 7 does not exist, expected one of 1"), "{error}");
}

#[test]
fn splats_that_are_no_numbers_are_left_out() {
    let scene = scene(false);
    let bytes = encode_glb(name(), &baked(&scene, LINEAR), None).unwrap();
    // Any number of the binary part may be the one.
    let start = bytes.len() - 4 * 8;
    let mut changed = bytes.clone();
    changed[start..start + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    std::fs::write(&path, changed).unwrap();
    let file = crate::read_scene_file(&path).unwrap();
    assert_eq!(file.scene.splats.len(), scene.splats.len() - 1);
    assert_eq!(file.warnings, [format!("left out, with a number that is NaN or infinite: 1 of {} splats", scene.splats.len())]);
}

#[test]
fn what_is_wrong_is_named() {
    let scene = scene(false);
    let bytes = encode_glb(name(), &baked(&scene, Appearance::PREVIEW), Some(&scene)).unwrap();
    for (from, to, part) in [
        ("\"count\":30", "\"count\":31", "truncated"),
        ("\"count\":30", "\"count\":99999999999999", "truncated"),
        ("KHR_gaussian_splatting:SCALE", "KHR_gaussian_splatting:SIZE", "no attribute \"KHR_gaussian_splatting:SCALE\""),
        ("\"componentType\":5126", "\"componentType\":5125", "component type 5125"),
        ("\"SH_1\"", "\"SH_x\"", "no attribute \"SH_1\""),
        ("\"radianceScale\":300.0", "\"radianceScale\":-1.0", "out of range"),
        ("\"luminance_degree\":1", "\"luminance_degree\":9", "out of range"),
        ("\"byteLength\":", "\"uri\":\"x.bin\",\"byteLength\":", "outside of this file"),
    ] {
        let changed = with_json(&bytes, |json| json.replace(from, to));
        let error = decode_glb(name(), &changed).unwrap_err().to_string();
        assert!(error.contains(part), "{part}: {error}");
    }
    assert!(decode_glb(name(), b"glTF").is_err());
    assert!(decode_glb(name(), &bytes[..bytes.len() - 4]).unwrap_err().message.contains("truncated"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn damage_is_an_error_or_a_valid_scene(at: prop::sample::Index, byte: u8, in_json: bool) {
        let scene = scene(true);
        let mut bytes = encode_glb(name(), &baked(&scene, Appearance::PREVIEW), Some(&scene)).unwrap();
        let json = 20 + u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let at = at.index(if in_json { json } else { bytes.len() });
        bytes[at] = byte;
        if let Ok(scene) = decode_glb(name(), &bytes) {
            prop_assert_eq!(scene.splats.validate(), Ok(()));
        }
    }
}

#[test]
fn lamps_are_nodes_beside_the_splats() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    let scene = scene(false);
    let lamp = crate::StageLight {
        middle: glam::DVec3::new(1.0, 2.0, 3.0),
        shape: crate::LightShape::Sphere { radius: 0.5 },
        radiance: [4.0, 2.0, 1.0],
    };
    let lights = crate::StageLights {
        lights: vec![lamp],
        dome: None,
        portals: Vec::new(),
        metres_per_unit: None,
        cd_m2_per_unit: None,
        color_space: ColorSpace::LinearRec709,
    };
    write_glb(&path, &baked(&scene, Appearance::PREVIEW), Some(&scene), Some(&lights)).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let document: serde_json::Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    assert_eq!(document["scenes"][0]["nodes"], serde_json::json!([0, 1]));
    assert_eq!(document["nodes"][1]["extensions"]["KHR_lights_punctual"]["light"], 0);
    assert_eq!(document["extensions"]["KHR_lights_punctual"]["lights"][0]["type"], "point");
    assert!(document["extensionsUsed"].as_array().unwrap().contains(&"KHR_lights_punctual".into()));
    let without = encode_glb(name(), &baked(&scene, Appearance::PREVIEW), Some(&scene)).unwrap();
    assert_eq!(read_glb(&path).unwrap(), decode_glb(name(), &without).unwrap());
    let none = crate::StageLights { lights: Vec::new(), ..lights };
    write_glb(&path, &baked(&scene, Appearance::PREVIEW), Some(&scene), Some(&none)).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), without);
}
