//! Parity of both engines, end to end: images, losses, gradients by parameter, steps of training,
//! densification.

use std::sync::Arc;

use luxel_core::engine::{DensifyPlan, Dropout, PlanRow, PositionNoise, StatsCollection, StepConfig};
use luxel_core::{Activation, Antialias, ColorModel, Cutoffs, Engine, RenderOptions, Splats};
use luxel_cpu::CpuEngine;
use luxel_gpu::{Gpu, GpuEngine};

use crate::Body;
use crate::compare::{assert_close, assert_close_but_few};
use crate::fixture::{camera, options, smoothing, splats, splats_with_special_cases, step, view, with_weights};

pub const ALL: &[(&str, Body)] = &[
    ("gpu_images_match_cpu", gpu_images_match_cpu),
    ("gpu_losses_match_cpu", gpu_losses_match_cpu),
    ("gpu_gradients_match_cpu", gpu_gradients_match_cpu),
    ("harmonics_above_the_active_degree_take_no_part", harmonics_above_the_active_degree_take_no_part),
    ("gpu_steps_match_cpu", gpu_steps_match_cpu),
    ("gpu_dropout_matches_cpu", gpu_dropout_matches_cpu),
    ("gpu_statistics_match_cpu", gpu_statistics_match_cpu),
    ("gpu_noise_matches_cpu", gpu_noise_matches_cpu),
    ("gpu_densification_matches_cpu", gpu_densification_matches_cpu),
    ("a_short_training_reaches_the_cpus_loss", a_short_training_reaches_the_cpus_loss),
];

/// Returns every kind of colour model.
pub fn models() -> Vec<ColorModel> {
    let lcd = |chroma_degree, luminance_degree, activation| ColorModel::Lcd { chroma_degree, luminance_degree, activation };
    vec![
        ColorModel::Sh { degree: 0 },
        ColorModel::Sh { degree: 3 },
        ColorModel::Sh { degree: 5 },
        ColorModel::LogSh { degree: 3 },
        lcd(3, 0, Activation::Softplus),
        lcd(2, 3, Activation::Exp),
        lcd(1, 1, Activation::Relu),
    ]
}

/// Returns both engines with the same scene.
pub fn engines(gpu: &Arc<Gpu>, splats: &Splats) -> (CpuEngine, GpuEngine) {
    let (mut cpu, mut engine) = (CpuEngine::new(1).unwrap(), GpuEngine::new(gpu).unwrap());
    cpu.load(splats, None).unwrap();
    engine.load(splats, None).unwrap();
    (cpu, engine)
}

/// Returns both presets of cut-offs, every kind of anti-aliasing, with and without supersampling.
pub fn rasters() -> [(String, RenderOptions); 6] {
    let (hdr, parity) = (Cutoffs::HDR, Cutoffs::PARITY);
    let (off, pixel, mip) = (Antialias::Off, Antialias::Pixel, Antialias::Mip);
    [(hdr, off, 1), (parity, off, 1), (hdr, pixel, 1), (hdr, mip, 1), (hdr, pixel, 2), (parity, off, 3)].map(
        |(cutoffs, antialias, samples)| {
            let mut options = options(cutoffs, antialias);
            options.raster.samples = samples;
            let name = if samples == 1 { format!("{antialias:?}") } else { format!("{antialias:?}, {samples}x{samples} samples") };
            (name, options)
        },
    )
}

fn gpu_images_match_cpu(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    for model in models() {
        for (name, options) in rasters() {
            let mut scene = splats_with_special_cases(model, &camera, 3);
            if options.raster.antialias == Antialias::Mip {
                scene.smoothing = smoothing(scene.len());
                scene.gain = (0..scene.len()).map(|i| [0.01, 1.0, 30.0][i % 3]).collect();
            }
            let (mut cpu, mut engine) = engines(gpu, &scene);
            let [expected, found] = [cpu.render(&camera, &options), engine.render(&camera, &options)].map(|image| image.unwrap().pixels);
            let what = format!("rasterize, image: {} {name}", model.name());
            // A pixel at a splat's threshold may fall on either side; the jump there is below the
            // threshold's contribution.
            assert_close_but_few(&what, found.as_flattened(), expected.as_flattened(), 2e-5, (6, 4e-3));
        }
    }
}

fn train_step(stats: StatsCollection, cutoffs: Cutoffs, antialias: Antialias, number: u32) -> StepConfig {
    StepConfig { stats, ..step(number, options(cutoffs, antialias)) }
}

fn gpu_losses_match_cpu(gpu: &Arc<Gpu>) {
    for (size, masked) in [([45, 38], false), ([45, 38], true), ([16, 16], true), ([7, 50], false), ([1, 1], false)] {
        let camera = camera(size[0], size[1]);
        let scene = splats(models()[1], 24, &camera, 5);
        let (mut cpu, mut engine) = engines(gpu, &scene);
        let mut view = view(&camera, masked, 9);
        if masked && size[0] == 16 {
            view = with_weights(view, 10);
        }
        let step = train_step(StatsCollection::Off, Cutoffs::HDR, Antialias::Off, 1);
        let [expected, found] = [cpu.gradients(&view, &step).unwrap().0, engine.gradients(&view, &step).unwrap().0];
        assert_eq!(found.visible, expected.visible);
        for (name, found, expected) in
            [("loss", found.loss, expected.loss), ("l1", found.l1, expected.l1), ("ssim", found.ssim, expected.ssim)]
        {
            assert_close(&format!("loss, {name}: {size:?}"), &[found], &[expected], 2e-5);
        }
    }
}

/// Returns the parameters by kind.
pub fn groups(splats: &Splats) -> [(&'static str, &[f32]); 6] {
    [
        ("position", splats.position.as_flattened()),
        ("rotation", splats.rotation.as_flattened()),
        ("log scale", splats.log_scale.as_flattened()),
        ("opacity", &splats.opacity_logit),
        ("harmonics", &splats.sh),
        ("luminance", &splats.raw_luminance),
    ]
}

/// Returns the pass that computes a parameter's gradient.
fn differentiates(parameter: &str) -> &'static str {
    if ["harmonics", "luminance"].contains(&parameter) { "color_backward" } else { "project_backward" }
}

fn gpu_gradients_match_cpu(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    for model in models() {
        for (raster, options) in rasters() {
            let mut scene = splats_with_special_cases(model, &camera, 3);
            if options.raster.antialias == Antialias::Mip {
                scene.smoothing = smoothing(scene.len());
            }
            let (mut cpu, mut engine) = engines(gpu, &scene);
            // Weights of 0 and 1 among others.
            let view = with_weights(view(&camera, true, 4), 5);
            let step = StepConfig { stats: StatsCollection::Off, ..step(1, options) };
            let [expected, found] = [cpu.gradients(&view, &step).unwrap().1, engine.gradients(&view, &step).unwrap().1];
            for ((name, found), (_, expected)) in groups(&found).into_iter().zip(groups(&expected)) {
                assert_close(&format!("{}, {name}: {} {raster}", differentiates(name), model.name()), found, expected, 1e-4);
            }
        }
    }
}

/// Tests the state of training before all degrees are active.
fn harmonics_above_the_active_degree_take_no_part(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    for model in [models()[1], models()[4]] {
        let (mut cpu, mut engine) = engines(gpu, &splats(model, 60, &camera, 6));
        let view = view(&camera, false, 4);
        for active_degree in 0..=2 {
            let mut step = train_step(StatsCollection::Off, Cutoffs::HDR, Antialias::Off, 1);
            step.render.active_degree = active_degree;
            let what = format!("{} up to degree {active_degree}", model.name());
            let [expected, found] =
                [cpu.render(&camera, &step.render), engine.render(&camera, &step.render)].map(|image| image.unwrap().pixels);
            assert_close_but_few(&format!("rasterize, image: {what}"), found.as_flattened(), expected.as_flattened(), 2e-5, (6, 4e-3));
            let [expected, found] = [cpu.gradients(&view, &step).unwrap().1, engine.gradients(&view, &step).unwrap().1];
            for ((name, found), (_, expected)) in groups(&found).into_iter().zip(groups(&expected)) {
                assert_close(&format!("{}, {name}: {what}", differentiates(name)), found, expected, 1e-4);
            }
        }
    }
}

fn gpu_steps_match_cpu(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    for model in [models()[1], models()[4]] {
        let scene = splats_with_special_cases(model, &camera, 3);
        let (mut cpu, mut engine) = engines(gpu, &scene);
        let view = view(&camera, false, 4);
        for number in 1..=4 {
            let step = train_step(StatsCollection::Gradients, Cutoffs::HDR, Antialias::Off, number);
            cpu.train_step(&view, &step).unwrap();
            engine.train_step(&view, &step).unwrap();
        }
        let [(expected, expected_moments), (found, found_moments)] = [cpu.save().unwrap(), engine.save().unwrap()];
        for ((name, found), (_, expected)) in groups(&found).into_iter().zip(groups(&expected)) {
            assert_close(&format!("adam, parameters after 4 steps: {name} {}", model.name()), found, expected, 1e-3);
        }
        let pairs = [("first", &found_moments.first, &expected_moments.first), ("second", &found_moments.second, &expected_moments.second)];
        for (which, found, expected) in pairs {
            for ((name, found), (_, expected)) in groups(found).into_iter().zip(groups(expected)) {
                assert_close(&format!("adam, {which} moments: {name} {}", model.name()), found, expected, 1e-3);
            }
        }
    }
}

/// The same splats are left out, by numbers that reach over shards.
fn gpu_dropout_matches_cpu(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    let scene = splats_with_special_cases(models()[4], &camera, 3);
    let (mut cpu, mut engine) = engines(gpu, &scene);
    engine.split_shards(16);
    engine.load(&scene, None).unwrap();
    let view = view(&camera, false, 4);
    for (rate, seed) in [(0.1, 1), (0.5, u32::MAX)] {
        let step = train_step(StatsCollection::Off, Cutoffs::HDR, Antialias::Pixel, 1);
        let step = StepConfig { dropout: Some(Dropout { rate, seed }), ..step };
        let [(expected_report, expected), (report, found)] =
            [cpu.gradients(&view, &step).unwrap(), engine.gradients(&view, &step).unwrap()];
        assert_eq!(report.visible, expected_report.visible);
        assert_close(&format!("loss, dropout of {rate}"), &[report.loss], &[expected_report.loss], 2e-5);
        for ((name, found), (_, expected)) in groups(&found).into_iter().zip(groups(&expected)) {
            assert_close(&format!("{}, {name}: dropout of {rate}", differentiates(name)), found, expected, 1e-4);
        }
    }
}

fn gpu_statistics_match_cpu(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    let scene = splats_with_special_cases(models()[1], &camera, 3);
    for stats in [StatsCollection::Off, StatsCollection::Gradients, StatsCollection::GradientsAndAbsolute] {
        let (mut cpu, mut engine) = engines(gpu, &scene);
        let view = view(&camera, false, 4);
        for _ in 0..2 {
            let step = train_step(stats, Cutoffs::HDR, Antialias::Off, 1);
            cpu.gradients(&view, &step).unwrap();
            engine.gradients(&view, &step).unwrap();
        }
        let [expected, found] = [cpu.densify_stats().unwrap(), engine.densify_stats().unwrap()];
        assert_eq!(found.views, expected.views);
        assert_close("project_backward, densification statistics: gradient", &found.gradient, &expected.gradient, 2e-4);
        assert_close("project_backward, densification statistics: absolute gradient", &found.abs_gradient, &expected.abs_gradient, 2e-4);
        engine.set_densify_stats(&expected).unwrap();
        assert_eq!(engine.densify_stats().unwrap(), expected);
    }
}

fn gpu_noise_matches_cpu(gpu: &Arc<Gpu>) {
    let camera = camera(20, 20);
    let mut scene = splats(models()[0], 40, &camera, 11);
    // Faint splats move, opaque ones do not.
    for (i, logit) in scene.opacity_logit.iter_mut().enumerate() {
        *logit = -9.0 + 0.3 * i as f32;
    }
    let (mut cpu, mut engine) = engines(gpu, &scene);
    let view = view(&camera, false, 4);
    let noise = PositionNoise { scale: 3.0, seed: 0x1234_5678_9abc_def0 };
    let step = StepConfig { position_noise: Some(noise), ..train_step(StatsCollection::Off, Cutoffs::HDR, Antialias::Off, 1) };
    cpu.train_step(&view, &step).unwrap();
    engine.train_step(&view, &step).unwrap();
    let [expected, found] = [cpu.save().unwrap().0, engine.save().unwrap().0];
    assert_close("adam, noise", found.position.as_flattened(), expected.position.as_flattened(), 2e-4);
}

fn gpu_densification_matches_cpu(gpu: &Arc<Gpu>) {
    let camera = camera(20, 20);
    let scene = splats(models()[4], 40, &camera, 11);
    let (mut cpu, mut engine) = engines(gpu, &scene);
    let view = view(&camera, false, 4);
    let step = train_step(StatsCollection::Gradients, Cutoffs::HDR, Antialias::Off, 1);
    let (moved, moments) = {
        cpu.train_step(&view, &step).unwrap();
        cpu.save().unwrap()
    };
    let split =
        PlanRow { source: 7, offset_sigma: [0.5, -1.0, 0.2], log_scale_shift: -0.47, opacity_logit: Some(1.5), keep_moments: false };
    let rows = vec![PlanRow::keep(3), split, PlanRow::keep(39), PlanRow { source: 0, ..split }, PlanRow::keep(3)];
    let plans = [
        DensifyPlan { rows: rows.clone(), opacity_logit_cap: Some(-0.2), smoothing: None },
        DensifyPlan { rows: (0..5).map(PlanRow::keep).collect(), opacity_logit_cap: None, smoothing: Some(smoothing(5)) },
        DensifyPlan { rows: vec![PlanRow::keep(4), split_of(2)], opacity_logit_cap: None, smoothing: None },
    ];
    cpu.load(&moved, Some(&moments)).unwrap();
    // Shards of 16 splats: plans reach across their borders.
    engine.split_shards(16);
    engine.load(&moved, Some(&moments)).unwrap();
    for plan in &plans {
        cpu.densify(plan).unwrap();
        engine.densify(plan).unwrap();
        let [(expected, expected_moments), (found, found_moments)] = [cpu.save().unwrap(), engine.save().unwrap()];
        assert_eq!(found.smoothing, expected.smoothing);
        assert_eq!(found_moments, expected_moments);
        for ((name, found), (_, expected)) in groups(&found).into_iter().zip(groups(&expected)) {
            assert_close(&format!("densify: {name}"), found, expected, 1e-6);
        }
        assert_eq!(engine.densify_stats().unwrap(), cpu.densify_stats().unwrap());
    }
}

fn split_of(source: u32) -> PlanRow {
    PlanRow { source, offset_sigma: [0.0, 0.0, 1.0], log_scale_shift: 0.1, opacity_logit: None, keep_moments: true }
}

/// Trains a perturbed scene towards its own image for sixty steps: losses stay within 1 % of each
/// other, and fall.
fn a_short_training_reaches_the_cpus_loss(gpu: &Arc<Gpu>) {
    let camera = camera(40, 32);
    let truth = splats(models()[3], 60, &camera, 51);
    let mut start = truth.clone();
    luxel_core::synthetic::perturb(&mut start, 52);
    let (mut cpu, mut engine) = engines(gpu, &truth);
    let render = options(Cutoffs::HDR, Antialias::Off);
    let mut view = view(&camera, false, 4);
    view.image = cpu.render(&camera, &render).unwrap().into();
    view.target = luxel_core::Target::default();
    cpu.load(&start, None).unwrap();
    engine.load(&start, None).unwrap();
    let (mut first, mut last) = (0.0, [0.0; 2]);
    for number in 1..=60 {
        let step = train_step(StatsCollection::Off, Cutoffs::HDR, Antialias::Off, number);
        let step = StepConfig { loss: luxel_core::LossWeights::default(), ..step };
        let expected = cpu.train_step(&view, &step).unwrap();
        let found = engine.train_step(&view, &step).unwrap();
        if number == 1 {
            first = expected.loss;
        }
        if number % 20 == 0 {
            engine.finish().unwrap();
            let [expected, found] = [cpu.gradients(&view, &step).unwrap().0, engine.gradients(&view, &step).unwrap().0];
            assert_close(&format!("60 steps of training, loss: after {number}"), &[found.loss], &[expected.loss], 0.01);
            last = [found.loss, expected.loss];
        }
        assert!(found.loss.is_finite());
    }
    assert!(last.iter().all(|loss| *loss < 0.6 * first), "{first} to {last:?}");
}
