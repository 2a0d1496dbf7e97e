//! Weights of pixels and camera responses in the loss, compared with the oracle, with differences,
//! and with the loss without them.

use luxel_core::response::exposure_of_knot;
use luxel_core::{
    Activation, Antialias, Cutoffs, Engine, EngineError, Image, Knots, Mask, PixelValues, RESPONSE_KNOTS, Response, Target, ToneCurve,
};
use luxel_cpu::CpuEngine;

use crate::gradients::{
    Case, DIFFERENCES_TOLERANCE, ENGINE_TOLERANCE, against_differences, against_oracle, case, check, engine_gradient, lcd,
};
use crate::{fixture, oracle};

fn plain(masked: bool, seed: u64) -> Case {
    let antialias = if masked { Antialias::Mip } else { Antialias::Off };
    case(lcd(2, 1, Activation::Softplus), antialias, ("hdr", Cutoffs::HDR), masked, seed)
}

/// Returns a mask with weights 0, 1 and between.
pub fn weighted(mut case: Case, seed: u64) -> Case {
    case.view = fixture::with_weights(case.view, seed);
    case.name += " weights";
    case
}

/// Returns a view recorded by a camera with a different curve in each channel, with saturated and
/// black pixels among the others.
pub fn recorded(mut case: Case, seed: u64) -> Case {
    let knots: Knots = [0.8, 1.0, 1.3].map(|power| std::array::from_fn(|k| (0.55 * exposure_of_knot(k).powf(power / 2.2)) as f32 - 0.01));
    let response = Response { knots, exposure: [0.7, 1.1, 3.0] };
    let mut rng = fixture::Rng::new(seed);
    let value = |c: usize, p: f32, rng: &mut fixture::Rng| (response.apply(c, p * (0.4 * rng.normal()).exp()).value).clamp(0.0, 1.0);
    let pixels = case.view.image.pixels.iter().map(|pixel| [0, 1, 2].map(|c| value(c, pixel[c], &mut rng))).collect();
    case.view.image = Image::from_pixels(case.view.image.width, case.view.image.height, pixels).unwrap().into();
    case.view.values = PixelValues::Recorded { exposure_s: 1.0 };
    case.view.target = Target { curve: ToneCurve::Response(response), scale: [1.0; 3], vignetting: None };
    case.name += " response";
    case
}

fn cases() -> Vec<Case> {
    vec![
        weighted(plain(false, 31), 1),
        recorded(plain(false, 32), 2),
        recorded(plain(true, 33), 3),
        weighted(recorded(plain(false, 34), 4), 5),
    ]
}

#[test]
fn oracle_gradient_with_weights_and_responses_is_that_of_differences() {
    for case in cases() {
        check(&case, &against_differences(&case), DIFFERENCES_TOLERANCE, "by differences");
    }
}

#[test]
fn engine_gradient_with_weights_and_responses_is_the_oracles() {
    for case in cases() {
        check(&case, &against_oracle(&case), ENGINE_TOLERANCE, "by the engine");
        let exact = oracle::differentiate(&case.splats, &case.view, &case.options, &case.loss).loss;
        let (report, ..) = engine_gradient(&case);
        for (found, expected) in [(report.loss, exact.total), (report.l1, exact.l1), (report.ssim, exact.ssim)] {
            assert!((f64::from(found) - expected).abs() < 2e-6, "{}: {found}, expected {expected}", case.name);
        }
    }
}

#[test]
fn gradient_by_knots_is_the_oracles_and_that_of_differences() {
    for case in cases().into_iter().skip(1) {
        let ToneCurve::Response(response) = case.view.target.curve else { panic!("{}", case.name) };
        let exact = oracle::differentiate_by_knots(&case.splats, &case.view, &case.options, &case.loss);
        let largest = exact.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
        let found = engine_gradient(&case).0.by_knots.unwrap();
        for (i, (found, expected)) in found.as_flattened().iter().zip(&exact).enumerate() {
            let error = (f64::from(*found) - expected).abs() / largest;
            assert!(error < ENGINE_TOLERANCE, "{}: knot {i}: {found:e}, expected {expected:e}", case.name);
        }
        // The steepest knot of each channel, by differences of the oracle's loss.
        for channel in 0..3 {
            let of_channel = &exact[channel * RESPONSE_KNOTS..][..RESPONSE_KNOTS];
            let k = (0..RESPONSE_KNOTS).max_by(|a, b| of_channel[*a].abs().total_cmp(&of_channel[*b].abs())).unwrap();
            let loss = |h: f32| {
                let mut moved = response;
                moved.knots[channel][k] += h;
                let mut view = case.view.clone();
                view.target.curve = ToneCurve::Response(moved);
                oracle::differentiate(&case.splats, &view, &case.options, &case.loss).loss.total
            };
            let h = 1.0 / 4096.0;
            let numeric = (loss(h) - loss(-h)) / (2.0 * f64::from(h));
            let error = (numeric - of_channel[k]).abs() / largest;
            // Signs of L1 change within the step for some of the pixels.
            assert!(error < 0.05, "{}: channel {channel} knot {k}: {numeric:e} {:e}", case.name, of_channel[k]);
        }
    }
}

#[test]
fn weights_of_one_change_nothing_to_the_bit() {
    for (case, name) in [(plain(false, 35), "mu-law"), (recorded(plain(false, 36), 6), "response")] {
        let (report, gradient, stats) = engine_gradient(&case);
        let mask = Some(Mask { weights: vec![1.0; case.view.image.pixels.len()] }.into());
        let ones =
            Case { view: luxel_core::View { mask, ..case.view.clone() }, name: case.name.clone(), splats: case.splats.clone(), ..case };
        let (report_ones, gradient_ones, stats_ones) = engine_gradient(&ones);
        assert_eq!(report, report_ones, "{name}");
        assert_eq!(gradient, gradient_ones, "{name}");
        assert_eq!(stats, stats_ones, "{name}");
    }
}

#[test]
fn a_target_with_a_scale_is_the_scaled_image_to_the_bit() {
    for mut case in [plain(false, 41), weighted(plain(true, 42), 6), recorded(plain(false, 43), 8)] {
        let scale = [0.7, 1.0, 0.9];
        case.view.target.scale = scale;
        let of_scale = engine_gradient(&case);
        let mut image = Image::clone(&case.view.image);
        image.pixels.iter_mut().for_each(|rgb| *rgb = [0, 1, 2].map(|c| rgb[c] * scale[c]));
        case.view.image = image.into();
        case.view.target.scale = [1.0; 3];
        assert_eq!(of_scale, engine_gradient(&case), "{}", case.name);
    }
}

#[test]
fn a_pixel_of_no_weight_may_hold_anything() {
    let case = plain(true, 37);
    let mut other = case.view.clone();
    let mut image = Image::clone(&other.image);
    for (i, pixel) in image.pixels.iter_mut().enumerate().filter(|(i, _)| !case.view.is_valid(*i)) {
        *pixel = [1e6, 0.3 * i as f32, 0.0];
    }
    other.image = image.into();
    // In the windows, prediction and target are equal there, but their value still has an effect.
    let moved = Case { view: other, name: case.name.clone(), splats: case.splats.clone(), ..case };
    check(&moved, &against_oracle(&moved), ENGINE_TOLERANCE, "by the engine");
    assert_eq!(engine_gradient(&moved).0.l1, engine_gradient(&case).0.l1);
}

#[test]
fn gradient_by_knots_is_the_same_bits_for_any_number_of_threads() {
    let camera = fixture::camera(70, 131);
    let base = recorded(plain(false, 38), 7);
    let splats = fixture::splats(lcd(2, 1, Activation::Softplus), 200, &camera, 9);
    let view = luxel_core::View {
        values: PixelValues::Recorded { exposure_s: 1.0 },
        target: base.view.target,
        ..fixture::view(&camera, false, 10)
    };
    let step = luxel_core::engine::StepConfig { loss: base.loss, ..fixture::step(1, base.options) };
    let by_knots = |threads: usize| {
        let mut engine = CpuEngine::new(threads).unwrap();
        engine.load(&splats, None).unwrap();
        engine.gradients(&view, &step).unwrap().0.by_knots.unwrap()
    };
    let one = by_knots(1);
    assert!(one.as_flattened().iter().any(|v| *v != 0.0));
    assert_eq!((one, one), (by_knots(2), by_knots(5)));
}

#[test]
fn saturated_pixels_do_not_pull_what_is_brighter() {
    let mut case = recorded(plain(false, 39), 8);
    let ToneCurve::Response(response) = &mut case.view.target.curve else { panic!("{}", case.name) };
    // An exposure so long that the whole image is far beyond white, and is recorded so.
    response.exposure = [1e6; 3];
    let image = Image::filled(case.view.image.width, case.view.image.height, [1.0; 3]);
    case.view.image = image.into();
    (case.loss.opacity_weight, case.loss.scale_weight) = (0.0, 0.0);
    let (report, gradient, _) = engine_gradient(&case);
    assert_eq!(report.l1, 0.0);
    assert_eq!(oracle::flatten(&gradient).iter().position(|g| *g != 0.0), None);
    assert_eq!(report.by_knots, Some([[0.0; RESPONSE_KNOTS]; 3]));
    // The same image recorded a shade below white asks for less light.
    case.view.image = Image::filled(case.view.image.width, case.view.image.height, [0.99; 3]).into();
    assert!(oracle::flatten(&engine_gradient(&case).1).iter().any(|g| *g != 0.0));
}

#[test]
fn weights_that_are_none_are_refused() {
    let mut case = plain(false, 40);
    case.view.mask = Some(Mask { weights: vec![1.5; case.view.image.pixels.len()] }.into());
    let mut engine = CpuEngine::new(1).unwrap();
    engine.load(&case.splats, None).unwrap();
    let error = engine.gradients(&case.view, &fixture::step(1, case.options)).unwrap_err();
    assert!(matches!(&error, EngineError::Invalid { message: text, .. } if text.contains("weight")), "{error}");
}
