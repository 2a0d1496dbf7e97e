//! Scenes for other programs, and back: export, probe, and renders with layers.

use luxel_io::read_scene;

use crate::common::{SIDE, Workplace};

/// Options of every kind of file, and whether the radiance model comes back exactly.
const FILES: [(&str, &[&str]); 10] = [
    ("exact.ply", &[]),
    ("display.ply", &["--bake", "display", "--tonemap", "aces"]),
    ("linear.ply", &["--bake", "linear", "--output-color-space", "linear-rec2020"]),
    ("acescg.usda", &["--output-color-space", "acescg", "--exposure", "-1"]),
    ("display.usd", &["--bake", "display", "--degree", "1"]),
    ("exact.glb", &["--up", "z"]),
    ("linear.glb", &["--bake", "linear", "--scale", "0.5"]),
    ("two.spz", &["--spz-version", "2"]),
    ("three.spz", &["--spz-version", "3"]),
    ("four.spz", &["--crop=-9,-9,-9,9,9,9"]),
];

#[test]
fn every_file_that_is_written_is_read_rendered_and_edited() {
    let place = Workplace::new();
    place.train("run", &[]);
    let original = read_scene(&place.path("run/point_cloud/iteration_40/point_cloud.ply")).unwrap();
    for (file, options) in FILES {
        let mut args = vec!["export", "run", "-o", file];
        args.extend(options);
        let said = place.ok(&args);
        for part in ["splats", "file", "bake error", "views"] {
            assert!(said.contains(part), "{file}: no {part} in\n{said}");
        }
        let info = place.ok(&["info", file]);
        assert!(info.contains("scene") && info.contains("color space"), "{file}: {info}");
        let scene = read_scene(&place.path(file)).unwrap();
        assert_eq!(scene.splats.len(), original.splats.len(), "{file}");
        // However the file's world is turned and scaled, its splats come back to where the cameras
        // are.
        for (a, b) in scene.splats.position.iter().zip(&original.splats.position) {
            assert!((0..3).all(|c| (a[c] - b[c]).abs() < 1e-4), "{file}: {a:?} {b:?}");
        }
        let folder = format!("{file}-frames");
        place.ok(&["render", file, "--data", "data", "--frames", "0", "-o", &folder]);
        assert!(place.path(&folder).join("000.exr").is_file(), "{file}");
        place.ok(&["edit", file, "--stops", "1", "-o", &format!("{file}-edited.ply")]);
        // Once is enough.
        place.error(&args, &["exists already", "--overwrite"]);
    }
    let exact = read_scene(&place.path("exact.ply")).unwrap();
    assert_eq!(exact, original);
    let linear = |file: &str, space: &str| {
        let scene = read_scene(&place.path(file)).unwrap();
        assert_eq!(scene.color_space.name(), space, "{file}");
    };
    linear("linear.ply", "linear-rec2020");
    linear("acescg.usda", "acescg");
    linear("linear.glb", "linear-rec709");
}

#[test]
fn a_linear_bake_renders_the_scenes_radiance() {
    let place = Workplace::new();
    place.train("run", &["--method", "sh2"]);
    place.ok(&["render", "run", "-o", "own", "--exr-type", "float"]);
    let read = |file: String| luxel_io::read_image(&place.path(&file), &Default::default()).unwrap();
    for (file, options) in [("a.usda", ["--exposure", "0"]), ("b.ply", ["--bake", "linear"])] {
        place.ok(&["export", "run", "-o", file, options[0], options[1]]);
        place.ok(&["render", file, "--data", "data", "-o", &format!("of-{file}"), "--exr-type", "float"]);
        for view in ["000", "008"] {
            let (own, found) = (read(format!("own/{view}.exr")), read(format!("of-{file}/{view}.exr")));
            for (a, b) in own.image.pixels.as_flattened().iter().zip(found.image.pixels.as_flattened()) {
                // The cut-offs follow radiance in units that the scale changed.
                assert!((a - b).abs() < 0.02 * (0.1 + a), "{file} {view}: {a} {b}");
            }
        }
    }
}

#[test]
fn pruning_and_refining_do_what_they_say() {
    let place = Workplace::new();
    place.train("run", &[]);
    let error = |file: &str, more: &[&str]| -> f64 {
        let mut args = vec!["export", "run", "-o", file, "--bake", "display", "--quiet"];
        args.extend(more);
        let said = place.ok(&args);
        let line = said.lines().find(|line| line.contains("mean absolute error")).unwrap().to_owned();
        line.split_whitespace().last().unwrap().parse().unwrap()
    };
    let (plain, refined) = (error("plain.ply", &["--refine", "0"]), error("refined.ply", &["--refine", "150"]));
    assert!(refined < plain, "{refined} {plain}");
    // By default, on few and small views, it is what 100 steps make.
    assert!(error("default.ply", &[]) < plain);
    error("explicit.ply", &["--refine", "100"]);
    assert!(std::fs::read(place.path("default.ply")).unwrap() == std::fs::read(place.path("explicit.ply")).unwrap());
    // A picture's splats differ in size from those of the radiance; where one file holds both, each
    // has its own.
    let splats = |file: &str| read_scene(&place.path(file)).unwrap().splats;
    let (plain, refined) = (splats("plain.ply"), splats("refined.ply"));
    assert_ne!(refined.log_scale, plain.log_scale);
    assert_ne!(refined.opacity_logit, plain.opacity_logit);
    assert_eq!((refined.position, refined.rotation), (plain.position, plain.rotation));
    let scene = splats("run/point_cloud/iteration_40/point_cloud.ply");
    for file in ["both.ply", "both.glb"] {
        place.ok(&["export", "run", "-o", file, "--refine", "150", "--up", "as-is", "--quiet"]);
        let read = splats(file);
        assert_eq!((&read.log_scale, &read.opacity_logit, &read.sh), (&scene.log_scale, &scene.opacity_logit, &scene.sh), "{file}");
    }
    error("few.ply", &["--max-splats", "50"]);
    assert_eq!(read_scene(&place.path("few.ply")).unwrap().splats.len(), 50);
    place.ok(&["export", "few.ply", "-o", "fewer.ply", "--max-splats", "20"]);
    assert_eq!(read_scene(&place.path("fewer.ply")).unwrap().splats.len(), 20);
    // The same every time.
    error("again.ply", &["--refine", "150"]);
    assert_eq!(std::fs::read(place.path("again.ply")).unwrap(), std::fs::read(place.path("refined.ply")).unwrap());
}

#[test]
fn what_does_not_go_together_is_refused_before_any_work() {
    let place = Workplace::new();
    place.train("run", &[]);
    let refused = |args: &[&str], parts: &[&str]| {
        let mut all = vec!["export", "run", "-o"];
        all.extend(args);
        place.error(&all, parts);
    };
    refused(&["a.obj"], &["unknown extension", ".usda"]);
    refused(&["a.usdc", "--bake", "exact"], &["USD holds harmonics only", "--bake linear"]);
    refused(&["a.gltf"], &["write .glb"]);
    refused(&["a.spz", "--bake", "linear"], &["8 bits", "--bake display"]);
    refused(&["a.usda", "--bake", "exact"], &["harmonics only"]);
    refused(&["a.ply", "--spz-version", "2"], &["a.ply", "--spz-version", "write .spz"]);
    refused(&["a.glb", "--bake", "linear", "--output-color-space", "acescg"], &["expected linear-rec709"]);
    refused(&["a.ply", "--output-color-space", "acescg"], &["--bake linear"]);
    refused(&["a.ply", "--bake", "linear", "--refine", "5"], &["--bake display"]);
    refused(&["a.html", "--degree", "2"], &["a.html", "--degree", "leave it out"]);
    refused(&["a.html", "--bake", "display"], &["a.html", "--bake"]);
    refused(&["a.ply", "--max-degree", "2"], &["--max-degree is for .html"]);
    place.fails(2, &["export", "run", "-o", "a.html", "--max-degree", "6"]);
    refused(&["a.ply", "--crop", "90,90,90,91,91,91"], &["no splats are left", "--crop"]);
    place.fails(2, &["export", "run", "-o", "a.ply", "--crop", "1,2,3"]);
    place.error(&["export", "run/point_cloud/iteration_40/point_cloud.ply", "-o", "b.ply", "--refine", "3"], &["--data"]);
    std::fs::write(place.path("bad.usda"), "#usda 1.0\n").unwrap();
    place.error(&["info", "bad.usda"], &["no prim of type"]);
}

#[test]
fn a_page_has_the_scene_in_it() {
    let place = Workplace::new();
    place.train("run", &[]);
    let said = place.ok(&["export", "run", "-o", "whole.html"]);
    for part in ["whole.html", "half floats", "file         "] {
        assert!(said.contains(part), "{said}");
    }
    place.ok(&["export", "run", "-o", "few.html", "--max-splats", "20", "--max-degree", "0", "--quiet"]);
    let size = |file: &str| std::fs::metadata(place.path(file)).unwrap().len();
    assert!(size("few.html") < size("whole.html"));
    let page = std::fs::read_to_string(place.path("few.html")).unwrap();
    assert!(page.contains("\"splats\":20,") && page.contains("<title>run</title>") && !page.contains("src=\"/page"));
    place.error(&["export", "run", "-o", "few.html"], &["few.html", "--overwrite"]);
}

#[test]
fn a_probe_holds_the_light_of_all_directions() {
    let place = Workplace::new();
    place.train("run", &[]);
    let said = place.ok(&["probe", "run", "--at", "0,0,1.2", "-o", "probe.exr", "--size", "64", "--exr-type", "float"]);
    for part in ["64x32", "mean radiance", "peak radiance", "irradiance", "+y"] {
        assert!(said.contains(part), "{part}\n{said}");
    }
    let image = luxel_io::read_image(&place.path("probe.exr"), &Default::default()).unwrap().image;
    assert_eq!((image.width, image.height), (64, 32));
    assert!(image.pixels.iter().any(|p| p[0] > 0.0));
    place.ok(&[
        "probe",
        "run",
        "--at=-1,0,1.2",
        "-o",
        "cube.exr",
        "--size",
        "16",
        "--projection",
        "cube",
        "--output-color-space",
        "acescg",
    ]);
    let cube = luxel_io::read_image(&place.path("cube.exr"), &Default::default()).unwrap();
    assert_eq!((cube.image.height, cube.color_space.map(|s| s.name())), (96, Some("acescg")));
    // Without the splats near it, what is left is what the background gives: nothing.
    place.ok(&["probe", "run", "--at", "0,0,0", "-o", "empty.exr", "--size", "16", "--near", "100"]);
    let empty = luxel_io::read_image(&place.path("empty.exr"), &Default::default()).unwrap().image;
    assert!(empty.pixels.iter().all(|p| *p == [0.0; 3]));
    place.error(&["probe", "run", "--at", "0,0,0", "-o", "probe.exr"], &["exists already"]);
    let told = place.events(&["probe", "run", "--at", "0,0,1.2", "-o", "probe.exr", "--size", "16", "--overwrite"], "finished");
    assert!(told.len() == 1 && told[0]["irradiance"]["+y"].is_array(), "{told:?}");
    place.fails(2, &["probe", "run", "--at", "0,0", "-o", "x.exr"]);
}

#[test]
fn renders_have_layers_spaces_and_metadata_and_shards_make_the_same_frames() {
    let place = Workplace::new();
    place.train("run", &[]);
    place.ok(&[
        "render",
        "run",
        "--split",
        "all",
        "-o",
        "one",
        "--alpha",
        "--depth",
        "--output-color-space",
        "aces2065-1",
        "--exr-type",
        "float",
    ]);
    let decoded = luxel_io::read_image(&place.path("one/000.exr"), &Default::default()).unwrap();
    assert_eq!(decoded.color_space.map(|s| s.name()), Some("aces2065-1"));
    let alpha = decoded.alpha.unwrap();
    assert!(alpha.len() == SIDE * SIDE && alpha.iter().all(|a| (0.0..=1.0).contains(a)) && alpha.iter().any(|a| *a > 0.1));
    for shard in ["0/2", "1/2"] {
        let args = [
            "render",
            "run",
            "--split",
            "all",
            "-o",
            "two",
            "--alpha",
            "--depth",
            "--output-color-space",
            "aces2065-1",
            "--exr-type",
            "float",
        ];
        place.ok(&[&args[..], &["--shard", shard, "--threads", "1"]].concat());
    }
    for entry in std::fs::read_dir(place.path("one")).unwrap() {
        let name = entry.unwrap().file_name();
        let [one, two] = ["one", "two"].map(|folder| std::fs::read(place.path(folder).join(&name)).unwrap());
        assert!(one == two, "{name:?}");
    }
}

#[test]
fn the_scene_of_a_run_has_refined_display_colours_and_the_same_radiance() {
    let place = Workplace::new();
    place.train("refined", &[]);
    place.train("plain", &["--refine-display", "0"]);
    let path = |run: &str| place.path(run).join("point_cloud/iteration_40/point_cloud.ply");
    assert!(std::fs::read(path("refined")).unwrap() != std::fs::read(path("plain")).unwrap());
    assert!(read_scene(&path("refined")).unwrap() == read_scene(&path("plain")).unwrap());
}

#[test]
fn videos_need_a_curve_and_an_encoder() {
    let place = Workplace::new();
    place.train("run", &[]);
    place.error(&["render", "run", "-o", "a", "--video", "a.mp4"], &["--tonemap", "--hdr10"]);
    let missing = ["render", "run", "-o", "b", "--video", "b.mp4", "--tonemap", "agx", "--ffmpeg", "no-such-program"];
    place.error(&missing, &["no-such-program", "install ffmpeg"]);
    // The encoder is looked for before hours of rendering.
    assert!(!place.path("b").exists());
    place.fails(2, &["render", "run", "-o", "c", "--video", "c.mp4", "--tonemap", "agx", "--shard", "0/2"]);
}

/// An encoder that writes something and ends with `code`.
#[cfg(unix)]
fn encoder(place: &Workplace, name: &str, code: u8) {
    use std::os::unix::fs::PermissionsExt;
    let script = format!("#!/bin/sh\ncat >/dev/null\nfor last; do :; done\necho {name} >\"${{last#file:}}\"\nexit {code}\n");
    std::fs::write(place.path(name), script).unwrap();
    std::fs::set_permissions(place.path(name), std::fs::Permissions::from_mode(0o755)).unwrap();
}

#[cfg(unix)]
#[test]
fn a_video_is_whole_and_takes_no_place_that_is_taken() {
    let place = Workplace::new();
    place.train("run", &[]);
    encoder(&place, "works", 0);
    encoder(&place, "breaks", 1);
    let render = ["render", "run", "-o", "frames", "--video", "shot/a.mp4", "--tonemap", "agx", "--ffmpeg"];
    let video = || std::fs::read_to_string(place.path("shot/a.mp4")).unwrap();
    std::fs::create_dir(place.path("shot")).unwrap();
    place.error(&[&render[..], &["./breaks"]].concat(), &["ffmpeg failed"]);
    assert_eq!(std::fs::read_dir(place.path("shot")).unwrap().count(), 0);
    place.ok(&[&render[..], &["./works"]].concat());
    assert_eq!(video(), "works\n");
    place.error(&[&render[..], &["./breaks"]].concat(), &["shot/a.mp4: exists already", "--overwrite"]);
    place.error(&[&render[..], &["./breaks", "--overwrite"]].concat(), &["ffmpeg failed"]);
    assert_eq!(video(), "works\n");
    place.ok(&[&render[..], &["./works", "--overwrite"]].concat());
    assert_eq!(std::fs::read_dir(place.path("shot")).unwrap().count(), 1);
}

#[test]
fn a_room_of_any_size_is_a_scene_file() {
    let place = Workplace::empty();
    place.ok(&["bench", "--generate", "500", "--save", "room.ply", "--method", "lcd"]);
    assert!(place.ok(&["info", "room.ply"]).contains("lcd"));
    let save = ["bench", "--generate", "400", "--save", "room.ply"];
    place.error(&save, &["room.ply: exists already", "--overwrite"]);
    assert_eq!(read_scene(&place.path("room.ply")).unwrap().splats.len(), 500);
    let told = place.events(&["export", "room.ply", "-o", "room.glb"], "finished");
    assert!(told.len() == 1 && told[0]["splats"] == 500, "{told:?}");
    place.ok(&[&save[..], &["--overwrite"]].concat());
    assert_eq!(read_scene(&place.path("room.ply")).unwrap().splats.len(), 400);
    assert_eq!(read_scene(&place.path("room.glb")).unwrap().splats.len(), 500);
}
