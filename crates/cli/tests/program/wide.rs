//! Fisheyes, panoramas and pairs for two eyes: rendered from a run, trained as they are, and the
//! lamps of a probe.

use luxel_core::Image;
use luxel_io::{ReadOptions, read_image};
use serde_json::{Value, json};

use crate::common::Workplace;

fn light(image: &Image) -> f64 {
    image.pixels.iter().flatten().map(|v| f64::from(*v)).sum()
}

#[test]
fn a_run_is_rendered_with_other_lenses_and_trained_on_what_they_show() {
    let place = Workplace::new();
    place.train("run", &[]);
    let render = |args: &[&str]| place.ok(&[&["render", "run", "--overwrite"][..], args].concat());
    render(&["--projection", "equirectangular", "--at", "0,0,1.2", "--size", "64x32", "-o", "panorama"]);
    let panorama = place.image("panorama/panorama.exr");
    assert_eq!([panorama.width, panorama.height], [64, 32]);
    assert!(light(&panorama) > 0.0);
    render(&["--projection", "fisheye", "--fov", "200", "--size", "40x40", "--split", "all", "--stereo", "0.1", "-o", "domes"]);
    let eyes = ["left", "right"].map(|eye| place.image(&format!("domes/000_{eye}.exr")));
    assert!(eyes[0] != eyes[1] && light(&eyes[0]) > 0.0);
    // Beyond the circle there is nothing.
    assert_eq!(eyes[0].at(0, 0), [0.0; 3]);

    // A data set of fisheyes: the cameras of the run with another lens.
    let text = std::fs::read_to_string(place.path("data/transforms.json")).unwrap();
    let mut cameras: Value = serde_json::from_str(&text).unwrap();
    for key in ["camera_angle_x", "fl_y", "k1"] {
        cameras.as_object_mut().unwrap().remove(key);
    }
    for (key, value) in [("camera_model", json!("OPENCV_FISHEYE")), ("fl_x", json!(12.0)), ("w", json!(40)), ("h", json!(40))] {
        cameras[key] = value;
    }
    for (key, value) in [("cx", json!(20)), ("cy", json!(20)), ("fisheye_crop_radius", json!(18)), ("fl_y", json!(12.0))] {
        cameras[key] = value;
    }
    std::fs::create_dir(place.path("lens")).unwrap();
    std::fs::write(place.path("lens/transforms.json"), cameras.to_string()).unwrap();
    render(&["--cameras", "lens/transforms.json", "-o", "lens/images"]);
    let said = place.ok(&["info", "lens"]);
    assert!(said.contains("40 x 40") || said.contains("40x40"), "{said}");
    let train = ["train", "lens", "-o", "wide", "--iterations", "30", "--device", "cpu"];
    let warned = |more: &[&str]| {
        let output = place.luxel(&[&train[..], more].concat()).output().unwrap();
        assert!(output.status.success());
        String::from_utf8(output.stderr).unwrap().contains("--stereo-points finds nothing")
    };
    assert!(warned(&["--stereo-points", "500"]) && !warned(&["--overwrite"]));
    place.ok(&["eval", "wide"]);
    place.ok(&["render", "wide", "-o", "again"]);

    place.error(&["render", "run", "--projection", "equirectangular", "--size", "64x64", "-o", "x"], &["expected 64 x 32"]);
    place.error(&["render", "wide", "--size", "80x80", "-o", "x"], &["fisheye projection", "--projection"]);
    // A frame of a pair is both eyes, in a shard as well.
    let files = |folder: &str| {
        let names = std::fs::read_dir(place.path(folder)).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        names.collect::<std::collections::BTreeSet<_>>().into_iter().collect::<Vec<_>>()
    };
    let pairs = ["--split", "all", "--stereo", "0.1", "--size", "16x12"];
    render(&[&pairs[..], &["--frames", "1-2", "-o", "frames"]].concat());
    assert_eq!(files("frames"), ["001_left.exr", "001_right.exr", "002_left.exr", "002_right.exr"]);
    render(&[&pairs[..], &["--frames", "1-2", "--shard", "1/2", "-o", "shard"]].concat());
    assert_eq!(files("shard"), ["002_left.exr", "002_right.exr"]);
    let beyond = place.luxel(&["render", "run", "--frames", "0-999", "--size", "8x8", "-o", "beyond"]).output().unwrap();
    assert!(String::from_utf8_lossy(&beyond.stderr).contains("--frames ends at 999"), "{beyond:?}");
    place.error(&["render", "run", "--frames", "999", "-o", "x"], &["--frames starts at 999"]);
    place.error(&["render", "run", "--stereo", "0.1", "--tonemap", "agx", "--video", "x.mp4", "-o", "x"], &["--stereo renders two"]);
    for part in [["--frames", "0"], ["--shard", "0/1"]] {
        place.fails(2, &[&["render", "run", "--at", "0,0,0", "--projection", "fisheye", "-o", "x"][..], &part].concat());
    }

    place.fails(2, &["render", "run", "--at", "0,0,0", "-o", "x"]);
    place.fails(2, &["render", "run", "--projection", "fisheye", "--at", "0,0,0", "--split", "all", "-o", "x"]);
}

#[test]
fn a_probe_has_coverage_a_preview_and_lamps() {
    let place = Workplace::new();
    place.train("run", &[]);
    let probe = ["probe", "run", "--at", "0,0,1.2", "--size", "128", "-o", "probe.exr"];
    let told = place.events(&[&probe[..], &["--alpha", "--tonemap", "agx", "--exposure", "1"]].concat(), "finished");
    assert!(place.path("probe.png").is_file());
    let lights = told[0]["lights"].as_array().unwrap();
    for light in lights {
        assert!(light["solid_angle_sr"].as_f64().unwrap() > 0.0 && light["irradiance"].as_array().unwrap().len() == 3, "{light}");
    }
    let decoded = read_image(&place.path("probe.exr"), &ReadOptions::default()).unwrap();
    let alpha = decoded.alpha.unwrap();
    assert!(alpha.iter().all(|a| (-1e-6..=1.0 + 1e-6).contains(a)) && alpha.iter().any(|a| *a > 0.5));
    place.error(&[&probe[..], &["--tonemap", "agx"]].concat(), &["exists already"]);
}

#[test]
fn lamps_are_written_in_every_format_with_the_rest_of_the_light() {
    let place = Workplace::new();
    place.train("run", &[]);
    let told = place.events(&["lights", "run", "-o", "lights.usda", "--medians", "3", "--size", "32"], "finished");
    assert!(told[0]["lights"].is_array() && told[0]["map"] == "lights_dome.exr", "{}", told[0]);
    let layer = std::fs::read_to_string(place.path("lights.usda")).unwrap();
    assert!(layer.contains("@@@./lights_dome.exr@@@"), "{layer}");
    let map = read_image(&place.path("lights_dome.exr"), &ReadOptions::default()).unwrap().image;
    assert_eq!((map.width, map.height), (32, 16));
    for name in ["lights.glb", "lights.json", "lights.csv"] {
        place.ok(&["lights", "run", "-o", name, "--no-dome"]);
        assert!(place.path(name).is_file());
    }
    place.error(&["lights", "run", "-o", "lights.usda"], &["exists already"]);
    place.error(&["lights", "run", "-o", "lights.obj"], &[".usda"]);
    std::fs::copy(place.path("run/point_cloud/iteration_40/point_cloud.ply"), place.path("scene.ply")).unwrap();
    place.error(&["lights", "scene.ply", "-o", "other.usda"], &["no cameras", "--data"]);
}
