//! Poses that are optimised with the scene: perturbed ones are found again, right ones stay, and a
//! resumed run has the bits of an unbroken one.

#![allow(clippy::unwrap_used, reason = "helpers of tests may panic as they do")]

mod common;

use common::{config, dataset, engine};
use glam::DVec3;
use luxel_core::{Camera, CameraMotion, Dataset, random::standard_normal};
use luxel_train::{AlignmentScene, TrainConfig, Trainer, align_camera, pose_change};

/// Distance of the cameras from the room.
const DEPTH: f64 = 4.0;

fn base(iterations: u32) -> TrainConfig {
    TrainConfig { max_splats: Some(800), densify_interval: Some(50), refine_poses: true, ..config(iterations) }
}

/// The room seen by training cameras that are a pixel off.
fn perturbed() -> Dataset {
    let mut data = dataset();
    for (i, view) in data.train.iter_mut().enumerate() {
        let noise = |k: u64| f64::from(standard_normal(11, 6 * i as u64 + k)[0]);
        let turn = DVec3::new(noise(0), noise(1), noise(2)) * 0.012;
        view.camera = CameraMotion::IDENTITY.then(turn, DVec3::new(noise(3), noise(4), noise(5)) * 0.05).apply(&view.camera);
    }
    data
}

fn run(trainer: &mut Trainer, steps: u32) {
    for _ in 0..steps {
        trainer.step().unwrap();
    }
}

fn trained(data: &Dataset, config: TrainConfig) -> Trainer {
    let mut trainer = Trainer::new(data, config, engine()).unwrap();
    while !trainer.is_finished() {
        trainer.step().unwrap();
    }
    trainer
}

/// Returns the mean distance of cameras from the true ones, pixels, once the similarity between
/// the two sets is removed as far as pairs of neighbours show it: the error of relative poses.
fn relative_error_px(cameras: &[Camera], truth: &[Camera]) -> f64 {
    let relative = |cameras: &[Camera], i: usize| {
        let world_from_first = cameras[i].camera_from_world.inverse();
        let pose = cameras[i + 1].camera_from_world * world_from_first;
        Camera { camera_from_world: pose, ..cameras[i + 1].clone() }
    };
    let pairs = cameras.len() - 1;
    (0..pairs).map(|i| pose_change(&relative(truth, i), &relative(cameras, i), DEPTH).px).sum::<f64>() / pairs as f64
}

#[test]
fn perturbed_poses_come_back_and_the_images_with_them() {
    let (truth, data) = (dataset(), perturbed());
    let true_cameras: Vec<Camera> = truth.train.iter().map(|view| view.camera.clone()).collect();
    let given: Vec<Camera> = data.train.iter().map(|view| view.camera.clone()).collect();
    let fixed = trained(&data, TrainConfig { refine_poses: false, ..base(500) });
    assert_eq!((fixed.cameras(), fixed.pose_report()), (given.clone(), None));
    let mut refined = trained(&data, TrainConfig { pose_lr: Some(0.2), ..base(500) });
    let (before, after) = (relative_error_px(&given, &true_cameras), relative_error_px(&refined.cameras(), &true_cameras));
    println!("relative error {before} px, then {after} px, {:?}", refined.pose_report());
    assert!(before > 0.7 && after < 0.65 * before, "{before} px, then {after} px");
    let report = refined.pose_report().unwrap();
    assert!(report.mean.px > 0.3 && report.largest.degrees > 0.1 && report.focal_factors.is_empty(), "{report:?}");

    // A test view that is off is aligned to the scene.
    let scene = AlignmentScene {
        render: refined.render_options(),
        loss: refined.config().loss_weights(),
        radiance_scale: refined.radiance_scale(),
        mu: refined.config().mu,
        response: None,
        positions: refined.scene().unwrap().splats.position,
    };
    let first = align_camera(refined.engine(), &truth.test[0], &scene).unwrap();
    let mut off = truth.test[0].clone();
    off.camera = CameraMotion::IDENTITY.then(DVec3::new(0.02, -0.015, 0.01), DVec3::new(0.02, 0.03, 0.0)).apply(&off.camera);
    let again = align_camera(refined.engine(), &off, &scene).unwrap();
    let (start, left) = (pose_change(&first, &off.camera, DEPTH).px, pose_change(&first, &again, DEPTH).px);
    assert!(start > 0.8 && left < 0.6 * start, "{start} px off, then {left} px");
}

#[test]
fn right_poses_stay() {
    let data = dataset();
    // The initial points are a pixel off: the scene takes shape before the poses may move.
    let trainer = trained(&data, TrainConfig { refine_focal: true, pose_lr: Some(0.02), pose_from: Some(250), ..base(400) });
    let report = trainer.pose_report().unwrap();
    println!("{report:?}");
    assert!(report.mean.px > 0.0 && report.mean.px < 0.1, "{report:?}");
    let [factor] = report.focal_factors[..] else { panic!("one lens has one factor") };
    assert!((factor - 1.0).abs() < 0.02 && factor != 1.0, "{factor}");
}

#[test]
fn a_resumed_run_has_the_bits_of_an_unbroken_one() {
    let data = perturbed();
    let config = TrainConfig { refine_focal: true, ..base(60) };
    let mut whole = Trainer::new(&data, config.clone(), engine()).unwrap();
    let mut first = Trainer::new(&data, config, engine()).unwrap();
    run(&mut first, 33);
    let mut second = Trainer::resume(&data, first.snapshot().unwrap(), engine()).unwrap();
    assert_eq!(second.cameras(), first.cameras());
    run(&mut whole, 60);
    run(&mut second, 27);
    assert_eq!(second.snapshot().unwrap(), whole.snapshot().unwrap());
    assert_eq!(second.cameras(), whole.cameras());
}

#[test]
fn a_run_without_a_step_that_refines_is_refused() {
    let data = dataset();
    let refused = |config: TrainConfig| Trainer::new(&data, config, engine()).err().unwrap().to_string();
    let error = refused(TrainConfig { pose_from: Some(60), ..base(60) });
    assert!(error.starts_with("refine_poses") && error.contains("none of the run's 60 steps"), "{error}");
    let error = refused(TrainConfig { pose_from: Some(9), pose_until: Some(9), ..base(60) });
    assert!(error.starts_with("pose_until"), "{error}");
}
