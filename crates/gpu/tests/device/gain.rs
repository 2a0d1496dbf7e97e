//! Gains of edits on the GPU.

use std::sync::Arc;

use luxel_core::engine::{DensifyPlan, PlanRow};
use luxel_core::{Antialias, CameraProjection, Cutoffs, Engine, RenderOptions};
use luxel_gpu::Gpu;

use crate::Body;
use crate::fixture::{camera, mix, options, smoothing, splats, step, three_lights, view, wide_camera};
use crate::parity::{engines, models};

pub const ALL: &[(&str, Body)] =
    &[("a_gain_multiplies_every_pixel", a_gain_multiplies_every_pixel), ("gains_are_kept_and_not_trained", gains_are_kept_and_not_trained)];

fn a_gain_multiplies_every_pixel(gpu: &Arc<Gpu>) {
    let pinhole = camera(45, 38);
    let panorama = wide_camera(CameraProjection::Equirectangular, 40, 20);
    let lights = three_lights(&pinhole, 150);
    let mixed = mix(&lights.iter().map(|(splats, gain)| (splats, *gain)).collect::<Vec<_>>());
    for mut scene in models().into_iter().map(|model| splats(model, 150, &pinhole, 3)).chain([mixed]) {
        for camera in [&pinhole, &panorama] {
            let options = RenderOptions { background: [0.0; 3], ..options(Cutoffs::HDR, Antialias::Pixel) };
            scene.gain = Vec::new();
            let (_, mut engine) = engines(gpu, &scene);
            let before = engine.render(camera, &options).unwrap();
            for gain in [1.0 / 1024.0, 0.7, 30.0, 1024.0] {
                scene.gain = vec![gain; scene.len()];
                engine.load(&scene, None).unwrap();
                let after = engine.render(camera, &options).unwrap();
                for (b, a) in before.pixels.as_flattened().iter().zip(after.pixels.as_flattened()) {
                    assert!((a - gain * b).abs() <= 5e-6 * gain * b, "{} {gain}: {a} {}", scene.color_model.name(), gain * b);
                }
            }
        }
    }
}

fn gains_are_kept_and_not_trained(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    let mut scene = splats(models()[1], 70, &camera, 3);
    scene.smoothing = smoothing(scene.len());
    scene.gain = (0..scene.len()).map(|i| i as f32).collect();
    let (mut cpu, mut engine) = engines(gpu, &scene);
    let plan = DensifyPlan { rows: [9, 3, 3, 64].map(PlanRow::keep).to_vec(), ..DensifyPlan::default() };
    let options = options(Cutoffs::HDR, Antialias::Mip);
    let engines: [&mut dyn Engine; 2] = [&mut cpu, &mut engine];
    let images = engines.map(|engine| {
        assert_eq!(engine.save().unwrap().0, scene);
        for result in [
            engine.train_step(&view(&camera, false, 5), &step(1, options)).map(|_| ()),
            engine.view_gradients(&view(&camera, false, 5), &step(1, options)).map(|_| ()),
        ] {
            assert!(result.unwrap_err().to_string().contains("gains of edits"));
        }
        engine.densify(&plan).unwrap();
        assert_eq!(engine.save().unwrap().0.gain, [9.0, 3.0, 3.0, 64.0]);
        let mut small = scene.select([9, 3, 3, 64]);
        let kept = engine.render(&camera, &options).unwrap();
        engine.load(&small, None).unwrap();
        assert_eq!(engine.render(&camera, &options).unwrap(), kept);
        small.gain[3] = 0.5;
        engine.replace_parameters(&small).unwrap();
        engine.render(&camera, &options).unwrap()
    });
    let [cpu, gpu] = images.map(|image| image.pixels);
    for (a, b) in cpu.as_flattened().iter().zip(gpu.as_flattened()) {
        assert!((a - b).abs() <= 1e-4 * (a + b) + 4e-3, "{a} {b}");
    }
}
