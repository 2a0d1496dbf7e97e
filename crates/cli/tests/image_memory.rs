//! Runs on data sets whose images have no room in memory.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use common::{SIDE, Workplace};

/// Room for four decoded images of nine.
fn room() -> String {
    format!("{}kB", 4 * 12 * SIDE * SIDE / 1000 + 1)
}

fn scene(place: &Workplace, run: &str) -> Vec<u8> {
    std::fs::read(place.path(&format!("{run}/point_cloud/iteration_40/point_cloud.ply"))).unwrap()
}

#[test]
fn a_run_within_little_memory_is_the_same_each_time_and_close_to_one_in_memory() {
    let place = Workplace::new();
    let room = room();
    place.train("run", &[]);
    place.train("small", &["--image-memory", &room]);
    place.train("again", &["--image-memory", &room, "--checkpoint-every", "15", "--keep-checkpoints", "9"]);
    let psnr = |run: &str| place.json(&format!("{run}/metrics.json"))["splits"]["test"]["mean"]["psnr_scene"].as_f64().unwrap();
    // Stored views are half floats, which differ by 1/2048: far below the error of so few steps.
    assert!((psnr("run") - psnr("small")).abs() < 0.05, "{} {}", psnr("run"), psnr("small"));
    assert!(scene(&place, "small") == scene(&place, "again"));
    assert!(!place.path("run.images").exists(), "all images have room by default");
    // From a state in the middle, with the cache, without it, and with a damaged one.
    let images = place.path("again.images");
    for damage in [0, 1, 2] {
        let checkpoints = std::fs::read_dir(place.path("again/checkpoints")).unwrap();
        let mut found: Vec<_> = checkpoints.map(|entry| entry.unwrap().path()).collect();
        found.sort();
        found[1..].iter().for_each(|later| std::fs::remove_file(later).unwrap());
        match damage {
            0 => {}
            1 => std::fs::remove_dir_all(&images).unwrap(),
            _ => {
                for entry in std::fs::read_dir(&images).unwrap() {
                    std::fs::write(entry.unwrap().path(), "damaged").unwrap();
                }
            }
        }
        place.ok(&["train", "--resume", "-o", "again"]);
        assert!(scene(&place, "small") == scene(&place, "again"), "{damage}");
    }
}

#[test]
fn the_limit_is_said_and_one_that_is_too_small_is_refused() {
    let place = Workplace::new();
    let args = ["train", "data", "-o", "run", "--iterations", "2", "--init-points", "50", "--image-memory"];
    let output = place.luxel(&[&args[..], &[&room()]].concat()).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && stderr.contains("run.images as half floats"), "{stderr}");
    place.error(&[&args[..], &["5kB", "--overwrite"]].concat(), &["3 are in memory at the same time", "give --image-memory 1MiB"]);
    let stderr = place.fails(2, &[&args[..], &["many"]].concat());
    assert!(stderr.contains("such as 4GiB"), "{stderr}");
}
