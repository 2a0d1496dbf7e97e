//! Mixes of light and frozen parameters on the GPU.

use std::sync::Arc;

use luxel_core::engine::LearningRates;
use luxel_core::{Antialias, CameraProjection, Cutoffs, Engine, RenderOptions, Splats};
use luxel_gpu::Gpu;

use crate::Body;
use crate::compare::assert_close_but_few;
use crate::fixture::{camera, mix, options, splats, step, three_lights, view, wide_camera};
use crate::parity::{engines, models};

pub const ALL: &[(&str, Body)] = &[
    ("gpu_mixes_are_the_weighted_sum_of_renders", gpu_mixes_are_the_weighted_sum_of_renders),
    ("gpu_mixes_match_cpu", gpu_mixes_match_cpu),
    ("a_rate_of_zero_keeps_the_bits", a_rate_of_zero_keeps_the_bits),
];

fn mixed(lights: &[(Splats, f32)]) -> Splats {
    mix(&lights.iter().map(|(splats, gain)| (splats, *gain)).collect::<Vec<_>>())
}

fn gpu_mixes_are_the_weighted_sum_of_renders(gpu: &Arc<Gpu>) {
    let pinhole = camera(45, 38);
    let lights = three_lights(&pinhole, 150);
    let panorama = wide_camera(CameraProjection::Equirectangular, 40, 20);
    for (camera, cutoffs) in [(&pinhole, Cutoffs::HDR), (&pinhole, Cutoffs::PARITY), (&panorama, Cutoffs::HDR)] {
        let options = RenderOptions { background: [0.0; 3], ..options(cutoffs, Antialias::Pixel) };
        let mut engine = engines(gpu, &mixed(&lights)).1;
        let found = engine.render(camera, &options).unwrap();
        let mut expected = vec![0.0f32; found.pixels.as_flattened().len()];
        for (splats, gain) in &lights {
            engine.load(splats, None).unwrap();
            let image = engine.render(camera, &options).unwrap();
            expected.iter_mut().zip(image.pixels.as_flattened()).for_each(|(sum, value)| *sum += gain * value);
        }
        for (found, expected) in found.pixels.as_flattened().iter().zip(&expected) {
            assert!((found - expected).abs() <= 5e-6 * expected.abs() + 1e-9, "{found} {expected}");
        }
    }
}

fn gpu_mixes_match_cpu(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    let options = options(Cutoffs::HDR, Antialias::Pixel);
    let (mut cpu, mut engine) = engines(gpu, &mixed(&three_lights(&camera, 150)));
    let [expected, found] = [cpu.render(&camera, &options), engine.render(&camera, &options)].map(|image| image.unwrap().pixels);
    assert_close_but_few("mix, image", found.as_flattened(), expected.as_flattened(), 2e-5, (6, 4e-3));
    let mask: Vec<f32> = (0..45 * 38).map(|i| f32::from(u8::from(i % 45 < 20))).collect();
    let light = |engine: &mut dyn Engine| engine.contributions(&camera, &options, &mask).unwrap().light;
    assert_close_but_few("mix, light", &light(&mut engine), &light(&mut cpu), 1e-4, (2, 4e-3));
    let view = view(&camera, false, 5);
    let error = engine.train_step(&view, &step(1, options)).unwrap_err();
    assert!(error.to_string().contains("mix of lights"), "{error}");
}

fn a_rate_of_zero_keeps_the_bits(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    for model in models() {
        let before = splats(model, 100, &camera, 3);
        let (mut cpu, mut engine) = engines(gpu, &before);
        let mut step = step(1, options(Cutoffs::HDR, Antialias::Pixel));
        step.learning_rates = LearningRates { position: 0.0, rotation: 0.0, log_scale: 0.0, opacity_logit: 0.0, ..step.learning_rates };
        let engines: [&mut dyn Engine; 2] = [&mut cpu, &mut engine];
        for engine in engines {
            for number in 1..=5 {
                step.step = number;
                engine.train_step(&view(&camera, false, u64::from(number)), &step).unwrap();
            }
            let (after, moments) = engine.save().unwrap();
            assert_eq!((&after.position, &after.rotation), (&before.position, &before.rotation));
            assert_eq!((&after.log_scale, &after.opacity_logit), (&before.log_scale, &before.opacity_logit));
            assert_ne!(after.sh, before.sh);
            assert!(moments.first.position.iter().all(|m| *m == [0.0; 3]));
        }
    }
}
