//! Anchors from the command line: trained, evaluated, rendered, resumed, and refused where splats
//! are needed.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use common::Workplace;

/// Options of the shortest run that means something.
const ANCHORS: [&str; 10] = ["train", "data", "--method", "lcd-anchors", "--iterations", "30", "--eval-at", "0", "--init-points", "300"];

fn train(place: &Workplace, run: &str, more: &[&str]) {
    place.ok(&[&ANCHORS[..], &["-o", run], more].concat());
}

fn anchors(place: &Workplace, run: &str) -> Vec<u8> {
    std::fs::read(place.path(run).join("anchors/iteration_30/anchors.safetensors")).unwrap()
}

#[test]
fn anchors_are_trained_evaluated_and_rendered_like_splats() {
    let place = Workplace::new();
    train(&place, "run", &["--threads", "2", "--max-splats", "500"]);
    let metrics = place.json("run/metrics.json");
    assert_eq!((&metrics["method"], &metrics["iterations"]), (&"lcd-anchors".into(), &30.into()));
    let splats = metrics["splats"].as_u64().unwrap();
    assert!(splats > 0 && splats <= 500 && splats.is_multiple_of(10) && metrics["field_parameters"].is_null(), "{metrics}");
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
    assert!(told.contains("lcd-anchors") && told.contains("anchors") && told.contains("lcd-c0-l0"), "{told}");
    assert!(place.ok(&["info", "run/anchors/iteration_30/anchors.safetensors"]).contains("anchors"));
}

#[test]
fn threads_and_an_interruption_change_no_bit_of_anchors() {
    let place = Workplace::new();
    train(&place, "unbroken", &["--threads", "1"]);
    train(&place, "threads", &["--threads", "3"]);
    assert_eq!(anchors(&place, "threads"), anchors(&place, "unbroken"));
    // What an interrupted run leaves: its last checkpoint is of step 20, and nothing is newer.
    train(&place, "broken", &["--threads", "2", "--checkpoint-every", "10", "--keep-checkpoints", "9"]);
    std::fs::remove_file(place.path("broken/checkpoints/step_000000030.safetensors")).unwrap();
    for folder in ["anchors", "eval"] {
        std::fs::remove_dir_all(place.path("broken").join(folder)).unwrap();
    }
    let told = place.luxel(&["train", "--resume", "-o", "broken"]).output().unwrap();
    let stderr = String::from_utf8_lossy(&told.stderr).into_owned() + &String::from_utf8_lossy(&told.stdout);
    assert!(told.status.success() && stderr.contains("resuming after step 20"), "{stderr}");
    assert_eq!(anchors(&place, "broken"), anchors(&place, "unbroken"));
    // A damaged newest checkpoint is skipped.
    std::fs::write(place.path("broken/checkpoints/step_000000030.safetensors"), "torn").unwrap();
    std::fs::remove_dir_all(place.path("broken/anchors")).unwrap();
    place.ok(&["train", "--resume", "-o", "broken"]);
    assert_eq!(anchors(&place, "broken"), anchors(&place, "unbroken"));
}

#[test]
fn what_needs_splats_refuses_anchors_by_name() {
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
        place.error(command, &["holds anchors (lcd-anchors)", "no splats"]);
    }
    let file = "run/anchors/iteration_30/anchors.safetensors";
    place.error(&["export", file, "-o", "scene.ply"], &["anchors", "no splats", "folder of its run"]);
}

#[test]
fn options_and_data_that_anchors_do_not_have_are_refused() {
    let place = Workplace::new();
    let refused = |more: &[&str], parts: &[&str]| place.error(&[&ANCHORS[..], &["-o", "run"], more].concat(), parts);
    refused(&["--sh-lr", "0.1"], &["--sh-lr", "--method lcd"]);
    refused(&["--hold-out", "0.1"], &["--hold-out", "--method lcd"]);
    refused(&["--refine-display", "5"], &["--refine-display", "--method lcd"]);
    refused(&["--antialias", "mip"], &["--antialias", "off or pixel"]);
    refused(&["--device", "gpu"], &["anchors are decoded and trained on the processor", "--device cpu"]);
    refused(&["--profile"], &["--profile", "anchors"]);
    place.error(&["train", "data", "-o", "run", "--method", "gausshdr-anchors"], &["expected a captured LDR image", "--supervision hdr"]);
    assert!(!place.path("run").exists());
    train(&place, "run", &["--activation", "exp"]);
    place.error(&["train", "--resume", "-o", "run", "--activation", "softplus"], &["--activation"]);
    place.error(&["demo", "--method", "lcd-anchors", "-o", "demo"], &["demo trains splats"]);
}

#[test]
fn a_study_has_anchors_among_its_methods() {
    let place = Workplace::new();
    let study = ["reproduce", "data", "-o", "study", "--seeds", "1", "--iterations", "20", "--init-points", "50"];
    place.ok(&[&study[..], &["--methods", "lcd-anchors,sh0"]].concat());
    let tables = std::fs::read_to_string(place.path("study/tables.tex")).unwrap();
    assert!(tables.contains("lcd-anchors (LCD on anchors)"), "{tables}");
}
