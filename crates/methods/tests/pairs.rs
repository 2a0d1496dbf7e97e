//! Methods that train on captured images beside radiance: HDR-GS on the room of `common`, seen by a
//! camera of known response.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic as they do")]

mod common;

use common::runs::{captured, check_resumed_and_threads, means, psnr, response, trained};
use common::{config, dataset};
use luxel_core::{Dataset, PixelValues, Snapshot, View};
use luxel_metrics::GainFit;
use luxel_train::{CutoffPreset, HdrNormalisation, LateViews, Method, Strategy, TrainConfig, TrainError, Trainer};

const EXPOSURES_S: [f32; 3] = [0.5, 4.0, 32.0];

/// The room with three captured images of each training pose.
fn pairs() -> Dataset {
    let mut data = dataset();
    for view in &mut data.train {
        view.recordings = EXPOSURES_S.into_iter().enumerate().map(|(k, exposure_s)| captured(view, k, exposure_s)).collect();
    }
    data
}

fn base(iterations: u32) -> TrainConfig {
    TrainConfig { max_splats: Some(600), method: Method::HdrGs, ..config(iterations) }
}

fn snapshot(mut trainer: Trainer) -> Snapshot {
    trainer.snapshot().unwrap()
}

#[test]
fn hdr_gs_learns_radiance_at_one_scale_and_the_response_of_the_camera() {
    let data = pairs();
    // Short runs need networks that learn faster.
    let mut hdr_gs = trained(&data, TrainConfig { tone_lr: 5e-3, ..base(800) }, 800);
    let parity = TrainConfig { method: Method::LogSh3, cutoffs: CutoffPreset::Parity, ..base(800) };
    let mut log_harmonics = trained(&data, parity, 800);
    let (pair, alone) = (psnr(&mut hdr_gs, &data, GainFit::None), psnr(&mut log_harmonics, &data, GainFit::None));
    println!("hdr-gs {pair:.2} dB, logsh3 {alone:.2} dB");
    // Hundreds of steps are few for the networks: the scene follows the radiance, not as closely.
    assert!(pair > 19.0 && alone > pair, "{pair} {alone}");
    let record = hdr_gs.tone_mappers().unwrap();
    assert!(log_harmonics.tone_mappers().is_none());
    assert!((record.reference_s - 4.0).abs() < 1e-5 && record.numbers[0].len() == 3 * 128 + 1);
    // y = sigmoid(bias + sum of outgoing max(weight s + bias, 0)).
    let value = |c: usize, x: f32| {
        let numbers = &record.numbers[c];
        let s = (x / (record.radiance_unit * record.reference_s)).ln();
        let unit = |j: usize| numbers[256 + j] * (numbers[j] * s + numbers[128 + j]).max(0.0);
        1.0 / (1.0 + (-(numbers[384] + (0..128).map(unit).sum::<f32>())).exp())
    };
    for x in [0.1f32, 0.3, 1.0, 2.0] {
        let (found, expected) = (value(0, x), response(x));
        println!("x {x}: {found} {expected}");
        assert!((found - expected).abs() < 0.1, "{x}: {found} {expected}");
    }
}

#[test]
fn by_the_own_maximum_one_gain_for_all_views_brings_the_scene_to_scale() {
    let data = pairs();
    let mut own = trained(&data, TrainConfig { hdr_normalisation: HdrNormalisation::Own, ..base(400) }, 400);
    let (raw, fitted) = (psnr(&mut own, &data, GainFit::None), psnr(&mut own, &data, GainFit::Common));
    println!("as it is {raw:.2} dB, after one gain {fitted:.2} dB");
    assert!(fitted > 18.0, "{raw} {fitted}");
}

#[test]
fn without_weight_of_captured_images_hdr_gs_is_training_of_log_harmonics() {
    let data = pairs();
    // Without densification, whose thresholds turn rounding into other splats.
    let alone =
        TrainConfig { ldr_weight: 0.0, hdr_weight: 1.0, average_share: 0.0, densify_from: Some(1000), stereo_points: Some(0), ..base(60) };
    // HDR-GS sees whole views.
    let plain = TrainConfig {
        method: Method::LogSh3,
        cutoffs: CutoffPreset::Parity,
        hdr_weight: 0.6,
        ldr_weight: 1.0,
        late_views: LateViews::Whole,
        ..alone.clone()
    };
    let (mut a, mut b) = (Trainer::new(&data, alone, means()).unwrap(), Trainer::new(&data, plain, means()).unwrap());
    for step in 1..=60 {
        let (a, b) = (a.step().unwrap().loss, b.step().unwrap().loss);
        // The CPU engine defers an update, but not its report.
        assert!((a - b).abs() < 0.02 * b, "step {step}: {a} {b}");
    }
    assert_eq!(a.splats_len(), b.splats_len());
    let options = a.render_options();
    let view = &data.test[0];
    let [x, y] = [&mut a, &mut b].map(|trainer| trainer.engine().render(&view.camera, &options).unwrap());
    let differences = x.pixels.as_flattened().iter().zip(y.pixels.as_flattened()).map(|(x, y)| f64::from((x - y) / (y + 0.05)).abs());
    let mean = differences.sum::<f64>() / (3 * x.pixels.len()) as f64;
    println!("mean relative difference of renders {mean:e}");
    assert!(mean < 0.02, "{mean}");
}

#[test]
fn the_first_gradient_without_weight_of_captured_images_is_that_of_log_harmonics() {
    let data = pairs();
    let alone = TrainConfig { ldr_weight: 0.0, hdr_weight: 1.0, dropout: 0.0, ..base(60) };
    // HDR-GS sees whole views.
    let plain = TrainConfig {
        method: Method::LogSh3,
        cutoffs: CutoffPreset::Parity,
        hdr_weight: 0.6,
        ldr_weight: 1.0,
        late_views: LateViews::Whole,
        ..alone.clone()
    };
    let [a, b] = [alone, plain].map(|config| snapshot(trained(&data, config, 1)).moments.first);
    for (a, b) in [(a.position.as_flattened(), b.position.as_flattened()), (&a.sh, &b.sh), (&a.opacity_logit, &b.opacity_logit)] {
        let largest = b.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        let worst = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(largest > 0.0 && worst < 1e-3 * largest, "{worst} of {largest}");
    }
}

#[test]
fn radiance_without_weight_changes_no_bit() {
    let data = pairs();
    let run = |mu: f32| snapshot(trained(&data, TrainConfig { hdr_weight: 0.0, mu, radiance_scale: Some(1.0), ..base(40) }, 40));
    let (a, b) = (run(5000.0), run(20.0));
    assert!(a.scene.splats == b.scene.splats && a.moments == b.moments && a.stats == b.stats);
}

#[test]
fn statistics_are_those_of_the_captured_image() {
    let data = pairs();
    let stats = |hdr_weight: f32| {
        let config = TrainConfig { densify_from: Some(0), densify_interval: Some(50), hdr_weight, ..base(200) };
        let mut trainer = Trainer::new(&data, config, means()).unwrap();
        trainer.step().unwrap();
        trainer.snapshot().unwrap().stats
    };
    let (without, with) = (stats(0.0), stats(0.6));
    assert!(without.gradient.iter().any(|v| *v > 0.0));
    assert_eq!(without, with);
}

#[test]
fn a_resumed_run_equals_an_unbroken_one_and_any_number_of_threads_one() {
    check_resumed_and_threads(&pairs(), &base(50));
}

#[test]
fn crops_and_reduced_images_are_cut_from_both_images_alike() {
    let data = pairs();
    let schedule = "2@0,1@20".parse().unwrap();
    let config = TrainConfig { crop: Some(64), resolution_schedule: schedule, ..base(40) };
    assert!(trained(&data, config, 40).splats_len() > 0);
}

#[test]
fn data_without_pairs_and_options_of_other_methods_are_refused() {
    let start = |data: &Dataset, config: TrainConfig| match Trainer::new(data, config, means()) {
        Err(error) => (error.to_string(), error.remedy().map(ToString::to_string).unwrap_or_default()),
        Ok(_) => panic!("was accepted"),
    };
    let (error, remedy) = start(&dataset(), base(10));
    assert!(error.starts_with("method hdr-gs: view train/0 has no captured image beside its radiance"), "{error}");
    assert!(remedy.contains("supervision"), "{remedy}");
    let mut uneven = pairs();
    let other = View { camera: uneven.train[0].camera.downscaled(2), ..uneven.train[0].recordings[0].downscaled(2, 0.5) };
    uneven.train[0].recordings[1] = other;
    assert!(start(&uneven, base(10)).0.contains("is 24 x 24, expected 48 x 48"));
    let mut unexposed = pairs();
    unexposed.train[2].recordings[0].values = PixelValues::Recorded { exposure_s: 0.0 };
    assert!(start(&unexposed, base(10)).0.contains("has no exposure"));
    let refusals = [
        (TrainConfig { batch: 2, ..base(10) }, "batch"),
        (TrainConfig { strategy: Strategy::Mcmc, ..base(10) }, "strategy"),
        (TrainConfig { samples: Some(2), ..base(10) }, "samples"),
        (TrainConfig { absgrad: true, ..base(10) }, "absgrad"),
        (TrainConfig { refine_poses: true, ..base(10) }, "refine_poses"),
        (TrainConfig { background: [0.1; 3], ..base(10) }, "background"),
        (TrainConfig { hdr_weight: 0.0, ldr_weight: 0.0, ..base(10) }, "hdr_weight"),
    ];
    for (config, option) in refusals {
        let Err(error @ TrainError::Config { .. }) = Trainer::new(&pairs(), config, means()).map(|_| ()) else { panic!("{option}") };
        assert_eq!(error.option(), Some(option));
    }
}
