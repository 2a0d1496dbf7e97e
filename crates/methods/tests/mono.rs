//! Mono-HDR-GS on the room of `common`, seen by a camera of known response at one exposure.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic as they do")]

mod common;

use common::runs::{captured, check_resumed_and_threads, means, psnr, trained};
use common::{config, dataset, engine};
use luxel_core::{Dataset, Engine, Snapshot};
use luxel_methods::CapturedMethods;
use luxel_metrics::{GainFit, Measures, evaluate};
use luxel_train::{HdrNormalisation, Method, TrainConfig, Trainer, lifted_engine, snapshot_scene};

const EXPOSURE_S: f32 = 4.0;

/// The room with a captured image of each training pose.
fn pairs(exposure_s: impl Fn(usize) -> f32) -> Dataset {
    let mut data = dataset();
    for (i, view) in data.train.iter_mut().enumerate() {
        view.recordings = vec![captured(view, 0, exposure_s(i))];
    }
    data
}

fn base(iterations: u32) -> TrainConfig {
    TrainConfig { max_splats: Some(600), method: Method::MonoHdrGs, lift_lr: 5e-3, cycle_lr: 1e-3, ..config(iterations) }
}

fn psnr_in(engine: &mut dyn Engine, trainer: &Trainer, data: &Dataset, gain_fit: GainFit<'_>) -> f64 {
    let (options, scale, mu) = (trainer.render_options(), trainer.radiance_scale(), trainer.config().mu);
    let measures = Measures { gain_fit, ..Measures::new(scale, mu) };
    evaluate(engine, &options, &measures, &data.test, &mut |_, _, _| ()).unwrap().mean.psnr_scene
}

/// Returns the PSNR of the lifted scene as a resumed run renders it, as its snapshot does, and of
/// the scene without the lift.
fn psnr_thrice(trainer: &mut Trainer, data: &Dataset, gain_fit: GainFit<'_>) -> [f64; 3] {
    let snapshot: Snapshot = trainer.snapshot().unwrap();
    let mut again = lifted_engine(&snapshot, engine(), &CapturedMethods).unwrap().unwrap();
    let mut folded = engine();
    let scene = trainer.scene().unwrap();
    assert_eq!((scene.splats.color_model.name().as_str(), snapshot.scene.splats.color_model.name().as_str()), ("logsh3", "sh3"));
    folded.load(&scene.splats, None).unwrap();
    let of_own = psnr(&mut Trainer::resume(data, snapshot, means()).unwrap(), data, gain_fit);
    [of_own, psnr_in(&mut *again, trainer, data, gain_fit), psnr_in(&mut *folded, trainer, data, gain_fit)]
}

#[test]
fn radiance_is_learned_from_captured_values_and_survives_without_the_lift() {
    let data = pairs(|_| EXPOSURE_S);
    let mut trainer = trained(&data, base(800), 800);
    let [own, again, folded] = psnr_thrice(&mut trainer, &data, GainFit::None);
    println!("mono-hdr-gs {own:.2} dB, without the lift {folded:.2} dB");
    assert!(own > 18.0 && (folded - own).abs() < 1.0, "{own} {folded}");
    assert_eq!(own, again);
}

#[test]
fn by_the_own_maximum_one_gain_for_all_views_brings_the_scene_to_scale() {
    let data = pairs(|_| EXPOSURE_S);
    let mut own = trained(&data, TrainConfig { hdr_normalisation: HdrNormalisation::Own, ..base(400) }, 400);
    let fitted = psnr_thrice(&mut own, &data, GainFit::Common)[0];
    println!("after one gain {fitted:.2} dB");
    assert!(fitted > 17.0, "{fitted}");
}

#[test]
fn statistics_are_those_of_the_captured_image_and_its_radiance_without_weight_changes_no_bit() {
    let data = pairs(|_| EXPOSURE_S);
    let snapshot = |config: TrainConfig, steps: u32| {
        let mut trainer = trained(&data, config, steps);
        trainer.snapshot().unwrap()
    };
    let stats = |hdr_weight: f32| {
        let config = TrainConfig { densify_from: Some(0), densify_interval: Some(50), hdr_weight, ..base(200) };
        snapshot(config, 1).stats
    };
    let (without, with) = (stats(0.0), stats(0.6));
    assert!(without.gradient.iter().any(|v| *v > 0.0));
    assert_eq!(without, with);
    let run = |mu: f32| snapshot(TrainConfig { hdr_weight: 0.0, cycle_weight: 0.0, mu, radiance_scale: Some(1.0), ..base(40) }, 40);
    let (a, b) = (run(5000.0), run(20.0));
    assert!(a.scene.splats == b.scene.splats && a.moments == b.moments && a.stats == b.stats);
}

#[test]
fn a_resumed_run_equals_an_unbroken_one_and_any_number_of_threads_one() {
    let data = pairs(|_| EXPOSURE_S);
    let unbroken = check_resumed_and_threads(&data, &base(50));
    let folded = snapshot_scene(unbroken, &CapturedMethods).unwrap();
    assert_eq!(folded.splats.color_model.name(), "logsh3");
    folded.splats.validate().unwrap();
}

#[test]
fn images_of_several_exposures_are_refused_with_what_to_do() {
    let data = pairs(|i| [0.5, 4.0][i % 2]);
    let Err(error) = Trainer::new(&data, base(10), means()) else { panic!("was accepted") };
    assert_eq!(error.to_string(), "method mono-hdr-gs: captured images of 0.5, 4 s, expected one exposure for all");
    assert!(error.remedy().unwrap().to_string().contains("exposures"));
    assert!(Trainer::new(&dataset(), base(10), means()).is_err());
}
