//! Input from somebody else, and systems that refuse: names that are no text, links, pipes, limits.
#![cfg(unix)]

use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::common::{QUICK, Workplace};

/// Runs a shell command in the folder, in which `$LUXEL` is the program.
fn shell(place: &Workplace, command: &str) -> Output {
    let mut shell = Command::new("bash");
    shell.args(["-c", command]).current_dir(place.path("")).env("LUXEL", env!("CARGO_BIN_EXE_luxel")).env_remove("RUST_LOG");
    shell.stdin(Stdio::null()).output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Fails the test if the program still runs after a minute.
fn ends(place: &Workplace, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_luxel"));
    command.args(args).current_dir(place.path("")).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let start = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > Duration::from_secs(60) {
            child.kill().unwrap();
            panic!("{args:?} does not end");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    child.wait_with_output().unwrap()
}

fn fifo(path: &Path) {
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

#[test]
fn folders_with_names_that_are_no_text_are_written() {
    let place = Workplace::new();
    let run = OsStr::from_bytes(b"run\xff");
    for format in ["text", "json"] {
        let mut command = place.luxel(&["train", "data", "--overwrite", "--log-format", format]);
        let output = command.args(QUICK).arg("-o").arg(run).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        assert!(String::from_utf8_lossy(&output.stdout).contains("report.html") || format == "text");
    }
    let output = place.luxel(&["eval"]).arg(run).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let study = OsStr::from_bytes(b"study\xff");
    let mut command = place.luxel(&["reproduce", "data", "--methods", "lcd", "--seeds", "1", "--iterations", "20", "--init-points", "300"]);
    let output = command.arg("-o").arg(study).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
}

#[test]
fn a_folder_that_was_left_in_its_first_write_can_be_used() {
    let place = Workplace::new();
    for name in ["run", "study"] {
        std::fs::create_dir(place.path(name)).unwrap();
        std::fs::write(place.path(name).join(".luxel-a1b2c3.tmp"), "half").unwrap();
    }
    place.train("run", &[]);
    assert!(!place.path("run/.luxel-a1b2c3.tmp").exists());
    let cell = place.path("study/runs/data/lcd/seed_1");
    std::fs::create_dir_all(&cell).unwrap();
    std::fs::write(cell.join(".lock"), "").unwrap();
    std::fs::write(cell.join(".luxel-a1b2c3.tmp"), "half").unwrap();
    std::fs::write(place.path("study/matrix.toml"), "").unwrap();
    place.ok(&["reproduce", "data", "-o", "study", "--methods", "lcd", "--seeds", "1", "--iterations", "20", "--init-points", "300"]);
    assert!(!cell.join(".luxel-a1b2c3.tmp").exists());
}

#[test]
fn files_of_killed_processes_are_removed_by_the_next_command() {
    let place = Workplace::new();
    place.train("run", &[]);
    let left = ["run", "run/point_cloud/iteration_40", "run/eval/step_40/renders", "run/checkpoints"]
        .map(|folder| place.path(folder).join(".luxel-x.tmp"));
    for path in &left {
        std::fs::write(path, "half").unwrap();
    }
    place.ok(&["eval", "run"]);
    place.train("run", &["--overwrite"]);
    assert!(left.iter().all(|path| !path.exists()), "{left:?}");
}

#[test]
fn a_run_from_somebody_else_makes_nothing_be_written_elsewhere() {
    let place = Workplace::new();
    place.train("run", &[]);
    let home = place.path("home");
    std::fs::create_dir(&home).unwrap();
    std::fs::write(home.join("profile"), "mine").unwrap();
    let names = |folder: &Path| std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name()).collect::<Vec<_>>();
    // A link in the place of a file is replaced.
    for name in ["report.html", "metrics.json", "eval/step_40/metrics.json", "eval/step_40/renders/000.exr"] {
        let link = place.path("run").join(name);
        let _ = std::fs::remove_file(&link);
        symlink(home.join("profile"), &link).unwrap();
    }
    place.ok(&["eval", "run"]);
    assert!(!place.path("run/report.html").is_symlink());
    // A folder that leads out of the run is refused.
    for name in ["eval/step_40/renders", "checkpoints", "point_cloud"] {
        let (folder, aside) = (place.path("run").join(name), place.path("aside"));
        std::fs::rename(&folder, &aside).unwrap();
        symlink(&home, &folder).unwrap();
        let output = match name {
            "eval/step_40/renders" => place.luxel(&["eval", "run"]).output().unwrap(),
            _ => place.luxel(&["train", "--resume", "-o", "run", "--iterations", "60"]).output().unwrap(),
        };
        let names = names(&home);
        assert!(names == ["profile"], "{name}: {names:?}\n{}", stderr(&output));
        std::fs::remove_file(&folder).unwrap();
        std::fs::rename(&aside, &folder).unwrap();
    }
    std::fs::remove_file(place.path("run/.lock")).unwrap();
    symlink(home.join("lock"), place.path("run/.lock")).unwrap();
    place.error(&["eval", "run"], &["run/.lock", "is a link"]);
    assert_eq!(std::fs::read_to_string(home.join("profile")).unwrap(), "mine");
    assert_eq!(names(&home), ["profile"]);
}

#[test]
fn frames_are_not_written_through_links() {
    let place = Workplace::new();
    place.train("run", &[]);
    std::fs::create_dir_all(place.path("frames")).unwrap();
    std::fs::write(place.path("mine.exr"), "mine").unwrap();
    for i in 0..9 {
        symlink(place.path("none").join(format!("{i}.exr")), place.path(&format!("frames/{i:03}.exr"))).unwrap();
    }
    place.ok(&["render", "run", "--split", "all", "-o", "frames"]);
    assert!(!place.path("none").exists());
}

#[test]
fn pipes_are_refused_where_a_file_is_expected() {
    let place = Workplace::new();
    place.train("run", &[]);
    for name in ["a.safetensors", "a.ply", "a.exr", "a.json", "config.toml", "cameras.json", "data/points.ply"] {
        fifo(&place.path(name));
    }
    let mut transforms = place.json("data/transforms.json");
    transforms["ply_file_path"] = "points.ply".into();
    std::fs::write(place.path("data/transforms.json"), transforms.to_string()).unwrap();
    for args in [
        &["info", "a.safetensors"][..],
        &["info", "a.ply"],
        &["info", "a.exr"],
        &["info", "a.json"],
        &["info", "data"],
        &["train", "--config", "config.toml", "-o", "new"],
        &["train", "data", "-o", "new"],
        &["render", "run/point_cloud/iteration_40/point_cloud.ply", "--cameras", "cameras.json", "-o", "frames"],
        &["compare", "a.exr", "a.exr"],
    ] {
        let output = ends(&place, args);
        let message = stderr(&output);
        assert!(output.status.code() == Some(1) && message.contains("not a regular file"), "{args:?}: {:?}\n{message}", output.status);
    }
    for name in ["log.jsonl", "metrics.json", ".lock", "checkpoints/step_000000040.safetensors"] {
        let (path, aside) = (place.path("run").join(name), place.path("aside"));
        std::fs::rename(&path, &aside).unwrap();
        fifo(&path);
        for args in [&["info", "run"][..], &["eval", "run"], &["train", "--resume", "-o", "run"]] {
            ends(&place, args);
        }
        let _ = std::fs::remove_file(&path);
        std::fs::rename(&aside, &path).unwrap();
    }
}

#[test]
fn escapes_in_names_do_not_reach_the_terminal() {
    let place = Workplace::new();
    let name = "a\u{1b}]0;owned\u{7}\nqq.exr";
    std::fs::copy(place.path("data").join(first_image(&place)), place.path(name)).unwrap();
    let mut transforms = place.json("data/transforms.json");
    transforms["frames"][0]["file_path"] = format!("../{name}").into();
    std::fs::write(place.path("data/transforms.json"), transforms.to_string()).unwrap();
    let outputs = [
        place.luxel(&["info", name]).output().unwrap(),
        place.luxel(&["info", "data"]).output().unwrap(),
        place.luxel(&["info", &format!("none{name}")]).output().unwrap(),
        place.luxel(&["train", "data", "-o", "run"]).args(QUICK).output().unwrap(),
        place.luxel(&["eval", "run"]).output().unwrap(),
    ];
    for output in &outputs {
        for text in [&output.stdout, &output.stderr] {
            let text = String::from_utf8_lossy(text);
            assert!(!text.contains(['\u{1b}', '\u{7}']), "{text}");
        }
        // Tables have a line for each name.
        assert!(!String::from_utf8_lossy(&output.stdout).contains("\nqq"), "{output:?}");
    }
    assert!(outputs[2].status.code() == Some(1) && stderr(&outputs[2]).contains("\\u{1b}]0;owned\\u{7}"));
}

#[test]
fn a_photograph_with_a_line_feed_in_its_name_is_left_out_on_one_line() {
    let place = Workplace::new();
    std::fs::create_dir(place.path("photos")).unwrap();
    let image = place.path("data").join(first_image(&place));
    for name in ["photos/a.exr", "photos/b\nc.exr"] {
        std::fs::copy(&image, place.path(name)).unwrap();
    }
    let output = place.luxel(&["prepare", "photos", "-o", "set", "--sfm", "off"]).output().unwrap();
    let message = stderr(&output);
    assert!(output.status.success() && message.contains("b\\nc.exr is left out: its name holds a line feed"), "{message}");
    assert!(!message.contains("\nc.exr"), "{message}");
}

#[test]
fn pipes_and_files_in_the_place_of_a_set_or_a_folder_are_named() {
    let place = Workplace::new();
    std::fs::create_dir(place.path("set")).unwrap();
    fifo(&place.path("set/transforms.json"));
    place.error(&["info", "set"], &["transforms.json: not a regular file"]);
    place.train("run", &[]);
    place.error(&["render", "run", "-o", "data/transforms.json"], &["data/transforms.json: is a file, expected a folder"]);
}

fn first_image(place: &Workplace) -> PathBuf {
    place.json("data/transforms.json")["frames"][0]["file_path"].as_str().unwrap().into()
}

#[test]
fn logs_in_files_have_no_colours() {
    let place = Workplace::new();
    let output = place.luxel(&["train", "data", "-o", "run"]).args(QUICK).env("RUST_LOG", "trace").output().unwrap();
    assert!(!stderr(&output).contains('\u{1b}'));
}

#[test]
fn a_limit_on_file_sizes_is_an_error() {
    let place = Workplace::new();
    let quick = QUICK.join(" ");
    // In units of 1024 bytes: the scene and the checkpoint are larger.
    let output = shell(&place, &format!("ulimit -f 8; \"$LUXEL\" train data -o run {quick}"));
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("cannot save the state") && message.contains("File too large"), "{message}");
    let left: Vec<_> = std::fs::read_dir(place.path("run/checkpoints")).unwrap().collect();
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn threads_that_the_system_refuses_are_an_error() {
    let place = Workplace::new();
    place.train("run", &[]);
    // The stacks of so many threads are larger than the address space.
    let output = shell(&place, "ulimit -v 2000000; \"$LUXEL\" render run -o frames --threads 4096");
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("cannot start 4,096 threads") && message.contains("lower --threads"), "{message}");
}

#[test]
fn what_takes_more_memory_than_there_may_be_is_refused() {
    let place = Workplace::new();
    place.train("run", &[]);
    let mut png = luxel_io::encode_png(3, 2, &[0; 18]).unwrap();
    let size = png.windows(8).position(|window| window == [0, 0, 0, 3, 0, 0, 0, 2]).unwrap();
    png[size..size + 8].copy_from_slice(&[8192u32.to_be_bytes(), 8192u32.to_be_bytes()].concat());
    png.resize(40_000, 0);
    std::fs::write(place.path("flat.png"), png).unwrap();
    place.error(
        &["info", "flat.png", "--transfer", "srgb", "--memory", "1"],
        &["flat.png", "1536 MiB", "the limit is 1024 MiB", "raise --memory"],
    );
    let cameras = serde_json::json!({ "w": 30000, "h": 20000, "fl_x": 20000,
        "frames": [{ "file_path": "a", "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5], [0, 0, 0, 1]] }] });
    std::fs::write(place.path("cameras.json"), cameras.to_string()).unwrap();
    place.error(
        &["render", "run", "--cameras", "cameras.json", "-o", "frames", "--memory", "1"],
        &["30000 x 20000 pixels", "the limit is 1024 MiB", "raise --memory"],
    );
    place.error(&["bench", "--generate", "100", "--size", "65535x65535", "--memory", "1"], &["65535 x 65535 pixels"]);
    place.error(&["bench", "--generate", "50000000", "--memory", "1"], &["a room of 50000000 splats", "the limit is 1024 MiB"]);
    place.error(
        &["probe", "run", "--at", "0,0,0", "--size", "16384", "-o", "map.exr", "--memory", "1"],
        &["a probe 16384 pixels wide", "raise --memory"],
    );
    std::fs::write(
        place.path("large.hdr"),
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 3000 +X 3000\n"
            .iter()
            .copied()
            .chain(std::iter::repeat_n(99, 36_000_000))
            .collect::<Vec<u8>>(),
    )
    .unwrap();
    let output = place.luxel(&["compare", "large.hdr", "large.hdr", "--memory", "1"]).output().unwrap();
    assert!(output.status.code() == Some(1) && stderr(&output).contains("comparing 3000 x 3000 pixels"), "{}", stderr(&output));
    // A limit of the user's that the system does not have.
    for render in ["render run --cameras cameras.json -o frames", "bench --generate 100 --size 30000x20000"] {
        let output = shell(&place, &format!("ulimit -v 4000000; \"$LUXEL\" {render} --memory 64 --device cpu"));
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(message.contains("30000 x 20000 pixels takes") && message.contains("the system refuses"), "{message}");
    }
}

#[test]
fn a_run_that_is_taken_apart_meanwhile_reports_it() {
    let place = Workplace::new();
    let mut command = Command::new(env!("CARGO_BIN_EXE_luxel"));
    command.args([
        "train",
        "data",
        "-o",
        "run",
        "--iterations",
        "600",
        "--init-points",
        "300",
        "--threads",
        "2",
        "--checkpoint-every",
        "20",
    ]);
    let mut child = command.current_dir(place.path("")).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    while !std::fs::read_dir(place.path("run/checkpoints")).is_ok_and(|mut entries| entries.next().is_some()) {
        assert!(child.try_wait().unwrap().is_none(), "the run ended early");
        std::thread::sleep(Duration::from_millis(2));
    }
    for name in ["config.toml", "log.jsonl", ".lock"] {
        std::fs::remove_file(place.path("run").join(name)).unwrap();
    }
    let output = child.wait_with_output().unwrap();
    let message = stderr(&output);
    for name in ["config.toml was removed", "log.jsonl was removed", ".lock was removed", "remedy: ", "--resume"] {
        assert!(output.status.code() == Some(1) && message.contains(name), "{name}\n{message}");
    }
    place.ok(&["train", "--resume", "-o", "run"]);
    place.ok(&["eval", "run"]);
    std::fs::remove_file(place.path("run/log.jsonl")).unwrap();
    let output = place.luxel(&["train", "--resume", "-o", "run", "--iterations", "620"]).output().unwrap();
    assert!(output.status.success() && stderr(&output).contains("log.jsonl: no line for step 600"), "{}", stderr(&output));
}
