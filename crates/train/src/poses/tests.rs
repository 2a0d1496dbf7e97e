use glam::{DVec2, DVec3};
use luxel_core::Similarity;

use super::*;
use crate::testing::camera_looking_at;

fn ring(count: u32) -> Vec<Camera> {
    let eye = |i: u32| {
        let angle = f64::from(i) * 0.9;
        DVec3::new(4.0 * angle.sin(), 0.7 * f64::from(i % 3), -4.0 * angle.cos())
    };
    (0..count).map(|i| camera_looking_at(eye(i), DVec3::ZERO, [80, 60])).collect()
}

/// Returns the gradient of the squared distance, in pixels, between where two cameras see points.
fn gradient_towards(camera: &Camera, truth: &Camera) -> CameraGradient {
    let points = [[0.5, 0.3, 0.2], [-0.6, 0.1, 0.4], [0.2, -0.5, -0.7], [-0.3, 0.4, -0.2], [0.1, 0.1, 0.9]].map(DVec3::from_array);
    let error = |camera: &Camera| -> f64 {
        points.iter().filter_map(|p| Some((camera.project(*p)?.0 - truth.project(*p)?.0).length_squared())).sum()
    };
    let h = 1e-6;
    let by = |change: &dyn Fn(f64) -> Camera| (error(&change(h)) - error(&change(-h))) / (2.0 * h);
    let turned = |i: usize| by(&|h| CameraMotion::IDENTITY.then(DVec3::AXES[i] * h, DVec3::ZERO).apply(camera));
    let shifted = |i: usize| by(&|h| CameraMotion::IDENTITY.then(DVec3::ZERO, DVec3::AXES[i] * h).apply(camera));
    let zoomed = |i: usize| by(&|h| Camera { focal_px: camera.focal_px + DVec2::AXES[i] * h, ..camera.clone() });
    CameraGradient {
        rotation: DVec3::new(turned(0), turned(1), turned(2)),
        translation: DVec3::new(shifted(0), shifted(1), shifted(2)),
        focal_px: [zoomed(0), zoomed(1)],
    }
}

/// Moves cameras towards those that a fixed scene was seen with.
fn refined(given: Vec<Camera>, truth: &[Camera], refines_focal: bool) -> (Poses, Corrections) {
    let poses = Poses::new(given, 4.0);
    let mut corrections = Corrections::none(&poses, refines_focal);
    let rounds = 300;
    for step in 0..rounds * truth.len() {
        let index = step * 7 % truth.len();
        let camera = &corrections.cameras(&poses)[index];
        let gradient = gradient_towards(camera, &truth[index]);
        corrections.update(&poses, index, &gradient, 0.1 * decay(step as f64 / (rounds * truth.len()) as f64));
    }
    (poses, corrections)
}

fn largest_px(cameras: &[Camera], truth: &[Camera]) -> f64 {
    cameras.iter().zip(truth).map(|(a, b)| pose_change(b, a, 4.0).px).fold(0.0, f64::max)
}

/// Returns perturbed cameras whose perturbations have no similarity in common.
fn perturbed(truth: &[Camera]) -> Vec<Camera> {
    let mut motions: Vec<CameraMotion> = (0..truth.len())
        .map(|i| {
            let noise = |k: u64| f64::from(luxel_core::random::standard_normal(3, 6 * i as u64 + k)[0]);
            CameraMotion::IDENTITY.then(DVec3::new(noise(0), noise(1), noise(2)) * 0.012, DVec3::new(noise(3), noise(4), noise(5)) * 0.03)
        })
        .collect();
    Gauge::new(truth, 4.0).remove_common(truth, &mut motions);
    truth.iter().zip(motions).map(|(camera, motion)| motion.apply(camera)).collect()
}

#[test]
fn perturbed_poses_are_found_again() {
    let truth = ring(8);
    let given = perturbed(&truth);
    let before = largest_px(&given, &truth);
    let (poses, corrections) = refined(given, &truth, false);
    let after = largest_px(&corrections.cameras(&poses), &truth);
    assert!(before > 1.0 && after < 0.05 * before, "{before} px, then {after} px");
    let report = corrections.report(&poses);
    assert!(report.largest.px > 0.8 * before && report.mean.px < report.largest.px && report.largest.degrees > 0.1, "{report:?}");
}

#[test]
fn a_wrong_focal_length_is_found_again_with_its_poses() {
    let truth = ring(8);
    let given: Vec<Camera> = perturbed(&truth).into_iter().map(|camera| Camera { focal_px: camera.focal_px * 1.01, ..camera }).collect();
    let (poses, corrections) = refined(given, &truth, true);
    let [factor] = corrections.report(&poses).focal_factors[..] else { panic!("one lens has one factor") };
    assert!((factor * 1.01 - 1.0).abs() < 5e-4, "{factor}");
}

#[test]
fn the_common_similarity_is_removed_and_nothing_else() {
    let given = ring(9);
    let gauge = Gauge::new(&given, 4.0);
    let turn = glam::DMat3::from_quat(glam::DQuat::from_scaled_axis(DVec3::new(2e-4, -1e-4, 3e-4)));
    let common = Similarity::new(turn, 1.0004, DVec3::new(1e-3, 2e-3, -5e-4)).unwrap();
    let motion = |camera: &Camera| {
        let mut moved = camera.clone();
        common.apply_to_camera(&mut moved);
        // A similarity keeps depths up to its scale, a motion exactly: the eye is what moves.
        let rotation = moved.camera_from_world.matrix3;
        let eye = common.point(camera.eye());
        let pose = glam::DAffine3 { matrix3: rotation, translation: -(rotation * eye) };
        CameraMotion::between(&camera.camera_from_world, &pose)
    };
    let mut motions: Vec<CameraMotion> = given.iter().map(motion).collect();
    let size = |motions: &[CameraMotion]| {
        motions.iter().map(|m| m.translation.length() + 4.0 * m.rotation.to_scaled_axis().length()).fold(0.0, f64::max)
    };
    assert!(size(&motions) > 1e-3);
    gauge.remove_common(&given, &mut motions);
    // What is left is of second order.
    assert!(size(&motions) < 1e-5, "{}", size(&motions));
    // Corrections without a common part stay; removing twice changes no more.
    let truth = ring(9);
    let own: Vec<CameraMotion> =
        perturbed(&truth).iter().zip(&given).map(|(a, b)| CameraMotion::between(&b.camera_from_world, &a.camera_from_world)).collect();
    let mut kept = own.clone();
    gauge.remove_common(&given, &mut kept);
    for (a, b) in own.iter().zip(&kept) {
        assert!((a.translation - b.translation).length() < 1e-3 && a.rotation.abs_diff_eq(b.rotation, 1e-3), "{a:?} {b:?}");
    }
    // One camera is all there is in common; cameras at one place have no scale.
    let mut alone = vec![CameraMotion::IDENTITY.then(DVec3::X * 1e-3, DVec3::Y * 1e-3)];
    Gauge::new(&given[..1], 4.0).remove_common(&given[..1], &mut alone);
    assert!(size(&alone) < 1e-5, "{alone:?}");
}

#[test]
fn corrections_survive_json_bit_for_bit_and_are_checked() {
    let truth = ring(5);
    let (poses, corrections) = refined(perturbed(&truth), &truth, true);
    let json = serde_json::to_string(&corrections).unwrap();
    let read: Corrections = serde_json::from_str(&json).unwrap();
    assert_eq!(read, corrections);
    assert!(read.validate(&poses, true).is_ok() && read.validate(&poses, false).is_err());
    assert!(read.validate(&Poses::new(ring(4), 4.0), true).is_err());
    let broken = Corrections { second: [f64::NAN; DOF], ..read };
    assert!(broken.validate(&poses, true).is_err());
}

#[test]
fn a_gradient_that_is_not_finite_moves_nothing() {
    let poses = Poses::new(ring(3), 4.0);
    let mut corrections = Corrections::none(&poses, true);
    let start = corrections.clone();
    let broken = CameraGradient { translation: DVec3::new(0.0, f64::NAN, 0.0), ..CameraGradient::default() };
    corrections.update(&poses, 1, &broken, 0.1);
    assert_eq!(corrections, start);
    assert_eq!(corrections.cameras(&poses), ring(3));
    assert_eq!((default_rate_px(630, 200), default_rate_px(30_000, 10), default_rate_px(1, 0)), (0.4, 0.02, 0.4));
}
