//! Radiance fields from the command line: trained, evaluated, rendered, resumed, and refused where
//! splats are needed.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use common::Workplace;

/// Options of the shortest run that means something.
const FIELD: [&str; 8] = ["train", "data", "--method", "nerf-grid", "--iterations", "30", "--eval-at", "0"];

fn train(place: &Workplace, run: &str, more: &[&str]) {
    place.ok(&[&FIELD[..], &["-o", run], more].concat());
}

fn field(place: &Workplace, run: &str) -> Vec<u8> {
    std::fs::read(place.path(run).join("field/iteration_30/field.safetensors")).unwrap()
}

#[test]
fn a_field_is_trained_evaluated_and_rendered_like_splats() {
    let place = Workplace::new();
    train(&place, "run", &["--threads", "2"]);
    let metrics = place.json("run/metrics.json");
    assert_eq!((&metrics["method"], &metrics["iterations"], &metrics["splats"]), (&"nerf-grid".into(), &30.into(), &0.into()));
    assert!(metrics["field_parameters"].as_u64().unwrap() > 100_000, "{metrics}");
    assert!(metrics["splits"]["test"]["mean"]["psnr_scene"].is_f64(), "{metrics}");
    assert!(place.path("run/report.html").is_file() && place.path("run/log.jsonl").is_file());
    // Measured again, it is the same to the bit.
    let before = metrics["splits"]["test"]["mean"].clone();
    place.ok(&["eval", "run", "--threads", "1"]);
    assert_eq!(place.json("run/metrics.json")["splits"]["test"]["mean"], before);
    place.ok(&["render", "run", "-o", "renders", "--alpha", "--depth", "--samples", "2"]);
    let images = std::fs::read_dir(place.path("renders"))
        .unwrap()
        .filter(|entry| entry.as_ref().unwrap().path().extension().is_some_and(|extension| extension == "exr"));
    assert!(images.count() > 0);
    let told = place.ok(&["info", "run"]);
    assert!(told.contains("nerf-grid") && told.contains("grid levels"), "{told}");
    assert!(place.ok(&["info", "run/field/iteration_30/field.safetensors"]).contains("radiance field"));
}

#[test]
fn threads_and_an_interruption_change_no_bit_of_a_field() {
    let place = Workplace::new();
    train(&place, "unbroken", &["--threads", "1"]);
    train(&place, "threads", &["--threads", "3"]);
    assert_eq!(field(&place, "threads"), field(&place, "unbroken"));
    // What an interrupted run leaves: its last checkpoint is of step 20, and nothing is newer.
    train(&place, "broken", &["--threads", "2", "--checkpoint-every", "10", "--keep-checkpoints", "9"]);
    std::fs::remove_file(place.path("broken/checkpoints/step_000000030.safetensors")).unwrap();
    for folder in ["field", "eval"] {
        std::fs::remove_dir_all(place.path("broken").join(folder)).unwrap();
    }
    let told = place.luxel(&["train", "--resume", "-o", "broken"]).output().unwrap();
    let stderr = String::from_utf8_lossy(&told.stderr).into_owned() + &String::from_utf8_lossy(&told.stdout);
    assert!(told.status.success() && stderr.contains("resuming after step 20"), "{stderr}");
    assert_eq!(field(&place, "broken"), field(&place, "unbroken"));
    // A damaged newest checkpoint is skipped.
    std::fs::write(place.path("broken/checkpoints/step_000000030.safetensors"), "torn").unwrap();
    std::fs::remove_dir_all(place.path("broken/field")).unwrap();
    place.ok(&["train", "--resume", "-o", "broken"]);
    assert_eq!(field(&place, "broken"), field(&place, "unbroken"));
}

#[test]
fn what_needs_splats_refuses_a_field_by_name() {
    let place = Workplace::new();
    train(&place, "run", &[]);
    for command in [
        &["export", "run", "-o", "scene.ply"][..],
        &["edit", "run", "-o", "edited.ply", "--gain", "2"],
        &["probe", "run", "-o", "probe.exr", "--at", "0,0,0"],
        &["mix", "run", "run", "-o", "mixed.ply"],
        &["render", "run", "-o", "renders", "--edit", "gain 2"],
        &["train", "data", "-o", "more", "--from", "run"],
    ] {
        place.error(command, &["radiance field (nerf-grid)", "no splats"]);
    }
    let file = "run/field/iteration_30/field.safetensors";
    place.error(&["export", file, "-o", "scene.ply"], &["radiance field", "no splats", "folder of its run"]);
}

#[test]
fn options_and_data_that_are_not_a_fields_are_refused() {
    let place = Workplace::new();
    let refused = |more: &[&str], parts: &[&str]| place.error(&[&FIELD[..], &["-o", "run"], more].concat(), parts);
    refused(&["--max-splats", "10"], &["--max-splats", "--method lcd"]);
    refused(&["--ssim-weight", "0.1"], &["--ssim-weight", "--method lcd"]);
    refused(&["--refine-display", "5"], &["--refine-display", "--method lcd"]);
    refused(&["--device", "gpu"], &["radiance fields are computed on the processor", "--device cpu"]);
    refused(&["--profile"], &["--profile", "radiance field"]);
    place.error(&["train", "data", "-o", "run", "--field-loss", "linear"], &["--field-loss", "--method nerf-grid"]);
    assert!(!place.path("run").exists());
    train(&place, "run", &["--field-loss", "linear"]);
    place.error(&["train", "--resume", "-o", "run", "--field-loss", "mulaw"], &["--field-loss"]);
    place.error(&["demo", "--method", "nerf-grid", "-o", "demo"], &["demo trains splats"]);
}

#[test]
fn a_study_has_fields_among_its_methods() {
    let place = Workplace::new();
    place.ok(&[
        "reproduce",
        "data",
        "-o",
        "study",
        "--methods",
        "nerf-grid,sh0",
        "--seeds",
        "1",
        "--iterations",
        "20",
        "--init-points",
        "50",
    ]);
    let report = std::fs::read_to_string(place.path("study/report.html")).unwrap();
    assert!(report.contains("hash grid") && report.contains("GaussHDR"));
    let tables = std::fs::read_to_string(place.path("study/tables.tex")).unwrap();
    assert!(tables.contains("nerf-grid (NeRF, hash grid)"), "{tables}");
    let plan = place.ok(&["reproduce", "data", "-o", "other", "--methods", "table1", "--seeds", "1", "--iterations", "20", "--dry-run"]);
    assert!(plan.contains("10 runs"), "{plan}");
}
