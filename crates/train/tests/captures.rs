//! Gains of images and a camera's response, learned from the room of `common`, and their state in a
//! resumed run.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic as they do")]

mod common;

use common::{config, dataset, engine};
use luxel_core::response::exposure_of_knot;
use luxel_core::{Dataset, Image, Mask, NoiseModel, PixelValues, View};
use luxel_metrics::{EvaluationError, GainFit, Measures, SplitMetrics, evaluate, probe};
use luxel_train::{ExposureCompensation, NoiseChoice, TrainConfig, TrainError, Trainer};

fn run(trainer: &mut Trainer, steps: u32) {
    for _ in 0..steps {
        trainer.step().unwrap();
    }
}

fn base(iterations: u32) -> TrainConfig {
    TrainConfig { max_splats: Some(800), densify_interval: Some(50), ..config(iterations) }
}

/// The room with images that drift, and their ln gains by view and channel.
fn drifted() -> (Dataset, Vec<[f32; 3]>) {
    let mut data = dataset();
    let logs: Vec<[f32; 3]> = (0..6).map(|i| [0.2, -0.1, 0.15].map(|a| a * [1.0, -1.0, 0.5, -1.5, 1.5, -0.5][i])).collect();
    for (view, log) in data.train.iter_mut().zip(&logs) {
        let pixels = view.image.pixels.iter().map(|rgb| [0, 1, 2].map(|c| rgb[c] * log[c].exp())).collect();
        view.image = Image::from_pixels(view.image.width, view.image.height, pixels).unwrap().into();
    }
    (data, logs)
}

fn psnr(trainer: &mut Trainer, data: &Dataset, gain_fit: GainFit<'_>) -> f64 {
    metrics(trainer, &data.test, gain_fit).mean.psnr_scene
}

fn metrics(trainer: &mut Trainer, views: &[View], gain_fit: GainFit<'_>) -> SplitMetrics {
    let (options, scale, mu) = (trainer.render_options(), trainer.radiance_scale(), trainer.config().mu);
    let knots = trainer.response();
    let measures = Measures { response: knots.as_ref(), gain_fit, ..Measures::new(scale, mu) };
    evaluate(trainer.engine(), &options, &measures, views, &mut |_, _, _| ()).unwrap()
}

#[test]
fn gains_of_drifting_images_are_found_and_have_mean_zero() {
    let (data, truth) = drifted();
    let of = |exposure_compensation| {
        let mut trainer = Trainer::new(&data, TrainConfig { exposure_compensation, ..base(500) }, engine()).unwrap();
        run(&mut trainer, 500);
        trainer
    };
    assert!(of(ExposureCompensation::Off).log_gains().is_none());
    let with = of(ExposureCompensation::Color);
    let found = with.log_gains().unwrap();
    println!("{found:?}");
    for c in 0..3 {
        let sum: f32 = found.iter().map(|log| log[c]).sum();
        assert!(sum.abs() < 1e-5, "channel {c}: {sum}");
        for (found, truth) in found.iter().zip(&truth) {
            assert!((found[c] - truth[c]).abs() < 0.06, "channel {c}: {found:?} {truth:?}");
        }
    }
}

#[test]
fn metrics_of_training_images_follow_the_learned_gains() {
    let (mut data, _) = drifted();
    // A view without valid pixels does not move the gains of the views after it.
    data.train[1].mask = Some(Mask::from_valid(vec![false; 48 * 48]).into());
    let config = TrainConfig { exposure_compensation: ExposureCompensation::Color, ..base(500) };
    let mut trainer = Trainer::new(&data, config, engine()).unwrap();
    run(&mut trainer, 500);
    let gains = trainer.log_gains().unwrap().to_vec();
    let without = metrics(&mut trainer, &data.train, GainFit::None);
    let with = metrics(&mut trainer, &data.train, GainFit::Known(&gains));
    println!("{:.2} dB as they are, {:.2} dB after their gains", without.mean.psnr_scene, with.mean.psnr_scene);
    assert_eq!(with.views.len(), 5);
    assert!(with.mean.psnr_scene > without.mean.psnr_scene + 3.0);
    let (options, measures) = (trainer.render_options(), Measures::new(trainer.radiance_scale(), trainer.config().mu));
    let probed = probe(trainer.engine(), &options, &measures, &data.train[2], gains[2]).unwrap().unwrap();
    assert!((probed - with.views[1].metrics.psnr_scene).abs() < 1e-6, "{probed}");
}

#[test]
fn no_gain_is_measured_while_opacities_grow_back() {
    let data = dataset();
    let exposure_compensation = ExposureCompensation::Exposure;
    // Gains are measured after the steps 19 to 24, 43 to 48, 67 to 72, 91 to 96 and 115 to 120.
    // Recovery from the reset after step 66 lasts until step 99.
    let config = TrainConfig { opacity_reset_interval: 66, exposure_compensation, ..config(200) };
    let mut trainer = Trainer::new(&data, config, engine()).unwrap();
    let mut after = |step| {
        while trainer.iteration() < step {
            trainer.step().unwrap();
        }
        assert!(trainer.schedule().resets_after(66));
        trainer.log_gains().unwrap().to_vec()
    };
    let before = after(66);
    assert!(before.as_flattened().iter().any(|log| *log != 0.0));
    assert_eq!(after(96), before);
    let largest = |logs: &[[f32; 3]]| logs.as_flattened().iter().fold(0.0f32, |most, log| most.max(log.abs()));
    let later = after(120);
    println!("largest |ln gain| of images that do not drift: {} before the reset, {} after", largest(&before), largest(&later));
    assert!(later != before && largest(&later) < 0.1, "{later:?}");
}

/// The room as captured by a camera with this response, with three exposures per view; the test
/// view stays radiance.
fn recorded() -> Dataset {
    let mut data = dataset();
    let record = |view: &View, k: i32| {
        let exposure_s = 4f32.powi(k) * 4.0;
        let value = |p: f32| (p * exposure_s / (p * exposure_s + 1.0)).powf(1.0 / 2.2);
        let code = |p: f32| (value(p).clamp(0.0, 1.0) * 255.0).round() / 255.0;
        let pixels = view.image.pixels.iter().map(|rgb| rgb.map(code)).collect();
        let image = Image::from_pixels(view.image.width, view.image.height, pixels).unwrap().into();
        View { name: format!("{}_{k}", view.name), image, values: PixelValues::Recorded { exposure_s }, ..view.clone() }
    };
    data.train = data.train.iter().flat_map(|view| [-1, 0, 1].map(|k| record(view, k))).collect();
    data
}

#[test]
fn radiance_and_response_are_learnt_from_captured_images() {
    let data = recorded();
    let mut trainer = Trainer::new(&data, TrainConfig { unit_exposure: 0.5f32.powf(1.0 / 2.2), ..base(900) }, engine()).unwrap();
    run(&mut trainer, 900);
    let (as_is, fitted) = (psnr(&mut trainer, &data, GainFit::None), psnr(&mut trainer, &data, GainFit::Common));
    let knots = trainer.response().unwrap();
    println!("{as_is:.2} dB as it is, {fitted:.2} dB after a common gain");
    assert!(fitted > 24.0, "{as_is} {fitted}");
    // Above these exposures, only the lamp has values.
    for k in (6..23).step_by(4) {
        let x = exposure_of_knot(k);
        let expected = (x / (x + 1.0)).powf(1.0 / 2.2);
        assert!((f64::from(knots[1][k]) - expected).abs() < 0.06, "{x}: {} {expected}", knots[1][k]);
    }
    // A view of captured values is compared as captured.
    let views = Dataset { test: vec![recorded().train[4].clone()], ..data };
    assert!(psnr(&mut trainer, &views, GainFit::None) > 24.0);
    let measures = Measures::new(luxel_core::RadianceScale::ONE, 5000.0);
    let error = evaluate(trainer.engine(), &Default::default(), &measures, &views.test, &mut |_, _, _| ()).unwrap_err();
    assert!(matches!(error, EvaluationError::NoResponse { .. }), "{error}");
}

#[test]
fn a_resumed_run_has_the_gains_and_the_response_of_the_unbroken_one() {
    let data = recorded();
    let config = TrainConfig { exposure_compensation: ExposureCompensation::Exposure, ..base(120) };
    let mut unbroken = Trainer::new(&data, config.clone(), engine()).unwrap();
    run(&mut unbroken, 120);
    let mut first = Trainer::new(&data, config, engine()).unwrap();
    run(&mut first, 70);
    let mut resumed = Trainer::resume(&data, first.snapshot().unwrap(), engine()).unwrap();
    run(&mut resumed, 50);
    assert_eq!(unbroken.snapshot().unwrap(), resumed.snapshot().unwrap());
    assert!(unbroken.log_gains().unwrap().as_flattened().iter().any(|log| *log != 0.0));
    // A state without the response that its configuration needs is refused.
    let mut snapshot = resumed.snapshot().unwrap();
    assert_eq!(luxel_train::snapshot_response(&snapshot, &luxel_train::NoMethods).unwrap(), unbroken.response());
    let state: serde_json::Value = serde_json::from_str(&snapshot.state_json).unwrap();
    let mut state = state.as_object().unwrap().clone();
    state.remove("response");
    snapshot.state_json = serde_json::to_string(&state).unwrap();
    assert!(matches!(Trainer::resume(&data, snapshot, engine()), Err(TrainError::State(_))));
}

/// The room with a slab in front of two cameras beside the test view.
fn with_an_occluder(masked: bool) -> Dataset {
    let mut data = dataset();
    for view in data.train.iter_mut().skip(2).take(2) {
        let inside = |i: usize| (12..30).contains(&(i % 48)) && i / 48 > 10;
        let mut image = Image::clone(&view.image);
        image.pixels.iter_mut().enumerate().filter(|(i, _)| inside(*i)).for_each(|(_, rgb)| *rgb = [2.0, 1.5, 3.0]);
        view.image = image.into();
        view.mask = masked.then(|| Mask::from_valid((0..48 * 48).map(|i| !inside(i))).into());
    }
    data
}

#[test]
fn a_masked_object_leaves_no_trace() {
    let of = |masked| {
        let data = with_an_occluder(masked);
        let config = TrainConfig { radiance_scale: Some(0.2), ..base(300) };
        let mut trainer = Trainer::new(&data, config, engine()).unwrap();
        run(&mut trainer, 300);
        psnr(&mut trainer, &data, GainFit::None)
    };
    let (without, with) = (of(false), of(true));
    println!("{without:.2} dB without masks, {with:.2} dB with");
    assert!(with > without + 1.0, "{without} {with}");
}

#[test]
fn noisy_pixels_have_less_weight() {
    let data = dataset();
    let config = |noise_model| TrainConfig { noise_model, ..base(30) };
    let scene = |data: &Dataset, noise_model| {
        let mut trainer = Trainer::new(data, config(noise_model), engine()).unwrap();
        run(&mut trainer, 30);
        trainer.scene().unwrap()
    };
    let model = NoiseModel { read: 0.01, shot: 1e-3 };
    let mut stated = data.clone();
    stated.train.iter_mut().for_each(|view| view.noise = Some(model));
    let plain = scene(&data, NoiseChoice::Auto);
    assert_eq!(plain, scene(&stated, NoiseChoice::Off));
    let weighted = scene(&data, NoiseChoice::Given(model));
    assert_ne!(plain, weighted);
    assert_eq!(weighted, scene(&stated, NoiseChoice::Auto));
    // A noise model of zero changes no weight.
    assert_eq!(plain, scene(&data, NoiseChoice::Given(NoiseModel { read: 0.0, shot: 0.0 })));
}
