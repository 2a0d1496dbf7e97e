//! What the program prints, where, and what it does not print.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use common::Workplace;

#[cfg(target_os = "linux")]
#[test]
fn graphics_drivers_are_quiet_without_a_display() {
    let place = Workplace::new();
    let said = |args: &[&str]| {
        let output = place.luxel(args).output().unwrap();
        (output.status.success(), String::from_utf8(output.stderr).unwrap())
    };
    assert_eq!(said(&["info", "--devices"]), (true, String::new()));
    let quiet = ["train", "data", "-o", "run", "--iterations", "2", "--init-points", "20", "--device", "auto", "-q"];
    assert_eq!(said(&quiet), (true, String::new()));
}

#[cfg(target_os = "linux")]
#[test]
fn texts_that_cannot_be_written_are_an_error() {
    let place = Workplace::empty();
    for args in [&["help"][..], &["--help"], &["--version"], &["render", "--help"], &["help", "train"], &["completions", "zsh"]] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_luxel")).args(args).stdout(full).output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{args:?}: {stderr}");
        assert!(stderr.starts_with("error: cannot write to standard output"), "{args:?}: {stderr}");
        // A reader that leaves is no error.
        place.ok_unread(args);
    }
    assert!(place.fails(2, &["rendre"]).contains("unrecognized subcommand"));
}

#[test]
fn no_colours_are_printed_into_a_pipe() {
    let place = Workplace::new();
    place.train("run", &[]);
    for args in [
        &["help"][..],
        &["rendre"],
        &["train", "data"],
        &["info", "run"],
        &["eval", "run"],
        &["render", "run", "-o", "frames"],
        &["render", "nowhere", "-o", "frames"],
        &["train", "data", "-o", "again", "--iterations", "2", "--init-points", "20"],
    ] {
        let output = place.luxel(args).output().unwrap();
        assert!(!output.stdout.contains(&0x1b) && !output.stderr.contains(&0x1b), "{args:?}: {output:?}");
    }
}

#[test]
fn pictures_without_poses_and_data_sets_that_moved_have_a_remedy() {
    let place = Workplace::new();
    for folder in ["data/images", "photos/images"] {
        std::fs::create_dir_all(place.path(folder)).unwrap();
        std::fs::copy(place.path("data/images/000.exr"), place.path(folder).join("DSC_1.JPG")).unwrap();
        let name = folder.split('/').next().filter(|name| *name == "photos").unwrap_or(folder);
        place.error(
            &["train", name, "-o", "x"],
            &["pictures without poses", "DSC_1.JPG", "remedy: make a data set", &format!("{folder}, and")],
        );
    }
    std::fs::remove_file(place.path("data/images/DSC_1.JPG")).unwrap();
    std::fs::create_dir(place.path("empty")).unwrap();
    assert!(!place.fails(1, &["train", "empty", "-o", "x"]).contains("luxel prepare"));

    place.train("run", &[]);
    std::fs::rename(place.path("data"), place.path("moved")).unwrap();
    let what = "data: the data set of the run run is not there";
    for args in [
        &["eval", "run"][..],
        &["render", "run", "-o", "frames"],
        &["export", "run", "-o", "a.ply"],
        &["probe", "run", "--at", "0,0,0", "-o", "a.exr"],
        &["edit", "run", "--gain", "2", "-o", "a.ply", "--overlay", "a.png"],
    ] {
        place.error(args, &[what, "remedy: give --data"]);
    }
    place.error(&["train", "--resume", "-o", "run"], &[what, "remedy: name its new folder: luxel train DATASET --resume -o RUN"]);
    place.error(&["train", "--config", "run/config.toml", "-o", "b"], &["remedy: name its new folder: luxel train DATASET --config"]);
    place.ok(&["eval", "run", "--data", "moved"]);
    place.ok(&["train", "moved", "--resume", "-o", "run", "--iterations", "41"]);
}

#[test]
fn tables_and_descriptions_fit_into_a_terminal() {
    let place = Workplace::new();
    place.train("run", &[]);
    let long = "a folder of a project of a year of a studio";
    for folder in ["a", "b"] {
        std::fs::create_dir_all(place.path(folder)).unwrap();
        for name in ["", "2"] {
            std::fs::copy(place.path("data/images/000.exr"), place.path(&format!("{folder}/{long}{name}.exr"))).unwrap();
        }
    }
    let (scene, state) = ("run/point_cloud/iteration_40/point_cloud.ply", "run/checkpoints/step_000000040.safetensors");
    for args in [
        &["eval", "run", "--metrics", "all"][..],
        &["compare", "a", "b"],
        &["compare", &format!("a/{long}.exr"), &format!("b/{long}.exr")],
        &["info", "run"],
        &["info", "data"],
        &["info", scene],
        &["info", state],
        &["info", "data/images/000.exr"],
        &["info", "--devices"],
    ] {
        let text = place.ok(args);
        // A path has no place to break it.
        let long = text.lines().find(|line| line.chars().count() > 80 && !line.contains("/tmp/") && !line.contains(".exr"));
        assert_eq!(long, None, "{args:?}\n{text}");
    }
}

#[test]
fn ffmpeg_is_looked_for_before_frames_are_rendered() {
    let place = Workplace::new();
    place.train("run", &[]);
    let args = ["render", "run", "-o", "frames", "--video", "a.mp4", "--tonemap", "agx", "--ffmpeg", "no-such-ffmpeg"];
    place.error(&args, &["no-such-ffmpeg: no such program", "install ffmpeg", "--ffmpeg"]);
    assert!(!place.path("frames").exists());
}
