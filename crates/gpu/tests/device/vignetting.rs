//! Vignetting: losses, gradients and steps of the CPU engine, and no effect of a gain of 1.

use std::sync::Arc;

use luxel_core::engine::{CameraGradientChoice, StatsCollection, StepConfig};
use luxel_core::{Engine, StepReport, VIGNETTING_TERMS, View, Vignetting};
use luxel_gpu::{Gpu, GpuEngine};

use crate::Body;
use crate::compare::assert_close;
use crate::fixture::{camera, smoothing, splats_with_special_cases, step, view, with_weights};
use crate::parity::{engines, groups, models, rasters};
use crate::wide;

pub const ALL: &[(&str, Body)] = &[
    ("gpu_gradients_with_vignetting_match_cpu", gpu_gradients_with_vignetting_match_cpu),
    ("gpu_steps_with_vignetting_match_cpu", gpu_steps_with_vignetting_match_cpu),
    ("a_gain_of_one_costs_no_bit_of_the_step", a_gain_of_one_costs_no_bit_of_the_step),
];

/// The corners of the frame are beyond r = 1.
const VIGNETTING: Vignetting = Vignetting { axis_px: [20.5, 17.25], unit_px: 27.0, log_gain: [0.25, -0.5, 0.375, -0.625] };

fn vignetted(mut view: View) -> View {
    view.target.vignetting = Some(VIGNETTING);
    view
}

fn gpu_gradients_with_vignetting_match_cpu(gpu: &Arc<Gpu>) {
    let wide = wide::cameras(46, 23).map(|camera| (camera.projection.name().to_owned(), camera));
    let cameras = [("pinhole".to_owned(), camera(45, 38))].into_iter().chain(wide);
    for (kind, camera) in cameras {
        for (raster, options) in rasters() {
            let mut scene = splats_with_special_cases(models()[3], &camera, 3);
            if options.raster.antialias == luxel_core::Antialias::Mip {
                scene.smoothing = smoothing(scene.len());
            }
            let (mut cpu, mut engine) = engines(gpu, &scene);
            // Weights of 0 and 1 among others.
            let view = vignetted(with_weights(view(&camera, true, 4), 5));
            let step = StepConfig { stats: StatsCollection::Off, ..step(1, options) };
            let [(expected, expected_by), (found, found_by)] =
                [cpu.gradients(&view, &step).unwrap(), engine.gradients(&view, &step).unwrap()];
            let what = format!("{kind} {raster}");
            assert_close(&format!("loss, vignetting: {what}"), &[found.loss, found.l1], &[expected.loss, expected.l1], 2e-5);
            let by = [found, expected].map(|report: StepReport| report.by_vignetting.unwrap());
            assert_close(&format!("loss, by vignetting: {what}"), &by[0], &by[1], 1e-4);
            for ((name, found), (_, expected)) in groups(&found_by).into_iter().zip(groups(&expected_by)) {
                assert_close(&format!("project_backward, vignetting, {name}: {what}"), found, expected, 1e-4);
            }
        }
    }
}

fn gpu_steps_with_vignetting_match_cpu(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    let (mut cpu, mut engine) = engines(gpu, &splats_with_special_cases(models()[1], &camera, 3));
    let view = vignetted(view(&camera, false, 4));
    let (_, options) = &rasters()[2];
    for number in 1..=3 {
        for camera_gradient in [CameraGradientChoice::Skip, CameraGradientChoice::Compute] {
            let step = StepConfig { camera_gradient, ..step(number, *options) };
            let [expected, found] = [cpu.train_step(&view, &step), engine.train_step(&view, &step)].map(Result::unwrap);
            // The report is of this step, whatever else was asked for.
            assert_eq!((found.step, found.camera.is_some()), (number, expected.camera.is_some()));
            assert_close("loss, by vignetting, steps", &found.by_vignetting.unwrap(), &expected.by_vignetting.unwrap(), 1e-3);
        }
    }
    let [expected, found] =
        [cpu.camera_gradient(&view, &step(4, *options)), engine.camera_gradient(&view, &step(4, *options))].map(Result::unwrap);
    assert_close("loss, by vignetting, alone", &found.by_vignetting.unwrap(), &expected.by_vignetting.unwrap(), 1e-3);
}

fn a_gain_of_one_costs_no_bit_of_the_step(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    let scene = splats_with_special_cases(models()[1], &camera, 3);
    let run = |vignetting: Option<Vignetting>| {
        let mut engine = GpuEngine::new(gpu).unwrap();
        engine.load(&scene, None).unwrap();
        let mut view = view(&camera, false, 4);
        view.target.vignetting = vignetting;
        let report = engine.train_step(&view, &step(1, rasters()[2].1)).unwrap();
        engine.finish().unwrap();
        (report, engine.save().unwrap().0)
    };
    let (plain, expected) = run(None);
    let (report, found) = run(Some(Vignetting { log_gain: [0.0; VIGNETTING_TERMS], ..VIGNETTING }));
    assert_eq!(plain.by_vignetting, None);
    assert_eq!((StepReport { by_vignetting: None, ..report }, found), (plain, expected));
}
