//! A field learns a room, with equal bits for any number of threads, and resumed or not.

use glam::{DAffine3, DVec2, DVec3};
use luxel_core::tone::mu_law;
use luxel_core::{
    Camera, CameraProjection, ColorSpace, Dataset, Distortion, Image, Mask, PixelValues, Point, RadianceScale, Similarity, Target, View,
};

use crate::field::{Field, FieldConfig, FieldError, FieldNetwork, FieldTrainer, GridShape, Objective, PixelLoss};

const SIDE_PX: u32 = 32;

/// Radiance of the walls of the cube [-1, 1]^3 at a point: soft stripes, and a lamp on one wall.
fn wall(p: DVec3) -> [f32; 3] {
    let is_lamp = p.y < -0.99 && p.x.abs() < 0.3 && p.z.abs() < 0.3;
    let stripes = |phase: f64| (0.3 + 0.2 * (4.0 * (p.x + p.y + p.z) + phase).sin()) as f32;
    if is_lamp { [20.0, 18.0, 15.0] } else { [stripes(0.0), stripes(1.0), stripes(2.0)] }
}

fn camera(eye: DVec3, toward: DVec3) -> Camera {
    let forward = toward.normalize();
    let right = forward.cross(DVec3::new(0.1, 1.0, 0.2)).normalize();
    let down = forward.cross(right);
    let world_from_camera = DAffine3 { matrix3: glam::DMat3::from_cols(right, down, forward), translation: eye };
    Camera {
        camera_from_world: world_from_camera.inverse(),
        focal_px: DVec2::splat(f64::from(SIDE_PX) * 0.6),
        center_px: DVec2::splat(f64::from(SIDE_PX) / 2.0),
        size_px: [SIDE_PX; 2],
        distortion: Distortion::default(),
        projection: CameraProjection::Pinhole,
    }
}

fn view(number: usize, eye: DVec3, toward: DVec3) -> View {
    let camera = camera(eye, toward);
    let pixel = |i: u32| {
        let at = DVec2::new(f64::from(i % SIDE_PX) + 0.5, f64::from(i / SIDE_PX) + 0.5);
        let d = camera.camera_from_world.matrix3.transpose() * camera.unproject(at).unwrap();
        let distances = (0..3).map(|axis| (d[axis].signum() - eye[axis]) / d[axis]);
        wall(eye + d * distances.fold(f64::INFINITY, f64::min))
    };
    let pixels = (0..SIDE_PX * SIDE_PX).map(pixel).collect();
    let image = Image::from_pixels(SIDE_PX as usize, SIDE_PX as usize, pixels).unwrap();
    let (values, target) = (PixelValues::Radiance, Target::default());
    View { name: format!("{number:03}"), camera, image: image.into(), values, noise: None, mask: None, recordings: Vec::new(), target }
}

/// A room seen in 12 directions from 4 places each, with points on its walls.
fn room() -> Dataset {
    let around: Vec<DVec3> = luxel_core::sh::lattice(12).into_iter().map(|d| DVec3::from_array(d.map(f64::from))).collect();
    let train = (0..48).map(|i| view(i, 0.4 * around[(5 * i + i / 12) % 12], around[i % 12])).collect();
    let test = vec![view(99, DVec3::new(0.1, 0.05, -0.1), DVec3::new(0.5, -0.8, 0.3))];
    let points = luxel_core::sh::lattice(200).into_iter().map(|d| {
        let longest = d.iter().fold(0f32, |longest, c| longest.max(c.abs()));
        Point { position: d.map(|c| c / longest), rgb8: None, observations: Vec::new() }
    });
    Dataset {
        format: "synthetic".into(),
        train,
        test,
        points: points.collect(),
        color_space: ColorSpace::default(),
        bad_pixels: Vec::new(),
        fingerprint: String::new(),
        warnings: Vec::new(),
        world_from_local: Similarity::IDENTITY,
        metres_per_unit: None,
        is_developed: false,
        readers: 1,
    }
}

const CAPTURED: Objective = Objective::Captured { unit_value: 0.5 };
const PAIRS: Objective = Objective::Pairs { captured_weight: 1.0, radiance_weight: 0.6 };

/// Returns the values that a camera records: `0.5 x^(1/2.2)`, with white.
fn recorded(view: &View, exposure_s: f32) -> View {
    let value = |x: f32| (0.5 * (x * exposure_s).powf(1.0 / 2.2)).min(1.0);
    let pixels = view.image.pixels.iter().map(|pixel| pixel.map(value)).collect();
    let image = Image::from_pixels(view.image.width, view.image.height, pixels).unwrap();
    View { image: image.into(), values: PixelValues::Recorded { exposure_s }, ..view.clone() }
}

/// The room in captured images of three exposures, one of each pose; test views are radiance.
fn captured_room() -> Dataset {
    let mut dataset = room();
    dataset.train = dataset.train.iter().enumerate().map(|(i, view)| recorded(view, [0.1, 1.0, 8.0][i % 3])).collect();
    dataset
}

/// The room with captured images of one exposure beside the radiance.
fn room_of_pairs() -> Dataset {
    let mut dataset = room();
    for view in &mut dataset.train {
        view.recordings = vec![recorded(view, 1.0)];
    }
    dataset
}

fn options(iterations: u32) -> FieldConfig {
    FieldConfig {
        iterations,
        seed: 1,
        objective: Objective::Radiance { loss: PixelLoss::Mulaw },
        mu: 5000.0,
        radiance_scale: RadianceScale::ONE,
        network: FieldNetwork::Grid(GridShape { levels: 8, log2_entries: 12, coarsest: 8, finest: 128 }),
    }
}

fn psnr(field: &Field, view: &View) -> f64 {
    let render = field.render(&view.camera, [0.0; 3], 1).image;
    let pairs = render.pixels.iter().flatten().zip(view.image.pixels.iter().flatten());
    let error: f64 = pairs.map(|(a, b)| f64::from(mu_law(*a, 5000.0) - mu_law(*b, 5000.0)).powi(2)).sum();
    -10.0 * (error / f64::from(3 * SIDE_PX * SIDE_PX)).log10()
}

fn mean(losses: &[f32]) -> f32 {
    losses.iter().sum::<f32>() / losses.len() as f32
}

#[test]
fn a_field_learns_a_room() {
    let dataset = room();
    let mut trainer = FieldTrainer::new(&dataset, options(400), 2).unwrap();
    let before = psnr(trainer.field(), &dataset.test[0]);
    while !trainer.is_finished() {
        trainer.step().unwrap();
    }
    let after = psnr(trainer.field(), &dataset.test[0]);
    // A constant image of the mean is at 21 dB or below.
    assert!(before < 20.0 && after > 25.0, "{before} {after}");
    assert!(trainer.field().occupied_part() < 0.9, "{}", trainer.field().occupied_part());
    let layers = trainer.field().render(&dataset.test[0].camera, [0.0; 3], 1);
    let part =
        |is_right: &dyn Fn(usize) -> bool| (0..layers.alpha.len()).filter(|i| is_right(*i)).count() as f64 / layers.alpha.len() as f64;
    assert!(part(&|i| layers.alpha[i] > 0.9) > 0.95, "the room is closed");
    assert!(part(&|i| (0.6..1.8).contains(&layers.depth[i])) > 0.9, "the walls are where they are");
}

#[track_caller]
fn check_bits(dataset: &Dataset, options: FieldConfig) {
    let finish = |mut trainer: FieldTrainer| {
        while !trainer.is_finished() {
            trainer.step().unwrap();
        }
        trainer.snapshot()
    };
    let unbroken = finish(FieldTrainer::new(dataset, options, 1).unwrap());
    assert_eq!(finish(FieldTrainer::new(dataset, options, 3).unwrap()), unbroken);
    let mut first = FieldTrainer::new(dataset, options, 2).unwrap();
    for _ in 0..options.iterations / 2 + 1 {
        first.step().unwrap();
    }
    assert_eq!(finish(FieldTrainer::resume(dataset, first.snapshot(), 1).unwrap()), unbroken);
    // The state of one objective is not that of another.
    let mut other = unbroken;
    other.state.options.objective = match options.objective {
        Objective::Radiance { .. } => CAPTURED,
        Objective::Captured { .. } | Objective::Pairs { .. } => Objective::Radiance { loss: PixelLoss::Mulaw },
    };
    assert!(FieldTrainer::resume(dataset, other, 1).is_err());
}

#[test]
fn threads_and_interruptions_change_no_bit() {
    check_bits(&room(), options(40));
    check_bits(&captured_room(), FieldConfig { objective: CAPTURED, ..options(8) });
    check_bits(&room_of_pairs(), FieldConfig { objective: PAIRS, ..options(8) });
    let network = FieldNetwork::Layers { layers: 4, units: 16 };
    check_bits(&room(), FieldConfig { network, ..options(4) });
}

#[test]
fn a_field_learns_radiance_and_response_of_captured_images() {
    let dataset = captured_room();
    let mut trainer = FieldTrainer::new(&dataset, FieldConfig { objective: CAPTURED, ..options(240) }, 2).unwrap();
    let mut losses = Vec::new();
    while !trainer.is_finished() {
        losses.push(trainer.step().unwrap().loss);
    }
    assert!(mean(&losses[200..]) < 0.3 * mean(&losses[..40]), "{} {}", mean(&losses[..40]), mean(&losses[200..]));
    let knots = trainer.field().response().unwrap();
    for (k, value) in knots[1].iter().enumerate().step_by(3) {
        let x = luxel_core::response::exposure_of_knot(k);
        let expected = (0.5 * x.powf(1.0 / 2.2)).min(1.0) as f32;
        // What is recorded lies between.
        assert!(!(0.05..2.0).contains(&x) || (value - expected).abs() < 0.1, "{x}: {value} {expected}");
    }
    assert_eq!(FieldTrainer::new(&room(), options(1), 1).unwrap().field().response(), None);
}

#[test]
fn a_field_learns_pairs() {
    let dataset = room_of_pairs();
    let mut trainer = FieldTrainer::new(&dataset, FieldConfig { objective: PAIRS, ..options(240) }, 2).unwrap();
    let before = psnr(trainer.field(), &dataset.test[0]);
    let mut losses = Vec::new();
    while !trainer.is_finished() {
        losses.push(trainer.step().unwrap().loss);
    }
    // At the published rate the lifts need thousands of steps; these show the way.
    assert!(mean(&losses[200..]) < 0.85 * mean(&losses[..40]), "{} {}", mean(&losses[..40]), mean(&losses[200..]));
    let after = psnr(trainer.field(), &dataset.test[0]);
    assert!(after > before + 0.5, "{before} {after}");
}

#[test]
fn a_deep_network_learns_a_room() {
    let dataset = room();
    let network = FieldNetwork::Layers { layers: 4, units: 32 };
    let mut trainer = FieldTrainer::new(&dataset, FieldConfig { network, ..options(300) }, 2).unwrap();
    let mut losses = Vec::new();
    while !trainer.is_finished() {
        losses.push(trainer.step().unwrap().loss);
    }
    // At the published rate a network needs thousands of steps; these show the way.
    assert!(mean(&losses[260..]) < 0.85 * mean(&losses[..40]), "{} {}", mean(&losses[..40]), mean(&losses[260..]));
    assert_eq!(Field::from_arrays(trainer.field().shape(), trainer.field().arrays()).unwrap(), *trainer.field());
}

#[test]
fn views_of_other_values_are_refused_by_name() {
    let refused = |dataset: &Dataset, objective, parts: [&str; 3]| {
        let error = FieldTrainer::new(dataset, FieldConfig { objective, ..options(1) }, 1).err().unwrap().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    };
    refused(&captured_room(), options(1).objective, ["view 000", "holds a captured LDR image", "expected radiance"]);
    refused(&room(), CAPTURED, ["view 000", "holds radiance", "expected a captured LDR image"]);
    refused(&room(), PAIRS, ["view 000", "without a captured LDR image", "expected radiance with one"]);
    let mut several = room_of_pairs();
    let more = recorded(&several.train[3], 2.0);
    several.train[3].recordings.push(more);
    refused(&several, PAIRS, ["view 003", "several captured LDR images", "with one"]);
}

#[test]
fn more_samples_a_pixel_are_a_mean_of_rays() {
    let dataset = room();
    let field = FieldTrainer::new(&dataset, options(1), 1).unwrap().field().clone();
    let camera = &dataset.test[0].camera;
    let (one, two) = (field.render(camera, [1.0; 3], 1), field.render(camera, [1.0; 3], 2));
    assert_eq!((two.image.width, two.alpha.len(), two.depth.len()), (one.image.width, one.alpha.len(), one.depth.len()));
    assert!(one.image.pixels.iter().zip(&two.image.pixels).all(|(a, b)| (a[0] - b[0]).abs() < 0.2));
}

#[test]
fn masked_pixels_teach_nothing() {
    let mut dataset = room();
    dataset.train.truncate(1);
    let view = &mut dataset.train[0];
    view.mask = Some(Mask::from_valid(vec![false; view.image.pixels.len()]).into());
    assert_eq!(FieldTrainer::new(&dataset, options(1), 1).err(), Some(FieldError::NoPixels));
    dataset.train.clear();
    assert_eq!(FieldTrainer::new(&dataset, options(1), 1).err(), Some(FieldError::NoTrainViews));
}

#[test]
fn arrays_that_are_no_field_are_errors() {
    let field = FieldTrainer::new(&room(), options(1), 1).unwrap().field().clone();
    assert_eq!(Field::from_arrays(field.shape(), field.arrays()).unwrap(), field);
    let mut arrays = field.arrays();
    arrays.table.pop();
    assert!(matches!(Field::from_arrays(field.shape(), arrays), Err(FieldError::Arrays(_))));
    let mut arrays = field.arrays();
    arrays.weights[3] = f32::NAN;
    assert!(Field::from_arrays(field.shape(), arrays).unwrap_err().to_string().contains("number 3 is NaN"));
    let mut arrays = field.arrays();
    arrays.occupancy[0] = f32::INFINITY;
    assert!(Field::from_arrays(field.shape(), arrays).is_err());
    let mut shape = field.shape();
    shape.network = FieldNetwork::Grid(GridShape { levels: 0, ..GridShape::default() });
    assert!(Field::from_arrays(shape, field.arrays()).is_err());
}
