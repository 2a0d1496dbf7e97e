//! The program on a GPU: any adapter, software renderers too. Without an adapter the tests are
//! reported as ignored; where `LUXEL_REQUIRE_GPU=1` that is a failure. `LUXEL_TEST_GPU` is a part
//! of the name of the adapter to take. `LUXEL_GPU_TESTS=threads` asks for tests of single kernels:
//! there are none here.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use common::Workplace;
use libtest_mimic::{Arguments, Failed, Trial};

/// A test, given what `--device` is to say.
type Body = fn(&str);

const ALL: [(&str, Body); 4] = [
    ("a_run_moves_between_cpu_and_gpu", a_run_moves_between_cpu_and_gpu),
    ("engines_relocate_as_many_splats_at_the_bound", engines_relocate_as_many_splats_at_the_bound),
    ("bench_counts_the_work_of_a_step", bench_counts_the_work_of_a_step),
    ("software_renderers_are_taken_by_name_only", software_renderers_are_taken_by_name_only),
];

fn bench_counts_the_work_of_a_step(gpu: &str) {
    let place = Workplace::empty();
    let count = ["bench", "--generate", "400", "--size", "32x24", "--device", gpu, "--count"];
    let found: serde_json::Value = serde_json::from_str(&place.ok(&[&count[..], &["--json"]].concat())).unwrap();
    assert_eq!(found["schema_version"], luxel_app::schema::BENCH_COUNT.version, "{found}");
    let at = |name: &str| found["work"][name].as_u64().unwrap();
    assert!(at("entries") > 100 && at("alive_pairs") > at("block_pairs") && at("submissions") == 1, "{found}");
    assert!(place.ok(&count).contains("alive pairs"));
    let error = place.fails(1, &["bench", "--generate", "400", "--device", "cpu", "--count"]);
    assert!(error.contains("use --device gpu"), "{error}");
}

/// Steps that `run` has after each of its parts.
const PARTS: [&str; 3] = ["20", "30", "40"];

/// Trains `run` in parts, each on the device of its own.
fn train_in_parts(place: &Workplace, run: &str, devices: [&str; 3]) {
    place.ok(&["train", "data", "-o", run, "--init-points", "300", "--threads", "2", "--iterations", PARTS[0], "--device", devices[0]]);
    for (part, device) in PARTS.into_iter().zip(devices).skip(1) {
        place.ok(&["train", "--resume", "-o", run, "--iterations", part, "--device", device]);
    }
}

/// Checkpoints go from one engine to the other and back, and the run ends where it would have on
/// the CPU alone.
fn a_run_moves_between_cpu_and_gpu(gpu: &str) {
    let place = Workplace::new();
    train_in_parts(&place, "stays", ["cpu"; 3]);
    train_in_parts(&place, "moves", ["cpu", gpu, "cpu"]);
    train_in_parts(&place, "returns", [gpu, "cpu", gpu]);
    let psnr = |run: &str, device: &str| {
        place.ok(&["eval", run, "--device", device]);
        place.json(&format!("{run}/metrics.json"))["splits"]["test"]["mean"]["psnr_scene"].as_f64().unwrap()
    };
    let expected = psnr("stays", "cpu");
    for (run, device) in [("stays", gpu), ("moves", "cpu"), ("moves", gpu), ("returns", gpu)] {
        let found = psnr(run, device);
        assert!((found - expected).abs() < 0.05, "{run} on {device}: {found} dB, {expected} dB on the CPU alone");
    }
}

/// Rounds at the bound ask the engine what the views see of each splat, while steps may be on their
/// way.
fn engines_relocate_as_many_splats_at_the_bound(gpu: &str) {
    let place = Workplace::new();
    let figures = |device: &str, run: &str, turnover: &str| {
        let rounds = [
            "--densify-from",
            "5",
            "--densify-interval",
            "10",
            "--densify-threshold",
            "1e-7",
            "--max-splats",
            "320",
            "--turnover",
            turnover,
            "--clearance",
            "0",
            "--stereo-points",
            "0",
        ];
        let command = ["train", "data", "-o", run, "--init-points", "300", "--iterations", "60", "--device", device];
        place.ok(&[&command[..], &rounds[..]].concat());
        let metrics = place.json(&format!("{run}/metrics.json"));
        (metrics["splats"].as_u64().unwrap(), metrics["splits"]["test"]["mean"]["psnr_scene"].as_f64().unwrap())
    };
    let (splats, expected) = figures("cpu", "on-cpu", "0.2");
    let (_, without) = figures("cpu", "without", "0");
    assert!(splats == 320 && expected != without, "{splats} splats, {expected} dB, without changes {without} dB");
    let (splats, found) = figures(gpu, "on-gpu", "0.2");
    assert!(splats == 320 && (found - expected).abs() < 0.2, "{splats} splats, {found} dB, {expected} dB on the CPU");
}

fn software_renderers_are_taken_by_name_only(gpu: &str) {
    let place = Workplace::empty();
    let devices: serde_json::Value = serde_json::from_str(&place.ok(&["info", "--devices", "--json"])).unwrap();
    let name = gpu.trim_start_matches("gpu:");
    let found = devices.as_object().unwrap().values().find(|device| device["name"] == name).unwrap();
    let auto = found["auto"].as_str().unwrap();
    if found["kind"] == "software renderer" {
        assert_eq!(auto, "not taken: a software renderer is only taken by its name");
    } else {
        assert!(!auto.contains("software"), "{auto}");
    }
}

fn main() {
    let arguments = Arguments::from_args();
    let wanted = std::env::var("LUXEL_TEST_GPU").unwrap_or_default();
    let choice = luxel_gpu::DeviceChoice::Named(wanted);
    let adapter = luxel_gpu::adapters().into_iter().find(|adapter| adapter.reason_against(&choice).is_none());
    let device = adapter.map(|adapter| format!("gpu:{}", adapter.name));
    let single_kernels = std::env::var("LUXEL_GPU_TESTS").is_ok_and(|v| v == "threads");
    let mut trials = Vec::new();
    for (name, body) in ALL {
        let device = device.clone();
        let is_ignored = device.is_none() || single_kernels;
        let run = move || {
            if let Some(device) = &device {
                body(device);
            }
            Ok(())
        };
        trials.push(Trial::test(name, run).with_ignored_flag(is_ignored));
    }
    if device.is_none() && std::env::var("LUXEL_REQUIRE_GPU").is_ok_and(|v| v == "1") {
        trials.push(Trial::test("a_gpu_is_there", || {
            Err(Failed::from("LUXEL_REQUIRE_GPU=1, but there is no GPU; see luxel info --devices"))
        }));
    }
    libtest_mimic::run(&arguments, trials).exit();
}
