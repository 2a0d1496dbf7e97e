use luxel_core::Fisheye;

use super::*;
use crate::testing::{camera_at, dataset_of, view_of};

fn cameras() -> Vec<Camera> {
    let plain = camera_at([0.0; 3], [48, 32]);
    let shifted = Camera { center_px: glam::DVec2::new(10.0, 40.0), ..plain.clone() };
    let fisheye =
        Camera { projection: CameraProjection::Fisheye(Fisheye::new([0.0; 4])), focal_px: glam::DVec2::splat(12.0), ..plain.clone() };
    vec![plain, shifted, fisheye]
}

fn lenses(cameras: &[Camera]) -> Lenses {
    let view = |camera: &Camera| {
        let image = luxel_core::Image::filled(camera.size_px[0] as usize, camera.size_px[1] as usize, [1.0; 3]);
        view_of("a", camera.clone(), image)
    };
    Lenses::new(&dataset_of(cameras.iter().map(view).collect()))
}

/// Returns ln gain at points of the frame.
fn log_gains(camera: &Camera, frame: &Frame, weights: &Terms) -> Vec<f64> {
    let c = frame.log_gain(weights);
    let mut out = Vec::new();
    for (x, y) in (0..200).flat_map(|y| (0..200).map(move |x| (x, y))) {
        let at = [x, y].map(|n| (f64::from(n) + 0.5) / 200.0);
        let r2 = (0..2).map(|i| ((at[i] * f64::from(camera.size_px[i]) - camera.center_px[i]) / frame.unit_px).powi(2)).sum::<f64>();
        if r2 <= 1.0 {
            out.push(c[0] + r2 * (c[1] + r2 * (c[2] + r2 * c[3])));
        }
    }
    out
}

#[test]
fn ln_gain_has_mean_zero_and_the_weights_as_its_size() {
    for camera in cameras() {
        let frame = Frame::new(&camera);
        for weights in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.3, -0.2, 0.1]] {
            let gains = log_gains(&camera, &frame, &weights);
            let mean = gains.iter().sum::<f64>() / gains.len() as f64;
            let size = (gains.iter().map(|gain| gain * gain).sum::<f64>() / gains.len() as f64).sqrt();
            let expected = weights.iter().map(|w| w * w).sum::<f64>().sqrt();
            // Means are taken at fewer points than here.
            assert!(mean.abs() < 0.02 && (size - expected).abs() < 0.05, "{:?} {weights:?}: {mean} {size}", camera.projection);
        }
    }
}

#[test]
fn the_gradient_by_the_weights_is_that_of_differences() {
    let frame = Frame::new(&cameras()[1]);
    // A function of the coefficients that is not linear.
    let value = |weights: &Terms| frame.log_gain(weights).iter().zip([0.3, -0.7, 0.2, 0.9]).map(|(c, a)| (c - a).powi(2)).sum::<f64>();
    let weights = [0.4, -0.3, 0.2];
    let coefficients = frame.log_gain(&weights);
    let by: Vec<f32> = coefficients.iter().zip([0.3, -0.7, 0.2, 0.9]).map(|(c, a)| (2.0 * (c - a)) as f32).collect();
    let found = frame.gradient(&by.try_into().unwrap());
    for (k, found) in found.into_iter().enumerate() {
        let moved = |h: f64| value(&std::array::from_fn(|j| weights[j] + if j == k { h } else { 0.0 }));
        let expected = (moved(1e-5) - moved(-1e-5)) / 2e-5;
        assert!((found - expected).abs() < 1e-4 * expected.abs().max(1.0), "{k}: {found} {expected}");
    }
}

#[test]
fn a_fall_off_is_found_from_the_gradient_of_squares() {
    let cameras = cameras();
    let lenses = lenses(&cameras);
    assert_eq!(lenses.by_view, [0, 1, 2]);
    let mut found = Vignettings::none(&lenses);
    // cos^4 of a lens with half the field's tangent 0.9, and no scene beside it.
    let truth = |r2: f64| -2.0 * (1.0 + 0.81 * r2).ln();
    let places: Vec<f64> = (0..100).map(|i| (f64::from(i) + 0.5) / 100.0).collect();
    let mean_truth = places.iter().map(|r2| truth(*r2)).sum::<f64>() / 100.0;
    for step in 0..2000u32 {
        let progress = 0.1 + f64::from(step) / 2300.0;
        let vignetting = found.of_view(&lenses, 0, &cameras[0], 1, progress).unwrap();
        let mut by = [0.0; VIGNETTING_TERMS];
        let values: Vec<f64> = places.iter().map(|r2| f64::from(vignetting.log_gain_at(*r2 as f32))).collect();
        let mean = values.iter().sum::<f64>() / 100.0;
        for (r2, value) in places.iter().zip(&values) {
            let error = (value - mean) - (truth(*r2) - mean_truth);
            (0..4).for_each(|k| by[k] += 0.01 * error * r2.powi(k as i32));
        }
        found.update(&lenses, 0, &by.map(|v| v as f32), progress);
    }
    let report = found.report(&lenses);
    let expected = truth(1.0) / std::f64::consts::LN_2;
    assert!((report[0].corner_ev - expected).abs() < 0.03, "{} {expected}", report[0].corner_ev);
    assert_eq!((report[1].corner_ev, report[0].views), (0.0, 1));
    found.update(&lenses, 0, &[f32::NAN; 4], 0.5);
    assert_eq!(found.report(&lenses), report);
}

#[test]
fn parts_and_reduced_images_have_the_gain_of_their_place_in_the_frame() {
    let camera = cameras()[0].clone();
    let lenses = lenses(std::slice::from_ref(&camera));
    let mut state = Vignettings::none(&lenses);
    state.lenses[0].weights = [-0.4, 0.2, -0.1];
    assert_eq!(state.of_view(&lenses, 0, &camera, 1, 0.01), None);
    let whole = state.of_view(&lenses, 0, &camera, 1, 0.5).unwrap();
    let reduced = state.of_view(&lenses, 0, &camera.downscaled(2), 2, 0.5).unwrap();
    let corner_px = glam::DVec2::new(16.0, 5.0);
    let cropped = Camera { center_px: camera.center_px - corner_px, size_px: [20, 20], ..camera.clone() };
    let part = state.of_view(&lenses, 0, &cropped, 1, 0.5).unwrap();
    for at in [[0.5, 0.5], [24.0, 16.0], [40.0, 30.0]] {
        assert!((whole.gain(at) - reduced.gain(at.map(|v| v / 2.0))).abs() < 1e-6);
        assert!((whole.gain(at) - part.gain([at[0] - 16.0, at[1] - 5.0])).abs() < 1e-6);
    }
    // What was found serves for other views of the lens at any resolution, and for no other lens.
    let found = state.report(&lenses);
    for same in [camera.clone(), camera.downscaled(2), camera.downscaled(5)] {
        let other = found[0].of_camera(&same).unwrap();
        let factor = same.focal_px.x / camera.focal_px.x;
        assert!((other.gain([0.5, 0.5]) - whole.gain([0.5, 0.5].map(|v: f32| v / factor as f32))).abs() < 1e-5, "{:?}", same.size_px);
    }
    for other in
        [cameras()[1].clone(), Camera { focal_px: camera.focal_px * 1.02, ..camera.clone() }, Camera { size_px: [48, 40], ..camera }]
    {
        assert_eq!(found[0].of_camera(&other), None);
    }
}

#[test]
fn states_of_other_lenses_or_with_numbers_that_are_none_are_refused() {
    let lenses = lenses(&cameras());
    let mut state = Vignettings::none(&lenses);
    let json = serde_json::to_string(&state).unwrap();
    assert_eq!(serde_json::from_str::<Vignettings>(&json).unwrap(), state);
    assert!(state.validate(&lenses).is_ok());
    state.lenses[1].first[2] = f64::NAN;
    assert!(state.validate(&lenses).unwrap_err().to_string().contains("expected a finite one"));
    state.lenses.pop();
    assert!(state.validate(&lenses).unwrap_err().to_string().contains("vignetting of 2 lenses, the data set has 3"));
}
