//! GaussHDR on the room of `common`, seen by a camera of known response at three exposures.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic as they do")]

mod common;

use common::runs::{captured, check_resumed_and_threads, means, psnr, trained};
use common::{config, dataset};
use luxel_core::Dataset;
use luxel_metrics::GainFit;
use luxel_train::{Method, TrainConfig, Trainer};

const EXPOSURES_S: [f32; 3] = [0.5, 4.0, 32.0];

/// The room captured at three exposures of each training pose.
fn recordings() -> Dataset {
    let mut data = dataset();
    let train = std::mem::take(&mut data.train);
    data.train = train.iter().flat_map(|view| (0..3).map(move |k| captured(view, k, EXPOSURES_S[k]))).collect();
    data
}

fn base(iterations: u32) -> TrainConfig {
    TrainConfig { max_splats: Some(600), method: Method::GaussHdr, tone_lr: 5e-3, unit_exposure: 0.73, ..config(iterations) }
}

#[test]
fn radiance_and_response_are_learned_from_captured_images_alone() {
    let data = recordings();
    let mut trainer = trained(&data, base(800), 800);
    let psnr = psnr(&mut trainer, &data, GainFit::Common);
    println!("gausshdr {psnr:.2} dB after one gain");
    assert!(psnr > 15.0, "{psnr}");
    let response = trainer.response().unwrap();
    // Radiance times seconds of 1 is knot 20, where the response is (1 / 2)^(1 / 2.2).
    assert!(response.iter().all(|curve| (curve[20] - 0.73).abs() < 0.1), "{response:?}");
}

#[test]
fn a_resumed_run_equals_an_unbroken_one_and_any_number_of_threads_one() {
    check_resumed_and_threads(&recordings(), &base(50));
}

#[test]
fn radiance_is_refused() {
    let Err(error) = Trainer::new(&dataset(), base(10), means()) else { panic!("was accepted") };
    assert!(error.to_string().starts_with("method gausshdr: view train/0 is radiance, expected a captured image"), "{error}");
    assert!(error.remedy().unwrap().to_string().contains("supervision"));
}
