//! Parity of both engines for fisheyes and panoramas: images, gradients, statistics, contributions.

use std::sync::Arc;

use luxel_core::engine::{StatsCollection, StepConfig};
use luxel_core::{Antialias, Camera, CameraProjection, Cutoffs, Engine, Fisheye, RenderOptions, Splats};
use luxel_gpu::Gpu;

use crate::Body;
use crate::compare::{assert_close, assert_close_but_few};
use crate::fixture::{options, smoothing, splats_with_special_cases, step, view, wide_camera};
use crate::parity::{engines, groups, models};

pub const ALL: &[(&str, Body)] = &[
    ("gpu_wide_images_match_cpu", gpu_wide_images_match_cpu),
    ("gpu_wide_gradients_match_cpu", gpu_wide_gradients_match_cpu),
    ("gpu_wide_contributions_match_cpu", gpu_wide_contributions_match_cpu),
];

/// A fisheye with strong coefficients, one that sees 240 degrees, and a panorama.
pub fn cameras(width: u32, height: u32) -> [Camera; 3] {
    let bent = CameraProjection::Fisheye(Fisheye::new([-0.03, 0.012, -0.004, 0.0006]));
    let wide = CameraProjection::Fisheye(Fisheye { coefficients: [0.0; 4], max_angle_rad: 120f64.to_radians() });
    [bent, wide, CameraProjection::Equirectangular].map(|projection| wide_camera(projection, width, height))
}

/// Returns special cases, with two splats so large that they end at a right angle to their
/// direction.
fn scene(model: usize, camera: &Camera) -> Splats {
    splats_with_special_cases(models()[model], camera, 3)
}

fn rasters() -> [RenderOptions; 3] {
    let mut sampled = options(Cutoffs::HDR, Antialias::Pixel);
    sampled.raster.samples = 2;
    [options(Cutoffs::HDR, Antialias::Off), options(Cutoffs::PARITY, Antialias::Mip), sampled]
}

/// Takes the edges of the two large splats away, where rounding decides whether a pixel sees them.
fn without_edges(mut splats: Splats) -> Splats {
    for i in [1, 2] {
        splats.log_scale[i] = splats.log_scale[i].map(|s| s - 1.5);
    }
    splats
}

fn gpu_wide_images_match_cpu(gpu: &Arc<Gpu>) {
    for camera in cameras(70, 35) {
        // At an edge a pixel may differ by a whole splat.
        let cases = rasters().map(|options| (options, without_edges(scene(3, &camera)), 4e-3));
        for (n, (options, mut scene, band)) in cases.into_iter().chain([(rasters()[0], scene(3, &camera), 3e-2)]).enumerate() {
            if options.raster.antialias == Antialias::Mip {
                scene.smoothing = smoothing(scene.len());
            }
            let (mut cpu, mut engine) = engines(gpu, &scene);
            let [expected, found] = [cpu.render(&camera, &options), engine.render(&camera, &options)].map(|image| image.unwrap().pixels);
            let what = format!("fisheyes and panoramas, image: {} {n}", camera.projection.name());
            assert_close_but_few(&what, found.as_flattened(), expected.as_flattened(), 5e-5, (9, band));
        }
    }
}

fn gpu_wide_gradients_match_cpu(gpu: &Arc<Gpu>) {
    for camera in cameras(46, 23) {
        for (n, options) in rasters().into_iter().enumerate() {
            let mut scene = scene(3, &camera);
            if options.raster.antialias == Antialias::Mip {
                scene.smoothing = smoothing(scene.len());
            }
            let (mut cpu, mut engine) = engines(gpu, &scene);
            let view = view(&camera, n == 0, 9);
            let step = StepConfig { stats: StatsCollection::GradientsAndAbsolute, ..step(1, options) };
            let ((report, expected), (found_report, found)) =
                (cpu.gradients(&view, &step).unwrap(), engine.gradients(&view, &step).unwrap());
            let name = camera.projection.name();
            assert_close(&format!("fisheyes and panoramas, loss: {name} {n}"), &[found_report.loss], &[report.loss], 5e-5);
            for ((parameter, found), (_, expected)) in groups(&found).into_iter().zip(groups(&expected)) {
                assert_close(&format!("fisheyes and panoramas, gradients: {parameter} {name} {n}"), found, expected, 3e-4);
            }
            // Statistics come with a step.
            cpu.train_step(&view, &step).unwrap();
            engine.train_step(&view, &step).unwrap();
            let [expected, found] = [cpu.densify_stats(), engine.densify_stats()].map(Result::unwrap);
            for (what, found, expected) in
                [("norm", &found.gradient, &expected.gradient), ("absolute", &found.abs_gradient, &expected.abs_gradient)]
            {
                assert_close(&format!("fisheyes and panoramas, statistics: {what} {name} {n}"), found, expected, 1e-3);
            }
        }
    }
}

fn gpu_wide_contributions_match_cpu(gpu: &Arc<Gpu>) {
    let options = options(Cutoffs::HDR, Antialias::Off);
    for camera in cameras(40, 20) {
        let scene = scene(0, &camera);
        let (mut cpu, mut engine) = engines(gpu, &scene);
        let mask: Vec<f32> = (0..40 * 20).map(|i| (i % 3) as f32 / 2.0).collect();
        let [expected, found] =
            [cpu.contributions(&camera, &options, &mask), engine.contributions(&camera, &options, &mask)].map(Result::unwrap);
        for (what, found, expected) in [("masked", found.masked, expected.masked), ("blended", found.blended, expected.blended)] {
            assert_close(&format!("fisheyes and panoramas, contributions: {what} {}", camera.projection.name()), &found, &expected, 2e-4);
        }
    }
}
