//! GaussHDR on the room of `common`, seen by a camera of known response at three exposures.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic as they do")]

mod common;

use common::{config, dataset, engine};
use luxel_core::{Dataset, Image, PixelValues, View};
use luxel_cpu::CpuEngine;
use luxel_metrics::{GainFit, Measures, evaluate};
use luxel_train::{Method, TrainConfig, Trainer};

const EXPOSURES_S: [f32; 3] = [0.5, 4.0, 32.0];

/// The room captured at three exposures of each training pose, with 8 bits.
fn captured() -> Dataset {
    let mut data = dataset();
    let train = std::mem::take(&mut data.train);
    for (view, (k, exposure_s)) in train.iter().flat_map(|view| EXPOSURES_S.into_iter().enumerate().map(move |exposure| (view, exposure))) {
        let value = |v: f32| ((v * exposure_s / (v * exposure_s + 1.0)).powf(1.0 / 2.2) * 255.0).round() / 255.0;
        let pixels = view.image.pixels.iter().map(|rgb| rgb.map(value)).collect();
        let image = Image::from_pixels(view.image.width, view.image.height, pixels).unwrap().into();
        data.train.push(View { name: format!("{}_{k}", view.name), image, values: PixelValues::Recorded { exposure_s }, ..view.clone() });
    }
    data
}

fn base(iterations: u32) -> TrainConfig {
    TrainConfig { max_splats: Some(600), method: Method::GaussHdr, tone_lr: 5e-3, unit_exposure: 0.73, ..config(iterations) }
}

fn run(trainer: &mut Trainer, steps: u32) {
    for _ in 0..steps {
        trainer.step().unwrap();
    }
}

fn trained(data: &Dataset, config: TrainConfig, steps: u32) -> Trainer {
    let mut trainer = Trainer::new(data, config, engine()).unwrap();
    run(&mut trainer, steps);
    trainer
}

#[test]
fn radiance_and_response_are_learned_from_captured_images_alone() {
    let data = captured();
    let mut trainer = trained(&data, base(800), 800);
    let (options, scale, mu) = (trainer.render_options(), trainer.radiance_scale(), trainer.config().mu);
    let measures = Measures { gain_fit: GainFit::Common, ..Measures::new(scale, mu) };
    let psnr = evaluate(trainer.engine(), &options, &measures, &data.test, &mut |_, _, _| ()).unwrap().mean.psnr_scene;
    println!("gausshdr {psnr:.2} dB after one gain");
    assert!(psnr > 15.0, "{psnr}");
    let response = trainer.response().unwrap();
    // Radiance times seconds of 1 is knot 20, where the response is (1 / 2)^(1 / 2.2).
    assert!(response.iter().all(|curve| (curve[20] - 0.73).abs() < 0.1), "{response:?}");
}

#[test]
fn a_resumed_run_equals_an_unbroken_one_and_any_number_of_threads_one() {
    let data = captured();
    let unbroken = trained(&data, base(50), 50).snapshot().unwrap();
    let half = trained(&data, base(50), 23).snapshot().unwrap();
    assert_ne!(half.scene.splats.len(), 216, "splats are added before the run is resumed");
    let mut resumed = Trainer::resume(&data, half, engine()).unwrap();
    run(&mut resumed, 27);
    let resumed = resumed.snapshot().unwrap();
    assert!(resumed.scene == unbroken.scene && resumed.moments == unbroken.moments && resumed.state_json == unbroken.state_json);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    let threads = pool.install(|| {
        let mut trainer = Trainer::new(&data, base(50), Box::new(CpuEngine::new(3).unwrap())).unwrap();
        run(&mut trainer, 50);
        trainer.snapshot().unwrap()
    });
    assert!(threads.scene == unbroken.scene && threads.state_json == unbroken.state_json);
}

#[test]
fn radiance_is_refused() {
    let Err(error) = Trainer::new(&dataset(), base(10), engine()) else { panic!("was accepted") };
    assert!(error.to_string().starts_with("method gausshdr: view train/0 is radiance, expected a captured image"), "{error}");
    assert!(error.remedy().unwrap().to_string().contains("supervision"));
}
