//! Output of the program: texts, tables, events, remedies, and where each is printed.

use std::collections::BTreeSet;

use serde_json::Value;

use crate::common::Workplace;

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

/// The events of a command, each with the version of its schema.
fn events(place: &Workplace, args: &[&str]) -> (Option<i32>, Vec<Value>) {
    let output = place.luxel(&[args, &["--log-format", "json"]].concat()).output().unwrap();
    let stdout = String::from_utf8(output.stdout).unwrap();
    let events: Vec<Value> =
        stdout.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{args:?}: {e} in {line}"))).collect();
    assert!(events.iter().all(|event| event["schema_version"] == luxel_app::schema::EVENT.version), "{args:?}: {stdout}");
    (output.status.code(), events)
}

/// The paths of an event's list.
fn paths(list: &Value) -> BTreeSet<String> {
    list.as_array().unwrap().iter().map(|path| path.as_str().unwrap().replace('\\', "/")).collect()
}

#[test]
fn every_command_reports_its_start_its_files_and_its_end() {
    let place = Workplace::new();
    place.train("run", &[]);
    let train = ["train", "data", "-o", "events", "--iterations", "20", "--init-points", "50", "--threads", "2"];
    for (args, files) in [
        (&train[..], &["events/config.toml", "events/metrics.json", "events/report.html", "events/eval/step_20/renders/000.exr"][..]),
        (&["eval", "run"], &["run/metrics.json", "run/report.html", "run/eval/step_40/renders/000.exr", "run/eval/step_40/gt/008.exr"]),
        (&["compare", "data/images/000.exr", "data/images/001.exr", "--heatmap", "flip.png"], &["flip.png"]),
        (&["render", "run", "-o", "frames", "--tonemap", "agx"], &["frames/000.exr", "frames/000.png", "frames/008.exr", "frames/008.png"]),
        (&["edit", "run", "--gain", "2", "-o", "bright.ply", "--overlay", "bright.png"], &["bright.ply", "bright.png"]),
        (&["edit", "run", "--gain", "2", "--against", "run", "-o", "both"], &["both/comparison.json"]),
        (&["export", "run", "-o", "bake.ply", "--refine", "3"], &["bake.ply"]),
        (&["probe", "run", "--at", "0,0,0", "--size", "16", "-o", "probe.exr"], &["probe.exr"]),
        (&["info", "run"], &[]),
        (&["info", "--devices"], &[]),
        (&["bench", "--generate", "20", "--size", "16x16", "--steps", "1", "--warmup", "0"], &[]),
        (&["bench", "--generate", "20", "--save", "room.ply"], &["room.ply"]),
        (&["man", "pages"], &["pages/luxel.1", "pages/luxel-train.1"]),
    ] {
        let (code, events) = events(&place, args);
        assert_eq!(code, Some(0), "{args:?}: {events:?}");
        let (first, last) = (&events[0], &events[events.len() - 1]);
        assert_eq!((&first["event"], &first["command"]), (&"started".into(), &args[0].into()), "{args:?}");
        assert_eq!(last["event"], "finished", "{args:?}");
        let written = paths(&last["written"]);
        for file in files {
            assert!(written.contains(*file), "{args:?}: no {file} in {written:?}");
        }
        assert!(written.iter().all(|path| place.path(path).is_file()), "{args:?}: {written:?}");
        if files.is_empty() {
            assert_eq!(written.len(), 0, "{args:?}: {written:?}");
        }
        let one_by_one: BTreeSet<_> =
            events.iter().filter(|event| event["event"] == "written").map(|event| event["path"].as_str().unwrap()).collect();
        assert!(written.iter().all(|path| one_by_one.contains(path.as_str())), "{args:?}");
        // Quiet is taken everywhere, and both together are refused.
        place.fails(2, &[args, &["-q", "--log-format", "json"]].concat());
    }
    let quiet = place.luxel(&["render", "run", "-o", "frames", "-q"]).output().unwrap();
    assert!(quiet.stdout.is_empty() && quiet.stderr.is_empty(), "{quiet:?}");
    let table = place.luxel(&["eval", "run", "-q"]).output().unwrap();
    assert!(String::from_utf8(table.stdout).unwrap().contains("psnr") && table.stderr.is_empty());
}

#[test]
fn frames_are_reported_one_by_one() {
    let place = Workplace::new();
    place.train("run", &[]);
    for (args, count) in [(&["render", "run", "-o", "frames", "--split", "all"][..], 9), (&["eval", "run"], 9)] {
        let (_, events) = events(&place, args);
        let frames: Vec<&Value> = events.iter().filter(|event| event["event"] == "frame").collect();
        assert_eq!(frames.len(), count, "{args:?}");
        for (i, frame) in frames.iter().enumerate() {
            assert_eq!((frame["done"].as_u64(), frame["frames"].as_u64()), (Some(i as u64 + 1), Some(count as u64)), "{frame}");
            assert!(paths(&frame["files"]).iter().all(|path| place.path(path).is_file()), "{frame}");
        }
        assert!(frames.iter().any(|frame| frame["name"] == "images/000" && !paths(&frame["files"]).is_empty()), "{args:?}");
    }
    let probe = events(&place, &["probe", "run", "--at", "0,0,0", "--size", "16", "-o", "probe.exr"]).1;
    assert!(probe.iter().any(|event| event["event"] == "frame" && event["done"] == event["frames"]));
}

#[test]
fn an_error_is_an_event() {
    let place = Workplace::new();
    place.train("run", &[]);
    std::fs::rename(place.path("data"), place.path("moved")).unwrap();
    let (code, events) = events(&place, &["eval", "run"]);
    let last = events.last().unwrap();
    assert_eq!((code, &last["event"], &last["remedy"]), (Some(1), &"error".into(), &"give --data".into()), "{last}");
    assert!(last["message"].as_str().unwrap().contains("is not there") && last["causes"].is_array() && last["written"].is_array());
}

#[cfg(unix)]
#[test]
fn an_interruption_is_an_event() {
    use std::io::{BufRead, BufReader};
    let place = Workplace::new();
    let train = ["train", "data", "-o", "long", "--iterations", "1000000", "--init-points", "50", "--threads", "1"];
    let bench = ["bench", "--generate", "50000", "--size", "200x200", "--steps", "1000000", "--threads", "1"];
    for (args, since) in [(&train[..], "progress"), (&bench, "started")] {
        let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_luxel"))
            .current_dir(place.path(""))
            .args(args)
            .args(["--log-format", "json"])
            .stdout(std::process::Stdio::piped())
            .stderr(std::process::Stdio::null())
            .spawn()
            .unwrap();
        let mut lines =
            BufReader::new(child.stdout.take().unwrap()).lines().map(|line| serde_json::from_str::<Value>(&line.unwrap()).unwrap());
        while lines.next().unwrap()["event"] != since {}
        assert!(std::process::Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
        let last = lines.last().unwrap();
        assert_eq!((&last["event"], child.wait().unwrap().code()), (&"interrupted".into(), Some(130)), "{last}");
        let written = paths(&last["written"]);
        assert!(written.iter().all(|path| place.path(path).is_file()), "{last}");
        assert_eq!(written.contains("long/config.toml"), since == "progress", "{last}");
    }
}

#[test]
fn versions_and_metrics_name_revision_and_features() {
    let place = Workplace::new();
    assert_eq!(place.ok(&["-V"]), format!("luxel {}\n", luxel::VERSION));
    let long = place.ok(&["--version"]);
    for part in ["\nrevision  ", "\nfeatures  ", "\ntarget    "] {
        assert!(long.contains(part), "{long}");
    }
    for (feature, is_there) in [("gpu", cfg!(feature = "gpu")), ("ocio", cfg!(feature = "ocio")), ("view", cfg!(feature = "view"))] {
        assert_eq!(long.lines().any(|line| line.starts_with("features") && line.contains(feature)), is_there, "{feature}: {long}");
    }
    place.train("run", &[]);
    for command in [None, Some("eval")] {
        if let Some(command) = command {
            place.ok(&[command, "run"]);
        }
        let metrics = place.json("run/metrics.json");
        let revision = metrics["revision"].as_str().unwrap_or("unknown");
        assert!(long.contains(&format!("revision  {revision}")), "{revision} in {long}");
        assert_eq!(metrics["features"], serde_json::json!(luxel_app::build_info::features()));
        assert_eq!(metrics["train_cpu_seconds"].is_f64(), cfg!(unix), "{metrics}");
    }
    let report = std::fs::read_to_string(place.path("run/report.html")).unwrap();
    assert!(!cfg!(unix) || report.contains("processor time"));
}

#[test]
fn training_tells_the_time_on_the_clock_and_of_processors() {
    let place = Workplace::new();
    let args = ["train", "data", "-o", "run", "--iterations", "20", "--init-points", "50", "--threads", "1"];
    let stderr = String::from_utf8(place.luxel(&args).output().unwrap().stderr).unwrap();
    let line = stderr.lines().find(|line| line.starts_with("trained in ")).unwrap_or_else(|| panic!("{stderr}"));
    assert_eq!(line.ends_with("of processor time"), cfg!(unix), "{line}");
}

#[test]
fn the_report_has_a_curve_of_test_views_that_costs_no_bit() {
    let place = Workplace::new();
    let args = ["train", "data", "-o", "run", "--iterations", "300", "--init-points", "50", "--threads", "1", "--seed", "3"];
    place.ok(&args);
    let log = std::fs::read_to_string(place.path("run/log.jsonl")).unwrap();
    let lines: Vec<Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.iter().map(|line| line["iteration"].as_u64().unwrap()).collect::<Vec<_>>(), [100, 200, 300]);
    assert!(lines.iter().all(|line| line["psnr_test_sample"].is_f64() && line["psnr_test"].is_null()), "{log}");
    let report = std::fs::read_to_string(place.path("run/report.html")).unwrap();
    assert!(report.contains("some test views") && report.contains("all test views"));
    // The library's training, which looks at no test view, comes to the same scene.
    let dataset = luxel::Dataset::open(place.path("data")).unwrap();
    let config = luxel::TrainConfig { init_points: 50, seed: 3, ..luxel::TrainConfig::default() };
    let mut training = luxel::Training::builder(&dataset).config(config).steps(300).device(luxel::Device::Cpu).start().unwrap();
    for step in training.by_ref() {
        step.unwrap();
    }
    assert_eq!(training.into_scene().unwrap(), luxel_app::run::open_scene(place.path("run"), &luxel::Silent).unwrap());
}

#[test]
fn a_machine_is_examined() {
    let place = Workplace::empty();
    let text = place.ok(&["doctor"]);
    for part in ["colmap", "ffmpeg", "pycolmap", "instruction set", "memory", "temporary folder", "needed for", "poses of photographs"] {
        assert!(text.contains(part), "{part} in {text}");
    }
    // Without any program on the path each says how to get it, and that is no error.
    let output = place.luxel(&["doctor", "--json"]).env("PATH", "").output().unwrap();
    assert!(output.status.success());
    let facts: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(facts["schema_version"], luxel_app::schema::DOCTOR.version);
    for program in ["colmap", "ffmpeg", "pycolmap"] {
        assert_eq!(facts[program]["found"], "no");
        assert!(facts[program]["install"].as_str().unwrap().contains("install"), "{facts}");
    }
    assert_eq!(facts["temporary_folder"]["writable"], true);
    assert!(facts["devices"]["cpu"]["threads"].is_u64() && facts["luxel"]["features"].is_string(), "{facts}");
}

#[cfg(unix)]
#[test]
fn programs_that_are_found_tell_their_version() {
    use std::os::unix::fs::PermissionsExt;
    let place = Workplace::empty();
    for (name, says) in [("colmap", "COLMAP 3.8 -- Structure-from-Motion"), ("ffmpeg", "ffmpeg version 5.1 Copyright (c) 2000")] {
        let path = place.path(name);
        std::fs::write(&path, format!("#!/bin/sh\necho '{says}'\n")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    }
    let output = place.luxel(&["doctor", "--json"]).env("PATH", place.path("")).output().unwrap();
    let facts: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(
        (&facts["colmap"]["version"], &facts["ffmpeg"]["version"]),
        (&"COLMAP 3.8 -- Structure-from-Motion".into(), &"ffmpeg version 5.1".into())
    );
    assert_eq!(facts["colmap"]["found"], place.path("colmap").display().to_string());
}

#[test]
fn a_probe_where_no_camera_saw_is_warned_of() {
    let place = Workplace::new();
    place.train("run", &[]);
    let said = |at: &str| {
        let output = place.luxel(&["probe", "run", &format!("--at={at}"), "--size", "16", "-o", "a.exr", "--overwrite"]).output().unwrap();
        assert!(output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    let far = said("500,500,500");
    assert!(far.contains("warning: the point is in no image of the data set") && far.contains("the nearest is at "), "{far}");
    // The place that the warning names is in sight.
    let at = far.split("the nearest is at ").nth(1).unwrap().trim();
    assert!(!said(at).contains("warning: the point"), "{at}");
}
