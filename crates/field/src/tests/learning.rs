//! A field learns a room, with equal bits for any number of threads, and resumed or not.

use glam::{DAffine3, DVec2, DVec3};
use luxel_core::tone::mu_law;
use luxel_core::{
    Camera, CameraProjection, ColorSpace, Dataset, Distortion, Image, Mask, PixelValues, Point, RadianceScale, Similarity, Target, View,
};

use crate::{Field, FieldConfig, FieldError, FieldTrainer, GridShape, PixelLoss};

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
        readers: 1,
    }
}

fn options(iterations: u32) -> FieldConfig {
    FieldConfig {
        iterations,
        seed: 1,
        loss: PixelLoss::Mulaw,
        mu: 5000.0,
        radiance_scale: RadianceScale::ONE,
        grid: GridShape { levels: 8, log2_entries: 12, coarsest: 8, finest: 128 },
    }
}

fn psnr(field: &Field, view: &View) -> f64 {
    let render = field.render(&view.camera, [0.0; 3], 1).image;
    let pairs = render.pixels.iter().flatten().zip(view.image.pixels.iter().flatten());
    let error: f64 = pairs.map(|(a, b)| f64::from(mu_law(*a, 5000.0) - mu_law(*b, 5000.0)).powi(2)).sum();
    -10.0 * (error / f64::from(3 * SIDE_PX * SIDE_PX)).log10()
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

#[test]
fn threads_and_interruptions_change_no_bit() {
    let dataset = room();
    let finish = |mut trainer: FieldTrainer| {
        while !trainer.is_finished() {
            trainer.step().unwrap();
        }
        trainer.snapshot()
    };
    let unbroken = finish(FieldTrainer::new(&dataset, options(40), 1).unwrap());
    assert_eq!(finish(FieldTrainer::new(&dataset, options(40), 3).unwrap()), unbroken);
    let mut first = FieldTrainer::new(&dataset, options(40), 2).unwrap();
    for _ in 0..23 {
        first.step().unwrap();
    }
    assert_eq!(finish(FieldTrainer::resume(&dataset, first.snapshot(), 1).unwrap()), unbroken);
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
    shape.grid.levels = 0;
    assert!(Field::from_arrays(shape, field.arrays()).is_err());
}
