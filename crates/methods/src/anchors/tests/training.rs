//! Runs of a small scene: learning, resuming, and what is refused.

use glam::DVec3;
use luxel_core::{Dataset, Image, PixelValues, Point, View};
use luxel_cpu::CpuEngine;

use super::super::{AnchorEngine, AnchorSnapshot, AnchorTrainer};
use crate::testing::{camera_looking_at, dataset_of, view_of};
use luxel_core::Engine;
use luxel_train::{Method, TrainConfig, TrainError};

/// A wall of coloured tiles, seen from six places.
fn wall() -> Dataset {
    let eyes = [[-0.6, 0.0, 0.0], [0.6, 0.1, 0.0], [0.0, 0.5, 0.2], [0.0, -0.5, 0.1], [0.3, 0.2, -0.3], [-0.3, -0.2, 0.4]];
    let view = |(i, eye): (usize, [f64; 3])| {
        let camera = camera_looking_at(DVec3::from_array(eye), DVec3::new(0.0, 0.0, 3.0), [32, 32]);
        let pixel = |at: usize| {
            let [x, y] = [(at % 32) as f64 + 0.5, (at / 32) as f64 + 0.5];
            let direction = camera.camera_from_world.matrix3.transpose()
                * DVec3::new((x - camera.center_px.x) / camera.focal_px.x, (y - camera.center_px.y) / camera.focal_px.y, 1.0);
            let at = DVec3::from_array(eye) + direction * ((3.0 - eye[2]) / direction.z);
            let tile = ((2.0 * at.x).floor() as i64 + (2.0 * at.y).floor() as i64).rem_euclid(2);
            [0.2 + 0.6 * tile as f32, 0.3, 0.8 - 0.6 * tile as f32]
        };
        let image = Image::from_pixels(32, 32, (0..32 * 32).map(pixel).collect()).unwrap();
        view_of(&format!("view_{i}"), camera, image)
    };
    let points = (0..300).map(|i| {
        let [x, y, _] = luxel_core::random::standard_normal(4, i);
        Point { position: [1.2 * x, 1.2 * y, 3.0], rgb8: None, observations: Vec::new() }
    });
    Dataset { points: points.collect(), ..dataset_of(eyes.into_iter().enumerate().map(view).collect()) }
}

fn recorded() -> Dataset {
    let dataset = wall();
    let shot = |(i, view): (usize, &View)| {
        let exposure_s = [0.5, 1.0, 2.0][i % 3];
        let value = |x: f32| (x * exposure_s / (x * exposure_s + 1.0)).powf(0.6);
        let pixels = view.image.pixels.iter().map(|rgb| rgb.map(value)).collect();
        View { image: Image::from_pixels(32, 32, pixels).unwrap().into(), values: PixelValues::Recorded { exposure_s }, ..view.clone() }
    };
    Dataset { train: dataset.train.iter().enumerate().map(shot).collect(), ..dataset }
}

fn config(method: Method) -> TrainConfig {
    TrainConfig {
        method,
        iterations: 60,
        max_splats: Some(900),
        densify_from: Some(5),
        densify_interval: Some(10),
        densify_until: Some(45),
        ..TrainConfig::default()
    }
}

fn engine(threads: usize) -> Box<dyn Engine> {
    Box::new(CpuEngine::new(threads).unwrap())
}

fn train(trainer: &mut AnchorTrainer, steps: u32) -> Vec<f32> {
    (0..steps).map(|_| trainer.step().unwrap().loss).collect()
}

/// Returns the PSNR of all views as anchors render them, values of at most 1.
fn psnr(trainer: &AnchorTrainer, dataset: &Dataset) -> f64 {
    let mut renderer = AnchorEngine::new(trainer.scene().clone(), engine(2));
    let options = luxel_core::RenderOptions { raster: trainer.raster(), ..Default::default() };
    let (mut error, mut count) = (0.0, 0);
    for view in &dataset.train {
        let mut image = renderer.render(&view.camera, &options).unwrap();
        trainer.radiance_scale().restore(&mut image);
        let pairs = image.pixels.iter().flatten().zip(view.image.pixels.iter().flatten());
        error += pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        count += 3 * image.pixels.len();
    }
    -10.0 * (error / count as f64).log10()
}

#[test]
fn the_loss_falls_and_anchors_render_without_a_trainer() {
    let dataset = wall();
    let config = TrainConfig { iterations: 1000, max_splats: Some(3000), densify_until: Some(400), ..config(Method::LcdAnchors) };
    let mut trainer = AnchorTrainer::new(&dataset, config, engine(2)).unwrap();
    let before = psnr(&trainer, &dataset);
    let losses = train(&mut trainer, 1000);
    let mean = |losses: &[f32]| losses.iter().sum::<f32>() / losses.len() as f32;
    assert!(mean(&losses[980..]) < 0.15 * mean(&losses[..6]), "{} {}", mean(&losses[980..]), mean(&losses[..6]));
    // The bound leaves two dB of room for other orders of the same sums.
    let after = psnr(&trainer, &dataset);
    assert!(before < 10.0 && after > 22.0, "{before} {after}");
    assert!(trainer.is_finished() && trainer.scene().anchors.len() <= 300, "{}", trainer.scene().anchors.len());
    let mut renderer = AnchorEngine::new(trainer.scene().clone(), engine(2));
    let options = luxel_core::RenderOptions { raster: trainer.raster(), ..Default::default() };
    let view = &dataset.train[0];
    let image = renderer.render(&view.camera, &options).unwrap();
    assert_eq!(renderer.render_layers(&view.camera, &options).unwrap().image, image);
    assert!(renderer.save().unwrap_err().to_string().contains("decode their splats"));
}

#[test]
fn a_resumed_run_and_other_threads_give_the_same_bits() {
    for (method, dataset) in [(Method::LcdAnchors, wall()), (Method::GaussHdrAnchors, recorded())] {
        let mut unbroken = AnchorTrainer::new(&dataset, config(method), engine(1)).unwrap();
        train(&mut unbroken, 60);
        // Within growth, between rounds, and within the mean of the last states.
        for broken_after in [20, 33, 55] {
            let mut broken = AnchorTrainer::new(&dataset, config(method), engine(2)).unwrap();
            train(&mut broken, broken_after);
            let snapshot = broken.snapshot().unwrap();
            let mut resumed = AnchorTrainer::resume(&dataset, snapshot.clone(), engine(3)).unwrap();
            assert_eq!(resumed.snapshot().unwrap(), snapshot);
            train(&mut resumed, 60 - broken_after);
            assert_eq!(resumed.snapshot().unwrap(), unbroken.snapshot().unwrap(), "{method:?} {broken_after}");
        }
    }
}

#[test]
fn captured_images_are_learned_with_their_camera() {
    let dataset = recorded();
    for method in [Method::LcdAnchors, Method::GaussHdrAnchors] {
        let mut trainer = AnchorTrainer::new(&dataset, config(method), engine(2)).unwrap();
        assert!(trainer.response().is_some());
        let losses = train(&mut trainer, 60);
        assert!(losses[50..].iter().sum::<f32>() < losses[..10].iter().sum::<f32>(), "{method:?} {losses:?}");
    }
}

#[test]
fn damaged_and_foreign_snapshots_and_data_are_refused() {
    let dataset = wall();
    let mut trainer = AnchorTrainer::new(&dataset, config(Method::LcdAnchors), engine(1)).unwrap();
    train(&mut trainer, 3);
    let snapshot = trainer.snapshot().unwrap();
    let refused = |dataset: &Dataset, change: &dyn Fn(&mut AnchorSnapshot)| {
        let mut changed = snapshot.clone();
        change(&mut changed);
        AnchorTrainer::resume(dataset, changed, engine(1)).err().unwrap().to_string()
    };
    let other = Dataset { fingerprint: "4567".to_owned(), ..wall() };
    assert!(refused(&other, &|_| ()).contains("4567"));
    let last = snapshot.arrays.len() - 1;
    assert!(refused(&dataset, &|snapshot| snapshot.arrays.truncate(last)).contains("no array"));
    assert!(refused(&dataset, &|snapshot| snapshot.arrays[1].values.truncate(7)).contains("expected"));
    assert!(refused(&dataset, &|snapshot| snapshot.arrays[2].values[7] = f32::NAN).contains("not finite"));
    assert!(refused(&dataset, &|snapshot| snapshot.state_json.clear()).contains("state"));
    assert!(refused(&dataset, &|snapshot| snapshot.color_model = luxel_core::ColorModel::LogSh { degree: 0 }).contains("lcd"));
    let of = |config: TrainConfig| AnchorTrainer::new(&dataset, config, engine(1)).err().unwrap().to_string();
    assert!(of(TrainConfig { method: Method::Lcd, ..config(Method::Lcd) }).contains("trains no anchors"));
    assert!(of(config(Method::GaussHdrAnchors)).contains("expected a captured image"));
    assert!(of(TrainConfig { batch: 2, ..config(Method::LcdAnchors) }).contains("batch"));
    assert!(of(TrainConfig { refine_poses: true, ..config(Method::LcdAnchors) }).contains("refine_poses"));
    let no_views = AnchorTrainer::new(&dataset_of(Vec::new()), config(Method::LcdAnchors), engine(1));
    assert!(matches!(no_views.err(), Some(TrainError::NoTrainViews)));
}
