//! Stopping and going on: signals, kills, resuming, damaged checkpoints, disks that are full.
#![cfg(unix)]

use std::io::{BufRead, BufReader, Read};
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use crate::common::{self, Workplace};

/// Long enough to be caught in the middle, short enough to be finished.
const STEPS: &str = "900";

fn spawn(place: &Workplace, args: &[&str]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_luxel"));
    command.current_dir(place.path("")).args(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

fn signal(child: &Child, name: &str) {
    assert!(Command::new("kill").args([name, &child.id().to_string()]).status().unwrap().success());
}

/// Waits, and fails the test rather than hang it.
fn wait(child: &mut Child) -> ExitStatus {
    let start = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status;
        }
        assert!(start.elapsed() < Duration::from_secs(120), "the program does not end");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn train_args(run: &str) -> Vec<&str> {
    let mut args = vec!["train", "data", "-o", run, "--iterations", STEPS, "--init-points", "300", "--threads", "2"];
    args.extend(["--checkpoint-every", "60", "--eval-at", "0", "--log-format", "json"]);
    args
}

fn checkpoints(place: &Workplace, run: &str) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(place.path(run).join("checkpoints")) else { return Vec::new() };
    let mut paths: Vec<PathBuf> =
        entries.map(|e| e.unwrap().path()).filter(|p| p.extension().is_some_and(|e| e == "safetensors")).collect();
    paths.sort();
    paths
}

#[test]
fn an_interrupted_run_saves_and_goes_on_where_it_was() {
    let place = Workplace::new();
    for (run, name) in [("int", "-INT"), ("term", "-TERM")] {
        let mut child = spawn(&place, &train_args(run));
        // The first progress line means that steps are being made.
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        assert!(lines.any(|line| line.unwrap().contains("\"progress\"")));
        place.error(&["train", "--resume", "-o", run], &["another luxel"]);
        signal(&child, name);
        let rest = std::thread::spawn(move || lines.map(Result::unwrap).collect::<Vec<_>>());
        assert_eq!(wait(&mut child).code(), Some(130));
        let told = rest.join().unwrap().join("\n");
        assert!(told.contains(&format!("luxel train --resume -o {run}")), "{told}");
        let saved = checkpoints(&place, run);
        assert!(!saved.is_empty());
        place.ok(&["train", "--resume", "-o", run]);
        assert_eq!(place.json(&format!("{run}/metrics.json"))["iterations"], 900);
    }
}

#[test]
fn a_killed_run_ends_with_the_bits_of_an_unbroken_one() {
    let place = Workplace::new();
    place.ok(&train_args("unbroken"));
    let mut kills = 0;
    for attempt in 0..6u32 {
        let first = train_args("killed");
        let again = ["train", "data", "--resume", "-o", "killed", "--log-format", "json"];
        let known = checkpoints(&place, "killed");
        let mut child = spawn(&place, if attempt == 0 { &first } else { &again });
        // Somewhere after the next checkpoint: a different while each time.
        while child.try_wait().unwrap().is_none() && checkpoints(&place, "killed") == known {
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(Duration::from_millis(u64::from(attempt * 37 % 50)));
        kills += u32::from(child.try_wait().unwrap().is_none());
        child.kill().unwrap();
        wait(&mut child);
    }
    assert!(kills > 0, "the run was over before it could be killed");
    place.ok(&["train", "data", "--resume", "-o", "killed"]);
    for file in ["checkpoints/step_000000900.safetensors", "point_cloud/iteration_900/point_cloud.ply", "eval/step_900/renders/000.exr"] {
        let read = |run: &str| std::fs::read(place.path(run).join(file)).unwrap();
        assert!(read("unbroken") == read("killed"), "{file} differs after {kills} kills");
    }
    let iterations = |run: &str| -> Vec<u64> {
        let log = std::fs::read_to_string(place.path(run).join("log.jsonl")).unwrap();
        log.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap()["iteration"].as_u64().unwrap()).collect()
    };
    assert_eq!(iterations("unbroken"), iterations("killed"));
    // A finished run has nothing left to do, and reports its metrics again.
    place.ok(&["train", "--resume", "-o", "killed"]);
}

#[test]
fn a_damaged_checkpoint_is_passed_over() {
    let place = Workplace::new();
    place.train("run", &["--checkpoint-every", "10", "--keep-checkpoints", "3"]);
    let saved = checkpoints(&place, "run");
    assert_eq!(saved.len(), 3);
    let bytes = std::fs::read(&saved[2]).unwrap();
    std::fs::write(&saved[2], &bytes[..bytes.len() / 2]).unwrap();
    let output = place.luxel(&["train", "--resume", "-o", "run"]).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && stderr.contains("damaged checkpoint") && stderr.contains("step_000000040"), "{stderr}");
    assert!(std::fs::read(&saved[2]).unwrap() == bytes, "the same bits again");

    for path in checkpoints(&place, "run") {
        std::fs::write(path, "").unwrap();
    }
    place.error(&["train", "--resume", "-o", "run"], &["none of the 3 checkpoints", "--overwrite"]);
    // Without any, what the run has is not begun anew.
    std::fs::remove_dir_all(place.path("run/checkpoints")).unwrap();
    let log = std::fs::read(place.path("run/log.jsonl")).unwrap();
    place.error(&["train", "--resume", "-o", "run"], &["run: has scenes, but no checkpoint", "--overwrite"]);
    assert!(std::fs::read(place.path("run/log.jsonl")).unwrap() == log);
}

#[test]
fn a_resumed_run_keeps_its_settings() {
    let place = Workplace::new();
    place.train("run", &["--seed", "5"]);
    place.error(&["train", "--resume", "-o", "run", "--seed", "6", "--method", "sh3"], &["--seed is 5 in the run, 6 now", "--method"]);
    // An explicit option with the stored value is no contradiction, nor is one that leaves the
    // result as it is.
    place.ok(&["train", "data", "--resume", "-o", "run", "--seed", "5", "--threads", "1", "--keep-checkpoints", "4"]);
    assert_eq!(place.json("run/metrics.json")["seed"], 5);
    // More steps continue from the last; fewer than were made are a contradiction.
    place.error(&["train", "--resume", "-o", "run", "--iterations", "10"], &["10 iterations", "40 steps", "--iterations 40"]);
    place.ok(&["train", "--resume", "-o", "run", "--iterations", "50"]);
    assert_eq!(place.json("run/metrics.json")["iterations"], 50);
    // An evaluation that a killed process left unfinished is made up for.
    std::fs::remove_file(place.path("run/eval/step_50/metrics.json")).unwrap();
    std::fs::remove_file(place.path("run/metrics.json")).unwrap();
    place.ok(&["train", "--resume", "-o", "run"]);
    assert_eq!(place.json("run/metrics.json")["iterations"], 50);
    // So is one of which luxel eval has figures, but training no scene.
    std::fs::remove_file(place.path("run/eval/step_50/metrics.json")).unwrap();
    std::fs::remove_dir_all(place.path("run/point_cloud/iteration_50")).unwrap();
    place.ok(&["eval", "run"]);
    assert!(!place.path("run/eval/step_50/metrics.json").exists());
    place.ok(&["train", "--resume", "-o", "run"]);
    assert!(place.path("run/point_cloud/iteration_50/point_cloud.ply").is_file());
    // Other images are another data set.
    common::write_dataset(&place.path("other"));
    std::fs::copy(place.path("data/images/001.exr"), place.path("other/images/002.exr")).unwrap();
    place.error(&["train", "other", "--resume", "-o", "run"], &["data set"]);
}

#[test]
fn a_resumed_run_keeps_the_rule_of_its_early_end() {
    let place = Workplace::new();
    place.train("run", &["--early-end", "30"]);
    let path = place.path("run/config.toml");
    let stored = std::fs::read_to_string(&path).unwrap();
    let other = stored.replace("early_end = 30", "early_end = 35");
    assert_ne!(other, stored);
    std::fs::write(&path, other).unwrap();
    place.error(&["train", "--resume", "-o", "run"], &["config.toml has other training options than the checkpoint"]);
    std::fs::write(&path, stored).unwrap();
    place.ok(&["train", "--resume", "-o", "run"]);
    // Given steps are made, and the run has no early end any more.
    place.ok(&["train", "--resume", "-o", "run", "--iterations", "50"]);
    assert_eq!(place.json("run/metrics.json")["iterations"], 50);
    assert!(!std::fs::read_to_string(&path).unwrap().contains("early_end"));
}

#[test]
fn a_run_that_is_ended_where_it_stands_becomes_the_mean_so_far() {
    let place = Workplace::new();
    place.train("run", &["--checkpoint-every", "37", "--keep-checkpoints", "2", "--samples", "1"]);
    // As it is when it is stopped after step 37, the third of the six that are averaged.
    std::fs::remove_file(place.path("run/checkpoints/step_000000040.safetensors")).unwrap();
    for folder in ["point_cloud/iteration_40", "eval/step_40"] {
        std::fs::remove_dir_all(place.path("run").join(folder)).unwrap();
    }
    let state = || std::fs::read(place.path("run/checkpoints/step_000000037.safetensors")).unwrap();
    let stopped = state();
    let end = || place.ok(&["train", "--resume", "-o", "run", "--iterations", "37"]);
    end();
    let ended = state();
    assert!(ended != stopped, "the state is still that before the mean");
    let metrics = place.json("run/eval/step_37/metrics.json");
    assert_eq!(metrics["iterations"], 37);
    // The mean is taken once.
    end();
    assert!(state() == ended && place.json("run/eval/step_37/metrics.json") == metrics);
}

#[test]
fn a_full_disk_ends_the_run_and_keeps_its_checkpoint() {
    let place = Workplace::new();
    place.train("run", &["--checkpoint-every", "20"]);
    let saved = checkpoints(&place, "run");
    let before = std::fs::read(&saved[0]).unwrap();
    std::fs::remove_file(&saved[1]).unwrap();
    // A limit on file sizes, with its signal ignored, refuses writes in the middle as a full disk
    // does.
    let limit_kib = before.len() / 1024 / 2;
    let script = format!("trap '' XFSZ; ulimit -f {limit_kib}; exec \"$0\" train --resume -o run --checkpoint-every 5");
    let output = Command::new("bash").current_dir(place.path("")).args(["-c", &script, env!("CARGO_BIN_EXE_luxel")]).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    for part in ["error: ", "cannot save", "the last good checkpoint is", "step_000000020"] {
        assert!(stderr.contains(part), "{part}\n{stderr}");
    }
    assert!(std::fs::read(&saved[0]).unwrap() == before);
    place.ok(&["train", "--resume", "-o", "run"]);
}

/// Trains, lets something happen to the folder once steps are made, and returns the outcome with
/// stderr.
fn trained_while(place: &Workplace, run: &str, happens: impl FnOnce(&Workplace)) -> (Option<i32>, String) {
    let mut child = spawn(place, &train_args(run));
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(lines.any(|line| line.unwrap().contains("\"progress\"")));
    happens(place);
    let stderr = std::thread::scope(|scope| {
        scope.spawn(|| lines.for_each(drop));
        let mut stderr = String::new();
        child.stderr.take().unwrap().read_to_string(&mut stderr).unwrap();
        stderr
    });
    (wait(&mut child).code(), stderr)
}

#[test]
fn a_run_whose_folder_is_taken_apart_ends_with_an_error() {
    let place = Workplace::new();
    // The state is saved, and the run goes on when it is asked to.
    for name in ["config.toml", ".lock"] {
        let path = format!("run{name}");
        let (code, stderr) = trained_while(&place, &path, |place| std::fs::remove_file(place.path(&path).join(name)).unwrap());
        assert!(code == Some(1) && stderr.contains(&format!("{name} was removed")) && stderr.contains("--resume"), "{code:?} {stderr}");
        assert!(!place.path(&path).join("eval/step_900").exists());
        place.ok(&["train", "--resume", "-o", &path]);
    }

    // Another process is at work there: nothing more is written.
    let mut other = None;
    let (code, stderr) = trained_while(&place, "taken", |place| {
        std::fs::rename(place.path("taken/.lock"), place.path("taken/.old")).unwrap();
        let file = std::fs::File::create(place.path("taken/.lock")).unwrap();
        file.lock().unwrap();
        other = Some((file, checkpoints(place, "taken")));
    });
    assert!(code == Some(1) && stderr.contains(".lock was removed") && stderr.contains("another luxel"), "{code:?} {stderr}");
    let (lock, before) = other.unwrap();
    // One may have been in the making.
    let added = checkpoints(&place, "taken").iter().filter(|path| !before.contains(path)).count();
    assert!(added <= 1, "{before:?}");
    drop(lock);
    place.ok(&["train", "--resume", "-o", "taken"]);

    let (code, stderr) = trained_while(&place, "moved", |place| {
        while checkpoints(place, "moved").is_empty() {
            std::thread::sleep(Duration::from_millis(1));
        }
        std::fs::rename(place.path("moved"), place.path("aside")).unwrap();
    });
    assert!(code == Some(1) && stderr.contains("the folder was removed"), "{code:?} {stderr}");
    assert!(!place.path("moved").exists(), "the folder was made again");
    place.ok(&["train", "--resume", "-o", "aside"]);

    // All end as an unbroken one.
    place.ok(&train_args("unbroken"));
    let last = |run: &str| std::fs::read(checkpoints(&place, run).last().unwrap()).unwrap();
    for run in ["runconfig.toml", "run.lock", "taken", "aside"] {
        assert!(last(run) == last("unbroken"), "{run}");
    }
}

#[test]
fn the_end_of_input_stops_a_run_that_was_asked_to_listen() {
    let place = Workplace::new();
    let mut command = Command::new(env!("CARGO_BIN_EXE_luxel"));
    command.current_dir(place.path("")).args(train_args("run")).arg("--stop-at-end-of-input");
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(lines.any(|line| line.unwrap().contains("\"progress\"")));
    drop(child.stdin.take());
    let rest = std::thread::spawn(move || lines.map(Result::unwrap).collect::<Vec<_>>());
    assert_eq!(wait(&mut child).code(), Some(130));
    assert!(rest.join().unwrap().join("\n").contains("--resume"));
    assert!(!checkpoints(&place, "run").is_empty());
}

/// Until 0.1.0 the option `validation_share` was called `hold_out`.
#[test]
fn a_run_whose_option_had_another_name_goes_on() {
    let place = Workplace::new();
    place.train("run", &["--validation-share", "0.25"]);
    let path = place.path("run/config.toml");
    let config = std::fs::read_to_string(&path).unwrap();
    assert!(config.contains("validation_share = 0.25"), "{config}");
    std::fs::write(&path, config.replace("validation_share = ", "hold_out = ")).unwrap();
    place.ok(&["train", "--resume", "-o", "run", "--iterations", "50"]);
    place.ok(&["train", "--config", "run/config.toml", "data", "-o", "again", "--iterations", "10"]);
    for run in ["run", "again"] {
        let config = std::fs::read_to_string(place.path(run).join("config.toml")).unwrap();
        assert!(config.contains("validation_share = 0.25") && !config.contains("hold_out"), "{config}");
    }
}

#[test]
fn a_preempted_run_asks_for_requeuing_and_goes_on_to_the_bits_of_an_unbroken_one() {
    let place = Workplace::new();
    place.ok(&train_args("unbroken"));
    let begin = [&train_args("run")[..], &["--requeue-code", "75"]].concat();
    let again = ["train", "--resume", "-o", "run", "--log-format", "json", "--requeue-code", "75"];
    for (args, name, code) in [(&begin[..], "-TERM", 75), (&again, "-INT", 130)] {
        let mut child = spawn(&place, args);
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        assert!(lines.any(|line| line.unwrap().contains("\"progress\"")));
        signal(&child, name);
        if name == "-TERM" {
            // Job systems signal every process of a job and those that started it, which pass it
            // on.
            let _ = Command::new("kill").args([name, &child.id().to_string()]).stderr(Stdio::null()).status();
        }
        let rest = std::thread::spawn(move || lines.map(Result::unwrap).collect::<Vec<_>>());
        assert_eq!(wait(&mut child).code(), Some(code));
        let told = rest.join().unwrap().join("\n");
        assert!(told.contains("luxel train --resume -o run"), "{told}");
    }
    place.ok(&["train", "--resume", "-o", "run"]);
    let last = |run: &str| std::fs::read(checkpoints(&place, run).last().unwrap()).unwrap();
    assert!(last("run") == last("unbroken"));
    place.fails(2, &["train", "data", "-o", "other", "--requeue-code", "1"]);
}

/// Steps of runs that tell their progress a few times.
const MATRIX_STEPS: &str = "400";

/// Two runs, long enough to be caught in the middle.
fn matrix_args(folder: &str) -> Vec<&str> {
    let mut args = vec![
        "reproduce",
        "data",
        "-o",
        folder,
        "--methods",
        "sh1,lcd",
        "--seeds",
        "3",
        "--iterations",
        MATRIX_STEPS,
        "--init-points",
        "300",
    ];
    args.extend(["--threads", "1", "--jobs", "2", "--checkpoint-every", "60", "--log-format", "json"]);
    args
}

#[test]
fn an_interrupted_matrix_saves_its_runs_and_ends_with_the_bits_of_an_unbroken_one() {
    let place = Workplace::new();
    place.ok(&matrix_args("unbroken"));
    let mut child = spawn(&place, &matrix_args("broken"));
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(lines.any(|line| line.unwrap().contains("\"matrix_progress\"")));
    place.error(&matrix_args("broken"), &["another luxel"]);
    signal(&child, "-TERM");
    let rest = std::thread::spawn(move || lines.map(Result::unwrap).collect::<Vec<_>>());
    assert_eq!(wait(&mut child).code(), Some(130));
    let told = rest.join().unwrap().join("\n");
    assert!(told.contains("the same command continues from here"), "{told}");
    assert!(!place.path("broken/report.html").exists());
    assert!(["sh1", "lcd"].iter().any(|method| !checkpoints(&place, &format!("broken/runs/data/{method}/seed_3")).is_empty()));

    let mut child = spawn(&place, &[&matrix_args("broken")[..], &["--requeue-code", "99"]].concat());
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(lines.any(|line| line.unwrap().contains("\"matrix_progress\"")));
    signal(&child, "-TERM");
    let rest = std::thread::spawn(move || lines.count());
    assert_eq!(wait(&mut child).code(), Some(99));
    rest.join().unwrap();

    // Killed outright, its runs stop by themselves, and the lock of each falls.
    let mut child = spawn(&place, &matrix_args("broken"));
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(lines.any(|line| line.unwrap().contains("\"matrix_progress\"")));
    child.kill().unwrap();
    wait(&mut child);
    let start = Instant::now();
    while !place.luxel(&matrix_args("broken")).output().unwrap().status.success() {
        assert!(start.elapsed() < Duration::from_secs(120), "the runs of a killed matrix do not end");
    }
    for method in ["sh1", "lcd"] {
        let scene = |root: &str| {
            std::fs::read(place.path(root).join(format!("runs/data/{method}/seed_3/point_cloud/iteration_{MATRIX_STEPS}/point_cloud.ply")))
                .unwrap()
        };
        assert!(scene("unbroken") == scene("broken"), "{method}");
    }
}
