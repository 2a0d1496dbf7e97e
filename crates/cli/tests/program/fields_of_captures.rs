//! Radiance fields that are trained on captured LDR images, alone and beside radiance, and fields
//! without a hash grid.

use serde_json::{Value, json};

use crate::common::{SIDE, VIEWS, Workplace};

/// Exposures of every training pose, seconds.
const EXPOSURES_S: [f32; 3] = [0.25, 2.0, 16.0];

/// Writes `captured`: the data in HDR-NeRF's layout, whose cameras record `0.5 x^(1/2.2)`.
fn record(place: &Workplace) {
    let transforms = place.json("data/transforms.json");
    for folder in ["train", "test", "train_hdr", "test_hdr"] {
        std::fs::create_dir_all(place.path("captured").join(folder)).unwrap();
    }
    let (mut frames, mut exposures) = ([Vec::new(), Vec::new()], [json!({}), json!({})]);
    for (view, frame) in transforms["frames"].as_array().unwrap().iter().enumerate() {
        let is_test = view % 8 == 0;
        let (part, side) = if is_test { ("test", "test_hdr") } else { ("train", "train_hdr") };
        let source = place.path(&format!("data/images/{view:03}.exr"));
        std::fs::copy(&source, place.path(&format!("captured/{side}/hdr_{view:03}.exr"))).unwrap();
        let mut add = |k: usize| {
            let mut frame = frame.clone();
            frame["file_path"] = format!("{part}/r_{view}_{k}").into();
            frames[usize::from(is_test)].push(frame);
        };
        let image = luxel_io::read_image(&source, &Default::default()).unwrap().image;
        for (k, seconds) in EXPOSURES_S.into_iter().enumerate() {
            let code = |p: f32| ((p * seconds).powf(1.0 / 2.2) * 0.5 * 255.0).round().min(255.0) as u8;
            let pixels: Vec<u8> = image.pixels.as_flattened().iter().map(|p| code(*p)).collect();
            let png = image::RgbImage::from_raw(SIDE as u32, SIDE as u32, pixels).unwrap();
            png.save(place.path(&format!("captured/{part}/r_{view}_{k}.png"))).unwrap();
            exposures[usize::from(is_test)][format!("r_{view}_{k}.png")] = seconds.into();
            add(k);
        }
    }
    for ((part, frames), exposures) in ["train", "test"].into_iter().zip(frames).zip(&exposures) {
        let mut described = transforms.clone();
        described["frames"] = frames.into();
        write(place, &format!("captured/transforms_{part}.json"), &described);
        write(place, &format!("captured/exposure_{part}.json"), exposures);
    }
}

fn write(place: &Workplace, name: &str, content: &Value) {
    std::fs::write(place.path(name), content.to_string()).unwrap();
}

fn train(place: &Workplace, method: &str, run: &str, more: &[&str]) {
    place.ok(&[&["train", "captured", "--method", method, "--eval-at", "0", "-o", run], more].concat());
}

fn field(place: &Workplace, run: &str, step: u32) -> Vec<u8> {
    std::fs::read(place.path(run).join(format!("field/iteration_{step}/field.safetensors"))).unwrap()
}

/// Trains for `steps` steps, unbroken and resumed from half of them, measures and renders.
fn check_run(place: &Workplace, method: &str, steps: u32, more: &[&str]) -> Value {
    let (all, half) = (steps.to_string(), (steps / 2).to_string());
    let with = |options: &[&'static str]| -> Vec<String> { options.iter().chain(more).map(|option| (*option).to_owned()).collect() };
    let run = |name: &str, options: &[&'static str]| {
        let options = with(options);
        let mut options: Vec<&str> = options.iter().map(String::as_str).collect();
        options.extend(["--iterations", all.as_str()]);
        if name == "broken" {
            options.extend(["--checkpoint-every", half.as_str(), "--keep-checkpoints", "9"]);
        }
        train(place, method, name, &options);
    };
    run("unbroken", &["--threads", "1"]);
    run("broken", &["--threads", "2"]);
    assert_eq!(field(place, "broken", steps), field(place, "unbroken", steps));
    std::fs::remove_file(place.path(&format!("broken/checkpoints/step_{steps:09}.safetensors"))).unwrap();
    for folder in ["field", "eval"] {
        std::fs::remove_dir_all(place.path("broken").join(folder)).unwrap();
    }
    place.ok(&["train", "--resume", "-o", "broken", "--threads", "2"]);
    assert_eq!(field(place, "broken", steps), field(place, "unbroken", steps));
    let metrics = place.json("unbroken/metrics.json");
    assert_eq!(metrics["iterations"], steps);
    place.ok(&["eval", "unbroken", "--threads", "2"]);
    for (split, found) in metrics["splits"].as_object().unwrap() {
        assert_eq!(place.json("unbroken/metrics.json")["splits"][split]["mean"], found["mean"], "{split}");
    }
    place.ok(&["render", "unbroken", "-o", "frames"]);
    place.error(&["export", "unbroken", "-o", "scene.ply"], &["radiance field", "no splats"]);
    metrics
}

#[test]
fn a_field_of_log_radiance_learns_from_captured_images_alone() {
    let place = Workplace::new();
    record(&place);
    let metrics = check_run(&place, "hdr-nerf-grid", 20, &[]);
    assert_eq!(metrics["method"], "hdr-nerf-grid");
    for split in ["test", "test_gain_common"] {
        assert!(metrics["splits"][split]["mean"]["psnr_scene"].as_f64().unwrap() > 0.0, "{split}");
    }
    // Captured images of held-out poses: three of a pose, and so of those that are trained on.
    let of_test = &metrics["splits"]["test_ldr"];
    assert_eq!(of_test["views"].as_array().unwrap().len(), 3 * 2);
    assert!(of_test["mean"]["psnr_scene"].is_number() && of_test["mean"]["pu21_psnr"].is_null());
    let recorded = &metrics["splits"]["train"];
    assert_eq!(recorded["views"].as_array().unwrap().len(), 3 * (VIEWS - 2));
    assert!(recorded["mean"]["psnr_scene"].is_number() && recorded["mean"]["pu21_psnr"].is_null());
    let response = place.json("unbroken/captures.json");
    assert_eq!(response["iteration"], 20);
    let knots = response["response"]["recorded"][1].as_array().unwrap();
    assert!((knots[20].as_f64().unwrap() - 0.5).abs() < 0.1 && knots[10].as_f64().unwrap() < knots[25].as_f64().unwrap(), "{knots:?}");
    // The response is the field's own: a run without the file is measured alike.
    let before = place.json("unbroken/metrics.json")["splits"].clone();
    std::fs::remove_file(place.path("unbroken/captures.json")).unwrap();
    place.ok(&["eval", "unbroken"]);
    assert_eq!(place.json("unbroken/metrics.json")["splits"], before);
    assert!(place.ok(&["info", "unbroken"]).contains("tone mappers"));
}

#[test]
fn a_field_of_captured_values_is_lifted_to_the_radiance_beside_them() {
    let place = Workplace::new();
    record(&place);
    let metrics = check_run(&place, "mono-hdr-nerf-grid", 20, &["--exposures", "1", "--hdr-weight", "0.5"]);
    assert_eq!(metrics["method"], "mono-hdr-nerf-grid");
    for split in ["test", "test_gain_common", "train"] {
        assert!(metrics["splits"][split]["mean"]["psnr_scene"].as_f64().unwrap() > 0.0, "{split}");
    }
    assert_eq!(metrics["splits"]["train"]["views"].as_array().unwrap().len(), VIEWS - 2);
    assert!(!place.path("unbroken/captures.json").exists());
}

#[test]
fn a_network_without_a_grid_says_so_by_its_name() {
    let place = Workplace::new();
    record(&place);
    let metrics = check_run(&place, "nerf-grid", 2, &["--field-network", "4x8"]);
    assert_eq!(metrics["method"], "nerf-4x8");
    let told = place.ok(&["info", "unbroken"]);
    assert!(told.contains("nerf-4x8") && told.contains("layers") && !told.contains("grid levels"), "{told}");
    place.error(&["edit", "unbroken", "-o", "edited.ply", "--gain", "2"], &["radiance field (nerf-4x8)"]);
    let refused = |network: &str, parts: &[&str]| {
        place.error(&["train", "data", "-o", "run", "--method", "nerf-grid", "--field-network", network], parts);
    };
    refused("1x8", &["found 1x8", "2 to 16 layers of 8 to 512 units"]);
    refused("8x9000", &["found 8x9000", "8 to 512 units"]);
    let told = place.fails(2, &["train", "data", "-o", "run", "--method", "nerf-grid", "--field-network", "large"]);
    assert!(told.contains("grid, or layers and units such as 8x256"), "{told}");
    place.error(&["train", "data", "-o", "run", "--field-network", "8x256"], &["--field-network", "--method nerf-grid"]);
    place.ok(&["reproduce", "data", "-o", "study", "--methods", "nerf-4x8", "--seeds", "1", "--iterations", "1"]);
    let tables = std::fs::read_to_string(place.path("study/tables.tex")).unwrap();
    assert!(tables.contains("4x8 network, no hash grid"), "{tables}");
}

#[test]
fn data_and_options_that_do_not_fit_are_refused_by_name() {
    let place = Workplace::new();
    let refused = |data: &str, method: &str, more: &[&str], parts: &[&str]| {
        place.error(&[&["train", data, "-o", "run", "--iterations", "5", "--method", method], more].concat(), parts);
    };
    refused("data", "hdr-nerf-grid", &[], &["holds radiance, expected a captured LDR image"]);
    refused("data", "mono-hdr-nerf-grid", &[], &["no captured LDR images with exposures beside the radiance"]);
    record(&place);
    refused("captured", "hdr-nerf-grid", &["--supervision", "both"], &["trains on captured images alone", "--supervision ldr"]);
    refused("captured", "hdr-nerf-grid", &["--exposures", "1"], &["captured images of 2 to 2 s", "half a stop apart", "--exposures all"]);
    refused("captured", "mono-hdr-nerf-grid", &[], &["captured images of 0.25, 2, 16 s", "expected one exposure", "--exposures middle"]);
    refused("captured", "mono-hdr-nerf-grid", &["--supervision", "ldr"], &["beside radiance", "--supervision both"]);
    refused("captured", "nerf-grid", &["--supervision", "ldr"], &["learns from radiance", "hdr-nerf-grid"]);
    refused("captured", "mono-hdr-nerf-grid", &["--exposures", "1", "--hdr-weight", "0", "--ldr-weight", "0"], &["--hdr-weight"]);
    refused("captured", "mono-hdr-nerf-grid", &["--unit-exposure", "0.7"], &["--unit-exposure", "hdr-nerf-grid"]);
    refused("captured", "hdr-nerf-grid", &["--hdr-weight", "1"], &["--hdr-weight"]);
    refused("captured", "hdr-nerf-grid", &["--field-loss", "linear"], &["--field-loss", "--method nerf-grid"]);
    refused("captured", "hdr-nerf-grid", &["--tone-width", "64"], &["--tone-width"]);
    refused("captured", "hdr-nerf-grid", &["--device", "gpu"], &["radiance fields are computed on the processor"]);
    // An image without an exposure.
    let mut exposures = place.json("captured/exposure_train.json");
    exposures.as_object_mut().unwrap().remove("r_1_1.png");
    write(&place, "captured/exposure_train.json", &exposures);
    refused("captured", "mono-hdr-nerf-grid", &["--exposures", "middle"], &["captured"]);
    record(&place);
    // An image of another size.
    image::RgbImage::new(SIDE as u32 / 2, SIDE as u32).save(place.path("captured/train/r_2_1.png")).unwrap();
    refused("captured", "hdr-nerf-grid", &[], &["r_2_0", "the image is 12 x 24 pixels"]);
    refused("captured", "mono-hdr-nerf-grid", &["--exposures", "1"], &["r_2_0", "the image is 12 x 24 pixels"]);
    assert!(!place.path("run").exists());
}

#[test]
fn a_study_takes_the_middle_exposure_for_a_method_that_sees_one() {
    let place = Workplace::new();
    record(&place);
    let methods = "hdr-nerf-grid,mono-hdr-nerf-grid";
    place.ok(&["reproduce", "captured", "-o", "study", "--methods", methods, "--seeds", "1", "--iterations", "5"]);
    let tables = std::fs::read_to_string(place.path("study/tables.tex")).unwrap();
    for words in ["hdr-nerf-grid (HDR-NeRF, hash grid)", "mono-hdr-nerf-grid (Mono-HDR-NeRF, hash grid)"] {
        assert!(tables.contains(words), "{tables}");
    }
    let config = std::fs::read_to_string(place.path("study/runs/captured/mono-hdr-nerf-grid/seed_1/config.toml")).unwrap();
    assert!(config.contains("exposures = \"middle\"") && config.contains("supervision = \"both\""), "{config}");
}
