//! The engine's own guarantees: determinism, shards, halts and repeated steps, errors.

use std::sync::Arc;

use luxel_core::engine::{DensifyStats, SavedPart, SplatArray, StatsCollection, StepConfig};
use luxel_core::{Antialias, Camera, Cutoffs, Engine, EngineError, Moments, Splats, View};
use luxel_cpu::CpuEngine;
use luxel_gpu::{DeviceChoice, Gpu, GpuEngine, Traffic};

use crate::Body;
use crate::compare::{assert_close, assert_close_but_few};
use crate::fixture::{camera, options, smoothing, splats, step, view};
use crate::parity::{engines, groups, models};

pub const ALL: &[(&str, Body)] = &[
    ("crowded_tiles_match_the_cpu", crowded_tiles_match_the_cpu),
    ("splats_over_many_tiles_match_the_cpu", splats_over_many_tiles_match_the_cpu),
    ("tiles_counted_and_not_found_do_not_show", tiles_counted_and_not_found_do_not_show),
    ("pixels_that_do_not_count_leave_nothing", pixels_that_do_not_count_leave_nothing),
    ("what_is_saved_is_what_was_loaded", what_is_saved_is_what_was_loaded),
    ("equal_inputs_give_equal_bits", equal_inputs_give_equal_bits),
    ("shards_do_not_show", shards_do_not_show),
    ("optional_features_do_not_show", optional_features_do_not_show),
    ("too_small_buffers_do_not_show", too_small_buffers_do_not_show),
    ("a_view_beyond_the_limits_is_refused_and_changes_nothing", a_view_beyond_the_limits_is_refused_and_changes_nothing),
    ("a_large_render_after_a_small_step_wants_an_images_room_alone", a_large_render_after_a_small_step_wants_an_images_room_alone),
    ("empty_scenes_are_background", empty_scenes_are_background),
    ("a_loss_that_is_not_finite_stops_the_engine", a_loss_that_is_not_finite_stops_the_engine),
    ("a_run_moves_between_the_engines", a_run_moves_between_the_engines),
    ("a_report_is_of_a_step_not_long_ago", a_report_is_of_a_step_not_long_ago),
    ("a_step_is_one_submission_that_reads_little_back", a_step_is_one_submission_that_reads_little_back),
    ("contributions_match_the_cpu", contributions_match_the_cpu),
    ("bad_input_is_refused", bad_input_is_refused),
    ("a_lost_device_is_an_error_with_a_remedy", a_lost_device_is_an_error_with_a_remedy),
];

fn training(number: u32) -> StepConfig {
    StepConfig { stats: StatsCollection::GradientsAndAbsolute, ..step(number, options(Cutoffs::HDR, Antialias::Off)) }
}

/// Compares images and gradients of a scene on both engines.
fn compare(gpu: &Arc<Gpu>, what: &str, scene: &Splats, camera: &Camera) {
    let (mut cpu, mut engine) = engines(gpu, scene);
    let render = options(Cutoffs::HDR, Antialias::Off);
    let [expected, found] = [cpu.render(camera, &render), engine.render(camera, &render)].map(|image| image.unwrap().pixels);
    assert_close_but_few(
        &format!("crowded tiles and large splats, image: {what}"),
        found.as_flattened(),
        expected.as_flattened(),
        2e-5,
        (12, 4e-3),
    );
    let view = view(camera, true, 4);
    let [expected, found] = [cpu.gradients(&view, &training(1)).unwrap(), engine.gradients(&view, &training(1)).unwrap()];
    assert_eq!(found.0.visible, expected.0.visible);
    for ((name, found), (_, expected)) in groups(&found.1).into_iter().zip(groups(&expected.1)) {
        assert_close(&format!("crowded tiles and large splats, gradients: {what} {name}"), found, expected, 2e-4);
    }
    let [expected, found] = [cpu.densify_stats().unwrap(), engine.densify_stats().unwrap()];
    assert_close(&format!("crowded tiles and large splats, statistics: {what}"), &found.abs_gradient, &expected.abs_gradient, 2e-4);
}

/// Tests several buckets and batches per tile.
fn crowded_tiles_match_the_cpu(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    let mut scene = splats(models()[3], 700, &camera, 31);
    for logit in &mut scene.opacity_logit {
        *logit -= 2.5;
    }
    compare(gpu, "crowded", &scene, &camera);
    // Opaque splats, too, where pixels finish long before the tile's end.
    for logit in &mut scene.opacity_logit {
        *logit += 4.0;
    }
    compare(gpu, "opaque", &scene, &camera);
}

/// Tests more entries than one thread sums.
fn splats_over_many_tiles_match_the_cpu(gpu: &Arc<Gpu>) {
    let camera = camera(150, 130);
    let mut scene = splats(models()[1], 40, &camera, 32);
    for i in [3, 17, 30] {
        scene.position[i] = crate::fixture::unproject(&camera, [75.0, 60.0], 3.0 + 0.1 * i as f64);
        scene.log_scale[i] = [0.2, 0.5, -0.3];
    }
    compare(gpu, "large splats", &scene, &camera);
}

/// Tests an adapter without any optional feature: times of passes are all that it lacks.
fn optional_features_do_not_show(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    let view = view(&camera, true, 4);
    let trained = |gpu: &Arc<Gpu>| {
        let mut engine = GpuEngine::new(gpu).unwrap();
        engine.load(&splats(models()[3], 200, &camera, 36), None).unwrap();
        for number in 1..=4 {
            engine.train_step(&view, &training(number)).unwrap();
        }
        engine.finish().unwrap();
        let is_timed = engine.timings().iter().any(|timed| !timed.time.is_zero());
        assert_eq!(is_timed, gpu.facts().timestamps);
        engine.save().unwrap()
    };
    assert!(trained(&gpu.reopen_plain().unwrap()) == trained(gpu), "the bits differ");
}

/// Simulates a compiler that rounds `project` and `bin_emit` differently.
fn tiles_counted_and_not_found_do_not_show(gpu: &Arc<Gpu>) {
    let camera = camera(60, 50);
    let scene = splats(models()[1], 120, &camera, 42);
    let view = view(&camera, false, 4);
    let mut engine = GpuEngine::new(gpu).unwrap();
    engine.load(&scene, None).unwrap();
    let (_, expected) = engine.gradients(&view, &training(1)).unwrap();
    for surplus in [1, 3] {
        let found = engine.gradients_with_surplus(&view, &training(1), surplus).unwrap();
        for ((name, found), (_, expected)) in groups(&found).into_iter().zip(groups(&expected)) {
            assert_close(&format!("tiles counted and not found: {surplus} {name}"), found, expected, 1e-6);
        }
    }
}

/// Tests an infinite background: every pixel is infinite, and has weight 0.
fn pixels_that_do_not_count_leave_nothing(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    let mut view = view(&camera, false, 4);
    view.mask = Some(luxel_core::Mask::from_valid(vec![false; 45 * 38]).into());
    let mut step = training(1);
    step.render.background = [f32::INFINITY; 3];
    (step.loss.opacity_weight, step.loss.scale_weight) = (0.0, 0.0);
    let (_, mut engine) = engines(gpu, &splats(models()[1], 60, &camera, 43));
    let (_, gradients) = engine.gradients(&view, &step).unwrap();
    for (name, gradients) in groups(&gradients) {
        assert_eq!(gradients.iter().position(|g| *g != 0.0), None, "{name}");
    }
}

/// Asserts that arrays saved seven splats at a time are those of the whole.
fn assert_saved_by_pieces(engine: &mut GpuEngine, splats: &Splats, moments: &Moments) {
    let parts = [(SavedPart::Parameters, splats), (SavedPart::FirstMoments, &moments.first), (SavedPart::SecondMoments, &moments.second)];
    for ((part, expected), array) in parts.into_iter().flat_map(|part| SplatArray::ALL.map(|array| (part, array))) {
        let mut found = Vec::new();
        for first in (0..splats.len()).step_by(7) {
            found.extend(engine.save_array(part, array, first..splats.len().min(first + 7)).unwrap());
        }
        assert_eq!(found, expected.array(array), "{part:?} {array:?}");
        assert!(engine.save_array(part, array, 0..splats.len() + 1).is_err());
    }
}

fn what_is_saved_is_what_was_loaded(gpu: &Arc<Gpu>) {
    for model in models() {
        let mut scene = splats(model, 100, &camera(20, 20), 33);
        scene.smoothing = smoothing(scene.len());
        let moments = Moments { first: splats(model, 100, &camera(20, 20), 34), second: splats(model, 100, &camera(20, 20), 35) };
        let mut engine = GpuEngine::new(gpu).unwrap();
        engine.split_shards(30);
        engine.load(&scene, Some(&moments)).unwrap();
        assert_saved_by_pieces(&mut engine, &scene, &moments);
        assert_eq!(engine.save().unwrap(), (scene.clone(), moments));
        let geometry = engine.geometry().unwrap();
        assert_eq!((geometry.position, geometry.log_scale, geometry.opacity_logit), (scene.position, scene.log_scale, scene.opacity_logit));
        assert_eq!(engine.densify_stats().unwrap(), DensifyStats::zeros(100));
        assert_eq!(engine.len(), 100);
    }
}

/// Returns the scene after some steps.
fn trained(engine: &mut GpuEngine, scene: &Splats, views: &[View], steps: u32) -> (Splats, Moments, DensifyStats) {
    engine.load(scene, None).unwrap();
    for number in 1..=steps {
        engine.train_step(&views[number as usize % views.len()], &training(number)).unwrap();
    }
    let (splats, moments) = engine.save().unwrap();
    (splats, moments, engine.densify_stats().unwrap())
}

fn equal_inputs_give_equal_bits(gpu: &Arc<Gpu>) {
    let camera = camera(60, 50);
    let scene = splats(models()[3], 300, &camera, 36);
    let views = [view(&camera, false, 1), view(&camera, true, 2)];
    let run = || trained(&mut GpuEngine::new(gpu).unwrap(), &scene, &views, 6);
    assert!(run() == run(), "two runs differ");
}

fn shards_do_not_show(gpu: &Arc<Gpu>) {
    let camera = camera(60, 50);
    let scene = splats(models()[1], 300, &camera, 37);
    let views = [view(&camera, false, 1)];
    let mut engine = GpuEngine::new(gpu).unwrap();
    let whole = trained(&mut engine, &scene, &views, 3);
    let sharded = {
        let mut engine = GpuEngine::new(gpu).unwrap();
        engine.split_shards(128);
        trained(&mut engine, &scene, &views, 3)
    };
    assert!(whole == sharded, "shards of 128 splats show");
}

/// Tests 300 splats over all of 16 x 16 tiles: more entries than the initial capacity.
fn too_small_buffers_do_not_show(gpu: &Arc<Gpu>) {
    let camera = camera(256, 256);
    let mut scene = splats(models()[0], 300, &camera, 38);
    for (position, scale) in scene.position.iter_mut().zip(&mut scene.log_scale) {
        *position = crate::fixture::unproject(&camera, [128.0, 128.0], 4.0 + f64::from(position[0]).abs());
        *scale = [1.5; 3];
    }
    scene.opacity_logit.fill(-4.0);
    let views = [view(&camera, false, 1)];
    let mut engine = GpuEngine::new(gpu).unwrap();
    let grown = trained(&mut engine, &scene, &views, 3);
    // The buffers are now large enough from the first step on.
    let roomy = trained(&mut engine, &scene, &views, 3);
    assert!(grown == roomy, "growing buffers show");
    let mut cpu = CpuEngine::new(1).unwrap();
    cpu.load(&scene, None).unwrap();
    let render = options(Cutoffs::HDR, Antialias::Off);
    let mut fresh = GpuEngine::new(gpu).unwrap();
    fresh.load(&scene, None).unwrap();
    let [expected, found] = [cpu.render(&camera, &render), fresh.render(&camera, &render)].map(|image| image.unwrap().pixels);
    assert_close_but_few("grown buffers, image", found.as_flattened(), expected.as_flattened(), 2e-5, (60, 4e-3));
}

fn a_view_beyond_the_limits_is_refused_and_changes_nothing(gpu: &Arc<Gpu>) {
    let camera = camera(256, 256);
    let mut scene = splats(models()[0], 300, &camera, 38);
    scene.log_scale.fill([2.0; 3]);
    let mut engine = GpuEngine::new(gpu).unwrap();
    engine.limit_bindings(3 << 20);
    engine.load(&scene, None).unwrap();
    let error = engine.train_step(&view(&camera, false, 1), &training(1)).unwrap_err();
    assert!(error.to_string().contains("pairs of splats and tiles"), "{error}");
    assert!(error.remedy().is_some_and(|remedy| remedy.options().any(|option| option == "max_splats")), "{error}");
    assert_eq!(engine.save().unwrap().0, scene);
    // Smaller views still work.
    let small = crate::fixture::camera(20, 20);
    engine.train_step(&view(&small, false, 1), &training(1)).unwrap();
    engine.finish().unwrap();
}

/// Tests a render of 3.9 million pixels, whose derivatives of SSIM would not fit into bindings of
/// 128 MiB.
fn a_large_render_after_a_small_step_wants_an_images_room_alone(gpu: &Arc<Gpu>) {
    let (small, large) = (camera(40, 38), camera(2000, 1950));
    let scene = splats(models()[0], 20, &large, 7);
    let render = options(Cutoffs::HDR, Antialias::Off);
    let mut engine = GpuEngine::new(gpu).unwrap();
    engine.load(&scene, None).unwrap();
    let before = engine.render(&large, &render).unwrap();
    engine.gradients(&view(&small, false, 1), &training(1)).unwrap();
    assert!(engine.render(&large, &render).unwrap() == before);
    engine.gradients(&view(&small, false, 1), &training(1)).unwrap();
}

fn empty_scenes_are_background(gpu: &Arc<Gpu>) {
    let camera = camera(20, 17);
    let mut engine = GpuEngine::new(gpu).unwrap();
    let render = options(Cutoffs::HDR, Antialias::Off);
    for round in 0..2 {
        let image = engine.render(&camera, &render).unwrap();
        assert!(image.pixels.iter().all(|pixel| *pixel == render.background), "round {round}");
        let report = engine.train_step(&view(&camera, false, 1), &training(1)).unwrap();
        assert_eq!(report.visible, 0);
        engine.load(&Splats::empty(models()[0]), None).unwrap();
    }
    assert_eq!((engine.len(), engine.save().unwrap().0.len()), (0, 0));
    // Behind the camera.
    let mut behind = splats(models()[0], 3, &camera, 1);
    behind.position.fill(crate::fixture::unproject(&camera, [10.0, 8.0], -3.0));
    engine.load(&behind, None).unwrap();
    assert!(engine.render(&camera, &render).unwrap().pixels.iter().all(|pixel| *pixel == render.background));
}

fn a_loss_that_is_not_finite_stops_the_engine(gpu: &Arc<Gpu>) {
    let camera = camera(20, 20);
    let scene = splats(models()[0], 30, &camera, 1);
    let mut engine = GpuEngine::new(gpu).unwrap();
    engine.load(&scene, None).unwrap();
    let mut bad = view(&camera, false, 1);
    let mut image = (*bad.image).clone();
    image.pixels[7] = [f32::INFINITY; 3];
    bad.image = image.into();
    let good = view(&camera, false, 1);
    engine.train_step(&good, &training(1)).unwrap();
    let before = engine.save().unwrap();
    let mut reports = vec![engine.train_step(&bad, &training(2)).unwrap()];
    for number in 3..12 {
        reports.push(engine.train_step(&good, &training(number)).unwrap());
    }
    let first = reports.iter().find(|report| !report.loss.is_finite()).expect("no report of the loss");
    assert_eq!(first.step, 2);
    let error = engine.save().unwrap_err();
    assert!(matches!(&error, EngineError::Invalid { message, .. } if message.contains("step 2")), "{error}");
    // The engine accepts another scene.
    engine.load(&before.0, Some(&before.1)).unwrap();
    assert_eq!(engine.save().unwrap(), before);
    assert!(engine.train_step(&good, &training(2)).unwrap().loss.is_finite());
}

fn a_run_moves_between_the_engines(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    let scene = splats(models()[3], 60, &camera, 40);
    let view = view(&camera, false, 1);
    let (mut cpu, mut engine) = engines(gpu, &scene);
    let mut alone = CpuEngine::new(1).unwrap();
    alone.load(&scene, None).unwrap();
    for number in 1..=6 {
        alone.train_step(&view, &training(number)).unwrap();
        let (from, to): (&mut dyn Engine, &mut dyn Engine) =
            if number % 2 == 0 { (&mut engine, &mut cpu) } else { (&mut cpu, &mut engine) };
        from.train_step(&view, &training(number)).unwrap();
        let (splats, moments) = from.save().unwrap();
        let stats = from.densify_stats().unwrap();
        to.load(&splats, Some(&moments)).unwrap();
        to.set_densify_stats(&stats).unwrap();
    }
    let [expected, found] = [alone.save().unwrap().0, cpu.save().unwrap().0];
    for ((name, found), (_, expected)) in groups(&found).into_iter().zip(groups(&expected)) {
        assert_close(&format!("six steps to and fro between the engines: {name}"), found, expected, 1e-3);
    }
    assert_eq!(cpu.densify_stats().unwrap().views, alone.densify_stats().unwrap().views);
}

fn a_report_is_of_a_step_not_long_ago(gpu: &Arc<Gpu>) {
    let camera = camera(20, 20);
    let mut engine = GpuEngine::new(gpu).unwrap();
    engine.load(&splats(models()[0], 30, &camera, 1), None).unwrap();
    let view = view(&camera, false, 1);
    let mut last = 0;
    for number in 1..=10 {
        let report = engine.train_step(&view, &training(number)).unwrap();
        assert!(report.step <= number && report.step + 4 > number && report.step >= last, "{} after {number}", report.step);
        last = report.step;
    }
    engine.finish().unwrap();
}

fn a_step_is_one_submission_that_reads_little_back(gpu: &Arc<Gpu>) {
    let mut engine = GpuEngine::new(gpu).unwrap();
    let scene = splats(models()[3], 30, &camera(45, 38), 1);
    // A report; and where there are timestamps a pair of 8 bytes for each run of a pass: project,
    // sort, bin, sort and on to project_backward.
    let bytes_read = if gpu.facts().timestamps { 32 + 8 * 16 } else { 32 };
    // 512 tiles need another digit to sort by, and a shard its own part of the two passes over
    // parameters.
    for (size, shards, dispatches) in [([45, 38], 1, 23), ([512, 256], 1, 26), ([45, 38], 2, 25)] {
        engine.split_shards(30 / shards);
        engine.load(&scene, None).unwrap();
        let mut view = view(&camera(size[0], size[1]), false, 1);
        // An uploaded image stays cached, at any scale of the target.
        for (number, image_bytes) in [(1, 12 * u64::from(size[0] * size[1])), (2, 0)] {
            view.target.scale = [1.0 / number as f32; 3];
            engine.train_step(&view, &training(number)).unwrap();
            let expected = Traffic { dispatches, submissions: 1, bytes_read, image_bytes };
            assert_eq!(engine.traffic(), expected, "{size:?}, {shards} shards, step {number}");
        }
    }
    engine.finish().unwrap();
    if gpu.facts().timestamps {
        let named: Vec<&str> = engine.timings().iter().filter(|timed| !timed.time.is_zero()).map(|timed| timed.pass.name()).collect();
        for pass in ["project", "sort", "rasterize", "loss", "rasterize_backward", "project_backward"] {
            assert!(named.contains(&pass), "{pass} has no time: {named:?}");
        }
    }
}

fn bad_input_is_refused(gpu: &Arc<Gpu>) {
    let camera = camera(20, 20);
    let scene = splats(models()[0], 30, &camera, 1);
    let mut engine = GpuEngine::new(gpu).unwrap();
    engine.load(&scene, None).unwrap();
    let mut wrong = view(&camera, false, 1);
    wrong.camera.size_px = [21, 20];
    assert!(engine.train_step(&wrong, &training(1)).unwrap_err().to_string().contains("the camera expects 21 x 20"));
    let mut distorted = camera.clone();
    distorted.distortion.k1 = 0.1;
    let error = engine.render(&distorted, &options(Cutoffs::HDR, Antialias::Off)).unwrap_err().to_string();
    assert!(error.contains("undistort"), "{error}");
    let mut odd = scene.clone();
    odd.opacity_logit[3] = f32::NAN;
    assert!(matches!(engine.load(&odd, None), Err(EngineError::Splats(_))));
    let moments = Moments::zeros(models()[0], 29);
    assert!(engine.load(&splats(models()[0], 30, &camera, 2), Some(&moments)).unwrap_err().to_string().contains("moments are of 29"));
    assert!(engine.set_densify_stats(&DensifyStats::zeros(4)).unwrap_err().to_string().contains("the scene has 30"));
    let plan = luxel_core::engine::DensifyPlan { rows: vec![luxel_core::engine::PlanRow::keep(30)], ..Default::default() };
    assert!(engine.densify(&plan).unwrap_err().to_string().contains("names splat 30"));
    let response = luxel_core::Response { knots: [[0.5; luxel_core::RESPONSE_KNOTS]; 3], exposure: [1.0; 3] };
    let mut recorded = view(&camera, false, 1);
    recorded.target.curve = luxel_core::ToneCurve::Response(response);
    let error = engine.train_step(&recorded, &training(1)).unwrap_err();
    assert_eq!(error.remedy(), Some(&luxel_core::Remedy::set("device", "cpu")), "{error}");
    assert_eq!(engine.save().unwrap().0, scene);
}

/// Compares with the CPU, and with the image of white splats on black.
fn contributions_match_the_cpu(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    let mut scene = splats(models()[0], 300, &camera, 41);
    scene.sh.fill(luxel_core::SH_OFFSET / luxel_core::sh::C0);
    let mut render = luxel_core::RenderOptions { background: [0.0; 3], ..options(Cutoffs::HDR, Antialias::Off) };
    let mask: Vec<f32> = (0..45 * 38).map(|i| if i % 45 < 20 { 1.0 } else { 0.25 }).collect();
    let (mut cpu, mut engine) = engines(gpu, &scene);
    for samples in [2, 1] {
        render.raster.samples = samples;
        let [expected, found] =
            [cpu.contributions(&camera, &render, &mask), engine.contributions(&camera, &render, &mask)].map(Result::unwrap);
        assert_close("contributions: masked", &found.masked, &expected.masked, 2e-5);
        assert_close("contributions: blended", &found.blended, &expected.blended, 2e-5);
        assert_close("contributions: unoccluded", &found.unoccluded, &expected.unoccluded, 2e-5);
        assert_close("contributions: light", &found.light, &expected.light, 2e-5);
        let image = engine.render(&camera, &render).unwrap();
        let total: f64 = image.pixels.iter().map(|pixel| f64::from(pixel[0])).sum();
        let blended: f64 = found.blended.iter().map(|sum| f64::from(*sum)).sum();
        assert!((total - blended).abs() < 1e-4 * total, "{blended} {total}");
    }
    assert!(engine.contributions(&camera, &render, &mask[1..]).unwrap_err().to_string().contains("mask holds"));
}

/// Uses a device of its own, because the other tests need theirs.
fn a_lost_device_is_an_error_with_a_remedy(gpu: &Arc<Gpu>) {
    let lost = Gpu::open(&DeviceChoice::Named(gpu.facts().name.clone())).unwrap();
    let camera = camera(20, 20);
    let mut engine = GpuEngine::new(&lost).unwrap();
    let scene = splats(models()[0], 30, &camera, 1);
    engine.load(&scene, None).unwrap();
    let view = view(&camera, false, 1);
    engine.train_step(&view, &training(1)).unwrap();
    lost.lose();
    let render = options(Cutoffs::HDR, Antialias::Off);
    let errors = [
        engine.train_step(&view, &training(2)).unwrap_err(),
        engine.finish().map_or_else(|error| error, |()| engine.save().unwrap_err()),
        engine.render(&camera, &render).unwrap_err(),
        engine.load(&scene, None).unwrap_err(),
        GpuEngine::new(&lost).err().unwrap(),
    ];
    for error in errors {
        let is_lost = matches!(&error, EngineError::Device { message, .. } if message.contains("was lost"));
        assert!(is_lost && error.remedy().is_some_and(|remedy| remedy.options().any(|option| option == "resume")), "{error}");
    }
}
