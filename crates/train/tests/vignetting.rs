//! Vignetting that is learned with the scene: a known fall-off is found, from radiance and from
//! captured values, metrics take it into account, and a resumed run has the bits of an unbroken
//! one.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic as they do")]

mod common;

use common::{SIDE, config, dataset, engine};
use glam::{DAffine3, DMat3, DVec3};
use luxel_core::random::standard_normal;
use luxel_core::{
    Camera, CameraProjection, ColorModel, Dataset, Engine, PixelValues, Point, RenderOptions, Splat, Splats, View, Vignetting, logit,
};
use luxel_metrics::{GainFit, Measures, SplitMetrics, evaluate};
use luxel_train::{ExposureCompensation, LensVignetting, TrainConfig, TrainError, Trainer};

/// A lens that loses more than a stop in the corners.
const TRUTH: Vignetting = Vignetting { axis_px: [SIDE as f32 / 2.0; 2], unit_px: 33.941_126, log_gain: [0.0, -0.3, -0.7, 0.1] };

fn base(iterations: u32) -> TrainConfig {
    TrainConfig { max_splats: Some(800), densify_interval: Some(50), vignetting: true, ..config(iterations) }
}

/// A camera in front of the wall.
fn camera(x: f64, y: f64) -> Camera {
    let camera_from_world = DAffine3 { matrix3: DMat3::IDENTITY, translation: -DVec3::new(x, y, -4.0) };
    Camera { camera_from_world, ..common::camera(DVec3::NEG_Z) }
}

/// A wall of blobs that fills all images, seen from nine places and, for the test, between them.
fn wall() -> Dataset {
    let mut splats = Splats::empty(ColorModel::Sh { degree: 0 });
    for i in 0..256u32 {
        let at = [i % 16, i / 16].map(|c| 0.42 * (c as f32 - 7.5));
        let shade = 0.02 + 0.5 * ((i * 37 % 11) as f32 / 10.0).powi(2);
        let (dc, _) = splats.color_model.constant([shade, shade * 0.7, shade * (0.4 + 0.6 * (i % 2) as f32)]);
        splats.push(&Splat {
            position: [at[0], at[1], 0.4 * ((i * 7 % 5) as f32 / 4.0)],
            rotation: [1.0, 0.0, 0.0, 0.0],
            log_scale: [0.24f32.ln(); 3],
            opacity_logit: logit(0.9),
            sh: &dc,
            raw_luminance: &[],
        });
    }
    let mut engine = engine();
    engine.load(&splats, None).unwrap();
    let mut data = dataset();
    let blank = data.test[0].clone();
    let mut view = |name: String, camera: Camera| {
        let image = engine.render(&camera, &RenderOptions::default()).unwrap().into();
        View { name, camera, image, ..blank.clone() }
    };
    let place = |i: usize| [i % 3, i / 3].map(|c| 0.9 * (c as f64 - 1.0));
    data.train = (0..9).map(|i| view(format!("train/{i}"), camera(place(i)[0], place(i)[1]))).collect();
    data.test = vec![view("test/0".to_owned(), camera(0.4, 0.5))];
    let moved = |i: usize, p: &[f32; 3]| std::array::from_fn(|c| p[c] + 0.03 * standard_normal(9, i as u64)[c]);
    let points = splats.position.iter().enumerate();
    data.points = points.map(|(i, p)| Point { position: moved(i, p), rgb8: None, observations: Vec::new() }).collect();
    data
}

/// The wall through that lens; the test view stays as it is.
fn darkened() -> Dataset {
    let mut data = wall();
    for view in &mut data.train {
        let mut image = luxel_core::Image::clone(&view.image);
        TRUTH.apply(&mut image);
        view.image = image.into();
    }
    data
}

fn trained(data: &Dataset, config: TrainConfig) -> Trainer {
    let mut trainer = Trainer::new(data, config, engine()).unwrap();
    while !trainer.is_finished() {
        trainer.step().unwrap();
    }
    trainer
}

/// Returns the root mean square difference of two ln gains over the frame, without that of their
/// means, and the mean of the first.
fn difference(found: &Vignetting, truth: &Vignetting) -> [f64; 2] {
    let places = (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| [x as f32 + 0.5, y as f32 + 0.5]));
    let pairs: Vec<[f64; 2]> = places.map(|at| [found, truth].map(|vignetting| f64::from(vignetting.gain(at).ln()))).collect();
    let mean = |of: &dyn Fn(&[f64; 2]) -> f64| pairs.iter().map(of).sum::<f64>() / pairs.len() as f64;
    let offset = mean(&|pair| pair[0] - pair[1]);
    [mean(&|pair| (pair[0] - pair[1] - offset).powi(2)).sqrt(), mean(&|pair| pair[0])]
}

fn found(trainer: &Trainer, camera: &Camera) -> (LensVignetting, Vignetting) {
    let [lens] = <[LensVignetting; 1]>::try_from(trainer.vignetting().unwrap()).expect("one lens");
    let vignetting = lens.of_camera(camera).unwrap();
    (lens, vignetting)
}

fn metrics(trainer: &mut Trainer, views: &[View], gain_fit: GainFit<'_>) -> SplitMetrics {
    let (options, measures) = (trainer.render_options(), Measures::new(trainer.radiance_scale(), trainer.config().mu));
    evaluate(trainer.engine(), &options, &Measures { gain_fit, ..measures }, views, &mut |_, _, _| ()).unwrap()
}

#[test]
fn a_known_fall_off_is_found_and_leaves_the_scene() {
    let data = darkened();
    let mut with = trained(&data, base(700));
    let (lens, vignetting) = found(&with, &data.train[0].camera);
    let [error, mean] = difference(&vignetting, &TRUTH);
    println!("ln gain is {error:.4} off, its mean {mean:.1e}; {:.3} EV in the corners", lens.corner_ev);
    assert!(error < 0.015 && mean.abs() < 2e-3, "{error} {mean}");
    assert!((lens.corner_ev + 0.9 / std::f64::consts::LN_2).abs() < 0.1 && lens.views == 9, "{lens:?}");

    let mut without = trained(&data, TrainConfig { vignetting: false, ..base(700) });
    assert_eq!(without.vignetting(), None);
    // The gauge leaves one factor of brightness.
    let [better, worse] = [&mut with, &mut without].map(|trainer| metrics(trainer, &data.test, GainFit::Common).mean.psnr_scene);
    println!("{worse:.2} dB without, {better:.2} dB with");
    assert!(better > worse + 5.0, "{worse} {better}");

    // Images through the lens are compared through it.
    let mut seen = data.train.clone();
    let plain = metrics(&mut with, &seen, GainFit::None).mean.psnr_scene;
    LensVignetting::show_in(&[lens], &data.train, &mut seen);
    let through = metrics(&mut with, &seen, GainFit::None).mean.psnr_scene;
    println!("{plain:.2} dB, through the lens {through:.2} dB");
    assert!(through > plain + 8.0, "{plain} {through}");
}

#[test]
fn images_without_a_fall_off_get_none_at_any_resolution() {
    let data = wall();
    let trainer = trained(&data, TrainConfig { resolution_schedule: "2@0,1@150".parse().unwrap(), ..base(400) });
    let (lens, vignetting) = found(&trainer, &data.train[0].camera);
    let none = Vignetting { log_gain: [0.0; 4], ..TRUTH };
    let [error, _] = difference(&vignetting, &none);
    println!("{error:.4}, {:.3} EV in the corners", lens.corner_ev);
    assert!(error < 0.015, "{error}");
}

#[test]
fn a_fall_off_is_found_beside_a_camera_response() {
    let mut data = darkened();
    let record = |view: &View, k: i32| {
        let exposure_s = 4f32.powi(k) * 4.0;
        let value = |p: f32| (p * exposure_s / (p * exposure_s + 1.0)).powf(1.0 / 2.2);
        let code = |p: f32| (value(p).clamp(0.0, 1.0) * 255.0).round() / 255.0;
        let pixels = view.image.pixels.iter().map(|rgb| rgb.map(code)).collect();
        let image = luxel_core::Image::from_pixels(view.image.width, view.image.height, pixels).unwrap().into();
        View { name: format!("{}_{k}", view.name), image, values: PixelValues::Recorded { exposure_s }, ..view.clone() }
    };
    data.train = data.train.iter().flat_map(|view| [-1, 0, 1].map(|k| record(view, k))).collect();
    // Blobs that are all alike give stereo wrong points.
    let trainer = trained(&data, TrainConfig { unit_exposure: 0.5f32.powf(1.0 / 2.2), stereo_points: Some(0), ..base(900) });
    let (lens, vignetting) = found(&trainer, &data.train[0].camera);
    let [error, _] = difference(&vignetting, &TRUTH);
    println!("ln gain is {error:.4} off; {:.3} EV in the corners", lens.corner_ev);
    assert!(error < 0.015, "{error}");
}

#[test]
fn until_vignetting_begins_a_run_is_that_without() {
    let data = darkened();
    let after = |vignetting, steps| {
        let mut trainer = Trainer::new(&data, TrainConfig { vignetting, ..base(200) }, engine()).unwrap();
        (0..steps).for_each(|_| _ = trainer.step().unwrap());
        trainer.scene().unwrap()
    };
    assert_eq!(after(true, 19), after(false, 19));
    assert_ne!(after(true, 24), after(false, 24));
}

#[test]
fn a_resumed_run_has_the_bits_of_an_unbroken_one() {
    let data = darkened();
    let config = TrainConfig { exposure_compensation: ExposureCompensation::Exposure, refine_poses: true, ..base(120) };
    let run = |trainer: &mut Trainer, steps| (0..steps).for_each(|_| _ = trainer.step().unwrap());
    let mut whole = Trainer::new(&data, config.clone(), engine()).unwrap();
    run(&mut whole, 120);
    let mut first = Trainer::new(&data, config, engine()).unwrap();
    run(&mut first, 70);
    let mut second = Trainer::resume(&data, first.snapshot().unwrap(), engine()).unwrap();
    run(&mut second, 50);
    let mut snapshot = second.snapshot().unwrap();
    assert_eq!(snapshot, whole.snapshot().unwrap());
    assert_eq!(second.vignetting(), whole.vignetting());
    assert_eq!(luxel_train::snapshot_vignetting(&snapshot, &data).unwrap(), whole.vignetting().unwrap());
    assert!(whole.vignetting().unwrap()[0].corner_ev < -0.01);
    // A state without the vignetting that its configuration needs is refused.
    let start = snapshot.state_json.find("\"vignetting\":[").unwrap();
    let length = snapshot.state_json[start..].find("}],").unwrap() + 3;
    snapshot.state_json.replace_range(start..start + length, "");
    let error = Trainer::resume(&data, snapshot, engine()).err().unwrap();
    assert!(matches!(&error, TrainError::State(text) if text.contains("vignetting of the lenses") && text.ends_with("missing")), "{error}");
}

#[test]
fn panoramas_are_refused() {
    let mut data = dataset();
    data.train[3].camera = Camera::panorama(data.train[3].camera.camera_from_world, SIDE);
    data.train[3].image = luxel_core::Image::filled(SIDE as usize, SIDE as usize / 2, [0.1; 3]).into();
    assert_eq!(data.train[3].camera.projection, CameraProjection::Equirectangular);
    let error = Trainer::new(&data, base(60), engine()).err().unwrap().to_string();
    assert!(error.starts_with("vignetting") && error.contains("train/3 is a panorama"), "{error}");
}
