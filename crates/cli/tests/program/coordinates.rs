//! Scenes far from the origin of their coordinates and of any size: trained, read, rendered and
//! written as if they were near it and of usual size.

use std::io::Write;
use std::path::Path;

use glam::DVec3;
use luxel_core::{ColorModel, Image, Scene, Splats, synthetic};
use serde_json::{Value, json};

use crate::common::Workplace;

/// A place in UTM coordinates, metres.
const UTM: [f64; 3] = [455_123.4, 4_600_321.7, 212.6];

/// Returns positions of the cameras' matrices multiplied and moved.
fn moved(transforms: &Value, scale: f64, to: [f64; 3]) -> Value {
    let mut moved = transforms.clone();
    for frame in moved["frames"].as_array_mut().unwrap() {
        for (axis, to) in to.iter().enumerate() {
            let place = &mut frame["transform_matrix"][axis][3];
            *place = json!(place.as_f64().unwrap() * scale + to);
        }
    }
    moved
}

/// Puts the data set of the place at another one and another size.
fn move_data(place: &Workplace, scale: f64, to: [f64; 3]) {
    let moved = moved(&place.json("data/transforms.json"), scale, to);
    std::fs::write(place.path("data/transforms.json"), moved.to_string()).unwrap();
}

fn image(path: &Path) -> Image {
    luxel_io::read_image(path, &Default::default()).unwrap().image
}

/// Mean squared difference in decibels below the mean square of `a`.
fn snr_db(a: &Image, b: &Image) -> f64 {
    let squares = |values: &mut dyn Iterator<Item = f32>| values.map(|v| f64::from(v).powi(2)).sum::<f64>();
    let (a, b) = (a.pixels.as_flattened(), b.pixels.as_flattened());
    assert_eq!(a.len(), b.len());
    let signal = squares(&mut a.iter().copied());
    assert!(signal > 0.0, "a black image");
    -10.0 * (squares(&mut a.iter().zip(b).map(|(a, b)| a - b)) / signal).log10()
}

#[test]
fn a_scene_trains_alike_at_any_place_and_size() {
    let renders = |scale: f64, to: [f64; 3]| {
        let place = Workplace::new();
        move_data(&place, scale, to);
        place.train("run", &["--seed", "3"]);
        place.ok(&["render", "run", "--split", "all", "--exr-type", "float", "-o", "renders"]);
        place.ok(&["eval", "run"]);
        // A scene file with the data set named again, and with the cameras of a file.
        let ply = "run/point_cloud/iteration_40/point_cloud.ply";
        place.ok(&["render", ply, "--data", "data", "--split", "all", "--exr-type", "float", "-o", "by-data"]);
        place.ok(&["render", ply, "--cameras", "data/transforms.json", "--exr-type", "float", "-o", "by-cameras"]);
        let images: Vec<[Image; 3]> = (0..9)
            .map(|i| ["renders", "by-data", "by-cameras"].map(|folder| image(&place.path(&format!("{folder}/{i:03}.exr")))))
            .collect();
        for [run, data, cameras] in &images {
            assert!(snr_db(run, data) > 70.0 && snr_db(run, cameras) > 70.0, "{scale} {to:?}");
        }
        images.into_iter().map(|[run, ..]| run).collect::<Vec<_>>()
    };
    let truth = {
        let place = Workplace::new();
        (0..9).map(|i| image(&place.path(&format!("data/images/{i:03}.exr")))).collect::<Vec<_>>()
    };
    let quality = |renders: &[Image]| truth.iter().zip(renders).map(|(a, b)| snr_db(a, b)).sum::<f64>() / 9.0;
    let plain = quality(&renders(1.0, [0.0; 3]));
    for (scale, to) in [(1.0, UTM), (1e-3, [0.0; 3]), (1e4, [0.0; 3]), (1e-2, [3.0, -2.0, 1.0])] {
        let found = quality(&renders(scale, to));
        assert!((found - plain).abs() < 1.0, "{scale} {to:?}: {found} dB, {plain} dB where it was");
    }
}

#[test]
fn every_format_tells_the_place_of_a_far_scene() {
    let place = Workplace::new();
    move_data(&place, 1e-2, UTM);
    place.train("run", &["--seed", "3"]);
    let ply = "run/point_cloud/iteration_40/point_cloud.ply";
    let told: Value = serde_json::from_str(&place.ok(&["info", ply, "--json"])).unwrap();
    assert!(told["coordinates"].as_str().unwrap().contains("relative to"), "{told}");
    for (axis, at) in UTM.into_iter().enumerate() {
        let [min, max] = ["min", "max"].map(|end| told["bounds"][end][axis].as_f64().unwrap());
        assert!(min < at && at < max && max - min < 10.0, "{told}");
    }
    let told: Value = serde_json::from_str(&place.ok(&["info", "data", "--json"])).unwrap();
    assert!(told["coordinates"].is_string(), "{told}");

    let original = luxel_io::read_scene(&place.path(ply)).unwrap();
    for (file, more) in [
        ("exact.ply", &["--bake", "exact"][..]),
        ("turned.ply", &["--bake", "exact", "--up", "z", "--scale", "3"]),
        ("display.ply", &["--bake", "display"]),
        ("exact.glb", &[]),
        ("linear.glb", &["--bake", "linear", "--scale", "0.5"]),
        ("linear.usda", &[]),
    ] {
        place.ok(&[&["export", "run", "-o", file][..], more].concat());
        let read = luxel_io::read_scene(&place.path(file)).unwrap();
        assert_same_places(&original, &read, file);
    }
    // Others see positions near the file's origin.
    let text = std::fs::read(place.path("display.ply")).unwrap();
    assert!(String::from_utf8_lossy(&text[..2000]).contains("relative to the origin 455123"));
    let stderr = String::from_utf8(place.luxel(&["export", "run", "-o", "scene.spz"]).output().unwrap().stderr).unwrap();
    assert!(stderr.contains("relative to the origin 455123"), "{stderr}");

    // Boxes, spheres and probes are in the coordinates of the data set.
    let [x, y, z] = UTM;
    let all = format!("{},{},{},{},{},{}", x - 9.0, y - 9.0, z - 9.0, x + 9.0, y + 9.0, z + 9.0);
    place.ok(&["export", "run", "--crop", &all, "-o", "cropped.ply"]);
    assert_same_places(&original, &luxel_io::read_scene(&place.path("cropped.ply")).unwrap(), "cropped.ply");
    place.error(&["export", "run", "--crop", "-9,-9,-9,9,9,9", "-o", "none.ply"], &["no splats are left"]);
    let sphere = format!("sphere({x},{y},{z},0.01)");
    let report: Value =
        serde_json::from_str(&place.ok(&["edit", "run", "--where", &sphere, "--gain", "2", "-o", "edited.ply", "--json"])).unwrap();
    let inside = (0..original.splats.len()).filter(|i| original.world_position(*i).distance(UTM.into()) < 0.01).count();
    assert!(inside > 0 && inside < original.splats.len());
    assert_eq!(report["edit_1"]["selected"], json!(inside), "{report}");
    let at = format!("{x},{y},{z}");
    place.ok(&["probe", "run", "--at", &at, "--size", "32", "-o", "probe.exr"]);
    assert!(image(&place.path("probe.exr")).pixels.iter().any(|rgb| rgb[0] > 0.01));
}

fn assert_same_places(a: &Scene, b: &Scene, file: &str) {
    assert_eq!(a.splats.len(), b.splats.len(), "{file}");
    for i in 0..a.splats.len() {
        let error = a.world_position(i).distance(b.world_position(i));
        assert!(error < 1e-7, "{file}: splat {i} is {error} off, at {}", b.world_position(i));
    }
}

/// Writes splats as another program does, in 64 or 32 bits, multiplied and moved.
fn write_plain_ply(path: &Path, splats: &Splats, scale: f64, to: [f64; 3], kind: &str) {
    let mut out = std::io::BufWriter::new(std::fs::File::create(path).unwrap());
    writeln!(out, "ply\nformat ascii 1.0\nelement vertex {}", splats.len()).unwrap();
    ["x", "y", "z"].iter().for_each(|name| writeln!(out, "property {kind} {name}").unwrap());
    for name in ["f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"] {
        writeln!(out, "property float {name}").unwrap();
    }
    writeln!(out, "end_header").unwrap();
    for i in 0..splats.len() {
        let p = DVec3::from_array(splats.position[i].map(f64::from)) * scale + DVec3::from_array(to);
        let sizes = splats.log_scale[i].map(|s| f64::from(s) + scale.ln());
        let values = splats.sh_of(i)[..3].iter().copied().chain([splats.opacity_logit[i]]).map(f64::from);
        let rest = values.chain(sizes).chain(splats.rotation[i].map(f64::from));
        let words: Vec<String> = p.to_array().into_iter().chain(rest).map(|v| v.to_string()).collect();
        writeln!(out, "{}", words.join(" ")).unwrap();
    }
}

#[test]
fn splats_of_other_programs_render_alike_at_any_place_and_size() {
    let place = Workplace::new();
    let splats = synthetic::room(400, 5).with_color_model(ColorModel::Sh { degree: 0 }).unwrap();
    let transforms = place.json("data/transforms.json");
    let render = |name: &str, scale: f64, to: [f64; 3]| {
        write_plain_ply(&place.path(&format!("{name}.ply")), &splats, scale, to, "double");
        std::fs::write(place.path(&format!("{name}.json")), moved(&transforms, scale, to).to_string()).unwrap();
        let (scene, cameras) = (format!("{name}.ply"), format!("{name}.json"));
        place.ok(&["render", &scene, "--cameras", &cameras, "--exr-type", "float", "--depth", "-o", name]);
        image(&place.path(&format!("{name}/004.exr")))
    };
    let plain = render("plain", 1.0, [0.0; 3]);
    for (name, scale, to) in [("far", 1.0, UTM), ("tiny", 1e-3, [0.0; 3]), ("huge", 1e4, [0.0; 3]), ("far-tiny", 1e-2, [40.0, 50.0, -60.0])]
    {
        let db = snr_db(&plain, &render(name, scale, to));
        assert!(db > 50.0, "{name}: {db} dB");
    }
}
