//! Output paths: what is there stays, is kept as it is, or is replaced when that is asked for; and
//! names that do not say what is written.

use luxel_core::Image;
use luxel_io::read_exr_attributes;

use crate::common::{self, Workplace};

const SCENE: &str = "run/point_cloud/iteration_40/point_cloud.ply";

#[test]
fn frames_are_kept_where_equal_and_replaced_on_request_where_not() {
    let place = Workplace::new();
    place.train("run", &[]);
    let plain = ["render", "run", "-o", "frames", "--tonemap", "agx"];
    let with = |more: &[&'static str]| [&plain[..], more].concat();
    let bytes = |name: &str| std::fs::read(place.path(name)).unwrap();
    place.ok(&plain);
    let (frame, preview) = (bytes("frames/000.exr"), bytes("frames/000.png"));
    let made_by = |name: &str| read_exr_attributes(&place.path(name)).unwrap().texts["luxel:made_by"].clone();
    assert_eq!(made_by("frames/000.exr").len(), 64);
    assert_ne!(made_by("frames/000.exr"), made_by("frames/008.exr"));
    assert!(place.notes(&plain).contains("2 images exist already and are kept"));
    // The number of threads, the part that is rendered, and --overwrite itself decide nothing.
    assert!(place.notes(&with(&["--threads", "1", "--frames", "0", "--overwrite"])).contains("1 image exist"));

    // Everything else that makes another frame or preview.
    for more in [
        &["--edit", "gain 2"][..],
        &["--alpha"],
        &["--depth"],
        &["--normals"],
        &["--aov", "id"],
        &["--matte", "all=all"],
        &["--output-color-space", "acescg"],
        &["--samples", "1"],
        &["--exr-type", "float"],
        &["--background", "1,1,1"],
        &["--exposure", "1"],
        &["--downscale", "2"],
    ] {
        place.error(&with(more), &["frames/000.", "exists already", "--overwrite"]);
    }
    place.error(&["render", "run", "-o", "frames", "--tonemap", "aces"], &["frames/000.png: exists already", "and so do 1 more"]);
    assert!(bytes("frames/000.exr") == frame && bytes("frames/000.png") == preview);

    let before = place.image("frames/000.exr");
    place.ok(&with(&["--edit", "gain 2", "--overwrite"]));
    let after = place.image("frames/000.exr");
    let sum = |image: &Image| image.pixels.as_flattened().iter().map(|v| f64::from(*v)).sum::<f64>();
    assert!((sum(&after) / sum(&before) - 2.0).abs() < 0.05, "{} {}", sum(&before), sum(&after));
    assert!(bytes("frames/000.png") != preview);
    // The edited scene as a file makes the same frames.
    place.ok(&["edit", "run", "--gain", "2", "-o", "edited.ply"]);
    let edited = ["render", "edited.ply", "--data", "data", "-o", "frames", "--tonemap", "agx"];
    assert!(place.notes(&edited).contains("2 images exist already"));
    // Without a preview, the one of the replaced frame goes.
    place.ok(&["render", "run", "-o", "frames", "--overwrite"]);
    assert!(bytes("frames/008.exr") != frame && !place.path("frames/000.png").exists());
    // A preview that is missing is made beside an equal frame.
    place.ok(&plain);
    assert!(bytes("frames/000.exr") == frame && bytes("frames/000.png") == preview);

    // A scene that was trained again, and a file of another program.
    place.ok(&["train", "data", "-o", "run", "--overwrite", "--iterations", "30", "--init-points", "300"]);
    place.error(&plain, &["frames/000.exr: exists already", "another scene"]);
    std::fs::create_dir(place.path("others")).unwrap();
    common::write_image(&place.path("others/000.exr"), &before);
    place.error(&["render", "run", "-o", "others"], &["others/000.exr: exists already", "--overwrite"]);
}

/// An encoder that writes its arguments.
#[cfg(unix)]
#[test]
fn a_video_is_kept_where_equal_and_replaced_on_request_where_not() {
    use std::os::unix::fs::PermissionsExt;
    let place = Workplace::new();
    place.train("run", &[]);
    let script = "#!/bin/sh\ncat >/dev/null\nfor last; do :; done\necho \"$@\" >\"${last#file:}\"\n";
    std::fs::write(place.path("encoder"), script).unwrap();
    std::fs::set_permissions(place.path("encoder"), std::fs::Permissions::from_mode(0o755)).unwrap();
    // A path that looks like an option, and one that looks like a protocol.
    std::fs::create_dir(place.path("-d")).unwrap();
    let video = |more: &[&'static str]| {
        let plain = ["render", "run", "-o", "frames", "--video=-d/a:b.mp4", "--tonemap", "agx", "--ffmpeg", "./encoder"];
        [&plain[..], more].concat()
    };
    let read = || std::fs::read_to_string(place.path("-d/a:b.mp4")).unwrap();
    place.ok(&video(&[]));
    let first = read();
    assert!(first.contains("comment=luxel:made_by=") && first.contains("file:-d/"), "{first}");
    assert!(place.notes(&video(&[])).contains("a:b.mp4: exists already and is kept"));
    place.error(&video(&["--fps", "30"]), &["a:b.mp4: exists already", "--overwrite"]);
    assert_eq!(read(), first);
    place.ok(&video(&["--fps", "30", "--overwrite"]));
    assert!(read().contains("-r 30"));
}

#[test]
fn names_say_what_is_written() {
    let place = Workplace::new();
    place.train("run", &[]);
    for name in ["x.glb", "x.spz", "x.exr", "x.usda", "x"] {
        place.error(&["edit", "run", "--gain", "2", "-o", name], &[name, "expected .ply", "luxel export"]);
    }
    place.ok(&["edit", "run", "--gain", "2", "-o", "upper.PLY"]);
    place.error(&["edit", "run", "--gain", "2", "--dry-run", "--overlay", "a.jpg"], &["a.jpg", "expected .png"]);
    place.error(&["probe", "run", "--at", "0,0,0", "-o", "a.png"], &["a.png", "expected .exr"]);
    place.error(&["bench", "--generate", "10", "--save", "a.spz"], &["a.spz", "expected .ply"]);
    place.error(&["render", "run", "-o", "f", "--video", "a.avi", "--tonemap", "agx"], &["a.avi", "expected .mp4, .mov or .mkv"]);
    let frame = "run/eval/step_40/gt/000.exr";
    place.error(&["compare", frame, frame, "--heatmap", "a.exr"], &["a.exr", "expected .png"]);
    // Folders.
    let folder = "expected the name of a folder";
    place.error(&["render", "run", "-o", "a.exr"], &["a.exr", folder]);
    place.error(&["train", "data", "-o", "a.ply"], &["a.ply", folder]);
    place.error(&["edit", "run", "--gain", "2", "--against", "run", "-o", "a.png"], &["a.png", folder]);
    place.error(&["reproduce", "data", "-o", "a.json"], &["a.json", folder]);
    place.error(&["demo", "-o", "a.mp4"], &["a.mp4", folder]);
    place.error(&["prepare", "data/images", "-o", "a.exr"], &["a.exr", folder]);
    for name in ["x.glb", "a.exr", "a.ply", "a.png", "a.json", "a.mp4", "f", "a.spz", "x"] {
        assert!(!place.path(name).exists(), "{name}");
    }
}

#[test]
fn values_beyond_half_floats_are_kept() {
    let place = Workplace::new();
    place.train("run", &[]);
    place.ok(&["edit", "run", "--gain", "1e7", "-o", "bright.ply"]);
    place.ok(&["render", "bright.ply", "--data", "data", "-o", "bright"]);
    place.ok(&["probe", "bright.ply", "--data", "data", "--at", "0,0,1.2", "-o", "bright.exr", "--size", "32"]);
    let most = |name: &str| place.image(name).pixels.as_flattened().iter().copied().fold(0.0, f32::max);
    assert!(most("bright/000.exr") > 1e5 && most("bright.exr") > 1e5, "{} {}", most("bright/000.exr"), most("bright.exr"));
    // Half floats where they were asked for, with a warning.
    let half = place.notes(&["render", "bright.ply", "--data", "data", "-o", "half", "--exr-type", "half"]);
    assert!(half.contains("exceed 65504") && half.contains("--exr-type half") && most("half/000.exr") == 65504.0, "{half}");
}

#[test]
fn a_colour_space_that_nothing_reads_is_refused() {
    let place = Workplace::new();
    place.train("run", &[]);
    for args in [
        &["render", "run", "-o", "x"][..],
        &["probe", "run", "--at", "0,0,0", "-o", "x.exr"],
        &["export", "run", "-o", "x.ply"],
        &["export", SCENE, "--data", "data", "-o", "x.ply"],
    ] {
        let args = [args, &["--input-color-space", "acescg"]].concat();
        place.error(&args, &["--input-color-space", "--output-color-space"]);
    }
    // All images state linear Rec.709.
    for args in [
        &["train", "data", "-o", "x"][..],
        &["eval", "run"],
        &["info", "data"],
        &["info", "data/images/000.exr"],
        &["compare", "data/images/000.exr", "data/images/001.exr"],
    ] {
        place.error(&[args, &["--input-color-space", "acescg"]].concat(), &["acescg has nothing to act on"]);
    }
    place.ok(&["info", "data", "--input-color-space", "linear-rec709"]);
    assert!(!place.path("x").exists() && !place.path("x.ply").exists());
}

/// The metrics of `luxel eval` are those of `luxel compare` on its images.
#[test]
fn compare_takes_the_scale_that_the_files_state() {
    let place = Workplace::new();
    place.train("run", &[]);
    let metrics = place.json("run/metrics.json");
    let compared = |paths: [&str; 2]| -> serde_json::Value {
        serde_json::from_str(&place.ok(&["compare", paths[0], paths[1], "--metrics", "fast", "--json"])).unwrap()
    };
    let found = compared(["run/eval/step_40/gt", "run/eval/step_40/renders"]);
    assert_eq!(found["scale"], metrics["radiance_scale"]);
    assert_eq!(found["scale_rule"], "radiance scale that the files state");
    let psnr = |value: &serde_json::Value| value["psnr_scene"].as_f64().unwrap();
    let (of_eval, of_compare) = (psnr(&metrics["splits"]["test"]["mean"]), psnr(&found["mean"]));
    assert!((of_eval - of_compare).abs() < 0.02, "{of_eval} {of_compare}");
    // Renders state it for images that do not.
    place.ok(&["render", "run", "-o", "frames"]);
    let found = compared(["data/images/000.exr", "frames/000.exr"]);
    assert_eq!(found["scale"], metrics["radiance_scale"]);
    assert!(compared(["data/images/000.exr", "data/images/001.exr"])["scale_rule"].as_str().unwrap().starts_with("99.9th percentile"));
    // The L of edits and the luminance Y go by their names.
    let info: serde_json::Value = serde_json::from_str(&place.ok(&["info", SCENE, "--json"])).unwrap();
    let edit: serde_json::Value = serde_json::from_str(&place.ok(&["edit", "run", "--gain", "2", "--dry-run", "--json"])).unwrap();
    assert_eq!(edit["percentiles"]["luminance_sum"], info["percentiles"]["luminance_sum"]);
    assert_eq!(edit["percentiles"]["luminance"], info["percentiles"]["luminance"]);
    assert_ne!(info["percentiles"]["luminance"], info["percentiles"]["luminance_sum"]);
}
