use super::fade::FacePoint;
use super::*;

/// Returns renders of a world whose radiance is a function of direction.
fn renders(rig: &Rig, radiance: impl Fn(DVec3) -> [f32; 3]) -> Vec<Image> {
    let render = |camera: &Camera| {
        let [width, height] = camera.size_px.map(|side| side as usize);
        let pixel = |i: usize| {
            let px = DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            let slope = (px - camera.center_px) / camera.focal_px;
            let world = camera.camera_from_world.matrix3.transpose() * DVec3::new(slope.x, slope.y, 1.0);
            radiance(world.normalize())
        };
        Image { width, height, pixels: (0..width * height).map(pixel).collect() }
    };
    rig.cameras.iter().map(render).collect()
}

fn map(projection: Projection, width: usize) -> MapSize {
    MapSize { projection, width }
}

/// Returns the weights of all cameras in a direction of the environment.
fn weights(rig: &Rig, direction: DVec3) -> Vec<f64> {
    let of_face = |face: usize| {
        let point = rig.fades.face_point(face, direction);
        (0..OF_FACE).map(move |part| {
            let Some(FacePoint { weight, at }) = &point else { return 0.0 };
            weight * rig.fades.part_weights(at.y)[part / ACROSS] * rig.fades.part_weights(at.x)[part % ACROSS]
        })
    };
    (0..6).flat_map(of_face).collect()
}

#[test]
fn weights_add_up_to_one_within_the_images_of_the_cameras() {
    let rig = Rig::new(DVec3::ZERO, TURN, map(Projection::LatitudeLongitude, 64), Some(50.0));
    let mut shared = 0;
    for direction in crate::sh::lattice(20_000) {
        let direction = DVec3::from_array(direction.map(f64::from));
        let weights = weights(&rig, direction);
        assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{direction}: {weights:?}");
        for (camera, _) in rig.cameras.iter().zip(&weights).filter(|(_, weight)| **weight > 0.0) {
            let (px, _) = camera.project(TURN.transpose() * direction).unwrap();
            let [width, height] = camera.size_px.map(f64::from);
            // Interpolation reads half a pixel around the place.
            assert!(px.x >= 0.5 && px.y >= 0.5 && px.x <= width - 0.5 && px.y <= height - 0.5, "{direction}: {px} {camera:?}");
        }
        shared += usize::from(weights.iter().filter(|weight| **weight > 0.0).count() > 1);
    }
    assert!(shared > 15_000, "{shared}");
}

#[test]
fn weights_have_no_jumps() {
    let rig = Rig::new(DVec3::ZERO, DMat3::IDENTITY, map(Projection::LatitudeLongitude, 64), None);
    // Circles of a tenth of a degree a step, one of them along an edge of the cube.
    for height in [0.0, 0.3, 0.999, 1.0, 2.5] {
        let on_circle = |i: i32| {
            let angle = f64::from(i).to_radians() / 10.0;
            weights(&rig, DVec3::new(angle.sin(), height, angle.cos()))
        };
        for i in 0..3600 {
            let jump = on_circle(i).iter().zip(on_circle(i + 1)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(jump < 0.015, "height {height}, step {i}: {jump}");
        }
    }
}

const TURN: DMat3 = DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z);

#[test]
fn cameras_are_valid_and_narrow() {
    let rig = Rig::new(DVec3::new(1.0, 2.0, 3.0), TURN, map(Projection::LatitudeLongitude, 256), Some(90.0));
    assert_eq!(rig.cameras.len(), 54);
    for camera in &rig.cameras {
        camera.validate().unwrap();
        assert!((camera.eye() - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-9);
        for corner in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]] {
            let size = DVec2::new(camera.size_px[0].into(), camera.size_px[1].into());
            let slope = (size * DVec2::from_array(corner) - camera.center_px) / camera.focal_px;
            assert!(slope.length().atan().to_degrees() < 38.0, "{}", slope.length().atan().to_degrees());
        }
    }
}

#[test]
fn directions_come_out_where_they_belong() {
    // Radiance equals the direction, in world axes.
    let smooth = |d: DVec3| [0, 1, 2].map(|c| (2.0 + d[c]) as f32);
    for projection in [Projection::LatitudeLongitude, Projection::Cube] {
        let rig = Rig::new(DVec3::ZERO, TURN, map(projection, 64), None);
        let image = rig.assemble(&renders(&rig, smooth));
        assert_eq!(image.height, projection.height(64));
        for (i, pixel) in image.pixels.iter().enumerate() {
            let d = projection.direction([(i % 64) as f64 + 0.5, (i / 64) as f64 + 0.5], 64).normalize();
            let world = TURN.transpose() * d;
            let error = (0..3).map(|c| (f64::from(pixel[c]) - 2.0 - world[c]).abs()).fold(0.0, f64::max);
            assert!(error < 6e-3, "{projection:?} pixel {i}: {pixel:?} {world}");
        }
    }
}

#[test]
fn maps_lie_as_openexr_has_them() {
    let near = |a: DVec3, b: DVec3| (a.normalize() - b).length() < 1e-9;
    let at = |x, y| Projection::LatitudeLongitude.direction([x, y], 8);
    assert!(near(at(4.0, 2.0), DVec3::Z) && near(at(2.0, 2.0), DVec3::X) && near(at(0.0, 0.0), DVec3::Y));
    let face = |n: f64| Projection::Cube.direction([4.0, 4.0 + 8.0 * n], 8);
    for (n, axis) in [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z].into_iter().enumerate() {
        assert!(near(face(n as f64), axis));
        let [forward, right, down] = FACES[n];
        assert_eq!(right.cross(down), forward);
    }
}

#[test]
fn irradiance_is_that_of_known_environments() {
    use std::f64::consts::PI;
    for projection in [Projection::LatitudeLongitude, Projection::Cube] {
        let rig = Rig::new(DVec3::ZERO, DMat3::IDENTITY, map(projection, 128), None);
        // Everywhere 1: pi. Above the horizon 1: pi, 0 and pi / 2.
        let sky = |d: DVec3| [1.0, if d.y > 0.0 { 1.0 } else { 0.0 }, (1.0 + d.y) as f32];
        let summary = Summary::new(&rig.assemble(&renders(&rig, sky)), projection);
        let expected = [PI, PI, PI, PI, PI, PI];
        for (found, expected) in summary.irradiance.iter().zip(expected) {
            assert!((found[0] - expected).abs() < 2e-3, "{projection:?} {found:?}");
        }
        for (face, expected) in [(0, PI / 2.0), (2, PI), (3, 0.0)] {
            assert!((summary.irradiance[face][1] - expected).abs() < 0.03, "{projection:?} {:?}", summary.irradiance[face]);
        }
        // L = 1 + y: pi + 2 pi / 3 upwards.
        assert!((summary.irradiance[2][2] - (PI + 2.0 * PI / 3.0)).abs() < 3e-3);
        assert!((summary.mean_radiance[0] - 1.0).abs() < 1e-3 && (summary.mean_radiance[1] - 0.5).abs() < 6e-3);
        assert!((summary.peak_radiance - 2.0).abs() < 1e-2 && summary.peak_direction[1] > 0.98);
    }
}
