//! Camera paths, light probes and stills over HTTP.
#![allow(missing_docs, clippy::unwrap_used, reason = "tests")]

mod common;

use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};

use luxel::{Device, Renderer, SelectedEngine, Silent};
use luxel_io::{ExrSample, ReadOptions, decode_image};
use serde_json::{Value, json};

use common::Running;

/// Waits for the end of a render, and returns its state.
fn rendered(viewer: &Running) -> Value {
    let start = Instant::now();
    loop {
        let status = viewer.get("/api/path/render").json();
        if status["state"] != "running" || start.elapsed() > Duration::from_secs(120) {
            return status;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A path of two of the data set's cameras.
fn path(viewer: &Running, duration: f64) -> Value {
    let cameras = viewer.get("/api/scene").json()["cameras"].clone();
    let camera = |i: usize| {
        let keys = ["transform_matrix", "fl_x", "fl_y", "cx", "cy", "w", "h"];
        keys.into_iter().map(|key| (key.to_owned(), cameras[i][key].clone())).collect::<serde_json::Map<_, _>>()
    };
    json!({
        "keyframes": [{ "time": 0.0, "camera": camera(0) }, { "time": duration, "camera": camera(1) }],
        "duration": duration, "frames_per_second": 4.0, "ease": "ends", "closed": false, "width": 32, "height": 20,
    })
}

#[test]
fn a_path_is_a_camera_file_that_opens_again() {
    let viewer = Running::saving();
    let answer = viewer.post("/api/path", &path(&viewer, 2.0));
    let file = answer.json();
    let cameras = luxel::decode_cameras("path.json", &answer.body).unwrap();
    assert_eq!((cameras.len(), cameras[7].name.as_str(), cameras[7].camera.size_px), (8, "frame_00007", [32, 20]));
    // In the order of their names, as the page has them.
    let first = &viewer.dataset.train.iter().chain(&viewer.dataset.test).find(|view| view.name.ends_with("000")).unwrap().camera;
    assert!((cameras[0].camera.eye() - first.eye()).length() < 1e-9);
    let again = viewer.send("POST", "/api/path/read", &answer.body).json();
    assert_eq!(again, file["luxel_path"]);
    assert_eq!(viewer.post("/api/path", &again).body, answer.body);
    // Without keyframes every camera is one, and the path is the same.
    let mut plain = file.clone();
    plain.as_object_mut().unwrap().remove("luxel_path");
    let mut read = viewer.post("/api/path/read", &plain).json();
    assert_eq!(read["keyframes"].as_array().unwrap().len(), 8);
    read["frames_per_second"] = json!(8.0 / read["duration"].as_f64().unwrap());
    let same = luxel::decode_cameras("path.json", &viewer.post("/api/path", &read).body).unwrap();
    for (a, b) in cameras.iter().zip(&same) {
        assert!((a.camera.eye() - b.camera.eye()).length() < 1e-9 && (a.camera.focal_px - b.camera.focal_px).length() < 1e-9);
    }
}

#[test]
fn frames_of_a_path_are_what_the_renderer_makes_and_nothing_is_replaced() {
    let viewer = Running::saving();
    let wish = json!({ "path": path(&viewer, 1.0), "name": "turn", "edit": "gain 0.5", "samples": 2, "exr_type": "float" });
    assert_eq!(viewer.post("/api/path/render", &wish).json()["total"], 4);
    // Pages see pictures in between.
    assert_eq!(viewer.get("/api/frame.exr?view=001").status, 200);
    let status = rendered(&viewer);
    assert_eq!((&status["state"], &status["done"], &status["error"]), (&"finished".into(), &4.into(), &Value::Null));
    let folder = viewer.folder.path().join("paths/turn");
    let cameras = luxel::read_cameras(folder.join("cameras.json")).unwrap();
    let mut scene = viewer.scene.clone();
    scene.edit(&"gain 0.5".parse().unwrap()).unwrap();
    let mut renderer = Renderer::new(&scene, Device::Cpu.with_threads(1)).unwrap();
    renderer.set_samples(2).unwrap();
    for named in &cameras {
        let bytes = std::fs::read(folder.join(format!("{}.exr", named.name))).unwrap();
        let image = decode_image(Path::new("a.exr"), &bytes, &ReadOptions::default()).unwrap().image;
        assert_eq!(image.pixels, renderer.render(&named.camera).unwrap().pixels(), "{}", named.name);
    }
    // The samples of the path are not those of the page.
    let page = viewer.get("/api/frame.exr?view=001").body;
    renderer = Renderer::new(&viewer.scene, Device::Cpu.with_threads(1)).unwrap();
    let view = viewer.dataset.train.iter().chain(&viewer.dataset.test).find(|view| view.name.ends_with("001")).unwrap();
    assert_eq!(page, renderer.render(&view.camera).unwrap().encode_exr().unwrap());
    viewer.post("/api/path/render", &wish).refused(409, "exists already");
    assert_eq!(viewer.get("/api/path/render").json()["state"], "idle");
}

#[test]
fn a_render_is_cancelled_and_there_is_one_at_a_time() {
    let viewer = Running::saving();
    let wish = |name: &str| json!({ "path": path(&viewer, 500.0), "name": name });
    assert_eq!(viewer.post("/api/path/render", &wish("long")).json()["state"], "running");
    viewer.post("/api/path/render", &wish("other")).refused(409, "rendered already");
    viewer.send("POST", "/api/path/cancel", b"").json();
    let status = rendered(&viewer);
    assert!(status["state"] == "cancelled" && status["done"].as_u64().unwrap() < 2000, "{status}");
    assert!(!viewer.folder.path().join("paths/other").exists());
}

#[test]
fn hostile_paths_are_refused_and_nothing_is_written() {
    let viewer = Running::saving();
    let with = |change: &dyn Fn(&mut Value)| {
        let mut path = path(&viewer, 1.0);
        change(&mut path);
        path
    };
    for (path, words) in [
        (with(&|p| p["frames_per_second"] = json!(1e6)), "expected at most 10000"),
        (with(&|p| p["duration"] = json!(-1)), "positive"),
        (with(&|p| p["keyframes"] = json!([])), "no keyframes"),
        (with(&|p| p["keyframes"][1]["time"] = json!(0)), "expected a time after 0 s"),
        (with(&|p| p["keyframes"][1]["camera"]["fl_x"] = json!(-3)), "keyframe_1"),
        (with(&|p| p["keyframes"][1]["camera"]["transform_matrix"] = json!([1])), "keyframe_1"),
        (with(&|p| p["width"] = json!(4_000_000_000u32)), "4000000000"),
        (with(&|p| [p["width"], p["height"]] = [json!(65000), json!(65000)]), "65000"),
    ] {
        viewer.post("/api/path/render", &json!({ "path": path, "name": "a" })).refused(422, words);
    }
    for (path, words) in [
        (with(&|p| p["ease"] = json!("x")), "unknown variant"),
        (with(&|p| p["width"] = json!(-1)), "-1"),
        (with(&|p| p["more"] = json!(1)), "unknown field"),
        (json!(3), "the body"),
    ] {
        viewer.post("/api/path", &path).refused(400, words);
    }
    for name in ["", "..", "../up", "a/b", "C:\\x", ".hid", "con", &"n".repeat(200), "a\u{0}"] {
        viewer.post("/api/path/render", &json!({ "path": path(&viewer, 1.0), "name": name })).refused(422, "the name");
    }
    viewer.post("/api/path/render", &json!({ "path": path(&viewer, 1.0), "name": "a", "samples": 9 })).refused(400, "expected 1 to 4");
    viewer.post("/api/path/render", &json!({ "path": path(&viewer, 1.0), "name": "a", "edit": "nonsense" })).refused(400, "nonsense");
    viewer.send("POST", "/api/path/read", b"{").refused(422, "not JSON");
    viewer.send("POST", "/api/path/read", b"{}").refused(422, "not a camera file");
    viewer.send("POST", "/api/path", &vec![b'['; 17 << 20]).refused(413, "expected at most");
    viewer.send("POST", "/api/path", &vec![b'['; 1 << 20]).refused(400, "the body");
    viewer.get("/api/path").refused(405, "POST");
    viewer.send("POST", "/api/paths", b"").refused(404, "no such path");
    assert_eq!(viewer.get("/api/path/render").json()["state"], "idle");
    assert!(!viewer.folder.path().join("paths").exists());
}

#[test]
fn a_probe_is_what_the_library_makes() {
    let viewer = Running::saving();
    let query = "at=0.1,0.2,0.3&width=64";
    let mut engine = SelectedEngine::open(&Device::Cpu.with_threads(1)).unwrap().engine;
    let options = luxel::ProbeOptions { width_px: 64, ..luxel::ProbeOptions::at([0.1, 0.2, 0.3]) };
    let core = (*viewer.scene).clone();
    let probe = luxel::probe::probe(core, &options, Some(&viewer.dataset), engine.as_mut(), &Silent).unwrap();
    let expected = probe.encode_exr(ExrSample::smallest_for(probe.image())).unwrap();
    assert_eq!(viewer.get(&format!("/api/environment.exr?{query}")).body, expected);
    let facts = viewer.get(&format!("/api/environment?{query}")).json();
    assert_eq!((&facts["width"], &facts["height"]), (&64.into(), &32.into()));
    assert!(facts["warnings"].as_array().unwrap().len() <= 1 && facts["peak_radiance"].as_f64().unwrap() > 0.0);
    assert_eq!(viewer.get(&format!("/api/environment.frame?{query}")).body.len(), 6 * 64 * 32);
    let save = format!("/api/environment/save?{query}&name=cup");
    let path = viewer.send("POST", &save, b"").json()["path"].as_str().unwrap().to_owned();
    assert!(path.ends_with("probes/cup.exr") && std::fs::read(&path).unwrap() == expected);
    viewer.send("POST", &save, b"").refused(409, "exists already");
    // One that is not under way, or is done, has no progress.
    let progress = viewer.get(&format!("/api/environment/progress?{query}")).json();
    assert_eq!((&progress["done"], &progress["total"]), (&json!(0), &json!(0)));
    // Another point in sight of nobody.
    let far = viewer.get("/api/environment?at=900,900,900&width=8").json();
    assert!(far["warnings"][0].as_str().unwrap().contains("no image of the data set"), "{far}");
    for (query, words) in [
        ("at=1,2", "expected x,y,z"),
        ("at=1,2,x", "expected x,y,z"),
        ("at=1,2,inf", "expected x,y,z"),
        ("at=1,2,3,4", "expected x,y,z"),
        ("at=1,2,3&width=100000", "expected 4 to 8192"),
        ("at=1,2,3&more=1", "unknown parameter"),
    ] {
        viewer.get(&format!("/api/environment?{query}")).refused(400, words);
    }
    viewer.send("POST", "/api/environment/save?at=1,2,3&name=..%2Fa", b"").refused(422, "the name");
}

#[test]
fn the_light_on_an_object_is_lamps_and_a_small_map() {
    let viewer = Running::saving();
    let found = viewer.get("/api/lamps?at=0.1,-0.2,0.3").json();
    assert_eq!((&found["map"]["width"], &found["map"]["height"], &found["schema_version"]), (&json!(96), &json!(48), &json!(1)));
    let rgb = found["map"]["rgb"].as_array().unwrap();
    assert!(rgb.len() == 3 * 96 * 48 && rgb.iter().all(|value| value.as_f64().unwrap() >= 0.0));
    assert!(found["lamps"].is_array() && (0.0..=1.0).contains(&found["unseen_share"].as_f64().unwrap()));
    // The same again, and of a scene that is twice as bright.
    assert_eq!(viewer.get("/api/lamps?at=0.1,-0.2,0.3").json(), found);
    let brighter = viewer.get("/api/lamps?at=0.1,-0.2,0.3&edit=gain%202").json();
    let sum = |found: &Value| found["map"]["rgb"].as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).sum::<f64>();
    assert!((sum(&brighter) / sum(&found) - 2.0).abs() < 1e-3, "{} {}", sum(&found), sum(&brighter));
    viewer.get("/api/lamps?at=1,2").refused(400, "expected x,y,z");
    viewer.get("/api/lamps?at=1,2,3&more=1").refused(400, "unknown parameter");
    viewer.send("POST", "/api/lamps?at=1,2,3", b"").refused(405, "GET finds lamps");
}

/// Returns the PQ value of a luminance in `[0, 1]` of 10,000 cd/m2 (SMPTE ST 2084, equation 5.2).
fn pq(y: f64) -> f64 {
    let (m1, m2) = (2610.0 / 4096.0 / 4.0, 2523.0 / 4096.0 * 128.0);
    let (c1, c2, c3) = (3424.0 / 4096.0, 2413.0 / 4096.0 * 32.0, 2392.0 / 4096.0 * 32.0);
    let p = y.powf(m1);
    ((c1 + c2 * p) / (1.0 + c3 * p)).powf(m2)
}

#[test]
fn an_hdr_still_has_the_codes_of_st_2084() {
    let viewer = Running::saving();
    let png = viewer.get("/api/still.png?view=000&hdr=pq&exposure=2");
    assert_eq!(png.status, 200);
    let found = image_of(&png.body);
    let exr = decode_image(Path::new("a.exr"), &viewer.get("/api/frame.exr?view=000").body, &ReadOptions::default()).unwrap().image;
    assert_eq!(found.len(), exr.pixels.len());
    let scale = f64::from(viewer.scene.radiance_scale.get());
    // ITU-R BT.2087: linear Rec.709 to Rec.2020.
    let rows = [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]];
    let mut bright = 0;
    for (codes, rgb) in found.iter().zip(&exr.pixels) {
        for (code, row) in codes.iter().zip(rows) {
            let radiance: f64 = row.iter().zip(rgb).map(|(weight, value)| weight * f64::from(*value)).sum();
            let nits = (radiance / scale * 4.0 * 203.0).clamp(0.0, 10_000.0);
            // The file has half floats (0.05 %) and the matrix four digits (0.1 %). In codes
            // that is largest where the curve is steepest, 65535 times about 0.11 per factor of 2.
            let expected = 65535.0 * pq(nits / 10_000.0);
            let tolerance = if nits > 1.0 { 20.0 } else { 60.0 };
            assert!((f64::from(*code) - expected).abs() < tolerance, "{code}, expected {expected} for {nits} cd/m2");
            bright += usize::from(nits > 100.0);
        }
    }
    assert!(bright > 10, "{bright} bright values");
    viewer.get("/api/still.png?view=000").refused(400, "hdr=pq");
    viewer.get("/api/still.png?view=000&hdr=pq&exposure=nan").refused(400, "exposure");
    viewer.get("/api/still.png?view=000&hdr=pq&width=70000&height=70000").refused(400, "70000");
}

fn image_of(png: &[u8]) -> Vec<[u16; 3]> {
    let decoded = image::load_from_memory(png).unwrap().into_rgb16();
    decoded.pixels().map(|pixel| pixel.0).collect()
}

#[test]
fn a_light_probe_ends_with_the_connection_that_asked_for_it() {
    let viewer = Running::saving();
    let query = "at=0.1,0.2,0.3&width=2048";
    let mut stream = std::net::TcpStream::connect(viewer.address).unwrap();
    write!(stream, "GET /api/environment?{query} HTTP/1.1\r\nHost: {}\r\n\r\n", viewer.address).unwrap();
    let progress = || {
        let found = viewer.get(&format!("/api/environment/progress?{query}")).json();
        [&found["done"], &found["total"]].map(|number| number.as_u64().unwrap())
    };
    let until = |is_met: &dyn Fn([u64; 2]) -> bool| {
        for _ in 0..6000 {
            if is_met(progress()) {
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        panic!("{:?}", progress());
    };
    until(&|[done, total]| done > 0 && total > 6 && done < total);
    assert_eq!(viewer.get("/api/environment/progress?at=0.1,0.2,0.3&width=64").json()["total"], 0);
    drop(stream);
    until(&|[_, total]| total == 0);
    // The next one does not wait for it.
    assert_eq!(viewer.get("/api/environment?at=0.1,0.2,0.3&width=16").status, 200);
}
