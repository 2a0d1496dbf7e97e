//! The program from outside: commands, files, messages, exit codes.

use crate::common::{self, SIDE, VIEWS, Workplace};

#[test]
fn a_run_has_its_files_and_its_figures() {
    let place = Workplace::new();
    place.train("run", &["--eval-at", "20", "--checkpoint-every", "10", "--keep-checkpoints", "2", "--method", "sh3", "--seed", "7"]);
    for file in ["config.toml", "metrics.json", "log.jsonl", "report.html"] {
        assert!(place.path("run").join(file).is_file(), "{file}");
    }
    for step in [20, 40] {
        assert!(place.path(&format!("run/point_cloud/iteration_{step}/point_cloud.ply")).is_file());
        // Views 0 and 8 of 9 are held out.
        for image in ["renders/000.exr", "renders/008.exr", "gt/000.exr", "gt/008.exr"] {
            assert!(place.path(&format!("run/eval/step_{step}/{image}")).is_file(), "{step} {image}");
        }
    }
    assert_eq!(std::fs::read_dir(place.path("run/checkpoints")).unwrap().count(), 2);
    let log = std::fs::read_to_string(place.path("run/log.jsonl")).unwrap();
    let last: serde_json::Value = serde_json::from_str(log.lines().last().unwrap()).unwrap();
    assert_eq!(last["iteration"], 40);
    assert!(last["loss"].as_f64().unwrap() > 0.0 && last["splats"].as_u64().unwrap() > 0);

    let metrics = place.json("run/metrics.json");
    assert_eq!((&metrics["method"], &metrics["iterations"], &metrics["seed"]), (&"sh3".into(), &40.into(), &7.into()));
    for key in ["splats", "train_seconds", "radiance_scale", "mu", "threads"] {
        assert!(metrics[key].as_f64().unwrap() > 0.0, "{key}: {}", metrics[key]);
    }
    assert!(metrics["luxel_version"].is_string() && metrics["dataset"].is_string());
    assert!(metrics["peak_rss_bytes"].as_u64().is_some() == cfg!(target_os = "linux"));
    for (split, views) in [("test", 2), ("train", VIEWS - 2)] {
        let split = &metrics["splits"][split];
        assert_eq!(split["views"].as_array().unwrap().len(), views);
        for key in [
            "psnr_scene",
            "psnr_gtmax",
            "psnr_selfmax",
            "ssim_scene",
            "ssim_gtmax",
            "ssim_selfmax",
            "psnr_black_scene",
            "pu21_psnr",
            "pu21_ssim",
            "log_rmse",
        ] {
            assert!(split["mean"][key].is_number(), "mean {key}");
            assert!(split["views"][0][key].is_number(), "views {key}");
        }
        assert!(split["views"][0]["name"].as_str().unwrap().starts_with("images/00"));
        assert!(split["profile"].is_object() || split["profile"].is_array());
    }
}

#[test]
fn eval_prints_a_table_and_rewrites_the_figures() {
    let place = Workplace::new();
    place.train("run", &[]);
    let before = place.json("run/metrics.json");
    std::fs::remove_file(place.path("run/metrics.json")).unwrap();
    std::fs::remove_file(place.path("run/report.html")).unwrap();
    let table = place.ok(&["eval", "run", "--threads", "1"]);
    for part in ["test", "train", "psnr", "ssim", "scene", "gtmax", "selfmax", "images/000", "mean"] {
        assert!(table.contains(part), "{part}\n{table}");
    }
    let after = place.json("run/metrics.json");
    let mean = |metrics: &serde_json::Value, key: &str| metrics["splits"]["test"]["mean"][key].as_f64();
    assert!(mean(&after, "pu21_psnr").is_some() && mean(&after, "hdr_flip").is_none());
    place.ok(&["eval", "run", "--metrics", "all", "--peak-luminance", "300"]);
    let all = place.json("run/metrics.json");
    assert!((0.0..1.0).contains(&mean(&all, "hdr_flip").unwrap()) && mean(&all, "pu21_peak_luminance") == Some(300.0));
    let psnr = |metrics: &serde_json::Value| metrics["splits"]["test"]["mean"]["psnr_scene"].as_f64().unwrap();
    // The scene went through its file: single precision both times.
    assert!((psnr(&before) - psnr(&after)).abs() < 1e-3, "{} {}", psnr(&before), psnr(&after));
    assert!(place.path("run/report.html").is_file());
    // Another copy of the data set gives the same metrics, and its images do not replace the run's.
    common::write_dataset(&place.path("elsewhere"));
    let of_training =
        || ["metrics.json", "renders/000.exr", "gt/000.exr"].map(|name| std::fs::read(place.path("run/eval/step_40").join(name)).unwrap());
    let kept = of_training();
    std::fs::copy(place.path("data/images/001.exr"), place.path("elsewhere/images/000.exr")).unwrap();
    place.ok(&["eval", "run", "--data", "elsewhere"]);
    assert!(of_training() == kept && place.path("run/eval/step_40_on_elsewhere/gt/000.exr").is_file());
    common::write_dataset(&place.path("elsewhere"));
    place.ok(&["eval", "run", "--data", "elsewhere"]);
    assert!((psnr(&place.json("run/metrics.json")) - psnr(&after)).abs() < 1e-9);
    // With explicit options: other data of another size, and the run's own, which keeps the images
    // of training.
    for (data, folder) in [(&["--data", "elsewhere"][..], "eval/step_40_on_elsewhere_"), (&[], "eval/step_40_on_data")] {
        place.ok(&[&["eval", "run", "--downscale", "2"], data].concat());
        let folders = std::fs::read_dir(place.path("run/eval")).unwrap().map(|entry| entry.unwrap().path());
        let found: Vec<_> = folders.filter(|path| path.to_str().unwrap().contains(folder)).collect();
        assert_eq!(found.len(), 1, "{found:?}");
        let image = luxel_io::read_image(&found[0].join("gt/000.exr"), &Default::default()).unwrap().image;
        assert_eq!(image.width, SIDE / 2);
    }
    assert!(of_training() == kept);
}

#[test]
fn eval_writes_before_it_prints_and_not_beside_another_luxel() {
    let place = Workplace::new();
    place.train("run", &[]);
    let metrics = || std::fs::read(place.path("run/metrics.json")).unwrap();
    let before = metrics();
    let lock = std::fs::File::options().write(true).open(place.path("run/.lock")).unwrap();
    lock.lock().unwrap();
    place.error(&["eval", "run"], &["run: another luxel is at work"]);
    assert!(metrics() == before);
    drop(lock);
    std::fs::remove_file(place.path("run/report.html")).unwrap();
    place.ok_unread(&["eval", "run", "--peak-luminance", "300"]);
    assert!(metrics() != before && place.path("run/report.html").is_file());
}

#[test]
fn options_of_a_data_set_are_refused_where_none_is_read() {
    let place = Workplace::new();
    place.train("run", &[]);
    let ply = "run/point_cloud/iteration_40/point_cloud.ply";
    let checkpoint = "run/checkpoints/step_000000040.safetensors";
    for (path, what) in [("run", "run is a run"), (ply, "is a scene"), (checkpoint, "is a checkpoint"), ("data/images/000.exr", "an image")]
    {
        for option in [&["--downscale", "2"][..], &["--supervision", "ldr"], &["--format", "colmap"]] {
            place.error(&[&["info", path][..], option].concat(), &[option[0], what, "leave it out"]);
        }
    }
    place.fails(2, &["info", "--devices", "--downscale", "2"]);
    // An image's primaries are given where the file does not state them.
    image::RgbImage::from_raw(2, 1, vec![255, 0, 0, 0, 255, 0]).unwrap().save(place.path("plain.png")).unwrap();
    let stated = |options: &[&str]| -> serde_json::Value {
        serde_json::from_str(&place.ok(&[&["info", "plain.png", "--transfer", "srgb", "--json"], options].concat())).unwrap()
    };
    let (plain, wide) = (stated(&[]), stated(&["--input-color-space", "acescg"]));
    assert_eq!(wide["color_space"], "acescg");
    assert_ne!(wide["percentiles"], plain["percentiles"]);

    let cameras = ["render", "run", "--cameras", "data/transforms.json", "-o", "none"];
    for option in [&["--downscale", "2"][..], &["--masks", "off"]] {
        place.error(&[&cameras[..], option].concat(), &[option[0], "data/transforms.json", "leave it out"]);
        place.error(&[&["export", ply, "-o", "none.ply"][..], option].concat(), &[option[0], "--data DATASET"]);
        place.error(&[&["edit", "run", "--gain", "2", "-o", "none.ply"][..], option].concat(), &[option[0], "--overlay"]);
    }
    place.error(&["edit", "run", "--gain", "2", "-o", "none.ply", "--data", "data"], &["--data", "leave it out"]);
    assert!(!place.path("none").exists() && !place.path("none.ply").exists());
}

#[test]
fn render_writes_the_views_asked_for_once() {
    let place = Workplace::new();
    place.train("run", &[]);
    let count = |folder: &str| std::fs::read_dir(place.path(folder)).map_or(0, Iterator::count);
    place.ok(&["render", "run", "--split", "test", "-o", "test"]);
    assert_eq!(count("test"), 2);
    let image = luxel_io::read_image(&place.path("test/000.exr"), &Default::default()).unwrap().image;
    assert_eq!((image.width, image.height), (SIDE, SIDE));

    let stderr = String::from_utf8(place.luxel(&["render", "run", "--split", "all", "-o", "test"]).output().unwrap().stderr).unwrap();
    assert!(stderr.contains("2 images exist already"), "{stderr}");
    assert_eq!(count("test"), VIEWS);
    place.ok(&["render", "run", "--split", "train", "-o", "train"]);
    assert_eq!(count("train"), VIEWS - 2);

    // Frames and shards: 2 to 6 are five, every other of them from the second is two.
    place.ok(&["render", "run", "--split", "all", "--frames", "2-6", "--shard", "1/2", "-o", "part"]);
    assert!(count("part") == 2 && place.path("part/003.exr").is_file() && place.path("part/005.exr").is_file());

    // A scene file needs cameras, from a data set or a file; previews lie beside.
    let ply = "run/point_cloud/iteration_40/point_cloud.ply";
    place.ok(&["render", ply, "--data", "data", "--split", "test", "-o", "ply", "--tonemap", "agx", "--exposure", "-1.5"]);
    assert!(place.path("ply/000.exr").is_file() && place.path("ply/000.png").is_file());
    place.ok(&["render", ply, "--cameras", "data/transforms.json", "-o", "cameras"]);
    assert_eq!(count("cameras"), VIEWS);
    place.error(&["render", ply, "-o", "none"], &["--data", "--cameras"]);
    place.error(&["render", "run", "--frames", "100-200", "-o", "none"], &["--frames", "number of frames, 2"]);
    place.error(&["render", "data", "-o", "none"], &["config.toml"]);
}

#[test]
fn a_scene_of_several_samples_says_so_and_renders_may_take_others() {
    let place = Workplace::new();
    place.train("run", &["--samples", "2", "--samples-share", "0.5"]);
    let facts: serde_json::Value =
        serde_json::from_str(&place.ok(&["info", "run/point_cloud/iteration_40/point_cloud.ply", "--json"])).unwrap();
    assert_eq!(facts["samples"], 2);
    let render = |folder: &str, options: &[&str]| {
        place.ok(&[&["render", "run", "-o", folder][..], options].concat());
        let image = luxel_io::read_image(&place.path(&format!("{folder}/000.exr")), &Default::default()).unwrap().image;
        assert_eq!((image.width, image.height), (SIDE, SIDE));
        image
    };
    let own = render("own", &[]);
    assert_eq!(own, render("two", &["--samples", "2"]));
    assert_ne!(own, render("one", &["--samples", "1"]));
    place.fails(2, &["render", "run", "-o", "none", "--samples", "5"]);
    place.error(&["train", "data", "-o", "none", "--samples", "1", "--samples-share", "0.5"], &["--samples-share", "--samples above 1"]);
}

#[test]
fn render_options_change_the_images() {
    let place = Workplace::new();
    place.train("run", &[]);
    let render = |folder: &str, options: &[&str]| {
        let mut args = vec!["render", "run", "-o", folder];
        args.extend(options);
        place.ok(&args);
    };
    let size = |file: &str| std::fs::metadata(place.path(file)).unwrap().len();
    render("half", &[]);
    render("float", &["--exr-type", "float"]);
    assert!(size("float/000.exr") > size("half/000.exr"));
    let read = |file: &str| luxel_io::read_image(&place.path(file), &Default::default()).unwrap().image;
    render("lit", &["--background", "5,5,5"]);
    let sum = |file: &str| read(file).pixels.iter().map(|p| p[0]).sum::<f32>();
    assert!(sum("lit/000.exr") > sum("half/000.exr") + 1.0);
    render("small", &["--downscale", "2"]);
    assert_eq!(read("small/000.exr").width, SIDE / 2);
    let mut previews = std::collections::BTreeSet::new();
    for (folder, options) in [
        ("p1", ["--tonemap", "none", "--exposure", "0"]),
        ("p2", ["--tonemap", "mulaw", "--exposure", "0"]),
        ("p3", ["--tonemap", "reinhard", "--exposure", "0"]),
        ("p4", ["--tonemap", "aces", "--exposure", "0"]),
        ("p5", ["--tonemap", "agx", "--exposure", "0"]),
        ("p6", ["--tonemap", "agx", "--exposure", "3"]),
    ] {
        render(folder, &options);
        previews.insert(std::fs::read(place.path(&format!("{folder}/000.png"))).unwrap());
    }
    assert_eq!(previews.len(), 6);
    // Radiance beyond half floats makes float files, or is reported.
    render("bright", &["--background", "1e9,1e9,1e9"]);
    assert!(read("bright/000.exr").pixels.as_flattened().iter().any(|v| *v > 1e5));
    let output =
        place.luxel(&["render", "run", "-o", "half-bright", "--background", "1e9,1e9,1e9", "--exr-type", "half"]).output().unwrap();
    assert!(String::from_utf8_lossy(&output.stderr).contains("leave --exr-type half out"));
}

#[test]
fn info_describes_everything_there_is() {
    let place = Workplace::new();
    place.train("run", &[]);
    let checkpoint = std::fs::read_dir(place.path("run/checkpoints")).unwrap().next().unwrap().unwrap().path();
    let cases = [
        ("data/transforms.json", "data set", vec!["train_views"]),
        ("data", "data set", vec!["train_views", "test_views", "points", "masked_pixels", "percentiles", "color_space", "fingerprint"]),
        ("run", "run", vec!["method", "scene", "metrics", "dataset"]),
        ("run/point_cloud/iteration_40/point_cloud.ply", "scene", vec!["splats", "bounds", "percentiles", "radiance_scale", "file_bytes"]),
        (checkpoint.to_str().unwrap(), "checkpoint", vec!["splats", "file_bytes"]),
        ("data/images/000.exr", "image", vec!["width", "height", "percentiles", "bad_pixels", "color_space"]),
    ];
    for (path, kind, keys) in cases {
        let json: serde_json::Value = serde_json::from_str(&place.ok(&["info", path, "--json"])).unwrap();
        assert_eq!(json["kind"], kind);
        for key in keys {
            assert!(!json[key].is_null(), "{path}: {key} in {json:#}");
        }
        assert!(place.ok(&["info", path]).contains(kind));
    }
    assert_eq!(serde_json::from_str::<serde_json::Value>(&place.ok(&["info", "data", "--json"])).unwrap()["train_views"], VIEWS - 2);
    place.error(&["info", "nothing"], &["nothing"]);
}

#[test]
fn an_output_folder_that_exists_is_not_touched_without_a_word() {
    let place = Workplace::new();
    place.train("run", &[]);
    place.error(&["train", "data", "-o", "run"], &["--resume", "--overwrite"]);
    std::fs::write(place.path("run/notes.txt"), "mine").unwrap();
    place.train("run", &["--overwrite", "--seed", "1"]);
    assert_eq!(place.json("run/metrics.json")["seed"], 1);
    assert_eq!(std::fs::read_to_string(place.path("run/notes.txt")).unwrap(), "mine");

    std::fs::create_dir(place.path("thesis")).unwrap();
    std::fs::write(place.path("thesis/final.tex"), "years").unwrap();
    for flags in [&[][..], &["--overwrite"]] {
        let args: Vec<&str> = ["train", "data", "-o", "thesis"].iter().chain(flags).copied().collect();
        place.error(&args, &["thesis", "not a luxel run"]);
    }
    assert!(place.path("thesis/final.tex").is_file());
    place.error(&["train", "data", "-o", "thesis", "--resume"], &["no run to resume"]);
    place.error(&["train", "data", "-o", "thesis/final.tex"], &["expected a folder"]);
    place.error(&["demo", "-o", "run"], &["not a demo"]);
    place.error(&["demo", "-o", "thesis"], &["not an earlier demo"]);
    // A data set that cannot be read leaves no folder behind, and an overwritten run as it was.
    place.error(&["train", "nowhere", "-o", "new"], &["nowhere"]);
    assert!(!place.path("new").exists());
    std::fs::create_dir(place.path("empty")).unwrap();
    place.error(&["train", "empty", "-o", "run", "--overwrite"], &["empty"]);
    assert!(place.path("run/metrics.json").is_file());
}

#[test]
fn a_configuration_can_be_taken_over_and_changed() {
    let place = Workplace::new();
    place.train("first", &["--method", "sh1", "--seed", "5"]);
    place.ok(&["train", "--config", "first/config.toml", "-o", "second", "--seed", "6", "--iterations", "20"]);
    let metrics = place.json("second/metrics.json");
    assert_eq!((&metrics["method"], &metrics["seed"], &metrics["iterations"]), (&"sh1".into(), &6.into(), &20.into()));
    std::fs::write(place.path("bad.toml"), "seed = [").unwrap();
    place.error(&["train", "data", "--config", "bad.toml", "-o", "third"], &["bad.toml"]);
    // A misspelt option is not passed over.
    let config = std::fs::read_to_string(place.path("first/config.toml")).unwrap();
    for (section, misspelt) in [("[load]", "tranfser = \"linear\""), ("[run]", "eval_evry = 5"), ("[device]", "thread = 1")] {
        std::fs::write(place.path("bad.toml"), config.replace(section, &format!("{section}\n{misspelt}"))).unwrap();
        place.error(&["train", "data", "--config", "bad.toml", "-o", "third"], &["bad.toml", misspelt.split(' ').next().unwrap()]);
    }
}

#[test]
fn a_run_takes_as_many_steps_as_fit_into_its_time() {
    let place = Workplace::empty();
    common::write_dataset(&place.path("data"));
    let train = ["train", "data", "-o", "run", "--eval-at", "0", "--refine-display", "0", "--threads", "2"];
    place.ok(&[&train[..], &["--time", "1s", "--init-points", "50"]].concat());
    let config = std::fs::read_to_string(place.path("run/config.toml")).unwrap();
    let steps = place.json("run/metrics.json")["iterations"].as_u64().unwrap();
    // The preset's number of steps takes longer.
    let fast = luxel::TrainConfig::default().iterations;
    assert!(config.contains("time = \"1s\"") && config.contains(&format!("iterations = {steps}\n")), "{config}");
    assert!((21..u64::from(fast)).contains(&steps), "{steps}");
    // The run is complete; more steps make it longer, and take the place of the time.
    let notes = place.notes(&["train", "--resume", "-o", "run", "--threads", "2"]);
    assert!(notes.contains(&format!("all {steps} steps were made before, trained in ")), "{notes}");
    assert_eq!(place.json("run/metrics.json")["iterations"], steps);
    let longer = (steps + 5).to_string();
    place.ok(&["train", "--resume", "-o", "run", "--iterations", &longer, "--threads", "2"]);
    assert_eq!(place.json("run/metrics.json")["iterations"], steps + 5);
    assert!(!std::fs::read_to_string(place.path("run/config.toml")).unwrap().contains("time ="));
    for wrong in [&["--time", "5"][..], &["--time", "0s"], &["--time", "1min", "--iterations", "5"]] {
        place.fails(2, &[&["train", "data", "-o", "x"], wrong].concat());
    }
    place.error(&["train", "data", "-o", "x", "--method", "nerf-grid", "--time", "1min"], &["--time", "--method lcd"]);
}

#[test]
fn progress_is_told_as_asked() {
    let place = Workplace::new();
    let stdout = place.train("json", &["--log-format", "json", "--eval-every", "20"]);
    let events: Vec<serde_json::Value> = stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let count = |name: &str| events.iter().filter(|event| event["event"] == name).count();
    assert!(count("progress") >= 2 && count("finished") == 1, "{stdout}");
    assert_eq!(count("evaluation"), 3, "test at 20, test and train at 40: {stdout}");

    let mut args = vec!["train", "data", "-o", "quiet", "--quiet"];
    args.extend(common::QUICK);
    let output = place.luxel(&args).output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty() && output.stdout.is_empty());

    let table = place.train("profile", &["--profile"]);
    assert!(table.contains("rasterize_backward") && table.contains("ms a step"), "{table}");
    let args = [&["train", "data", "-o", "profile", "--overwrite", "--profile"], &common::QUICK[..]].concat();
    let profile = place.events(&args, "profile");
    assert!(profile.len() == 1 && profile[0]["ms_a_step"]["rasterize_backward"].as_f64().unwrap() > 0.0, "{profile:?}");
}

#[test]
fn usage_errors_have_code_two() {
    let place = Workplace::new();
    for args in [
        &[][..],
        &["trian"],
        &["train"],
        &["train", "data"],
        &["train", "data", "-o", "run", "--downscale", "0"],
        &["train", "data", "-o", "run", "--downscale", "17"],
        &["train", "data", "-o", "run", "--method", "nerf"],
        &["train", "data", "-o", "run", "--overwrite", "--resume"],
        &["train", "data", "-o", "run", "--threads", "0"],
        &["train", "data", "-o", "run", "--seed", "9223372036854775808"],
        &["render", "run", "-o", "x", "--frames", "9-1"],
        &["render", "run", "-o", "x", "--shard", "3/3"],
        &["render", "run", "-o", "x", "--exposure", "1"],
        &["render", "run", "-o", "x", "--background", "1,2"],
    ] {
        place.fails(2, args);
    }
    place.error(&["train", "data", "-o", "run", "--device", "gpu:no such card"], &["--device gpu:no such card", "--device cpu"]);
    assert!(!place.path("run").exists());
}

#[test]
fn the_demo_runs_anywhere_and_replaces_only_itself() {
    let place = Workplace::new();
    let mine = ["pictures/mine.png", "dataset/notes.txt"].map(|name| place.path("luxel-demo").join(name));
    for _ in 0..2 {
        let told = place.ok(&["demo", "--iterations", "5", "--quiet"]);
        for part in ["report.html", "point_cloud.ply", "pictures", "luxel render luxel-demo"] {
            assert!(told.contains(part), "{part}\n{told}");
        }
        for file in ["report.html", "metrics.json", "point_cloud/iteration_5/point_cloud.ply", "dataset/LICENSES.txt"] {
            assert!(place.path("luxel-demo").join(file).is_file(), "{file}");
        }
        let is_picture = |entry: &std::fs::DirEntry| entry.path() != mine[0];
        assert_eq!(std::fs::read_dir(place.path("luxel-demo/pictures")).unwrap().map(Result::unwrap).filter(is_picture).count(), 12);
        for path in &mine {
            std::fs::write(path, "mine").unwrap();
        }
    }
    assert!(mine.iter().all(|path| path.is_file()));
    place.ok(&["render", "luxel-demo", "--frames", "0", "-o", "frame"]);
    // A device that is not there costs nothing, and neither does what was made of a demo.
    place.error(&["demo", "--device", "gpu:no such card"], &["gpu:no such card"]);
    assert!(place.path("luxel-demo/report.html").is_file());
    place.ok(&["train", "--resume", "-o", "luxel-demo", "--iterations", "6", "--quiet"]);
    place.error(&["demo", "--iterations", "5"], &["not a demo"]);
    assert_eq!(place.events(&["demo", "-o", "other", "--iterations", "2"], "finished").len(), 1);
    // Training in its place takes its pictures with it; points are there, so none are made up.
    let train = ["train", "other/dataset", "-o", "other", "--overwrite", "--iterations", "2", "--init-points", "5", "--quiet"];
    let stderr = String::from_utf8(place.luxel(&train).output().unwrap().stderr).unwrap();
    assert!(stderr.contains("--init-points changes nothing"), "{stderr}");
    assert!(!place.path("other/pictures").exists() && place.path("other/metrics.json").is_file());
}

#[test]
fn devices_are_listed_with_what_auto_takes() {
    let place = Workplace::empty();
    let text = place.ok(&["info", "--devices"]);
    assert!(text.contains("cpu") && text.contains("threads") && text.contains("taken"), "{text}");
    let json: serde_json::Value = serde_json::from_str(&place.ok(&["info", "--devices", "--json"])).unwrap();
    let devices = json.as_object().unwrap().values().filter_map(|device| device["auto"].as_str());
    // Exactly one is taken.
    assert_eq!(devices.filter(|auto| auto.starts_with("taken")).count(), 1, "{json}");
    place.fails(2, &["info"]);
    place.fails(2, &["info", "data", "--devices"]);
    place.fails(2, &["train", "data", "-o", "run", "--device", "gpu:"]);
}

/// The loader of Vulkan drivers looks at these alone if they are set.
#[cfg(all(target_os = "linux", feature = "gpu"))]
#[test]
fn without_a_graphics_driver_auto_is_the_cpu_and_gpu_names_a_remedy() {
    let place = Workplace::new();
    let without_driver = |args: &[&str]| {
        let mut command = place.luxel(args);
        command.env("VK_DRIVER_FILES", "/nowhere/driver.json").env("VK_ICD_FILENAMES", "/nowhere/driver.json");
        let output = command.output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let train = |device| [&["train", "data", "-o", "run", "--device", device], &common::QUICK[..]].concat();
    let (code, stderr) = without_driver(&train("gpu"));
    assert_eq!(code, Some(1), "{stderr}");
    for part in ["--device gpu", "no GPU can be used", "--device cpu"] {
        assert!(stderr.contains(part), "no \"{part}\" in\n{stderr}");
    }
    let (code, stderr) = without_driver(&train("auto"));
    assert_eq!(code, Some(0), "{stderr}");
    assert!(stderr.contains("on 2 threads"), "{stderr}");
}
