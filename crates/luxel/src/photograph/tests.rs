use luxel_core::Splats;
use luxel_cpu::CpuEngine;

use super::*;
use crate::synthetic::{room, room_camera};

fn engine(splats: &Splats) -> CpuEngine {
    let mut engine = CpuEngine::new(1).unwrap();
    engine.load(splats, None).unwrap();
    engine
}

fn lens(diameter: f64, focus_distance: f64) -> Option<Aperture> {
    Some(Aperture { diameter, focus_distance, blades: None })
}

#[test]
fn points_in_the_plane_of_focus_stay_where_they_are() {
    let camera = room_camera([64, 48]);
    let photograph = Photograph { camera: camera.clone(), aperture: lens(0.3, 2.0), motion: None };
    let world = |p: DVec3| camera.camera_from_world.inverse().transform_point3(p);
    let (sharp, near) = (world(DVec3::new(0.3, -0.2, 2.0)), world(DVec3::new(0.0, 0.0, 1.0)));
    let mut widest = 0.0f64;
    for sample in lens_samples(64, None, 0) {
        let moved = photograph.camera_of(sample);
        assert!((moved.project(sharp).unwrap().0 - camera.project(sharp).unwrap().0).length() < 1e-9);
        widest = widest.max((moved.project(near).unwrap().0 - camera.project(near).unwrap().0).length());
    }
    // The circle of confusion: f D |1/z - 1/focus| across.
    let expected = 0.5 * camera.focal_px.x * 0.3 * (1.0 - 0.5);
    assert!(widest < expected && widest > 0.98 * expected, "{widest} of {expected}");
}

#[test]
fn without_aperture_and_motion_it_is_a_plain_render() {
    let scene = room(200, 1);
    let mut engine = engine(&scene.splats);
    let camera = room_camera([32, 24]);
    let options = scene.render_options();
    let plain = engine.render(&camera, &options).unwrap();
    for photograph in [
        Photograph { camera: camera.clone(), aperture: None, motion: None },
        Photograph { camera: camera.clone(), aperture: lens(0.0, 1.0), motion: None },
        Photograph { camera, aperture: None, motion: Some(ShutterMotion { before: None, after: None, open: 0.5 }) },
    ] {
        let taken = photograph.take(&mut engine, &options, Sampling::default(), false).unwrap();
        assert_eq!((&taken.image, taken.quality.samples, taken.quality.error), (&plain, 1, 0.0));
    }
}

#[test]
fn the_error_of_the_default_is_within_what_it_says() {
    let scene = room(3000, 1);
    let mut engine = engine(&scene.splats);
    let photograph = Photograph { camera: room_camera([64, 48]), aperture: lens(0.15, 1.5), motion: None };
    let options = scene.render_options();
    let mut taken = |count| photograph.take(&mut engine, &options, Sampling { count, set: 0 }, true).unwrap();
    let (reference, default) = (taken(Some(1024)), taken(None));
    let rms = |a: &Image, b: &Image| {
        let squares = a.pixels.as_flattened().iter().zip(b.pixels.as_flattened()).map(|(a, b)| f64::from(a - b).powi(2));
        squares.sum::<f64>().sqrt()
    };
    let black = Image { pixels: vec![[0.0; 3]; 64 * 48], ..reference.image.clone() };
    let error = rms(&default.image, &reference.image) / rms(&reference.image, &black);
    assert!(
        error <= default.quality.error && default.quality.error <= TOLERANCE,
        "{error}, stated {}, {} samples",
        default.quality.error,
        default.quality.samples
    );
    assert_eq!(default.alpha.len(), 64 * 48);
}

#[test]
fn the_camera_moves_from_frame_to_frame() {
    let camera = room_camera([64, 48]);
    let shifted = |by: f64, turn: f64| {
        let mut other = camera.clone();
        other.camera_from_world.matrix3 = glam::DMat3::from_rotation_y(turn) * camera.camera_from_world.matrix3;
        other.camera_from_world.translation = -(other.camera_from_world.matrix3 * (camera.eye() + by * DVec3::X));
        other
    };
    let both = ShutterMotion { before: Some(shifted(-1.0, -0.2)), after: Some(shifted(1.0, 0.2)), open: 1.0 };
    let start = ShutterMotion { before: None, ..both.clone() };
    let end = ShutterMotion { after: None, ..both.clone() };
    for moment in [-0.5, -0.1, 0.0, 0.3] {
        let expected = shifted(moment, 0.2 * moment).camera_from_world;
        for motion in [&both, &start, &end] {
            let found = motion.camera_at(&camera, moment).camera_from_world;
            assert!(found.abs_diff_eq(expected, 1e-12), "{moment}: {found:?}, expected {expected:?}");
        }
    }
}

#[test]
fn what_is_no_lens_or_shutter_is_refused_with_a_reason() {
    let camera = room_camera([64, 48]);
    let refused = |camera: &Camera, aperture, motion| {
        let photograph = Photograph { camera: camera.clone(), aperture, motion };
        photograph.check().unwrap_err().to_string()
    };
    assert!(refused(&camera, lens(0.1, -1.0), None).contains("in front of the camera"));
    assert!(refused(&camera, lens(0.1, f64::NAN), None).contains("focus at NaN"));
    assert!(refused(&camera, lens(-0.1, 1.0), None).contains("aperture of -0.1"));
    let two = Some(Aperture { diameter: 0.1, focus_distance: 1.0, blades: Some(2) });
    assert!(refused(&camera, two, None).contains("2 blades, expected 3 to 32"));
    assert!(refused(&camera, None, Some(ShutterMotion { before: None, after: None, open: 1.5 })).contains("open for 1.5"));
    let panorama = Camera::panorama(camera.camera_from_world, 64);
    assert!(refused(&panorama, lens(0.1, 1.0), None).contains("no plane of focus"));
}

#[test]
fn the_mean_of_all_parts_is_the_photograph() {
    let scene = room(200, 1);
    let mut engine = engine(&scene.splats);
    let options = scene.render_options();
    let photograph = Photograph { camera: room_camera([16, 12]), aperture: lens(0.3, 2.0), motion: None };
    let whole = photograph.take(&mut engine, &options, Sampling { count: Some(12), set: 0 }, false).unwrap().image;
    assert_eq!(photograph.take_part(&mut engine, &options, 12, [0, 1]).unwrap(), whole);
    let mut mean = vec![0.0f32; whole.pixels.as_flattened().len()];
    for part in 0..4 {
        let image = photograph.take_part(&mut engine, &options, 12, [part, 4]).unwrap();
        assert_ne!(image, whole);
        mean.iter_mut().zip(image.pixels.as_flattened()).for_each(|(mean, value)| *mean += 0.25 * value);
    }
    // Sums in another order differ by a few roundings.
    for (mean, value) in mean.iter().zip(whole.pixels.as_flattened()) {
        assert!((mean - value).abs() <= 1e-5 * value.abs().max(1e-3), "{mean} for {value}");
    }
    for part in [[4, 4], [12, 20], [0, 0]] {
        assert!(photograph.take_part(&mut engine, &options, 12, part).unwrap_err().to_string().contains("has none"));
    }
}
