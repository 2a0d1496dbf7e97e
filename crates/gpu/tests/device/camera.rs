//! The gradient by the camera: that of the CPU engine for every projection, and no effect on the
//! step that computes it.

use std::sync::Arc;

use luxel_core::engine::{CameraGradient, CameraGradientChoice, StatsCollection, StepConfig};
use luxel_core::{Antialias, Camera, Cutoffs, Engine, RenderOptions, Splats, StepReport};
use luxel_gpu::{Gpu, GpuEngine};

use crate::Body;
use crate::compare::assert_close;
use crate::fixture::{camera, options, smoothing, splats, splats_with_special_cases, step, view, with_weights};
use crate::parity::{engines, models, rasters};
use crate::wide;

pub const ALL: &[(&str, Body)] = &[
    ("gpu_gradients_by_the_camera_match_cpu", gpu_gradients_by_the_camera_match_cpu),
    ("the_gradient_by_the_camera_costs_no_bit_of_the_step", the_gradient_by_the_camera_costs_no_bit_of_the_step),
];

fn numbers(report: &StepReport) -> [Vec<f32>; 3] {
    let CameraGradient { rotation, translation, focal_px } = report.camera.unwrap();
    [rotation.to_array().to_vec(), translation.to_array().to_vec(), focal_px.to_vec()].map(|v| v.iter().map(|d| *d as f32).collect())
}

fn gpu_gradients_by_the_camera_match_cpu(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    for model in models() {
        for (raster, options) in rasters() {
            let scene = splats_with_special_cases(model, &camera, 3);
            compare(gpu, &camera, scene, options, &format!("{} {raster}", model.name()));
        }
    }
    for camera in wide::cameras(46, 23) {
        for (raster, options) in rasters() {
            let scene = splats_with_special_cases(models()[4], &camera, 3);
            compare(gpu, &camera, scene, options, &format!("{} {raster}", camera.projection.name()));
        }
    }
}

/// Compares the engines' gradients by a camera.
fn compare(gpu: &Arc<Gpu>, camera: &Camera, mut scene: Splats, options: RenderOptions, name: &str) {
    if options.raster.antialias == Antialias::Mip {
        scene.smoothing = smoothing(scene.len());
    }
    let (mut cpu, mut engine) = engines(gpu, &scene);
    let view = with_weights(view(camera, true, 4), 5);
    let step = step(1, options);
    let [expected, found] = [cpu.camera_gradient(&view, &step), engine.camera_gradient(&view, &step)].map(|r| numbers(&r.unwrap()));
    for (by, (found, expected)) in ["rotation", "translation", "focal"].into_iter().zip(found.iter().zip(&expected)) {
        assert_close(&format!("camera_backward, {by}: {name}"), found, expected, 2e-4);
    }
}

/// Tests several workgroups and shards, whose borders are not those of workgroups.
fn the_gradient_by_the_camera_costs_no_bit_of_the_step(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    let scene = splats(models()[3], 500, &camera, 6);
    let view = view(&camera, false, 4);
    let run = |choice, shard: usize| {
        let mut engine = GpuEngine::new(gpu).unwrap();
        engine.split_shards(shard);
        engine.load(&scene, None).unwrap();
        let step =
            StepConfig { stats: StatsCollection::Gradients, camera_gradient: choice, ..step(1, options(Cutoffs::HDR, Antialias::Off)) };
        let first = engine.train_step(&view, &step).unwrap();
        engine.finish().unwrap();
        (engine.save().unwrap().0, first)
    };
    let (plain, _) = run(CameraGradientChoice::Skip, 500);
    let (with, report) = run(CameraGradientChoice::Compute, 500);
    assert_eq!(with, plain);
    let (_, in_shards) = run(CameraGradientChoice::Compute, 150);
    for (whole, parts) in numbers(&report).iter().zip(numbers(&in_shards)) {
        assert_close("camera_backward, shards", &parts, whole, 1e-5);
    }
}
