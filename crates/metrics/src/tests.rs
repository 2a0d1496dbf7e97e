use proptest::prelude::*;

use super::*;
use luxel_core::tone::{MU, mu_law, mu_law_inverse};

fn image(width: usize, height: usize, value: impl Fn(usize) -> f32) -> Image {
    let pixels = (0..width * height).map(|i| [value(3 * i), value(3 * i + 1), value(3 * i + 2)]).collect();
    Image { width, height, pixels }
}

/// Radiance over five decades, without a pattern.
fn radiance(seed: f32) -> impl Fn(usize) -> f32 {
    move |i| 10f32.powf(((i as f32 + seed) * 0.754_877).sin() * 2.5 - 1.5)
}

fn metrics(prediction: &Image, target: &Image) -> ViewMetrics {
    view_metrics(prediction, target, None, MU).unwrap()
}

#[test]
fn equal_images_have_the_largest_psnr_and_ssim_one() {
    let target = image(20, 13, radiance(0.0));
    let m = metrics(&target, &target);
    for psnr in [m.psnr_scene, m.psnr_gtmax, m.psnr_selfmax] {
        assert_eq!(psnr, MAX_PSNR_DB);
    }
    for ssim in [m.ssim_scene, m.ssim_gtmax, m.ssim_selfmax] {
        assert!((ssim - 1.0).abs() < 1e-12, "{ssim}");
    }
    assert_eq!((m.l1_scene, m.mean_abs_mu), (0.0, 0.0));
    let json = serde_json::to_string(&m).unwrap();
    assert_eq!(serde_json::from_str::<ViewMetrics>(&json).unwrap(), m);
}

#[test]
fn psnr_of_a_constant_difference_under_the_mu_law_is_known() {
    // T = 0.5 against T = 0.4 everywhere: -20 log10(0.1) = 20 dB; black against 0.5: 6.02 dB.
    let target = image(8, 8, |_| mu_law_inverse(0.5, MU));
    let prediction = image(8, 8, |_| mu_law_inverse(0.4, MU));
    let m = metrics(&prediction, &target);
    assert!((m.psnr_scene - 20.0).abs() < 1e-4, "{}", m.psnr_scene);
    assert!((m.l1_scene - 0.1).abs() < 1e-6 && (m.mean_abs_mu - 0.1).abs() < 1e-6);
    assert!((m.psnr_black_scene - 6.0206).abs() < 1e-4, "{}", m.psnr_black_scene);
    // Divided by its maximum the target is white: black scores 0 dB, and any flat prediction is
    // perfect by its own maximum.
    assert!(m.psnr_black_gtmax.abs() < 1e-9);
    assert_eq!(m.psnr_selfmax, MAX_PSNR_DB);
    assert!(m.psnr_gtmax < 30.0);
}

#[test]
fn selfmax_is_capped_by_the_error_of_the_maximum() {
    // A relative error x of the brightest pixel alone costs about -20 log10(ln(1 + x) / ln 5001)
    // where mu p >> 1 (5 % -> 44.8 dB).
    let target = image(40, 40, |i| if i < 3 { 100.0 } else { 50.0 });
    let prediction = image(40, 40, |i| if i < 3 { 105.0 } else { 50.0 });
    let m = metrics(&prediction, &target);
    assert!((m.psnr_selfmax - 44.8).abs() < 0.1, "{}", m.psnr_selfmax);
    assert!(m.psnr_gtmax > 70.0, "{}", m.psnr_gtmax);
}

#[test]
fn scene_is_clipped_at_one_and_the_losses_l1_is_not() {
    let m = metrics(&image(4, 4, |_| 3.0), &image(4, 4, |_| 300.0));
    assert_eq!((m.psnr_scene, m.l1_scene), (MAX_PSNR_DB, 0.0));
    let expected = f64::from(mu_law(300.0, MU) - mu_law(3.0, MU));
    assert!((m.mean_abs_mu - expected).abs() < 1e-6);
}

#[test]
fn masked_pixels_do_not_count() {
    let mut target = image(16, 12, radiance(1.0));
    let mut prediction = image(16, 12, radiance(1.1));
    let mut mask = Mask::from_valid(vec![true; 16 * 12]);
    mask.weights[5] = 0.0;
    mask.weights[77] = 0.0;
    target.pixels[5] = [0.0; 3];
    target.pixels[77] = [0.0; 3];
    let first = view_metrics(&prediction, &target, Some(&mask), MU).unwrap();
    assert!((psnr_scene(&prediction, &target, Some(&mask), MU).unwrap() - first.psnr_scene).abs() < 1e-6);
    // Predictions in masked pixels change nothing, not even the maximum or NaN.
    prediction.pixels[5] = [1e6; 3];
    prediction.pixels[77] = [f32::NAN; 3];
    let second = view_metrics(&prediction, &target, Some(&mask), MU).unwrap();
    assert_eq!(first, second);
    let profile = LuminanceProfile::measure(&prediction, &target, Some(&mask), luxel_core::ColorSpace::LinearRec709).unwrap();
    assert_eq!(profile.count(), 16 * 12 - 2);
}

#[test]
fn a_masked_ssim_uses_the_target_in_place_of_the_prediction() {
    let target = image(16, 12, radiance(1.0));
    let mut prediction = target.clone();
    let mut mask = Mask::from_valid(vec![true; 16 * 12]);
    for i in 40..50 {
        prediction.pixels[i] = [0.0; 3];
        mask.weights[i] = 0.0;
    }
    let m = view_metrics(&prediction, &target, Some(&mask), MU).unwrap();
    assert!((m.ssim_scene - 1.0).abs() < 1e-12 && m.psnr_gtmax == MAX_PSNR_DB);
}

#[test]
fn a_black_prediction_scores_the_black_baseline() {
    let target = image(16, 12, radiance(1.0));
    let m = metrics(&Image::filled(16, 12, [0.0; 3]), &target);
    assert_eq!(m.psnr_scene, m.psnr_black_scene);
    assert_eq!(m.psnr_gtmax, m.psnr_black_gtmax);
    assert_eq!(m.psnr_selfmax, m.psnr_black_gtmax);
}

#[test]
fn a_black_target_is_compared_and_not_divided_by_zero() {
    let black = Image::filled(6, 6, [0.0; 3]);
    let m = metrics(&black, &black);
    assert!(m.named().iter().all(|(_, value)| value.is_finite()));
    assert_eq!(m.psnr_black_scene, MAX_PSNR_DB);
}

#[test]
fn images_that_cannot_be_compared_are_errors() {
    let target = image(4, 3, radiance(0.0));
    let mut bad = target.clone();
    bad.pixels[6] = [0.0, f32::NAN, 0.0];
    let size = view_metrics(&image(3, 4, radiance(0.0)), &target, None, MU).unwrap_err();
    assert_eq!(size.to_string(), "prediction is 3x4, target 4x3: metrics need equal sizes");
    let finite = view_metrics(&bad, &target, None, MU).unwrap_err();
    assert_eq!(finite.to_string(), "prediction is not finite at column 2, row 1");
    let mask = Mask::from_valid(vec![false; 12]);
    assert_eq!(view_metrics(&target, &target, Some(&mask), MU).unwrap_err(), MetricsError::NoValidPixels);
    let short = Mask::from_valid(vec![true; 11]);
    assert_eq!(view_metrics(&target, &target, Some(&short), MU).unwrap_err(), MetricsError::Mask { found: 11, expected: 12 });
    assert_eq!(view_metrics(&Image::default(), &Image::default(), None, MU).unwrap_err(), MetricsError::NoValidPixels);
    assert!(view_metrics(&target, &target, None, 0.0).is_err());
}

#[test]
fn the_mean_is_that_of_every_metric() {
    let target = image(16, 12, radiance(1.0));
    let views = [metrics(&image(16, 12, radiance(1.1)), &target), metrics(&image(16, 12, radiance(2.0)), &target)];
    let mean = ViewMetrics::mean(&views).unwrap();
    for (i, (name, value)) in mean.named().into_iter().enumerate() {
        let expected = (views[0].named()[i].1 + views[1].named()[i].1) / 2.0;
        assert!((value - expected).abs() < 1e-12, "{name}");
    }
    assert_eq!(ViewMetrics::mean(&[]), None);
}

#[test]
fn metric_names_are_those_of_the_saved_fields() {
    let json = serde_json::to_value(ViewMetrics::default()).unwrap();
    let saved = json.as_object().unwrap();
    assert_eq!(saved.len(), ViewMetrics::default().named().len());
    for (name, _) in ViewMetrics::default().named() {
        assert!(saved.contains_key(name), "{name}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Both protocols divide the unit away: radiance in other units gives the same metrics.
    #[test]
    fn gtmax_and_selfmax_do_not_depend_on_the_unit(seed in 0f32..50.0, factor in 1e-3f32..1e3) {
        let (mut p, mut t) = (image(13, 9, radiance(seed)), image(13, 9, radiance(seed + 0.2)));
        let before = metrics(&p, &t);
        p.scale(factor);
        t.scale(factor);
        let after = metrics(&p, &t);
        prop_assert!((before.psnr_gtmax - after.psnr_gtmax).abs() < 1e-3);
        prop_assert!((before.ssim_gtmax - after.ssim_gtmax).abs() < 1e-5);
        prop_assert!((before.psnr_selfmax - after.psnr_selfmax).abs() < 1e-3);
    }

    /// Only `selfmax` ignores the scale of the prediction.
    #[test]
    fn selfmax_does_not_see_a_scaled_prediction(seed in 0f32..50.0, factor in 1e-3f32..1e3) {
        let (mut p, t) = (image(13, 9, radiance(seed)), image(13, 9, radiance(seed + 0.2)));
        let before = metrics(&p, &t);
        p.scale(factor);
        let after = metrics(&p, &t);
        prop_assert!((before.psnr_selfmax - after.psnr_selfmax).abs() < 1e-3);
    }

    #[test]
    fn metrics_are_finite_and_in_range(seed in 0f32..50.0, other in 0f32..50.0) {
        let m = metrics(&image(12, 7, radiance(seed)), &image(12, 7, radiance(other)));
        for (name, value) in m.named() {
            prop_assert!(value.is_finite(), "{} = {}", name, value);
        }
        for ssim in [m.ssim_scene, m.ssim_gtmax, m.ssim_selfmax] {
            prop_assert!((-1.0..=1.0 + 1e-12).contains(&ssim));
        }
    }
}
