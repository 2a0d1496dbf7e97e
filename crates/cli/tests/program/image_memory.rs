//! Runs on data sets whose images have no room in memory.

use luxel::Downscale;
use luxel_app::run::RunFolder;
use luxel_core::Image;

use crate::common::{self, SIDE, VIEWS, Workplace, write_image};

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

/// Makes the images of the data set so many times as wide.
fn widen(place: &Workplace, times: usize) {
    let path = place.path("data/transforms.json");
    let mut json = place.json("data/transforms.json");
    json["w"] = (SIDE * times).into();
    for key in ["fl_x", "cx"] {
        json[key] = (json[key].as_f64().unwrap() * times as f64).into();
    }
    std::fs::write(path, json.to_string()).unwrap();
    for view in 0..VIEWS {
        let name = format!("data/images/{view:03}.exr");
        let Image { width, height, pixels } = place.image(&name);
        let wide = pixels.iter().flat_map(|pixel| std::iter::repeat_n(*pixel, times)).collect();
        write_image(&place.path(&name), &Image::from_pixels(width * times, height, wide).unwrap());
    }
}

#[test]
fn large_images_are_reduced_by_default_and_a_run_keeps_the_factor() {
    let place = Workplace::new();
    let few = ["--iterations", "2", "--init-points", "50", "--refine-display", "0", "--threads", "2"];
    let train = |run: &str, more: &[&str]| place.notes(&[&["train", "data", "-o", run][..], &few, more].concat());
    let factor = |run: &str| RunFolder::open(&place.path(run)).unwrap().1.load.downscale;
    // Small images stay as they are, without a word.
    let small = train("small", &[]);
    assert!(!small.contains("reduced") && factor("small") == Downscale::FULL_SIZE, "{small}");
    widen(&place, 100);
    let told = train("run", &[]);
    assert!(told.contains("reduced 2 times along each side, from 2400x24 to 1200x12 pixels"), "{told}");
    assert!(told.contains(", 1200x12") && factor("run") == Downscale::By(2), "{told}");
    let full = train("full", &["--downscale", "1"]);
    assert!(full.contains(", 2400x24") && factor("full") == Downscale::FULL_SIZE, "{full}");
    let told = place.notes(&["train", "--resume", "-o", "run", "--iterations", "3"]);
    assert!(told.contains(", 1200x12") && factor("run") == Downscale::By(2), "{told}");
    let information = place.notes(&["info", "data"]);
    assert!(information.contains("reduced 2 times"), "{information}");
    // What measures the run reads images of another size as the run did.
    common::write_dataset(&place.path("data"));
    let told = place.notes(&["eval", "run"]);
    assert!(told.contains(", 12x12") && !told.contains("reduced"), "{told}");
}
