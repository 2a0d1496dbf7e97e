//! Runs on captured LDR images, with gains and masks, and the files about them.

use luxel_core::Image;

use crate::common::{QUICK, SIDE, VIEWS, Workplace};

fn image_of(place: &Workplace, view: usize) -> Image {
    luxel_io::read_image(&place.path(&format!("data/images/{view:03}.exr")), &Default::default()).unwrap().image
}

/// Writes two captured images of every training view, beside the radiance of the held-out ones.
fn record(place: &Workplace) {
    let mut transforms = place.json("data/transforms.json");
    let frames = transforms["frames"].as_array().unwrap().clone();
    let (mut recorded, mut names) = (Vec::new(), Vec::new());
    std::fs::create_dir_all(place.path("data/ldr")).unwrap();
    for (view, frame) in frames.iter().enumerate() {
        if view % 8 == 0 {
            recorded.push(frame.clone());
            continue;
        }
        for (k, seconds) in [0.5f32, 8.0].into_iter().enumerate() {
            let code = |p: f32| ((p * seconds).powf(1.0 / 2.2) * 0.5 * 255.0).round().min(255.0) as u8;
            let pixels: Vec<u8> = image_of(place, view).pixels.as_flattened().iter().map(|p| code(*p)).collect();
            let name = format!("ldr/{view:03}_{k}");
            let png = image::RgbImage::from_raw(SIDE as u32, SIDE as u32, pixels).unwrap();
            png.save(place.path(&format!("data/{name}.png"))).unwrap();
            let mut frame = frame.clone();
            frame["file_path"] = format!("{name}.png").into();
            frame["exposure"] = seconds.into();
            recorded.push(frame);
            names.push(name);
        }
    }
    transforms["frames"] = recorded.into();
    std::fs::write(place.path("data/transforms.json"), transforms.to_string()).unwrap();
    let split = serde_json::json!({ "train": names, "test": ["images/000", "images/008"] });
    std::fs::write(place.path("data/split.json"), split.to_string()).unwrap();
}

/// Writes two captured images of every training view beside its radiance.
fn record_beside_radiance(place: &Workplace) {
    let radiance = place.json("data/transforms.json");
    record(place);
    let mut both = place.json("data/transforms.json");
    let frames = both["frames"].as_array_mut().unwrap();
    frames.extend(
        radiance["frames"].as_array().unwrap().iter().enumerate().filter(|(view, _)| view % 8 != 0).map(|(_, frame)| frame.clone()),
    );
    std::fs::write(place.path("data/transforms.json"), both.to_string()).unwrap();
    let train: Vec<String> = (0..VIEWS).filter(|view| view % 8 != 0).map(|view| format!("images/{view:03}")).collect();
    let split = serde_json::json!({ "train": train, "test": ["images/000", "images/008"] });
    std::fs::write(place.path("data/split.json"), split.to_string()).unwrap();
}

/// Decibels that a mean over views is above a black image's.
fn above_black_db(metrics: &serde_json::Value, split: &str) -> f64 {
    let mean = &metrics["splits"][split]["mean"];
    mean["psnr_scene"].as_f64().unwrap() - mean["psnr_black_scene"].as_f64().unwrap()
}

/// The least that forty steps learn of the level of the radiance, which a black image misses.
const LEARNED_DB: f64 = 1.0;

#[test]
fn hdr_gs_trains_measures_renders_exports_and_resumes_like_other_methods() {
    let place = Workplace::new();
    record_beside_radiance(&place);
    place.train("run", &["--method", "hdr-gs"]);
    let metrics = place.json("run/metrics.json");
    assert_eq!((&metrics["method"], metrics["splits"]["train"]["views"].as_array().unwrap().len()), (&"hdr-gs".into(), VIEWS - 2));
    for split in ["test", "test_gain_common"] {
        assert!(metrics["splits"][split]["mean"]["psnr_scene"].as_f64().unwrap() > 0.0, "{split}");
    }
    let mappers = place.json("run/captures.json")["tone_mappers"].clone();
    assert_eq!(mappers["numbers"][2].as_array().unwrap().len(), 3 * 128 + 1);
    assert!((mappers["reference_s"].as_f64().unwrap() - 2.0).abs() < 1e-5);
    let before = metrics["splits"]["test"]["mean"]["psnr_scene"].clone();
    place.ok(&["eval", "run", "--threads", "2"]);
    assert_eq!(place.json("run/metrics.json")["splits"]["test"]["mean"]["psnr_scene"], before);
    place.ok(&["render", "run", "-o", "frames", "--threads", "2"]);
    place.ok(&["export", "run", "-o", "scene.glb", "--threads", "2"]);
    place.ok(&["edit", "run", "-o", "edited.ply", "--compress-above", "1:2"]);
    place.ok(&["train", "--resume", "-o", "run", "--iterations", "45", "--threads", "2"]);
    assert_eq!(place.json("run/metrics.json")["iterations"], 45);
}

#[test]
fn hdr_gs_needs_pairs_and_refuses_what_it_does_not_have() {
    let place = Workplace::new();
    let refused = |more: &[&str], parts: &[&str]| {
        let mut args = vec!["train", "data", "-o", "run"];
        args.extend(QUICK);
        args.extend(more);
        place.error(&args, parts);
    };
    refused(&["--method", "hdr-gs"], &["no captured LDR images with exposures beside the radiance"]);
    record_beside_radiance(&place);
    refused(&["--method", "hdr-gs", "--supervision", "hdr"], &["trains on captured images beside radiance", "--supervision both"]);
    refused(&["--supervision", "both"], &["method lcd trains on one kind of images"]);
    refused(
        &["--method", "hdr-gs", "--cutoffs", "hdr"],
        &["--cutoffs: has an effect with --method lcd, sh0, sh1, sh2, sh3, sh4, sh5, logsh3 or lcd-anchors only"],
    );
    refused(&["--tone-width", "64"], &["--tone-width: has an effect with --method hdr-gs only"]);
    refused(&["--feature-lr", "1"], &["--feature-lr: has an effect with --method gausshdr only"]);
    refused(&["--method", "gausshdr", "--supervision", "both"], &["trains on captured images alone, expected ldr", "--supervision ldr"]);
    refused(&["--method", "gausshdr", "--strategy", "mcmc"], &["strategy", "method gausshdr has no other"]);
    refused(&["--method", "hdr-gs", "--batch", "2"], &["batch", "method hdr-gs has no other"]);
    refused(&["--method", "mono-hdr-gs"], &["captured images of 0.5, 8 s, expected one exposure for all", "--exposures middle"]);
    refused(&["--method", "hdr-gs", "--cycle-weight", "1"], &["--cycle-weight: has an effect with --method mono-hdr-gs only"]);
}

#[test]
fn mono_hdr_gs_trains_measures_renders_exports_and_resumes_like_other_methods() {
    let place = Workplace::new();
    record_beside_radiance(&place);
    place.train("run", &["--method", "mono-hdr-gs", "--exposures", "1"]);
    let metrics = place.json("run/metrics.json");
    assert_eq!(metrics["method"], "mono-hdr-gs");
    let means = |metrics: &serde_json::Value| {
        let splits = ["test", "test_folded", "test_folded_gain_common", "test_gain_common", "train"];
        splits.map(|split| metrics["splits"][split]["mean"]["psnr_scene"].as_f64().unwrap())
    };
    assert!(means(&metrics).iter().all(|psnr| *psnr > 0.0), "{:?}", means(&metrics));
    place.ok(&["eval", "run", "--threads", "2"]);
    assert_eq!(means(&place.json("run/metrics.json")), means(&metrics));
    // The run's own renders are those that its metrics are of; its scene file has no lift.
    place.ok(&["render", "run", "-o", "frames", "--threads", "2"]);
    let render = |path: &str| luxel_io::read_image(&place.path(path), &Default::default()).unwrap().image.pixels;
    let evaluated = render("run/eval/step_40/renders/000.exr");
    let rendered = render("frames/000.exr");
    let worst = evaluated.as_flattened().iter().zip(rendered.as_flattened());
    assert!(worst.map(|(a, b)| (a - b).abs() / (a.abs() + 1e-3)).fold(0.0, f32::max) < 2e-3);
    let scene = "run/point_cloud/iteration_40/point_cloud.ply";
    assert!(place.ok(&["info", scene]).contains("logsh3"));
    place.ok(&["export", "run", "-o", "scene.glb", "--threads", "2"]);
    place.ok(&["edit", "run", "-o", "edited.ply", "--compress-above", "1:2"]);
    place.ok(&["train", "--resume", "-o", "run", "--iterations", "45", "--threads", "2"]);
    assert_eq!(place.json("run/metrics.json")["iterations"], 45);
    std::fs::remove_dir_all(place.path("run/checkpoints")).unwrap();
    place.error(&["eval", "run"], &["the lift to radiance of step 45", "--resume"]);
}

#[test]
fn gausshdr_trains_on_captured_images_alone_and_is_a_run_like_others() {
    let place = Workplace::new();
    let args = ["train", "data", "-o", "run", "--method", "gausshdr"];
    place.error(&[&args[..], &QUICK[..]].concat(), &["holds radiance, expected a captured LDR image"]);
    record(&place);
    place.train("run", &["--method", "gausshdr"]);
    let metrics = place.json("run/metrics.json");
    assert_eq!((&metrics["method"], metrics["splits"]["train"]["views"].as_array().unwrap().len()), (&"gausshdr".into(), 2 * (VIEWS - 2)));
    let means = |metrics: &serde_json::Value| {
        ["test", "test_gain_common", "train"].map(|split| metrics["splits"][split]["mean"]["psnr_scene"].as_f64().unwrap())
    };
    for split in ["test", "test_gain_common", "train"] {
        let above = above_black_db(&metrics, split);
        assert!(above > LEARNED_DB, "{split}: {above} dB");
    }
    assert_eq!(place.json("run/captures.json")["response"]["recorded"][1].as_array().unwrap().len(), 32);
    place.ok(&["eval", "run", "--threads", "2"]);
    assert_eq!(means(&place.json("run/metrics.json")), means(&metrics));
    place.ok(&["render", "run", "-o", "frames", "--threads", "2"]);
    assert!(place.ok(&["info", "run/point_cloud/iteration_40/point_cloud.ply"]).contains("logsh3"));
    place.ok(&["export", "run", "-o", "scene.glb", "--threads", "2"]);
    place.ok(&["train", "--resume", "-o", "run", "--iterations", "45", "--threads", "2"]);
    assert_eq!(place.json("run/metrics.json")["iterations"], 45);
    // The response of a state without captures.json is that of its checkpoint.
    let before = means(&place.json("run/metrics.json"));
    std::fs::remove_file(place.path("run/captures.json")).unwrap();
    place.ok(&["eval", "run", "--threads", "2"]);
    assert_eq!(means(&place.json("run/metrics.json")), before);
}

#[test]
fn pairs_are_read_as_radiance_as_captured_images_or_both_with_and_without_a_split() {
    let place = Workplace::new();
    record_beside_radiance(&place);
    for has_split in [true, false] {
        if !has_split {
            std::fs::remove_file(place.path("data/split.json")).unwrap();
        }
        for (supervision, train) in [("hdr", VIEWS - 2), ("ldr", 2 * (VIEWS - 2)), ("both", VIEWS - 2)] {
            let told = place.ok(&["info", "data", "--supervision", supervision]);
            let count = |words: &str| told.lines().find_map(|line| line.strip_prefix(words)).unwrap().trim().parse::<usize>().unwrap();
            assert_eq!((count("train views"), count("test views")), (train, 2), "{supervision} {has_split}");
        }
    }
}

#[test]
fn a_study_measures_methods_with_and_without_radiance_by_one_scale() {
    let place = Workplace::new();
    record_beside_radiance(&place);
    let study = |methods: &str| {
        let options = ["--seeds", "1", "--iterations", "20", "--init-points", "50", "--threads", "2"];
        place.ok(&[&["reproduce", "data", "-o", "study", "--methods", methods][..], &options].concat());
    };
    let scales = || {
        let runs = std::fs::read_to_string(place.path("study/runs.csv")).unwrap();
        let rows: Vec<Vec<String>> = runs.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect();
        let column = rows[0].iter().position(|name| name == "radiance_scale").unwrap();
        rows[1..].iter().map(|row| row[column].clone()).collect::<Vec<_>>()
    };
    study("gausshdr");
    let own = scales();
    study("gausshdr,sh0");
    let one = scales();
    assert!(own.len() == 1 && one.len() == 2 && one[0] == one[1] && one[0] != own[0], "{own:?} {one:?}");
    let run = "study/runs/data/gausshdr/seed_1";
    // What the run itself says stays, until it is asked for another scale.
    let of_run = || place.json(&format!("{run}/metrics.json"));
    assert_eq!(of_run()["radiance_scale"].to_string(), own[0]);
    place.ok(&["eval", run, "--scale", &one[0], "--threads", "2"]);
    let asked = of_run();
    assert_eq!(asked["radiance_scale"].to_string(), one[0]);
    for split in ["test", "test_gain_common"] {
        let psnr = |metrics: &serde_json::Value| metrics["splits"][split]["mean"]["psnr_scene"].as_f64().unwrap();
        let of_study = place.json(&format!("{run}/measured.json"))["by_scale"].clone();
        assert_eq!(psnr(&of_study), psnr(&asked), "{split}");
    }
    place.fails(2, &["eval", run, "--scale", "0"]);
}

#[test]
fn a_run_on_recordings_tells_the_response_and_figures_with_and_without_its_scale() {
    let place = Workplace::new();
    record(&place);
    place.train("run", &["--supervision", "ldr", "--exposure-compensation", "exposure"]);
    let captures = place.json("run/captures.json");
    assert_eq!(captures["gains_ev"].as_object().unwrap().len(), 2 * (VIEWS - 2));
    let recorded = captures["response"]["recorded"][1].as_array().unwrap();
    assert!((recorded[20].as_f64().unwrap() - 0.5).abs() < 1e-6, "{recorded:?}");
    let splits = place.json("run/metrics.json")["splits"].clone();
    for split in ["test", "test_gain_common", "test_gain_per_view"] {
        assert!(splits[split]["mean"]["psnr_scene"].as_f64().unwrap() > 0.0, "{split}");
        assert!(splits[split]["mean"]["pu21_psnr"].is_number(), "{split}");
    }
    // Recorded values have no metrics that need radiance.
    assert_eq!(splits["train"]["views"].as_array().unwrap().len(), 2 * (VIEWS - 2));
    assert!(splits["train"]["mean"]["psnr_scene"].is_number() && splits["train"]["mean"]["pu21_psnr"].is_null());
    // The same metrics from the files alone, and a run that is resumed.
    let before = splits["train"]["mean"]["psnr_scene"].clone();
    place.ok(&["eval", "run", "--threads", "2"]);
    assert_eq!(place.json("run/metrics.json")["splits"]["train"]["mean"]["psnr_scene"], before);
    place.ok(&["train", "--resume", "-o", "run", "--iterations", "45", "--threads", "2"]);
    assert_eq!(place.json("run/metrics.json")["iterations"], 45);
}

#[test]
fn an_interrupted_run_is_evaluated_with_the_response_of_its_state() {
    let place = Workplace::new();
    record(&place);
    place.train("run", &["--supervision", "ldr", "--checkpoint-every", "20", "--keep-checkpoints", "3"]);
    // As in a run of more steps that is stopped after the first evaluation: the newest scene is
    // that of a checkpoint.
    for entry in ["checkpoints/step_000000040.safetensors", "point_cloud/iteration_40/point_cloud.ply", "eval/step_40/metrics.json"] {
        std::fs::remove_file(place.path("run").join(entry)).unwrap();
    }
    let mut captures = place.json("run/captures.json");
    assert_eq!(captures["iteration"], 40);
    for knots in captures["response"]["recorded"].as_array_mut().unwrap() {
        knots.as_array_mut().unwrap().iter_mut().for_each(|knot| *knot = (0.5 * knot.as_f64().unwrap()).into());
    }
    std::fs::write(place.path("run/captures.json"), captures.to_string()).unwrap();
    let figures = || {
        place.ok(&["eval", "run", "--threads", "2"]);
        let metrics = place.json("run/metrics.json");
        assert_eq!(metrics["iterations"], 20);
        metrics["splits"].clone()
    };
    let beside_another = figures();
    std::fs::remove_file(place.path("run/captures.json")).unwrap();
    assert_eq!(beside_another, figures());
    // Where none of that step is left, that is an error.
    std::fs::create_dir_all(place.path("run/point_cloud/iteration_20")).unwrap();
    place.ok(&["edit", "run", "--gain", "1", "-o", "run/point_cloud/iteration_20/point_cloud.ply"]);
    std::fs::remove_dir_all(place.path("run/checkpoints")).unwrap();
    place.error(&["eval", "run"], &["the camera's response of step 20", "--resume"]);
}

#[test]
fn metrics_are_taken_through_the_vignetting_that_a_run_tells() {
    let place = Workplace::new();
    place.train("run", &["--vignetting"]);
    let metrics = place.json("run/metrics.json");
    let lenses = metrics["vignetting"].as_array().unwrap();
    assert_eq!((lenses.len(), &lenses[0]["views"], &lenses[0]["size_px"]), (1, &(VIEWS - 2).into(), &serde_json::json!([SIDE, SIDE])));
    assert!(lenses[0]["corner_ev"].as_f64().unwrap() != 0.0, "{lenses:?}");
    assert_eq!(place.json("run/captures.json")["vignetting"], metrics["vignetting"]);
    let told = format!("{:+.2} EV in the corners", lenses[0]["corner_ev"].as_f64().unwrap());
    assert!(std::fs::read_to_string(place.path("run/report.html")).unwrap().contains(&told), "{told}");
    assert!(place.ok(&["info", "run"]).contains(&told), "{told}");
    let log = std::fs::read_to_string(place.path("run/log.jsonl")).unwrap();
    assert!(log.lines().last().unwrap().contains("\"vignetting_corner_ev\":["), "{log}");
    // The same from the files alone, and from the checkpoint.
    let evaluated = || {
        place.ok(&["eval", "run", "--threads", "2"]);
        let again = place.json("run/metrics.json");
        for split in ["test", "train"] {
            assert_eq!(again["splits"][split]["mean"], metrics["splits"][split]["mean"], "{split}");
        }
        assert_eq!(again["vignetting"], metrics["vignetting"]);
    };
    evaluated();
    std::fs::remove_file(place.path("run/captures.json")).unwrap();
    evaluated();
}

#[test]
fn radiance_alone_writes_nothing_about_captures() {
    let place = Workplace::new();
    place.train("run", &[]);
    assert!(!place.path("run/captures.json").exists());
    let splits = place.json("run/metrics.json")["splits"].clone();
    assert_eq!(splits.as_object().unwrap().keys().collect::<Vec<_>>(), ["test", "train"]);
}

#[test]
fn masks_are_named_by_an_option_or_lie_beside_the_data() {
    let place = Workplace::new();
    let black = image::GrayImage::new(SIDE as u32, SIDE as u32);
    std::fs::create_dir_all(place.path("data/masks")).unwrap();
    for view in 0..VIEWS {
        black.save(place.path(&format!("data/masks/{view:03}.png"))).unwrap();
    }
    let mut args = vec!["train", "data", "-o", "run"];
    args.extend(QUICK);
    place.error(&args, &["no training view has a valid pixel"]);
    place.train("run", &["--masks", "off"]);
    let mut args = vec!["train", "data", "-o", "other", "--masks", "none-there"];
    args.extend(QUICK);
    place.error(&args, &["none-there", "is not a folder"]);
}

#[test]
fn recordings_need_their_kind_of_data() {
    let place = Workplace::new();
    let mut args = vec!["train", "data", "-o", "run", "--supervision", "ldr"];
    args.extend(QUICK);
    place.error(&args, &["holds radiance, expected a captured LDR image"]);
    record(&place);
    let mut args = vec!["train", "data", "-o", "run", "--supervision", "ldr", "--exposures", "3"];
    args.extend(QUICK);
    place.error(&args, &["no bracket has exposures 3"]);
    // One exposure for all does not determine a response, which is reported.
    let mut args = vec!["train", "data", "-o", "run", "--supervision", "ldr", "--exposures", "0"];
    args.extend(QUICK);
    let output = place.luxel(&args).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && stderr.contains("the same exposure"), "{stderr}");
}
