//! Input that is wrong: exit code 1, and a message that says where and what to do.

use luxel_core::Image;
use serde_json::{Value, json};

use crate::common::{self, QUICK, Workplace};

/// The data set after a change to its transforms.json; training must fail with all of these words.
fn broken(change: impl FnOnce(&mut Value), parts: &[&str]) {
    let place = Workplace::new();
    let mut transforms = place.json("data/transforms.json");
    change(&mut transforms);
    std::fs::write(place.path("data/transforms.json"), transforms.to_string()).unwrap();
    refused(&place, parts);
}

fn refused(place: &Workplace, parts: &[&str]) {
    let mut args = vec!["train", "data", "-o", "run"];
    args.extend(QUICK);
    place.error(&args, parts);
    assert!(!place.path("run").exists(), "nothing is left behind");
}

#[test]
fn frames_without_their_images_are_refused_where_most_are_missing() {
    let rename = |t: &mut Value| {
        for (i, frame) in t["frames"].as_array_mut().unwrap().iter_mut().enumerate().skip(3) {
            frame["file_path"] = json!(format!("images/none{i}.exr"));
        }
    };
    broken(rename, &["transforms.json", "frame 3", "none3.exr"]);
}

#[test]
fn poses_that_are_none_are_refused() {
    broken(|t| t["frames"][2]["transform_matrix"] = json!([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1]]), &["transforms.json"]);
    broken(|t| t["frames"][2]["transform_matrix"] = json!([[1, 0, 0], [0, 1, 0]]), &["transforms.json", "frame 2"]);
    broken(|t| t["frames"][2]["transform_matrix"][0][0] = json!("x"), &["transforms.json", "frame 2"]);
    broken(|t| t["frames"][2]["transform_matrix"][0][3] = Value::Null, &["transforms.json"]);
}

#[test]
fn lenses_that_are_none_are_refused() {
    broken(|t| t["fl_x"] = json!(0), &["transforms.json", "focal"]);
    broken(|t| t["fl_x"] = json!(-5), &["transforms.json", "focal"]);
    broken(|t| t["w"] = json!(1u64 << 40), &["transforms.json"]);
}

#[test]
fn images_of_another_size_are_refused() {
    broken(|t| (t["w"], t["h"]) = (json!(31), json!(47)), &["transforms.json"]);
}

#[test]
fn a_data_set_without_images_is_refused() {
    broken(|t| t["frames"] = json!([]), &["data", "no images"]);
    let place = Workplace::new();
    std::fs::write(place.path("data/transforms.json"), "").unwrap();
    refused(&place, &["transforms.json"]);
}

#[test]
fn names_that_occur_twice_are_refused() {
    broken(|t| t["frames"][1] = t["frames"][0].clone(), &["images/000"]);
}

#[test]
fn truncated_files_are_refused() {
    for (file, part) in [("data/transforms.json", "transforms.json"), ("data/images/004.exr", "004.exr")] {
        let place = Workplace::new();
        let bytes = std::fs::read(place.path(file)).unwrap();
        for length in [0, 1, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(place.path(file), &bytes[..length]).unwrap();
            refused(&place, &[part]);
        }
    }
}

#[test]
fn a_single_image_trains_and_has_no_test_views() {
    let place = Workplace::new();
    let mut transforms = place.json("data/transforms.json");
    transforms["frames"] = json!([transforms["frames"][0]]);
    std::fs::write(place.path("data/transforms.json"), transforms.to_string()).unwrap();
    std::fs::write(place.path("data/split.json"), json!({ "train": ["images/000.exr"], "test": [] }).to_string()).unwrap();
    place.train("run", &[]);
    let metrics = place.json("run/metrics.json");
    assert!(metrics["splits"]["test"].is_null() && metrics["splits"]["train"]["mean"]["psnr_scene"].is_number());
    place.error(&["render", "run", "-o", "frames"], &["--split"]);
}

#[test]
fn bad_pixels_are_told_and_masked() {
    let place = Workplace::new();
    let mut image = luxel_io::read_image(&place.path("data/images/003.exr"), &Default::default()).unwrap().image;
    image.pixels[5] = [f32::NAN, 0.0, 0.0];
    image.pixels[6] = [f32::INFINITY, 0.0, 0.0];
    image.pixels[7] = [-1.0, 0.0, 0.0];
    common::write_image(&place.path("data/images/003.exr"), &image);
    let mut args = vec!["train", "data", "-o", "run"];
    args.extend(QUICK);
    let output = place.luxel(&args).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    assert!(stderr.contains("warning: images/003: masked pixels: 1 NaN, 1 infinite, 1 negative"), "{stderr}");
    let metrics = place.json("run/metrics.json");
    assert!(metrics["splits"]["train"]["mean"]["psnr_scene"].as_f64().unwrap().is_finite());
}

#[test]
fn black_images_are_refused() {
    let place = Workplace::new();
    for entry in std::fs::read_dir(place.path("data/images")).unwrap() {
        let black = Image::filled(common::SIDE, common::SIDE, [0.0; 3]);
        common::write_image(&entry.unwrap().path(), &black);
    }
    refused(&place, &["black"]);
}

#[test]
fn scenes_and_runs_that_are_none_are_refused() {
    let place = Workplace::new();
    place.train("run", &[]);
    let ply = place.path("run/point_cloud/iteration_40/point_cloud.ply");
    let bytes = std::fs::read(&ply).unwrap();
    for length in [0, 3, 40, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(place.path("bad.ply"), &bytes[..length]).unwrap();
        place.error(&["info", "bad.ply"], &["bad.ply"]);
        place.error(&["render", "bad.ply", "--data", "data", "-o", "x"], &["bad.ply"]);
    }
    place.error(&["render", "none.ply", "--data", "data", "-o", "x"], &["none.ply"]);
    place.error(&["eval", "data"], &["data", "not the folder of a training run"]);
    place.error(&["eval", "nothing"], &["nothing"]);
    place.error(&["info", "data/split.exr"], &["split.exr"]);

    // Without its newest scene a run falls back on its checkpoint; without both that is an error.
    std::fs::write(&ply, &bytes[..100]).unwrap();
    place.ok(&["eval", "run"]);
    std::fs::remove_dir_all(place.path("run/checkpoints")).unwrap();
    place.error(&["eval", "run"], &["run", "--resume"]);
    std::fs::write(place.path("run/config.toml"), "nothing = 1").unwrap();
    place.error(&["eval", "run"], &["config.toml"]);
    place.error(&["train", "data", "-o", "run", "--overwrite"], &["config.toml"]);
}

#[test]
fn outputs_that_cannot_be_written_are_refused() {
    let place = Workplace::new();
    std::fs::write(place.path("file"), "").unwrap();
    let mut args = vec!["train", "data", "-o", "file/run"];
    args.extend(QUICK);
    place.error(&args, &["file/run"]);
    place.train("run", &[]);
    place.error(&["render", "run", "-o", "file/frames"], &["file/frames"]);
}

#[test]
fn options_out_of_range_are_refused() {
    let place = Workplace::new();
    for (option, value) in [("--iterations", "0"), ("--mu", "0"), ("--ssim-weight", "1.5"), ("--radiance-scale", "-1")] {
        let mut args = vec!["train", "data", "-o", "run", "--init-points", "100"];
        let assignment = format!("{option}={value}");
        args.push(&assignment);
        place.error(&args, &[option]);
    }
    place.error(&["train", "data", "-o", "run", "--method", "sh3", "--activation", "exp"], &["--activation"]);
    place.error(&["train", "data", "-o", "run", "--mcmc-noise", "1"], &["--mcmc-noise: has an effect with --strategy mcmc only"]);
}

#[test]
fn what_integer_images_do_not_state_must_be_said() {
    let place = Workplace::new();
    let mut transforms = place.json("data/transforms.json");
    for frame in transforms["frames"].as_array_mut().unwrap() {
        let exr = frame["file_path"].as_str().unwrap().to_owned();
        let image = luxel_io::read_image(&place.path("data").join(&exr), &Default::default()).unwrap().image;
        let samples: Vec<u16> = image.pixels.as_flattened().iter().map(|v| (v * 1600.0) as u16).collect();
        let png = exr.replace(".exr", ".png");
        let side = common::SIDE as u32;
        image::ImageBuffer::<image::Rgb<u16>, _>::from_raw(side, side, samples).unwrap().save(place.path("data").join(&png)).unwrap();
        std::fs::remove_file(place.path("data").join(&exr)).unwrap();
        frame["file_path"] = json!(png);
    }
    std::fs::write(place.path("data/transforms.json"), transforms.to_string()).unwrap();
    refused(&place, &[".png", "--transfer"]);

    // Given explicitly, both options count: another curve is other radiance, and the scene's
    // primaries are those of the images.
    let info = |options: &[&str]| -> Value {
        let args: Vec<&str> = ["info", "data", "--json"].iter().chain(options).copied().collect();
        serde_json::from_str(&place.ok(&args)).unwrap()
    };
    let (linear, srgb) = (info(&["--transfer", "linear"]), info(&["--transfer", "srgb"]));
    assert_ne!(linear["percentiles"]["luminance"], srgb["percentiles"]["luminance"]);
    place.train("run", &["--transfer", "linear", "--input-color-space", "acescg"]);
    let run: Value = serde_json::from_str(&place.ok(&["info", "run", "--json"])).unwrap();
    assert_eq!(run["scene"]["color_space"], "acescg");
    // The run's settings are those of its data set from then on.
    place.ok(&["eval", "run"]);
    place.ok(&["render", "run", "-o", "frames", "--tonemap", "agx"]);
    let frame: Value = serde_json::from_str(&place.ok(&["info", "frames/000.exr", "--json"])).unwrap();
    assert_eq!(frame["color_space"], "acescg");
    // Images in other primaries than the scene's are not compared with it.
    common::write_dataset(&place.path("rec709"));
    let config = std::fs::read_to_string(place.path("run/config.toml")).unwrap();
    std::fs::write(place.path("run/config.toml"), config.replace("color_space = \"acescg\"\n", "")).unwrap();
    place.error(&["eval", "run", "--data", "rec709"], &["rec709", "acescg", "convert"]);
}

/// Names that are not UTF-8 are no names of TOML.
#[cfg(target_os = "linux")]
#[test]
fn settings_that_cannot_be_written_cost_no_run() {
    use std::os::unix::ffi::OsStrExt;
    let place = Workplace::new();
    place.train("run", &[]);
    let odd = place.path("").join(std::ffi::OsStr::from_bytes(b"odd-\xff"));
    common::write_dataset(&odd);
    let output = place.luxel(&["train"]).arg(&odd).args(["-o", "run", "--overwrite"]).args(QUICK).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && stderr.contains("config.toml cannot hold"), "{stderr}");
    assert!(place.path("run/config.toml").is_file() && place.path("run/checkpoints").is_dir());
    place.ok(&["eval", "run"]);
}
