//! `luxel bench` from outside. No time is asserted: times are there, finite and in order.

use luxel_core::{Cutoffs, RadianceScale, RasterConfig, Scene, synthetic};
use serde_json::{Value, json};

use crate::common::Workplace;

const SIDE: usize = 32;
const SPLATS: usize = 400;

/// Passes that the CPU engine tells apart.
const PASSES: [&str; 8] = ["adam", "bin", "loss", "project", "project_backward", "rasterize", "rasterize_backward", "sort"];

/// A workload of a few hundred splats with its camera and a target.
fn workplace() -> Workplace {
    let place = Workplace::empty();
    let raster = RasterConfig { cutoffs: Cutoffs::PARITY, ..RasterConfig::default() };
    let splats = synthetic::room(SPLATS, 1);
    let scene = Scene {
        splats,
        radiance_scale: RadianceScale::ONE,
        color_space: Default::default(),
        raster,
        edits: Vec::new(),
        world_from_local: luxel_core::Similarity::IDENTITY,
        metres_per_unit: None,
    };
    luxel_io::write_scene_ply(&place.path("room.ply"), &scene).unwrap();
    write_camera(&place, |_| {});
    std::fs::write(place.path("target.npy"), npy(SIDE, SIDE, 0.25)).unwrap();
    place
}

fn write_camera(place: &Workplace, change: impl FnOnce(&mut Value)) {
    let half = SIDE as f64 / 2.0;
    let mut camera = json!({
        "width": SIDE, "height": SIDE, "fx": 21.0, "fy": 21.0, "cx": half, "cy": half, "near": 0.01,
        "world_to_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    });
    change(&mut camera);
    std::fs::write(place.path("camera.json"), camera.to_string()).unwrap();
}

fn npy(width: usize, height: usize, value: f32) -> Vec<u8> {
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({height}, {width}, 3), }}\n");
    let length = (header.len() as u16).to_le_bytes();
    let samples: Vec<u8> = std::iter::repeat_n(value.to_le_bytes(), width * height * 3).flatten().collect();
    [&b"\x93NUMPY\x01\x00"[..], &length, header.as_bytes(), &samples].concat()
}

const FILES: [&str; 13] =
    ["bench", "--workload", "room.ply", "--camera", "camera.json", "--device", "cpu", "--threads", "1", "--steps", "3", "--warmup", "1"];

fn with<'a>(more: &[&'a str]) -> Vec<&'a str> {
    FILES.iter().chain(more).copied().collect()
}

/// The JSON of a measurement of the files.
fn measured(place: &Workplace, more: &[&str]) -> Value {
    let stdout = place.ok(&with(&[more, &["--json"]].concat()));
    assert_eq!(stdout.trim_end().lines().count(), 1, "{stdout}");
    serde_json::from_str(&stdout).unwrap()
}

#[test]
fn figures_are_one_json_object() {
    let place = workplace();
    let json = measured(&place, &["--target", "target.npy"]);
    let facts = [
        ("workload", json!("room.ply")),
        ("method", json!("sh3")),
        ("splats", json!(SPLATS)),
        ("width", json!(SIDE)),
        ("height", json!(SIDE)),
        ("threads", json!(1)),
        ("cutoffs", json!("parity")),
        ("order", json!("spatial")),
        ("target", json!("target.npy")),
        ("steps", json!(3)),
        ("warmup", json!(1)),
        ("mu", json!(5000.0)),
    ];
    for (name, value) in facts {
        assert_eq!(json[name], value, "{name}");
    }
    for name in ["forward_ms", "step_ms"] {
        let [min, q1, median, q3] = ["min", "q1", "median", "q3"].map(|of| json[name][of].as_f64().unwrap());
        assert!(0.0 < min && min <= q1 && q1 <= median && median <= q3, "{name}: {}", json[name]);
    }
    let passes: Vec<&str> = json["passes_ms"].as_object().unwrap().keys().map(String::as_str).collect();
    assert_eq!(passes, PASSES);
    assert!(json["visible"].as_u64().unwrap() > 100 && json["first_loss"].as_f64().unwrap() > 0.0);
    let [touched, alive] = ["touched", "alive"].map(|of| json["evaluations"][of].as_u64().unwrap());
    assert!(alive > 0 && alive < touched && touched.is_multiple_of(16), "{}", json["evaluations"]);
    assert!(json["instruction_set"].is_string() && json["luxel_version"].is_string());
    assert_eq!(json["peak_rss_bytes"].as_u64().is_some(), cfg!(target_os = "linux"));
}

#[test]
fn table_has_every_pass() {
    let table = workplace().ok(&with(&["--order", "file"]));
    for part in
        ["room.ply", "400, ", "32x32", "1 thread", "parity", "file", "render of the workload", "forward", "step", "first loss", " alive"]
    {
        assert!(table.contains(part), "{part}\n{table}");
    }
    for pass in PASSES {
        assert!(table.contains(pass), "{pass}\n{table}");
    }
}

#[test]
fn options_change_what_they_name() {
    let place = workplace();
    let loss = |more: &[&str]| measured(&place, more)["first_loss"].as_f64().unwrap();
    let base = loss(&[]);
    // Either order is one of the same splats, down to those of equal depth.
    assert!((loss(&["--order", "file"]) / base - 1.0).abs() < 1e-3);
    for more in [&["--seed", "1"][..], &["--mu", "1"], &["--target", "target.npy"], &["--cutoffs", "hdr"], &["--method", "lcd"]] {
        assert_ne!(loss(more), base, "{more:?}");
    }
    for (method, name) in [("lcd", "lcd"), ("sh0", "sh0"), ("sh5", "sh5")] {
        assert_eq!(measured(&place, &["--method", method])["method"], name);
    }
    let baseline = measured(&place, &["--instruction-set", "baseline"]);
    assert!((baseline["first_loss"].as_f64().unwrap() / base - 1.0).abs() < 1e-3);
    if cfg!(target_arch = "x86_64") {
        assert_eq!(baseline["instruction_set"], "sse2");
    }
}

#[test]
fn synthetic_room_needs_no_files() {
    let place = Workplace::empty();
    let room = |more: &[&str]| -> Value {
        let args = ["bench", "--generate", "500", "--steps", "1", "--warmup", "0", "--json"];
        serde_json::from_str(&place.ok(&[&args, more].concat())).unwrap()
    };
    let json = room(&["--size", "48x20"]);
    assert_eq!((&json["splats"], &json["width"], &json["height"]), (&json!(500), &json!(48), &json!(20)));
    assert!(json["first_loss"].as_f64().unwrap() > 0.0);
    assert_eq!(room(&[])["width"], 400);
    write_camera(&place, |_| {});
    assert_eq!(room(&["--camera", "camera.json"])["width"], SIDE);
}

#[test]
fn files_that_are_wrong_are_named() {
    let place = workplace();
    let refused = |more: &[&str], parts: &[&str]| place.error(&with(more), parts);
    std::fs::write(place.path("other.npy"), npy(SIDE, SIDE + 1, 0.1)).unwrap();
    refused(&["--target", "other.npy"], &["other.npy", "32 x 33 pixels", "expects 32 x 32"]);
    std::fs::write(place.path("other.npy"), npy(SIDE, SIDE, f32::NAN)).unwrap();
    refused(&["--target", "other.npy"], &["other.npy", "pixel 0, 0", "not finite"]);
    std::fs::write(place.path("other.npy"), &npy(SIDE, SIDE, 0.1)[..500]).unwrap();
    refused(&["--target", "other.npy"], &["other.npy", "expected 12288"]);
    refused(&["--target", "absent.exr"], &["absent.exr"]);
    refused(&["--target", "room.ply"], &["room.ply", "not an image"]);

    write_camera(&place, |camera| camera["fx"] = json!(-1));
    refused(&[], &["camera.json", "\"fx\" is -1", "focal length"]);
    write_camera(&place, |camera| camera["world_to_camera"][0][0] = json!(2));
    refused(&[], &["camera.json", "world_to_camera", "rotation"]);
    std::fs::write(place.path("camera.json"), "{").unwrap();
    refused(&[], &["camera.json", "not JSON"]);

    write_camera(&place, |_| {});
    let ply = std::fs::read(place.path("room.ply")).unwrap();
    std::fs::write(place.path("room.ply"), &ply[..ply.len() / 2]).unwrap();
    refused(&[], &["room.ply"]);
}

#[test]
fn scenes_that_cannot_be_measured_as_asked_are_named() {
    let place = workplace();
    let raster = RasterConfig::default();
    let lcd = in_lcd(&synthetic::room(50, 1));
    let write = |name: &str, splats| {
        let scene = Scene {
            splats,
            radiance_scale: RadianceScale::new(2.0).unwrap(),
            color_space: Default::default(),
            raster,
            edits: Vec::new(),
            world_from_local: luxel_core::Similarity::IDENTITY,
            metres_per_unit: None,
        };
        luxel_io::write_scene_ply(&place.path(name), &scene).unwrap();
    };
    write("lcd.ply", lcd.clone());
    write("empty.ply", synthetic::room(0, 1));
    let args = |scene| vec!["bench", "--workload", scene, "--camera", "camera.json", "--steps", "1"];
    assert!(place.ok(&args("lcd.ply")).contains("lcd"));
    place.error(&[&args("lcd.ply")[..], &["--method", "sh3"]].concat(), &["lcd.ply", "lcd cannot become sh3"]);
    place.error(&args("empty.ply"), &["empty.ply", "no splats"]);
    place.error(&[&args("lcd.ply")[..], &["--device", "gpu:no such card"]].concat(), &["--device gpu:no such card"]);
}

fn in_lcd(splats: &luxel_core::Splats) -> luxel_core::Splats {
    let model = luxel_core::ColorModel::Lcd { chroma_degree: 3, luminance_degree: 0, activation: luxel_core::Activation::Softplus };
    splats.with_color_model(model).unwrap()
}

#[test]
fn usage_errors_have_code_two() {
    let place = Workplace::empty();
    for args in [
        &["bench"][..],
        &["bench", "--workload", "room.ply"],
        &["bench", "--workload", "room.ply", "--camera", "camera.json", "--generate", "5"],
        &["bench", "--workload", "room.ply", "--camera", "camera.json", "--size", "4x4"],
        &["bench", "--generate", "0"],
        &["bench", "--generate", "5", "--size", "4"],
        &["bench", "--generate", "5", "--size", "4x4", "--camera", "camera.json"],
        &["bench", "--generate", "5", "--steps", "0"],
        &["bench", "--generate", "5", "--mu", "0"],
        &["bench", "--generate", "5", "--transfer", "linear"],
        &["bench", "--generate", "5", "--instruction-set", "mmx"],
    ] {
        place.fails(2, args);
    }
}
