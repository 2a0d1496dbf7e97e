//! The gradient by the camera: compared with central differences of the f64 oracle, for every
//! colour model and every projection, and with itself for any number of threads.

use glam::{DVec2, DVec3};
use luxel_core::engine::{CameraGradient, CameraGradientChoice, StepConfig};
use luxel_core::{Camera, CameraMotion, Cutoffs, Engine, Splats, StepReport};
use luxel_cpu::CpuEngine;

use crate::fixture;
use crate::gradients::{Case, case, cases, lcd};
use crate::oracle::{Parameters, Trace, flatten, objective};
use crate::wide;

/// Step of the differences, in radians, world units and pixels.
const H: f64 = 1e-6;

/// f32 carries 6e-8. A sum over a scene loses a digit or two to cancellation between splats beside
/// what each of their gradients has lost.
const TOLERANCE: f64 = 1e-4;

fn step(case: &Case) -> StepConfig {
    StepConfig { loss: case.loss, ..fixture::step(1, case.options) }
}

fn found(case: &Case, threads: usize) -> StepReport {
    let mut engine = CpuEngine::new(threads).unwrap();
    engine.load(&case.splats, None).unwrap();
    engine.camera_gradient(&case.view, &step(case)).unwrap()
}

/// Returns the loss and its decisions as `camera` sees the scene.
fn value(case: &Case, camera: Camera) -> (f64, Trace) {
    let p = Parameters { splats: case.splats.clone(), flat: flatten(&case.splats) };
    let view = luxel_core::View { camera, ..case.view.clone() };
    let (total, _, rendered) = objective(&p, &view, &case.options, &case.loss);
    (total, rendered.trace)
}

/// Returns the derivative by a change of the camera, or `None` where a decision changes.
fn difference(case: &Case, change: impl Fn(&Camera, f64) -> Camera) -> Option<f64> {
    [H, 0.1 * H].into_iter().find_map(|h| {
        let [above, below] = [h, -h].map(|h| value(case, change(&case.view.camera, h)));
        (above.1 == below.1).then_some((above.0 - below.0) / (2.0 * h))
    })
}

fn turned(axis: usize) -> impl Fn(&Camera, f64) -> Camera {
    move |camera, h| CameraMotion::IDENTITY.then(DVec3::AXES[axis] * h, DVec3::ZERO).apply(camera)
}

fn shifted(axis: usize) -> impl Fn(&Camera, f64) -> Camera {
    move |camera, h| CameraMotion::IDENTITY.then(DVec3::ZERO, DVec3::AXES[axis] * h).apply(camera)
}

fn zoomed(axis: usize) -> impl Fn(&Camera, f64) -> Camera {
    move |camera, h| Camera { focal_px: camera.focal_px + DVec2::AXES[axis] * h, ..camera.clone() }
}

fn check(case: &Case, what: &str, found: &[f64], expected: &[Option<f64>]) {
    let largest = expected.iter().flatten().fold(0.0, |m: f64, d| m.max(d.abs()));
    // A direction in which a pixel's decision changes cannot be measured; there are few.
    assert!(largest > 0.0 && expected.iter().flatten().count() + 1 >= expected.len(), "{}: {what}: only {expected:?}", case.name);
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        let Some(expected) = expected else { continue };
        let error = (found - expected).abs() / largest;
        assert!(error < TOLERANCE, "{}: {what}[{i}]: {found:e}, expected {expected:e}: {error:.1e} of the largest", case.name);
    }
}

#[test]
fn gradient_by_the_pose_is_that_of_differences() {
    for case in cases().into_iter().chain(wide::cases()) {
        let CameraGradient { rotation, translation, .. } = found(&case, 1).camera.unwrap();
        let [turn, shift] = [[0, 1, 2].map(|axis| difference(&case, turned(axis))), [0, 1, 2].map(|axis| difference(&case, shifted(axis)))];
        check(&case, "rotation", &rotation.to_array(), &turn);
        check(&case, "translation", &translation.to_array(), &shift);
    }
}

#[test]
fn gradient_by_the_focal_lengths_is_that_of_differences() {
    for case in cases() {
        let found = found(&case, 1).camera.unwrap();
        check(&case, "focal", &found.focal_px, &[0, 1].map(|axis| difference(&case, zoomed(axis))));
    }
}

#[test]
fn there_is_no_gradient_by_the_focal_lengths_of_a_wide_lens() {
    for case in wide::cases() {
        assert_eq!(found(&case, 1).camera.unwrap().focal_px, [0.0; 2], "{}", case.name);
    }
}

fn large_case() -> Case {
    let antialias = luxel_core::Antialias::Pixel;
    let mut case = case(lcd(2, 1, luxel_core::Activation::Softplus), antialias, ("hdr", Cutoffs::HDR), true, 25);
    case.splats = fixture::splats(case.splats.color_model, 1000, &case.view.camera, 26);
    case
}

#[test]
fn the_gradient_has_the_same_bits_for_any_number_of_threads() {
    let case = large_case();
    let one = found(&case, 1);
    assert!(one.camera.is_some_and(|gradient| gradient.is_finite() && gradient != CameraGradient::default()));
    assert_eq!(found(&case, 3), one);
}

/// Returns the scene after a step and the step's report.
fn trained(case: &Case, camera_gradient: CameraGradientChoice) -> (Splats, StepReport) {
    let mut engine = CpuEngine::new(2).unwrap();
    engine.load(&case.splats, None).unwrap();
    let report = engine.train_step(&case.view, &StepConfig { camera_gradient, ..step(case) }).unwrap();
    (engine.save().unwrap().0, report)
}

#[test]
fn asking_for_the_gradient_changes_neither_the_step_nor_the_scene() {
    let case = large_case();
    let (without, plain) = trained(&case, CameraGradientChoice::Skip);
    let (with, report) = trained(&case, CameraGradientChoice::Compute);
    assert_eq!(with, without);
    assert_eq!(plain.camera, None);
    assert_eq!(report, StepReport { camera: report.camera, ..plain });
    // Without the update the same gradient is found, and the scene is left alone.
    let mut engine = CpuEngine::new(2).unwrap();
    engine.load(&case.splats, None).unwrap();
    assert_eq!(engine.camera_gradient(&case.view, &step(&case)).unwrap().camera, report.camera);
    assert_eq!(flatten(&engine.save().unwrap().0), flatten(&case.splats));
}
