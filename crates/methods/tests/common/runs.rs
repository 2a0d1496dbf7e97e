//! Runs of methods with steps of their own: captured images, and runs resumed or on other threads.

#![allow(dead_code, reason = "not every test file that shares this module needs all of it")]

use luxel_core::{Dataset, Image, PixelValues, Snapshot, View};
use luxel_cpu::CpuEngine;
use luxel_methods::CapturedMethods;
use luxel_metrics::{GainFit, Measures, evaluate};
use luxel_train::{TrainConfig, Trainer, TrainingMeans};

use super::engine;

/// The response of the camera that captures the room.
pub(crate) fn response(x: f32) -> f32 {
    (x / (x + 1.0)).powf(1.0 / 2.2)
}

/// Returns number `k` of the images that the camera captures of a view, of 8 bits.
pub(crate) fn captured(view: &View, k: usize, exposure_s: f32) -> View {
    let value = |v: f32| (response(v * exposure_s) * 255.0).round() / 255.0;
    let pixels = view.image.pixels.iter().map(|rgb| rgb.map(value)).collect();
    let image = Image::from_pixels(view.image.width, view.image.height, pixels).unwrap().into();
    View { name: format!("{}_{k}", view.name), image, values: PixelValues::Recorded { exposure_s }, ..view.clone() }
}

/// An engine on two threads, and the methods.
pub(crate) fn means() -> TrainingMeans<'static> {
    TrainingMeans { engine: engine(), methods: &CapturedMethods }
}

/// Performs some steps.
pub(crate) fn run(trainer: &mut Trainer, steps: u32) {
    for _ in 0..steps {
        trainer.step().unwrap();
    }
}

/// Returns a run after some steps.
pub(crate) fn trained(data: &Dataset, config: TrainConfig, steps: u32) -> Trainer {
    let mut trainer = Trainer::new(data, config, means()).unwrap();
    run(&mut trainer, steps);
    trainer
}

/// Returns the PSNR of a run's renders of the test views, dB.
pub(crate) fn psnr(trainer: &mut Trainer, data: &Dataset, gain_fit: GainFit<'_>) -> f64 {
    let (options, scale, mu) = (trainer.render_options(), trainer.radiance_scale(), trainer.config().mu);
    let measures = Measures { gain_fit, ..Measures::new(scale, mu) };
    evaluate(trainer.engine(), &options, &measures, &data.test, &mut |_, _, _| ()).unwrap().mean.psnr_scene
}

/// Checks that a run of 50 steps that is resumed after 23, and one on three threads, equal an
/// unbroken one on two threads bit for bit. Returns the unbroken one.
pub(crate) fn check_resumed_and_threads(data: &Dataset, config: &TrainConfig) -> Snapshot {
    let unbroken = trained(data, config.clone(), 50).snapshot().unwrap();
    let half = trained(data, config.clone(), 23).snapshot().unwrap();
    assert_ne!(half.scene.splats.len(), data.points.len(), "splats are added before the run is resumed");
    let mut resumed = Trainer::resume(data, half, means()).unwrap();
    run(&mut resumed, 27);
    let resumed = resumed.snapshot().unwrap();
    assert!(resumed.scene == unbroken.scene && resumed.moments == unbroken.moments && resumed.state_json == unbroken.state_json);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    let threads = pool.install(|| {
        let mut trainer =
            Trainer::new(data, config.clone(), TrainingMeans { engine: Box::new(CpuEngine::new(3).unwrap()), methods: &CapturedMethods })
                .unwrap();
        run(&mut trainer, 50);
        trainer.snapshot().unwrap()
    });
    assert!(threads.scene == unbroken.scene && threads.state_json == unbroken.state_json);
    unbroken
}
