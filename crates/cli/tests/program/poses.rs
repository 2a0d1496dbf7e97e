//! Runs that refine poses, and the files about them.

use crate::common::{VIEWS, Workplace};

#[test]
fn refined_cameras_are_written_reported_and_used() {
    let place = Workplace::new();
    place.train("run", &["--refine-poses", "--refine-focal"]);
    let metrics = place.json("run/metrics.json");
    for split in ["test", "test_aligned", "train"] {
        assert!(metrics["splits"][split]["mean"]["psnr_scene"].as_f64().unwrap() > 0.0, "{split}");
    }
    for name in ["poses", "test_alignment"] {
        for number in ["px", "degrees", "scene_units"] {
            let [mean, largest] = ["mean", "largest"].map(|of| metrics[name][of][number].as_f64().unwrap());
            assert!(mean > 0.0 && largest >= mean, "{name} {number}: {mean} {largest}");
        }
    }
    assert_eq!(metrics["poses"]["focal_factors"].as_array().unwrap().len(), 1);
    let log = std::fs::read_to_string(place.path("run/log.jsonl")).unwrap();
    assert!(log.lines().last().unwrap().contains("\"poses\":{\"mean\":"), "{log}");
    assert!(std::fs::read_to_string(place.path("run/report.html")).unwrap().contains("test_aligned"));
    let cameras = place.json("run/cameras.json");
    assert_eq!((cameras["schema_version"].as_u64(), cameras["frames"].as_array().unwrap().len()), (Some(1), VIEWS));
    let given = place.json("data/transforms.json");
    assert_ne!(cameras["frames"][1]["transform_matrix"], given["frames"][1]["transform_matrix"]);

    // The same metrics from the files alone.
    let out = place.ok(&["eval", "run"]);
    assert!(out.contains("test_aligned"), "{out}");
    let again = place.json("run/metrics.json");
    for split in ["test", "test_aligned", "train"] {
        let [first, second] = [&metrics, &again].map(|metrics| metrics["splits"][split]["mean"]["psnr_scene"].as_f64().unwrap());
        assert!((first - second).abs() < 1e-3, "{split}: {first} {second}");
    }
    assert_eq!(again["poses"], metrics["poses"]);
    // Views are rendered through the refined cameras, and their file is one of cameras.
    let rendered = |args: &[&str]| {
        place.ok(&[&["render", "run", "-o", "out", "--overwrite"], args].concat());
        std::fs::read_dir(place.path("out")).unwrap().count()
    };
    assert!(rendered(&["--cameras", "run/cameras.json"]) >= VIEWS);

    // A run that starts over leaves none of it.
    place.train("run", &["--overwrite"]);
    assert!(!place.path("run/cameras.json").exists());
    assert!(place.json("run/metrics.json")["splits"]["test_aligned"].is_null());
    assert!(!std::fs::read_to_string(place.path("run/log.jsonl")).unwrap().contains("\"poses\""));
}

#[test]
fn options_of_poses_need_poses_to_refine() {
    let place = Workplace::new();
    place.error(&["train", "data", "-o", "run", "--refine-focal"], &["--refine-focal", "--refine-poses only"]);
    place.error(&["train", "data", "-o", "run", "--iterations", "20", "--refine-poses", "--pose-from", "20"], &["20 steps"]);
}
