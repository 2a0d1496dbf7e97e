//! `luxel reproduce` from outside.

use std::path::Path;

use crate::common::{self, Workplace};

/// Two methods, one seed, few steps; `data` is the tiny data set.
const TINY: [[&str; 2]; 6] =
    [["-o", "matrix"], ["--methods", "sh1,lcd"], ["--seeds", "7"], ["--iterations", "20"], ["--init-points", "200"], ["--threads", "1"]];

/// The command with these options, in place of those of [`TINY`] that they repeat.
fn args<'a>(options: &[[&'a str; 2]]) -> Vec<&'a str> {
    let kept = TINY.iter().filter(|[name, _]| !options.iter().any(|[other, _]| name == other));
    ["reproduce", "data"].into_iter().chain(kept.chain(options).flatten().copied()).collect()
}

fn read(place: &Workplace, name: &str) -> String {
    std::fs::read_to_string(place.path(name)).unwrap()
}

/// Returns the value of `column` in the line of a CSV file that begins with `start`.
fn value(csv: &str, start: &str, column: &str) -> String {
    let mut lines = csv.lines();
    let at = lines.next().unwrap().split(',').position(|name| name == column).unwrap_or_else(|| panic!("no column {column}"));
    let line = lines.find(|line| line.starts_with(start)).unwrap_or_else(|| panic!("no line {start} in\n{csv}"));
    line.split(',').nth(at).unwrap().to_owned()
}

fn modified(path: &Path) -> std::time::SystemTime {
    std::fs::metadata(path).unwrap().modified().unwrap()
}

#[test]
fn a_matrix_becomes_tables_and_figures() {
    let place = Workplace::new();
    let told = place.ok(&args(&[["--seeds", "7,8"], ["--metrics", "all"], ["--jobs", "2"]]));
    assert!(told.contains("report.html") && told.contains("tables.tex"), "{told}");
    for folder in ["sh1/seed_7", "sh1/seed_8", "lcd/seed_7", "lcd/seed_8"] {
        assert!(place.path("matrix/runs/data").join(folder).join("report.html").is_file(), "{folder}");
    }
    let runs = read(&place, "matrix/runs.csv");
    assert_eq!(runs.lines().count(), 5);
    for column in ["train_minutes", "peak_memory_mb", "psnr_scene", "ssim_gtmax", "hdr_flip", "frames_per_second", "train_psnr_scene"] {
        assert!(value(&runs, "data,lcd,49,8", column).parse::<f64>().unwrap() > 0.0, "{column}");
    }
    assert_eq!(value(&runs, "data,sh1,12,7", "lpips_alex"), "");
    let means = read(&place, "matrix/means.csv");
    let psnr = |seed: &str| value(&runs, &format!("data,sh1,12,{seed}"), "psnr_scene").parse::<f64>().unwrap();
    let mean: f64 = value(&means, "data,sh1,2", "psnr_scene").parse().unwrap();
    assert!((mean - 0.5 * (psnr("7") + psnr("8"))).abs() < 1e-9);
    let deviation: f64 = value(&means, "data,sh1,2", "psnr_scene_sd").parse().unwrap();
    assert!((deviation - (psnr("7") - psnr("8")).abs() / 2f64.sqrt()).abs() < 1e-9);
    assert!(read(&place, "matrix/profiles.csv").lines().any(|line| line.starts_with("data,lcd,")));

    // Colours move least where they are held apart from luminance, and most where channels are
    // mapped one by one.
    let editing = read(&place, "matrix/editing.csv");
    let error = |start: &str| value(&editing, start, "chromaticity_error").parse::<f64>().unwrap();
    assert!(error("data,lcd,luminance") < error("data,sh1,channels") && error("data,sh1,luminance").is_finite(), "{editing}");

    let report = read(&place, "matrix/report.html");
    for part in [
        "1 data set",
        "Luminance editing",
        "sh1 by channels",
        "2 seeds",
        "20 iterations",
        "Error by luminance",
        "Side by side",
        "HDR-Syn-8S",
        "other data",
        "class=\"best\"",
        "± ",
        "HDR-FLIP",
        "Machine and protocol",
        "<b>gtmax</b>",
        "runs/data/lcd/seed_8/report.html",
        "42.69",
    ] {
        assert!(report.contains(part), "{part}");
    }
    // Self-contained, and without activations to compare.
    assert!(!report.contains("src=\"http") && !report.contains("<link") && !report.contains("Activation of the luminance"));
    let tex = read(&place, "matrix/tables.tex");
    assert!(
        tex.contains("\\toprule") && tex.contains("\\textbf{") && tex.contains("$\\pm$") && tex.contains("as published by LCD-GS"),
        "{tex}"
    );
}

#[test]
fn what_is_finished_stays_and_more_can_be_asked_for() {
    let place = Workplace::new();
    place.ok(&args(&[]));
    let figures = place.path("matrix/runs/data/lcd/seed_7/metrics.json");
    let (before, then) = (std::fs::read(&figures).unwrap(), modified(&figures));
    // A run that was interrupted early has its settings only; another has lost its metrics.
    let interrupted = place.path("matrix/runs/data/sh1/seed_7");
    for entry in ["metrics.json", "log.jsonl", "report.html"] {
        std::fs::remove_file(interrupted.join(entry)).unwrap();
    }
    for entry in ["eval", "checkpoints", "point_cloud"] {
        std::fs::remove_dir_all(interrupted.join(entry)).unwrap();
    }
    place.ok(&args(&[["--methods", "lcd-exp,sh1,lcd"], ["--jobs", "2"]]));
    let scene = place.path("matrix/runs/data/sh1/seed_7/point_cloud/iteration_20/point_cloud.ply");
    assert!(scene.is_file());
    assert!(modified(&figures) == then && std::fs::read(&figures).unwrap() == before);
    let report = read(&place, "matrix/report.html");
    assert!(report.contains("Activation of the luminance") && report.contains("lcd-exp") && report.contains("Exponential"));
    assert_eq!(read(&place, "matrix/runs.csv").lines().count(), 4);
    // Asking for a part of what is there, or for one more, leaves the others in the report.
    place.ok(&args(&[["--methods", "lcd"]]));
    assert_eq!(read(&place, "matrix/runs.csv").lines().count(), 4);
    let plan = |options: &[[&str; 2]]| place.events(&[&args(options)[..], &["--dry-run"]].concat(), "plan").remove(0);
    let counts = |plan: &serde_json::Value| ["runs", "finished", "open", "steps"].map(|name| plan[name].as_u64().unwrap());
    let one_more = plan(&[["--methods", "sh0"]]);
    assert_eq!(counts(&one_more), [4, 3, 1, 20]);
    assert!(one_more["seconds"].as_f64().unwrap() > 0.0 && !place.path("matrix/runs/data/sh0").exists());
    assert_eq!(counts(&plan(&[["--methods", "sh0,lcd"], ["--seeds", "7,8"]])), [6, 3, 3, 60]);
    assert_eq!(counts(&plan(&[["--methods", "lcd"]])), [3, 3, 0, 0]);
    // One that is not finished is left to the command that asks for it.
    std::fs::remove_file(place.path("matrix/runs/data/lcd-exp/seed_7/eval/step_20/metrics.json")).unwrap();
    place.ok(&args(&[["--methods", "sh0"]]));
    let runs = read(&place, "matrix/runs.csv");
    assert_eq!(runs.lines().count(), 4, "{runs}");
    for start in ["data,sh1,", "data,lcd,", "data,sh0,"] {
        assert!(runs.lines().any(|line| line.starts_with(start)), "{start} in\n{runs}");
    }
    assert!(place.path("matrix/runs/data/sh1/seed_7/metrics.json").is_file());
}

#[test]
fn tables_are_of_training_and_of_this_machine() {
    let place = Workplace::new();
    let all = args(&[["--methods", "lcd"], ["--seeds", "9223372036854775807"]]);
    place.ok(&all);
    let runs = read(&place, "matrix/runs.csv");
    assert!(value(&runs, "data,lcd", "computed_by").starts_with("1 thread of "), "{runs}");
    assert!(read(&place, "matrix/report.html").contains("on 1 thread of "));
    // Figures of another luminance or of other images are not the matrix's.
    common::write_dataset(&place.path("other"));
    std::fs::copy(place.path("other/images/003.exr"), place.path("other/images/000.exr")).unwrap();
    let run = "matrix/runs/data/lcd/seed_9223372036854775807";
    place.ok(&["eval", run, "--peak-luminance", "50"]);
    place.ok(&["eval", run, "--data", "other"]);
    place.ok(&all);
    assert_eq!(read(&place, "matrix/runs.csv"), runs);
    // Frames per second of another machine are measured again.
    let measured = place.path(run).join("measured.json");
    let mut elsewhere = place.json(&format!("{run}/measured.json"));
    (elsewhere["computed_by"], elsewhere["frames_per_second"]) = ("a faster card".into(), 1e9.into());
    std::fs::write(&measured, elsewhere.to_string()).unwrap();
    place.ok(&all);
    let fps: f64 = value(&read(&place, "matrix/runs.csv"), "data,lcd", "frames_per_second").parse().unwrap();
    assert!(fps < 1e9 && place.json(&format!("{run}/measured.json"))["computed_by"].as_str().unwrap().starts_with("1 thread of "));
}

#[test]
fn runs_side_by_side_have_the_bits_of_runs_in_turn() {
    let place = Workplace::new();
    place.ok(&args(&[]));
    place.ok(&args(&[["-o", "other"], ["--jobs", "2"], ["--threads", "2"]]));
    for run in ["sh1/seed_7", "lcd/seed_7"] {
        let scene = |root: &str| {
            std::fs::read(place.path(root).join("runs/data").join(run).join("point_cloud/iteration_20/point_cloud.ply")).unwrap()
        };
        assert!(scene("matrix") == scene("other"), "{run}");
    }
}

#[test]
fn data_sets_have_the_names_that_are_given() {
    let place = Workplace::new();
    common::write_dataset(&place.path("more/data"));
    let lcd = args(&[["--methods", "lcd"], ["--memory", "4"]]);
    place.ok(&[&lcd[..], &["late=more/data"]].concat());
    for run in ["matrix/runs/data/lcd/seed_7", "matrix/runs/late/lcd/seed_7"] {
        assert!(place.path(run).join("metrics.json").is_file(), "{run}");
    }
    // The names are kept for later commands, whichever data sets these name.
    place.ok(&lcd);
    let runs = read(&place, "matrix/runs.csv");
    assert!(value(&runs, "data,lcd", "psnr_scene") == value(&runs, "late,lcd", "psnr_scene"), "{runs}");
    assert!(read(&place, "matrix/report.html").contains("late"));
}

#[test]
fn two_at_once_in_one_folder_are_told_so() {
    let place = Workplace::new();
    // Another process has just locked the folder and begun, before it wrote its mark.
    std::fs::create_dir_all(place.path("matrix/runs/data")).unwrap();
    let lock = std::fs::File::create(place.path("matrix/.lock")).unwrap();
    lock.try_lock().unwrap();
    place.error(&args(&[]), &["another luxel is at work in this folder"]);
    drop(lock);
    place.error(&args(&[]), &["not a matrix"]);
}

#[test]
fn runs_that_do_not_fit_are_named_and_nothing_is_trained() {
    let place = Workplace::new();
    place.ok(&args(&[["--methods", "lcd"]]));
    place.error(
        &args(&[["--max-splats", "100"]]),
        &["runs/data/lcd/seed_7", "--max-splats is unset there, 100 now", "choose another folder"],
    );
    assert!(!place.path("matrix/runs/data/sh1").exists());
    place.error(&args(&[["--iterations", "30"]]), &["--iterations is 20 there, 30 now"]);
    place.error(&args(&[["--downscale", "2"]]), &["--downscale is 1 there, 2 now"]);
    // What leaves the result alone may change.
    place.ok(&args(&[["--methods", "lcd"], ["--checkpoint-every", "5"], ["--threads", "2"]]));
    std::fs::create_dir_all(place.path("matrix/runs/data/sh1/seed_7")).unwrap();
    std::fs::write(place.path("matrix/runs/data/sh1/seed_7/thesis.tex"), "years").unwrap();
    place.error(&args(&[]), &["runs/data/sh1/seed_7: is not empty and not a run"]);
}

#[test]
fn what_cannot_be_a_matrix_is_said() {
    let place = Workplace::new();
    common::write_dataset(&place.path("more/data"));
    place.error(&[&args(&[])[..], &["more/data"]].concat(), &["have one name, data,", "OTHER=more/data"]);
    assert!(place.fails(2, &[&args(&[])[..], &["a b=more/data"]].concat()).contains("expected NAME=PATH"));
    place.error(&[&args(&[])[..], &["nowhere"]].concat(), &["nowhere: cannot open the data set"]);
    place.error(&args(&[["--methods", "lcd,lcd-l0"]]), &["method lcd is given twice"]);
    place.error(&args(&[["--seeds", "1,2,1"]]), &["seed 1 is given twice"]);
    place.error(&args(&[["--mu", "0"]]), &["mu"]);
    place.error(&args(&[["--lpips-weights", "data/transforms.json"]]), &["safetensors"]);
    assert!(!place.path("matrix").exists());
    std::fs::create_dir(place.path("thesis")).unwrap();
    std::fs::write(place.path("thesis/final.tex"), "years").unwrap();
    place.error(&args(&[["-o", "thesis"]]), &["thesis", "not a matrix"]);
    assert_eq!(std::fs::read_dir(place.path("thesis")).unwrap().count(), 1);
    for bad in [
        ["--method", "sh3"],
        ["--seed", "3"],
        ["--activation", "exp"],
        ["--methods", "nerf"],
        ["--jobs", "0"],
        ["--seeds", "x"],
        ["--seeds", "9223372036854775808"],
    ] {
        let stderr = place.fails(2, &args(&[bad]));
        assert!(!stderr.contains("panicked"), "{stderr}");
    }
    assert!(place.fails(2, &args(&[["--seed", "3"]])).contains("give --seeds"));
    let help = place.ok(&["reproduce", "--help"]);
    assert!(
        help.contains("--max-splats") && help.contains("--methods") && !help.contains("--method <") && !help.contains("--seed <"),
        "{help}"
    );
}

#[test]
fn a_run_that_fails_does_not_stop_the_others() {
    let place = Workplace::new();
    place.ok(&args(&[["--methods", "sh1"]]));
    let checkpoint = place.path("matrix/runs/data/sh1/seed_7/checkpoints");
    for entry in std::fs::read_dir(&checkpoint).unwrap() {
        std::fs::write(entry.unwrap().path(), "").unwrap();
    }
    std::fs::remove_file(place.path("matrix/runs/data/sh1/seed_7/eval/step_20/metrics.json")).unwrap();
    let stderr = place.fails(1, &args(&[]));
    for part in ["data sh1 seed 7: ", "none of the 1 checkpoints can be read", "the report is without it"] {
        assert!(stderr.contains(part), "{part}\n{stderr}");
    }
    let report = read(&place, "matrix/report.html");
    assert!(report.contains("data sh1 seed 7 failed") && report.contains("runs/data/lcd/seed_7"), "{report}");
    // Figures stand without the images that the pictures are made of.
    std::fs::remove_dir_all(place.path("matrix/runs/data/lcd/seed_7/eval/step_20/renders")).unwrap();
    place.ok(&args(&[["--methods", "lcd"]]));
    assert!(read(&place, "matrix/report.html").contains("Left out: cannot show view"));
}

/// The program's file name in job lists needs a shell.
#[cfg(unix)]
mod jobs {
    use std::process::{Child, Command, Stdio};

    use super::*;

    const FOUR: [[&str; 2]; 1] = [["--seeds", "7,8"]];

    fn spawn(place: &Workplace, command: &mut Command) -> Child {
        command.current_dir(place.path("")).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    }

    fn ended_well(child: Child) -> String {
        let output = child.wait_with_output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{stderr}");
        stderr
    }

    /// The metrics of training, without those of time and memory.
    fn metrics(place: &Workplace, folder: &str) -> Vec<String> {
        let runs = read(place, &format!("{folder}/runs.csv"));
        let of_run = |run: [&str; 2]| {
            let start = format!("data,{},{}", run[0], run[1]);
            ["psnr_scene", "ssim_gtmax", "train_psnr_scene", "splats"].map(|column| value(&runs, &start, column)).join(",")
        };
        [["sh1", "12,7"], ["sh1", "12,8"], ["lcd", "49,7"], ["lcd", "49,8"]].map(of_run).to_vec()
    }

    #[test]
    fn a_job_list_has_a_command_for_each_run_and_they_make_the_table_of_one_process() {
        let place = Workplace::new();
        place.ok(&args(&[FOUR[0], ["-o", "whole"]]));
        let list = || place.ok(&[&args(&FOUR)[..], &["--list"]].concat());
        let jobs = list();
        let names = ["data sh1 seed 7", "data lcd seed 7", "data sh1 seed 8", "data lcd seed 8"];
        assert!(jobs.lines().zip(names).all(|(line, name)| line.ends_with(&format!("  # {name}"))) && jobs.lines().count() == 4, "{jobs}");
        assert!(!place.path("matrix").exists(), "a list writes nothing");
        let events = place.events(&[&args(&FOUR)[..], &["--list"]].concat(), "job");
        assert_eq!(events.len(), 4);
        assert_eq!((&events[2]["only"], &events[2]["run"], &events[2]["finished"]), (&"3/4".into(), &names[2].into(), &false.into()));

        // All four at once: the last one to end writes the report, and the others say what is
        // missing.
        let running: Vec<Child> = jobs.lines().map(|line| spawn(&place, Command::new("sh").args(["-c", line]))).collect();
        let told: Vec<String> = running.into_iter().map(ended_well).collect();
        assert!(place.path("matrix/report.html").is_file(), "{told:?}");
        assert_eq!(metrics(&place, "matrix"), metrics(&place, "whole"));
        assert_eq!(list(), jobs, "the order depends on the options alone");
        let finished = place.events(&[&args(&FOUR)[..], &["--list"]].concat(), "job");
        assert!(finished.iter().all(|job| job["finished"] == true));
    }

    #[test]
    fn one_share_twice_at_the_same_time_is_harmless() {
        let place = Workplace::new();
        place.ok(&args(&[FOUR[0], ["-o", "whole"]]));
        let program = env!("CARGO_BIN_EXE_luxel");
        let shares = ["1/2", "1/2", "0/2"].map(|share| {
            let mut command = Command::new(program);
            spawn(&place, command.args(args(&FOUR)).args(["--only", share]))
        });
        let told = shares.map(ended_well);
        for run in ["sh1/seed_7", "sh1/seed_8", "lcd/seed_7", "lcd/seed_8"] {
            let scene = |root: &str| {
                std::fs::read(place.path(root).join("runs/data").join(run).join("point_cloud/iteration_20/point_cloud.ply")).unwrap()
            };
            assert!(scene("matrix") == scene("whole"), "{run}: {told:?}");
        }
    }

    #[test]
    fn a_report_on_a_part_says_what_is_missing() {
        let place = Workplace::new();
        let with = |more: &[&'static str]| [&args(&FOUR)[..], more].concat();
        place.error(&with(&["--report"]), &["no run is finished"]);
        let told = place.luxel(&with(&["--only", "1/2"])).output().unwrap();
        let stderr = String::from_utf8_lossy(&told.stderr).into_owned();
        assert!(told.status.success() && stderr.contains("2 runs missing: data lcd seed 7, data lcd seed 8"), "{stderr}");
        assert!(!place.path("matrix/report.html").exists());
        // A run that another process works in is left to it.
        let busy = place.path("matrix/runs/data/lcd/seed_7");
        std::fs::create_dir_all(&busy).unwrap();
        let lock = std::fs::File::create(busy.join(".lock")).unwrap();
        lock.try_lock().unwrap();
        let told = place.luxel(&with(&["--only", "2/2"])).output().unwrap();
        let stderr = String::from_utf8_lossy(&told.stderr).into_owned();
        assert!(told.status.success() && stderr.contains("data lcd seed 7: another process trains it"), "{stderr}");
        drop(lock);
        let plan = place.events(&with(&["--only", "2/2", "--dry-run"]), "plan").remove(0);
        assert_eq!(["runs", "finished", "open"].map(|name| plan[name].as_u64().unwrap()), [2, 1, 1]);
        let told = place.luxel(&with(&["--report"])).output().unwrap();
        assert!(told.status.success() && String::from_utf8_lossy(&told.stderr).contains("1 run missing: data lcd seed 7"), "{told:?}");
        assert!(read(&place, "matrix/report.html").contains("1 run missing: data lcd seed 7"));
        assert!(read(&place, "matrix/tables.tex").contains("% Missing: data lcd seed 7"));
        for bad in ["3/2", "1", "0/0"] {
            place.fails(2, &with(&["--only", bad]));
        }
    }
}
