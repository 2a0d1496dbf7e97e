//! Training on the CPU engine: it learns, it is deterministic, and a resumed run equals an unbroken
//! one.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic as they do")]

mod common;

use common::{config, dataset, engine};
use luxel_core::{Antialias, Dataset, Point, Snapshot, Splats};
use luxel_metrics::evaluate;
use luxel_train::{Method, Preset, Strategy, TrainConfig, Trainer};

fn run(trainer: &mut Trainer, steps: u32) {
    for _ in 0..steps {
        trainer.step().unwrap();
    }
}

fn test_psnr(trainer: &mut Trainer, data: &Dataset) -> f64 {
    let (options, scale, mu) = (trainer.render_options(), trainer.radiance_scale(), trainer.config().mu);
    let mut seen = 0;
    let split = evaluate(trainer.engine(), &options, &luxel_metrics::Measures::new(scale, mu), &data.test, &mut |_, image, _| {
        seen += image.pixels.len();
    })
    .unwrap();
    assert_eq!(seen, 48 * 48);
    assert_eq!(split.views[0].name, "test/0");
    split.mean.psnr_scene
}

/// Returns the PSNR of a view that is not trained on, before and after 300 steps with `config`.
fn learn(config: TrainConfig) -> (f64, f64) {
    let data = dataset();
    let mut trainer = Trainer::new(&data, config, engine()).unwrap();
    let before = test_psnr(&mut trainer, &data);
    run(&mut trainer, 300);
    assert!(trainer.is_finished());
    let after = test_psnr(&mut trainer, &data);
    let smoothed = trainer.scene().unwrap().splats.smoothing.len();
    assert_eq!(smoothed, if trainer.config().antialias == Antialias::Mip { trainer.splats_len() } else { 0 });
    println!("{before:.2} dB -> {after:.2} dB with {} splats", trainer.splats_len());
    (before, after)
}

#[test]
fn a_view_not_trained_on_is_learnt_by_every_method() {
    // The threshold is about two thirds of the usual gain, which leaves a margin for other
    // processors.
    for (method, antialias) in [(Method::Sh3, Antialias::Off), (Method::Lcd, Antialias::Pixel), (Method::Lcd, Antialias::Mip)] {
        let (before, after) = learn(TrainConfig { method, antialias, max_splats: Some(1000), densify_interval: Some(50), ..config(300) });
        assert!(after > before + 8.0, "{method:?} {antialias:?}: {before} dB -> {after} dB");
    }
}

#[test]
fn a_view_not_trained_on_is_learnt_by_mcmc() {
    // The threshold is about two thirds of the usual gain. To reach it, opaque splats must stay in
    // place, so the noise must depend on opacity.
    let (before, after) =
        learn(TrainConfig { strategy: Strategy::Mcmc, max_splats: Some(1000), densify_interval: Some(50), ..config(300) });
    assert!(after > before + 12.0, "{before} dB -> {after} dB");
}

/// Returns the snapshot after 60 steps in one go, and after 30 steps, saving, and 30 more.
fn unbroken_and_resumed(data: &Dataset, config: &TrainConfig) -> (Snapshot, Snapshot) {
    let mut unbroken = Trainer::new(data, config.clone(), engine()).unwrap();
    run(&mut unbroken, 60);
    let mut first = Trainer::new(data, config.clone(), engine()).unwrap();
    run(&mut first, 33);
    let mut second = Trainer::resume(data, first.snapshot().unwrap(), engine()).unwrap();
    assert_eq!(second.iteration(), 33);
    run(&mut second, 27);
    (unbroken.snapshot().unwrap(), second.snapshot().unwrap())
}

#[test]
fn a_resumed_run_equals_an_unbroken_one_across_densification() {
    let adc = TrainConfig { densify_threshold: 1e-5, opacity_reset_interval: 40, ..config(120) };
    let mip = TrainConfig { antialias: Antialias::Mip, method: Method::Sh3, absgrad: true, absgrad_threshold: 1e-5, ..adc.clone() };
    let mcmc = TrainConfig { strategy: Strategy::Mcmc, luminance_degree: Some(1), ..config(120) };
    // The stages end before, at and after the step that is saved. Mip mode is included, because its
    // filter is of full resolution throughout.
    let stages = TrainConfig { resolution_schedule: "4@0,2@20,1@33".parse().unwrap(), ..adc.clone() };
    let mip_stages = TrainConfig { resolution_schedule: "2@0,1@45".parse().unwrap(), ..mip.clone() };
    // The saved step is among those that are averaged; the last step is the planned one.
    let averaged = TrainConfig { average_share: 0.6, densify_until: Some(26), ..config(60) };
    let averaged = TrainConfig { densify_threshold: 1e-5, ..averaged };
    let bounded = TrainConfig { max_splats: Some(230), turnover: 0.2, ..adc.clone() };
    for config in [adc, mip, mcmc, stages, mip_stages, averaged, bounded] {
        let (unbroken, resumed) = unbroken_and_resumed(&dataset(), &config);
        assert!(unbroken.scene.splats.len() > 216, "no densification took place: {}", unbroken.scene.splats.len());
        assert!(
            unbroken == resumed,
            "{:?}, {:?}, {}: the resumed run differs",
            config.strategy,
            config.antialias,
            config.resolution_schedule
        );
    }
}

#[test]
fn splats_that_no_view_sees_are_pruned_in_a_resumed_run_too() {
    let mut data = dataset();
    data.train.truncate(2);
    let behind_all = |z: f32| z < -40.0;
    data.points.extend((0..5).map(|i| Point { position: [0.0, 0.2 * i as f32, -50.0], rgb8: None, observations: Vec::new() }));
    // Densification ends at and after the step that is saved.
    for densify_until in [Some(30), Some(40)] {
        let config = |prune_unseen| TrainConfig { densify_threshold: 1e-5, prune_unseen, densify_until, ..config(120) };
        let unseen = |snapshot: &Snapshot| snapshot.scene.splats.position.iter().filter(|position| behind_all(position[2])).count();
        let (kept, _) = unbroken_and_resumed(&data, &config(0.0));
        let (pruned, resumed) = unbroken_and_resumed(&data, &config(1e-3));
        assert_eq!([unseen(&kept), unseen(&pruned)], [5, 0]);
        let lost = kept.scene.splats.len() - pruned.scene.splats.len();
        assert!((5..kept.scene.splats.len() / 5).contains(&lost), "{lost} of {}", kept.scene.splats.len());
        assert!(pruned == resumed);
    }
}

#[test]
fn needles_are_shortened_by_the_end_and_a_resumed_run_is_equal() {
    let data = dataset();
    for strategy in [Strategy::Adc, Strategy::Mcmc] {
        let config = |max_aspect| TrainConfig { densify_threshold: 1e-5, strategy, max_aspect, ..config(120) };
        let longest = |splats: &Splats| (0..splats.len()).map(|i| splats.log_aspect(i)).fold(0.0, f32::max);
        let mut ends = [0.0, 1.1].map(|max_aspect| {
            let mut trainer = Trainer::new(&data, config(max_aspect), engine()).unwrap();
            run(&mut trainer, 120);
            trainer.scene().unwrap().splats
        });
        assert!(longest(&ends[0]) > 1.1f32.ln() + 0.01, "{}", longest(&ends[0]));
        assert!(longest(&ends[1]) < 1.1f32.ln() + 1e-5, "{}", longest(&ends[1]));
        assert_eq!(ends[1].limit_aspect(1.1), 0);
        let ends_there = TrainConfig { iterations: 60, ..config(1.1) };
        let (unbroken, resumed) = unbroken_and_resumed(&data, &ends_there);
        assert!(unbroken == resumed);
    }
}

#[test]
fn at_the_bound_splats_are_relocated_and_stay_within_it() {
    let data = dataset();
    let bounded = |turnover| TrainConfig { densify_threshold: 1e-5, max_splats: Some(230), turnover, ..config(120) };
    let opacities = |turnover| {
        let mut trainer = Trainer::new(&data, bounded(turnover), engine()).unwrap();
        run(&mut trainer, 60);
        trainer.scene().unwrap().splats.opacity_logit
    };
    let (fixed, changed) = (opacities(0.0), opacities(0.2));
    assert_eq!((fixed.len(), changed.len()), (230, 230));
    assert_ne!(fixed, changed);
}

#[test]
fn the_scene_of_a_finished_run_is_the_mean_of_its_last_states() {
    let data = dataset();
    let config = |average_share| TrainConfig { average_share, samples: Some(1), ..config(20) };
    let mut plain = Trainer::new(&data, config(0.0), engine()).unwrap();
    let mut averaged = Trainer::new(&data, config(0.1), engine()).unwrap();
    run(&mut plain, 19);
    run(&mut averaged, 19);
    let before = plain.scene().unwrap();
    assert_eq!(averaged.scene().unwrap(), before);
    assert_eq!(averaged.snapshot().unwrap().average.as_ref(), Some(&before.splats));
    plain.step().unwrap();
    averaged.step().unwrap();
    let (last, mean) = (plain.scene().unwrap().splats, averaged.snapshot().unwrap());
    assert_eq!(mean.average, None);
    assert_eq!(mean.moments, plain.snapshot().unwrap().moments);
    for ((mean, before), last) in mean.scene.splats.sh.iter().zip(&before.splats.sh).zip(&last.sh) {
        assert!((mean - 0.5 * (before + last)).abs() <= 1e-6 * (before.abs() + last.abs()), "{before} and {last}: {mean}");
    }
    assert_ne!(mean.scene.splats.position, last.position);
}

fn harmonics(trainer: &mut Trainer) -> Vec<f32> {
    trainer.scene().unwrap().splats.sh
}

fn assert_is_mean(mean: &[f32], states: &[Vec<f32>]) {
    for (i, mean) in mean.iter().enumerate() {
        let expected = states.iter().map(|state| f64::from(state[i])).sum::<f64>() / states.len() as f64;
        assert!((f64::from(*mean) - expected).abs() < 1e-5, "coefficient {i}: {mean}, expected {expected}");
    }
}

#[test]
fn a_run_that_is_made_longer_is_averaged_before_its_new_end() {
    let data = dataset();
    let mut trainer = Trainer::new(&data, TrainConfig { average_share: 0.1, samples: Some(1), ..config(20) }, engine()).unwrap();
    run(&mut trainer, 20);
    let finished = harmonics(&mut trainer);
    trainer.set_iterations(40);
    assert_eq!(harmonics(&mut trainer), finished, "a mean that was finished stays the scene");
    // Steps 37 to 40 are averaged. The state after step 40, before the mean replaces it, comes from
    // a run that continues beyond.
    run(&mut trainer, 16);
    let mut states = Vec::new();
    for _ in 37..40 {
        trainer.step().unwrap();
        states.push(harmonics(&mut trainer));
    }
    let mut beyond = Trainer::resume(&data, trainer.snapshot().unwrap(), engine()).unwrap();
    let mut resumed = Trainer::resume(&data, trainer.snapshot().unwrap(), engine()).unwrap();
    beyond.set_iterations(41);
    run(&mut beyond, 1);
    states.push(harmonics(&mut beyond));
    run(&mut trainer, 1);
    run(&mut resumed, 1);
    assert_is_mean(&harmonics(&mut trainer), &states);
    assert_eq!(trainer.snapshot().unwrap().average, None);
    assert_eq!(trainer.snapshot().unwrap(), resumed.snapshot().unwrap());
}

#[test]
fn a_run_that_ends_early_becomes_the_mean_so_far() {
    let data = dataset();
    let config = TrainConfig { average_share: 0.5, densify_until: Some(10), samples: Some(1), ..config(40) };
    let mut trainer = Trainer::new(&data, config, engine()).unwrap();
    run(&mut trainer, 20);
    let states: Vec<Vec<f32>> = (21..=30)
        .map(|_| {
            trainer.step().unwrap();
            harmonics(&mut trainer)
        })
        .collect();
    let under_way = trainer.snapshot().unwrap();
    let resumed = |end| {
        let mut trainer = Trainer::resume(&data, under_way.clone(), engine()).unwrap();
        trainer.set_iterations(end);
        trainer
    };
    // The run ends at the current step.
    let mut stopped = resumed(30);
    assert!(stopped.finish_average().unwrap() && stopped.is_finished());
    assert_is_mean(&harmonics(&mut stopped), &states);
    assert_eq!(stopped.snapshot().unwrap().moments, under_way.moments);
    assert!(!stopped.finish_average().unwrap(), "there is nothing left to take");
    // The run ends one step later.
    let mut ended = resumed(31);
    assert!(!ended.finish_average().unwrap());
    ended.step().unwrap();
    let mut whole = resumed(40);
    whole.step().unwrap();
    let states: Vec<Vec<f32>> = states.into_iter().chain([harmonics(&mut whole)]).collect();
    assert_is_mean(&harmonics(&mut ended), &states);
    // The run ends much later, so these steps are not among the last.
    let mut longer = resumed(80);
    assert!(!longer.finish_average().unwrap());
    longer.step().unwrap();
    assert_eq!(longer.snapshot().unwrap().average, None);
    assert_eq!(harmonics(&mut longer), harmonics(&mut whole));
}

#[test]
fn a_view_not_trained_on_is_learnt_on_reduced_images_first() {
    // The threshold is about two thirds of the usual gain.
    let resolution_schedule = "4@0,2@75,1@150".parse().unwrap();
    let (before, after) = learn(TrainConfig { resolution_schedule, max_splats: Some(1000), densify_interval: Some(50), ..config(300) });
    assert!(after > before + 8.0, "{before} dB -> {after} dB");
}

#[test]
fn steps_are_made_at_the_resolution_of_their_stage() {
    let data = dataset();
    let schedule = |text: &str| TrainConfig { resolution_schedule: text.parse().unwrap(), ..config(8) };
    let mut trainer = Trainer::new(&data, schedule("4@0,1@2"), engine()).unwrap();
    let mut factors = Vec::new();
    for _ in 0..4 {
        factors.push(trainer.downscale());
        trainer.step().unwrap();
    }
    assert_eq!(factors, [4, 4, 1, 1]);
    // A schedule of full resolution changes nothing.
    let scene = |text| {
        let mut trainer = Trainer::new(&data, schedule(text), engine()).unwrap();
        run(&mut trainer, 8);
        trainer.scene().unwrap()
    };
    assert!(scene("1@0") == scene("off"));
    assert!(scene("2@0") != scene("off"));
}

#[test]
fn the_fast_preset_learns_in_small() {
    // Points of stereo start 2 dB higher and end 0.3 dB higher: 27.2 dB.
    let fast =
        TrainConfig { max_splats: Some(1000), iterations: 300, densify_interval: Some(50), ..TrainConfig::from_preset(Preset::Fast) };
    let (before, after) = learn(fast);
    assert!(after > before + 7.0 && after > 26.0, "{before} dB -> {after} dB");
}

#[test]
fn splats_start_with_the_given_opacity_and_scale() {
    let data = dataset();
    let start = |config| Trainer::new(&data, config, engine()).unwrap().scene().unwrap().splats;
    let usual = start(config(1));
    let given = start(TrainConfig { init_opacity: Some(0.4), init_scale: Some(0.5), ..config(1) });
    assert!((luxel_core::sigmoid(usual.opacity_logit[3]) - 0.1).abs() < 1e-6);
    assert!((luxel_core::sigmoid(given.opacity_logit[3]) - 0.4).abs() < 1e-6);
    assert!((usual.log_scale[3][0] - given.log_scale[3][0] - 2f32.ln()).abs() < 1e-5);
    assert_eq!(usual.position, given.position);
}

#[test]
fn another_seed_is_another_run() {
    let data = dataset();
    let scene = |seed| {
        let mut trainer = Trainer::new(&data, TrainConfig { seed, ..config(100) }, engine()).unwrap();
        run(&mut trainer, 3);
        trainer.scene().unwrap()
    };
    assert!(scene(1) == scene(1));
    assert!(scene(1) != scene(2));
}

#[test]
fn one_view_without_points_or_tests_can_be_trained_on() {
    let mut data = dataset();
    data.train.truncate(1);
    data.points.clear();
    data.test.clear();
    let config = TrainConfig { init_points: 300, ..config(20) };
    let mut trainer = Trainer::new(&data, config, engine()).unwrap();
    let first = trainer.step().unwrap();
    run(&mut trainer, 19);
    assert!(trainer.step().unwrap().loss < first.loss);
    let none = evaluate(
        trainer.engine(),
        &Default::default(),
        &luxel_metrics::Measures::new(luxel_core::RadianceScale::ONE, 5000.0),
        &data.test,
        &mut |_, _, _| (),
    )
    .unwrap();
    assert!(none.views.is_empty());
}

#[test]
fn a_longer_run_goes_through_the_same_steps_first() {
    let data = dataset();
    // The average is off, because it differs between runs of different length.
    let config = TrainConfig { average_share: 0.0, ..config(20) };
    let mut short = Trainer::new(&data, config.clone(), engine()).unwrap();
    run(&mut short, 20);
    let mut long = Trainer::new(&data, config, engine()).unwrap();
    long.set_iterations(40);
    run(&mut long, 20);
    assert!(short.is_finished() && !long.is_finished());
    assert!(short.scene().unwrap() == long.scene().unwrap());
    let mut resumed = Trainer::resume(&data, long.snapshot().unwrap(), engine()).unwrap();
    run(&mut resumed, 20);
    assert!(resumed.is_finished());
}

#[test]
fn large_splats_are_pruned_after_a_reset_unless_there_is_no_limit() {
    let data = dataset();
    // Nothing grows, and the limit is so small that every splat exceeds it.
    let splats = |prune_scale, opacity_reset_interval| {
        let config = TrainConfig { densify_threshold: 1e9, prune_scale, opacity_reset_interval, stereo_points: Some(0), ..config(120) };
        let mut trainer = Trainer::new(&data, config, engine()).unwrap();
        (0..60).find_map(|_| trainer.step().err()).map_or_else(|| Ok(trainer.scene().unwrap().splats.len()), |error| Err(error.to_string()))
    };
    assert!(splats(1e-6, 20).unwrap_err().contains("every splat was pruned"));
    let (kept, without_reset) = (splats(0.0, 20).unwrap(), splats(1e-6, 0).unwrap());
    assert_eq!(kept, without_reset);
}
