use glam::DVec2;
use luxel_core::{Image, PixelValues, Target};

use super::*;

/// A data set of cameras at `eyes` that look at `target`, with y up.
fn dataset(eyes: &[DVec3], target: DVec3) -> Dataset {
    let poses: Vec<DAffine3> = eyes.iter().map(|eye| looking_at(*eye, target, DVec3::Y)).collect();
    posed(&poses)
}

fn posed(poses: &[DAffine3]) -> Dataset {
    let view = |(i, pose): (usize, &DAffine3)| View {
        name: format!("images/{i:03}"),
        camera: Camera {
            camera_from_world: *pose,
            focal_px: DVec2::new(40.0, 41.0),
            center_px: DVec2::new(17.0, 11.0),
            size_px: [32, 24],
            distortion: Distortion::default(),
            projection: CameraProjection::Pinhole,
        },
        image: Image::filled(32, 24, [1.0; 3]).into(),
        values: PixelValues::Radiance,
        noise: None,
        mask: None,
        recordings: Vec::new(),
        target: Target::default(),
    };
    Dataset {
        format: String::new(),
        train: poses.iter().enumerate().map(view).collect(),
        test: Vec::new(),
        points: Vec::new(),
        color_space: luxel_core::ColorSpace::default(),
        bad_pixels: Vec::new(),
        fingerprint: String::new(),
        warnings: Vec::new(),
        world_from_local: luxel_core::Similarity::IDENTITY,
        metres_per_unit: None,
        is_developed: false,
        readers: 2,
    }
}

/// Twelve eyes at distance 3 and height 1 around a target, from `degrees` of the circle.
fn ring(target: DVec3, degrees: f64) -> Vec<DVec3> {
    let eye = |i: usize| {
        let angle = degrees.to_radians() * i as f64 / 12.0;
        target + DVec3::new(3.0 * angle.cos(), 1.0, 3.0 * angle.sin())
    };
    (0..12).map(eye).collect()
}

fn cameras(dataset: &Dataset, kind: PathKind, frames: usize) -> Vec<Camera> {
    let path = camera_path(dataset, kind, frames).unwrap();
    assert_eq!(path.cameras.len(), frames);
    for (i, named) in path.cameras.iter().enumerate() {
        assert_eq!(named.name, format!("frame_{i:05}"));
        assert_eq!(named.camera.validate(), Ok(()));
        assert_eq!((named.camera.center_px, named.camera.size_px), (DVec2::new(16.0, 12.0), [32, 24]));
    }
    path.cameras.into_iter().map(|named| named.camera).collect()
}

/// Returns whether the camera has the point in the middle of its image, upright.
fn looks_at(camera: &Camera, point: DVec3) -> bool {
    let (pixel, _) = camera.project(point).unwrap();
    (pixel - camera.center_px).length() < 1e-6 && camera.camera_from_world.matrix3.row(1).y < 0.0
}

const TARGET: DVec3 = DVec3::new(100.0, -20.0, 7.0);

#[test]
fn an_orbit_of_a_surrounded_scene_is_a_closed_circle() {
    let found = cameras(&dataset(&ring(TARGET, 360.0), TARGET), PathKind::Orbit, 36);
    for camera in &found {
        let offset = camera.eye() - TARGET;
        assert!((offset.y - 1.0).abs() < 1e-6 && (DVec2::new(offset.x, offset.z).length() - 3.0).abs() < 1e-6, "{offset}");
        assert!(looks_at(camera, TARGET));
    }
    // Steps are equal, from the last to the first too.
    let steps: Vec<f64> = (0..36).map(|i| (found[(i + 1) % 36].eye() - found[i].eye()).length()).collect();
    assert!(steps.iter().all(|step| (step - steps[0]).abs() < 1e-9 && *step > 0.1), "{steps:?}");
}

#[test]
fn an_orbit_stays_on_the_side_that_was_captured() {
    let eyes = ring(TARGET, 90.0);
    let found = cameras(&dataset(&eyes, TARGET), PathKind::Orbit, 60);
    let angle = |eye: DVec3| (eye.z - TARGET.z).atan2(eye.x - TARGET.x).to_degrees();
    let (low, high) = (angle(eyes[0]), angle(eyes[11]));
    let angles: Vec<f64> = found.iter().map(|camera| angle(camera.eye())).collect();
    assert!(angles.iter().all(|a| (low - 1e-6..=high + 1e-6).contains(a)), "{angles:?}");
    assert!(angles.iter().any(|a| *a < low + 1.0) && angles.iter().any(|a| *a > high - 1.0), "{angles:?}");
    assert!(found.iter().all(|camera| looks_at(camera, TARGET)));
    // Captured from either side of the turn's seam.
    let seam: Vec<DVec3> = ring(TARGET, 90.0).iter().map(|eye| TARGET + (*eye - TARGET) * DVec3::new(-1.0, 1.0, 1.0)).collect();
    let across = cameras(&dataset(&[&seam[..], &[TARGET + DVec3::new(-3.0, 1.0, -1.0)]].concat(), TARGET), PathKind::Orbit, 60);
    assert!(across.iter().all(|camera| camera.eye().x < TARGET.x + 0.1), "the far side");
}

#[test]
fn a_spiral_stays_within_the_cameras_and_closes() {
    let eyes: Vec<DVec3> = (0..25).map(|i| DVec3::new(f64::from(i % 5) - 2.0, f64::from(i / 5) - 2.0, 0.0)).collect();
    let target = DVec3::new(0.0, 0.0, 8.0);
    let found = cameras(&dataset(&eyes, target), PathKind::Spiral, 40);
    for camera in &found {
        let eye = camera.eye();
        assert!(eye.x.abs() <= 2.0 && eye.y.abs() <= 2.0 && looks_at(camera, target), "{eye}");
    }
    assert!(found.iter().any(|camera| camera.eye().x > 0.5) && found.iter().any(|camera| camera.eye().y < -0.5));
    let step = |a: usize, b: usize| (found[b].eye() - found[a].eye()).length();
    assert!(step(39, 0) < 2.0 * step(0, 1), "{} {}", step(39, 0), step(0, 1));
    // Cameras back to back have no common direction.
    let out: Vec<DAffine3> = ring(DVec3::ZERO, 360.0).iter().map(|eye| looking_at(*eye, 2.0 * *eye, DVec3::Y)).collect();
    assert!(camera_path(&posed(&out), PathKind::Spiral, 9).unwrap_err().to_string().contains("choose orbit or between-views"));
}

#[test]
fn a_path_between_views_passes_through_all_of_them() {
    let eyes = ring(TARGET, 200.0);
    let data = dataset(&eyes, TARGET);
    let found = cameras(&data, PathKind::BetweenViews, 400);
    for view in &data.train {
        let nearest = found.iter().min_by(|a, b| {
            let distance = |camera: &Camera| (camera.eye() - view.camera.eye()).length();
            distance(a).total_cmp(&distance(b))
        });
        let nearest = nearest.unwrap();
        assert!((nearest.eye() - view.camera.eye()).length() < 0.03);
        assert!(nearest.forward().dot(view.camera.forward()) > 0.999);
    }
    assert!((found[0].eye() - eyes[0]).length() < 1e-9 && (found[399].eye() - eyes[11]).length() < 1e-9);
    // Even speed: no step is more than a fifth longer than another.
    let steps: Vec<f64> = found.windows(2).map(|pair| (pair[1].eye() - pair[0].eye()).length()).collect();
    let [least, most] = [steps.iter().copied().fold(f64::INFINITY, f64::min), steps.iter().copied().fold(0.0, f64::max)];
    assert!(most < 1.2 * least, "{least} {most}");
    // Views in random order are visited by their places.
    let shuffled: Vec<DVec3> = (0..12).map(|i| eyes[i * 5 % 12]).collect();
    let path = camera_path(&dataset(&shuffled, TARGET), PathKind::BetweenViews, 50).unwrap();
    assert!(path.description.contains("nearest neighbour"), "{}", path.description);
    assert!(camera_path(&dataset(&eyes[..1], TARGET), PathKind::BetweenViews, 5).unwrap_err().to_string().contains("needs two"));
    assert!(camera_path(&posed(&[]), PathKind::Orbit, 5).unwrap_err().to_string().contains("no views"));
}

#[test]
fn a_single_camera_and_parallel_ones_have_paths_too() {
    let one = posed(&[DAffine3::IDENTITY]);
    for kind in [PathKind::Orbit, PathKind::Spiral] {
        assert_eq!(camera_path(&one, kind, 7).unwrap().cameras.len(), 7);
    }
    let parallel: Vec<DAffine3> = (0..5).map(|i| DAffine3::from_translation(DVec3::new(f64::from(i), 0.0, 0.0))).collect();
    let path = camera_path(&posed(&parallel), PathKind::Orbit, 20).unwrap();
    assert!(path.cameras.iter().all(|named| named.camera.validate().is_ok() && named.camera.forward().z > 0.5));
}

#[test]
fn another_size_keeps_the_field_of_view_of_one_side() {
    let camera = posed(&[DAffine3::IDENTITY]).train[0].camera.clone();
    let wide = resized(&camera, [64, 36]);
    assert_eq!((wide.camera.focal_px, wide.camera.size_px, wide.cropped), (DVec2::new(80.0, 82.0), [64, 36], [0.0, 0.25]));
    // The ray of the principal point, and of the left edge, stay.
    assert_eq!(wide.camera.center_px, DVec2::new(34.0, 22.0 - 6.0));
    let tall = resized(&camera, [16, 24]);
    assert_eq!((tall.camera.focal_px, tall.cropped), (DVec2::new(40.0, 41.0), [0.5, 0.0]));
    assert_eq!(resized(&camera, [32, 24]), Resized { camera, cropped: [0.0, 0.0] });
}
