//! `luxel compare` from outside.

use std::path::Path;

use luxel_core::Image;
use luxel_io::{ExrOptions, ExrSample, write_exr};

use crate::common::{self, Workplace};

const WIDTH: usize = 20;
const HEIGHT: usize = 14;

/// A gradient over three decades with a lamp, times `gain`.
fn room(gain: f32) -> Image {
    let value = |i: usize| if i == 30 { 50.0 } else { 0.01 * (1 + i % WIDTH) as f32 * (1 + i / WIDTH) as f32 };
    let pixels = (0..WIDTH * HEIGHT).map(|i| [value(i), 0.8 * value(i), 0.5 * value(i)].map(|v| v * gain)).collect();
    Image::from_pixels(WIDTH, HEIGHT, pixels).unwrap()
}

fn write(path: &Path, image: &Image) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    write_exr(path, image, &ExrOptions { sample: ExrSample::Float, ..ExrOptions::default() }).unwrap();
}

fn json(place: &Workplace, args: &[&str]) -> serde_json::Value {
    serde_json::from_str(&place.ok(args)).unwrap()
}

#[test]
fn two_images_get_every_figure() {
    let place = Workplace::empty();
    write(&place.path("a.exr"), &room(1.0));
    write(&place.path("b.exr"), &room(1.25));
    let text = place.ok(&["compare", "a.exr", "b.exr", "--scale", "2", "--peak-luminance", "600"]);
    for part in
        ["psnr", "ssim", "scene", "gtmax", "selfmax", "pu21", "600 cd/m2", "hdr-flip", "log-rmse", "relative error", "+25.00%", "0.1 to 1"]
    {
        assert!(text.contains(part), "{part}\n{text}");
    }
    let found = json(&place, &["compare", "a.exr", "b.exr", "--json", "--scale", "2"]);
    let image = &found["images"][0];
    let figure = |key: &str| image[key].as_f64().unwrap_or_else(|| panic!("{key}: {image}"));
    // A gain of 1.25 is 0.0969 decades and goes unseen by selfmax.
    assert!((figure("log_rmse") - 0.09691).abs() < 1e-4, "{image}");
    assert!(figure("psnr_selfmax") > 90.0 && figure("psnr_gtmax") < 50.0 && figure("hdr_flip") > 0.01);
    assert!(figure("pu21_psnr") > 20.0 && figure("pu21_ssim") > 0.9 && figure("pu21_peak_luminance") == 1000.0);
    let errors = image["relative_error_by_decade"].as_array().unwrap();
    assert!(errors.len() >= 3 && errors.iter().all(|e| (e["relative_error"].as_f64().unwrap() - 0.25).abs() < 0.06), "{errors:?}");
    assert_eq!(found["mean"]["pu21_psnr"], image["pu21_psnr"]);
    // The other way round: the reference by name.
    let turned = json(&place, &["compare", "a.exr", "--reference", "b.exr", "--json", "--metrics", "fast"]);
    assert!(turned["images"][0].get("hdr_flip").is_none());
    assert_eq!(turned["reference"], "b.exr");
}

#[test]
fn a_scale_is_chosen_from_the_reference_alone() {
    let place = Workplace::empty();
    write(&place.path("a.exr"), &room(1.0));
    write(&place.path("b.exr"), &room(3.0));
    let scale = |paths: [&str; 2]| json(&place, &["compare", paths[0], paths[1], "--json", "--metrics", "fast"])["scale"].as_f64().unwrap();
    let (first, second) = (scale(["a.exr", "b.exr"]), scale(["b.exr", "a.exr"]));
    assert!(first > 1.0 && (second / first - 3.0).abs() < 1e-3, "{first} {second}");
}

#[test]
fn folders_are_matched_by_stem_and_the_missing_are_named() {
    let place = Workplace::empty();
    for (name, gain) in [("000", 1.0), ("001", 1.1), ("only_here", 1.0)] {
        write(&place.path("truth").join(format!("{name}.exr")), &room(gain));
    }
    for (name, gain) in [("000", 1.2), ("001", 1.1), ("only_there", 1.0)] {
        write(&place.path("renders").join(format!("{name}.exr")), &room(gain));
    }
    std::fs::write(place.path("truth/notes.txt"), "no image").unwrap();
    let output = place.luxel(&["compare", "truth", "renders", "--heatmap", "maps"]).output().unwrap();
    let (text, warnings) = (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
    assert!(output.status.success(), "{warnings}");
    for part in ["000", "001", "mean", "pu21", "100.00"] {
        assert!(text.contains(part), "{part}\n{text}");
    }
    for part in ["only_here.exr: no test", "only_there.exr: no reference"] {
        assert!(warnings.contains(part), "{part}\n{warnings}");
    }
    for name in ["000", "001"] {
        let map = luxel_io::read_image(&place.path(&format!("maps/{name}.png")), &Default::default()).unwrap().image;
        assert_eq!((map.width, map.height), (WIDTH, HEIGHT));
    }
    place.error(&["compare", "truth", "renders", "--heatmap", "maps"], &["000.png: exists already", "--overwrite"]);
    place.ok(&["compare", "truth", "renders", "--heatmap", "maps", "--overwrite"]);
    let onto_itself = ["compare", "truth/000.exr", "renders/000.exr", "--heatmap", "maps/../truth/000.exr", "--overwrite"];
    place.error(&onto_itself[..5], &["truth/000.exr: exists already"]);
    place.error(&onto_itself, &["truth/000.exr: is read by this command"]);
    let found = json(&place, &["compare", "truth", "renders", "--json", "--metrics", "fast"]);
    assert_eq!(found["images"].as_array().unwrap().len(), 2);
    assert!(found["missing_test"][0].as_str().unwrap().ends_with("only_here.exr"));
    let mean = 0.5 * (found["images"][0]["pu21_psnr"].as_f64().unwrap() + found["images"][1]["pu21_psnr"].as_f64().unwrap());
    assert!((found["mean"]["pu21_psnr"].as_f64().unwrap() - mean).abs() < 1e-9);
}

#[test]
fn masked_and_bad_pixels_are_left_out() {
    let place = Workplace::empty();
    let (mut reference, mut test) = (room(1.0), room(1.0));
    reference.pixels[5] = [f32::NAN; 3];
    for pixel in &mut test.pixels[WIDTH..2 * WIDTH] {
        *pixel = [9.0; 3];
    }
    write(&place.path("a.exr"), &reference);
    write(&place.path("b.exr"), &test);
    let mask: Vec<u8> = (0..WIDTH * HEIGHT).flat_map(|i| [if i / WIDTH == 1 { 0 } else { 255 }; 3]).collect();
    luxel_io::write_png(&place.path("mask.png"), WIDTH, HEIGHT, &mask).unwrap();
    let image = &json(&place, &["compare", "a.exr", "b.exr", "--mask", "mask.png", "--json"])["images"][0];
    assert_eq!(image["masked_pixels"], WIDTH + 1);
    assert_eq!((image["psnr_scene"].as_f64(), image["hdr_flip"].as_f64()), (Some(100.0), Some(0.0)));
    // Of a folder of masks, each reference takes the one of its name; one without is reported.
    for name in ["a", "b"] {
        write(&place.path(&format!("images/{name}.exr")), &room(1.0));
    }
    std::fs::create_dir(place.path("masks")).unwrap();
    std::fs::copy(place.path("mask.png"), place.path("masks/a.png")).unwrap();
    let args = ["compare", "images", "images", "--mask", "masks", "--metrics", "fast", "--json"];
    let images = &json(&place, &args)["images"];
    assert_eq!((&images[0]["masked_pixels"], &images[1]["masked_pixels"]), (&WIDTH.into(), &0.into()));
    let stderr = String::from_utf8(place.luxel(&args).output().unwrap().stderr).unwrap();
    assert!(stderr.contains("images/b.exr: no mask of this name, compared whole") && !stderr.contains("images/a.exr"), "{stderr}");
    std::fs::rename(place.path("masks/a.png"), place.path("masks/c.png")).unwrap();
    let stderr = place.fails(1, &args);
    assert!(stderr.contains("masks has 1 image, and none has the name of a reference"), "{stderr}");
    // A render that is no number is an error, not an excuse.
    let stderr = place.fails(1, &["compare", "b.exr", "a.exr"]);
    assert!(stderr.contains("a.exr") && stderr.contains("not finite at column 5, row 0"), "{stderr}");
}

#[test]
fn what_cannot_be_compared_is_said() {
    let place = Workplace::empty();
    write(&place.path("folder/a.exr"), &room(1.0));
    write(&place.path("other/b.exr"), &room(1.0));
    write(&place.path("small.exr"), &Image::filled(4, 3, [1.0; 3]));
    std::fs::write(place.path("text.exr"), "no image").unwrap();
    for (args, part) in [
        (&["folder/a.exr", "small.exr"][..], "folder/a.exr is 20x14, small.exr is 4x3: expected equal sizes"),
        (&["folder", "small.exr"], "folder is a folder, small.exr is a file"),
        (&["folder", "other"], "none have the same name"),
        (&["folder/a.exr", "text.exr"], "text.exr"),
        (&["folder/a.exr", "nowhere.exr"], "nowhere.exr: cannot open"),
        (&["folder/a.exr", "folder/a.exr", "--mask", "small.exr"], "a mask needs the size of its image"),
    ] {
        let stderr = place.fails(1, &[&["compare"][..], args].concat());
        assert!(stderr.contains(part), "{part}\n{stderr}");
    }
    for args in [&["folder/a.exr"][..], &["folder/a.exr", "folder/a.exr", "--reference", "other/b.exr"], &["a.exr", "b.exr", "c.exr"]] {
        place.fails(2, &[&["compare"][..], args].concat());
    }
}

#[test]
fn straight_and_premultiplied_alpha_of_one_picture_are_equal() {
    let place = Workplace::empty();
    let (mut colour, mut alpha) = (Vec::new(), Vec::new());
    let mut straight = image::ImageBuffer::<image::Rgba<u16>, _>::new(WIDTH as u32, HEIGHT as u32);
    for (i, pixel) in straight.pixels_mut().enumerate() {
        let (rgb, opacity) = ([1000 * i, 500 * i, 200 * i].map(|v| (v % 65_536) as u16), (4000 + 3000 * (i % WIDTH)) as u16);
        *pixel = image::Rgba([rgb[0], rgb[1], rgb[2], opacity]);
        let share = f32::from(opacity) / 65535.0;
        colour.push(rgb.map(|v| f32::from(v) / 65535.0 * share));
        alpha.push(share);
    }
    straight.save(place.path("straight.png")).unwrap();
    let options = ExrOptions { sample: ExrSample::Float, alpha: Some(alpha), ..ExrOptions::default() };
    write_exr(&place.path("premultiplied.exr"), &Image::from_pixels(WIDTH, HEIGHT, colour).unwrap(), &options).unwrap();
    let found = json(&place, &["compare", "premultiplied.exr", "straight.png", "--transfer", "linear", "--metrics", "fast", "--json"]);
    assert!(found["mean"]["psnr_scene"].as_f64().unwrap() > 90.0, "{}", found["mean"]);
}

#[test]
fn two_runs_are_compared_on_the_test_views_that_both_have() {
    let place = Workplace::new();
    place.train("run", &[]);
    place.train("other", &["--method", "sh1"]);
    let text = place.ok(&["compare", "run", "other", "-o", "both"]);
    for part in ["1  run: lcd, step 40", "2  other: sh1", "2 - 1", "psnr scene, dB", "hdr-flip", "000"] {
        assert!(text.contains(part), "{part}\n{text}");
    }
    assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
    // The picture has three renders in two rows.
    let picture = luxel_io::read_image(&place.path("both/000.png"), &Default::default()).unwrap().image;
    assert_eq!([picture.width, picture.height], [3 * common::SIDE, 2 * common::SIDE]);
    let told = place.json("both/runs.json");
    assert_eq!(told["schema_version"], 1);
    // The metrics are those of each run, and the differences are theirs.
    let psnr = |value: &serde_json::Value| value["psnr_scene"].as_f64().unwrap();
    for (i, run) in ["run", "other"].into_iter().enumerate() {
        let own = psnr(&place.json(&format!("{run}/metrics.json"))["splits"]["test"]["mean"]);
        // Images are half floats.
        assert!((psnr(&told["runs"][i]["mean"]) - own).abs() < 0.01, "{run}: {own}\n{told:#}");
    }
    let view = &told["views"][0];
    assert!((psnr(&view["difference"]) - (psnr(&view["second"]) - psnr(&view["first"]))).abs() < 1e-9);
    assert_eq!(json(&place, &["compare", "run", "run", "--json", "--metrics", "fast"])["difference"]["psnr_scene"], 0.0);
    place.error(&["compare", "run", "other", "-o", "both"], &["exists already"]);
    place.error(&["compare", "run", "run/eval/step_40/gt"], &["expected two runs"]);
    place.error(&["compare", "run/eval/step_40/gt", "run/eval/step_40/renders", "-o", "x"], &["--output x is for two runs"]);
    // Other images are another ground truth.
    let other = place.path("other/eval/step_40/gt/000.exr");
    let mut image = luxel_io::read_image(&other, &Default::default()).unwrap().image;
    image.pixels[7][1] *= 1.5;
    common::write_image(&other, &image);
    place.error(&["compare", "run", "other"], &["000.exr", "the same ground truth", "train both on the same data"]);
    std::fs::remove_dir_all(place.path("other/eval")).unwrap();
    place.error(&["compare", "run", "other"], &["other: has no images of test views", "luxel eval other"]);
}

#[test]
fn a_scene_file_is_evaluated_without_its_run() {
    let place = Workplace::new();
    place.train("run", &[]);
    let scene = "run/point_cloud/iteration_40/point_cloud.ply";
    let text = place.ok(&["eval", scene, "--data", "data", "-o", "measured"]);
    assert!(text.contains("psnr, dB") && text.contains("mean"), "{text}");
    let (own, file) = (place.json("run/metrics.json"), place.json("measured/metrics.json"));
    for split in ["test", "train"] {
        assert_eq!(file["splits"][split]["mean"]["psnr_scene"], own["splits"][split]["mean"]["psnr_scene"], "{split}");
    }
    assert_eq!([&file["radiance_scale"], &file["splats"]], [&own["radiance_scale"], &own["splats"]]);
    for name in ["renders/000.exr", "gt/000.exr"] {
        let read = |folder: &str| std::fs::read(place.path(folder).join(name)).unwrap();
        assert!(read("measured") == read("run/eval/step_40"), "{name}");
    }
    let told = json(&place, &["eval", scene, "--data", "data", "--json"]);
    assert!(told["schema_version"] == 1 && told["splits"] == file["splits"], "{told:#}");
    place.error(&["eval", scene], &["give --data DATASET"]);
    place.error(&["eval", scene, "--data", "data", "-o", "measured"], &["exists already"]);
    place.error(&["eval", "run", "-o", "x"], &["is for a scene file"]);
}
