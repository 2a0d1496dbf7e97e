use super::*;

fn image(width: usize, height: usize, value: impl Fn(usize) -> f32) -> Image {
    let pixels = (0..width * height).map(|i| [value(3 * i), value(3 * i + 1), value(3 * i + 2)]).collect();
    Image { width, height, pixels }
}

/// Radiance over four decades, without a pattern.
fn radiance(seed: f32) -> impl Fn(usize) -> f32 {
    move |i| 10f32.powf(((i as f32 + seed) * 0.754_877).sin() * 2.0)
}

fn hdr(test: &Image, reference: &Image, mask: Option<&Mask>) -> FlipMap {
    hdr_flip(test, reference, mask, ColorSpace::LinearRec709).unwrap()
}

#[test]
fn equal_images_do_not_flip() {
    for (width, height) in [(1, 1), (3, 2), (30, 17)] {
        let reference = image(width, height, radiance(0.0));
        let map = hdr(&reference, &reference, None);
        assert_eq!((map.mean, map.error.len()), (0.0, width * height));
    }
}

#[test]
fn black_images_have_a_flip() {
    let (black, bright) = (image(6, 5, |_| 0.0), image(6, 5, |_| 1.0));
    assert_eq!(hdr(&black, &black, None).mean, 0.0);
    for map in [hdr(&bright, &black, None), hdr(&black, &bright, None)] {
        assert!(map.mean > 0.5 && map.error.iter().all(|e| (0.0..=1.0).contains(e)), "{}", map.mean);
    }
}

#[test]
fn the_unit_of_radiance_does_not_matter() {
    let (mut reference, mut test) = (image(24, 15, radiance(0.0)), image(24, 15, radiance(0.2)));
    let before = hdr(&test, &reference, None);
    reference.scale(1024.0);
    test.scale(1024.0);
    let after = hdr(&test, &reference, None);
    assert!((before.mean - after.mean).abs() < 1e-5, "{} {}", before.mean, after.mean);
}

#[test]
fn masked_pixels_do_not_count() {
    let reference = image(20, 12, radiance(0.0));
    let mut test = reference.clone();
    for pixel in &mut test.pixels[..40] {
        *pixel = [f32::NAN; 3];
    }
    let mut target = reference.clone();
    target.pixels[0] = [f32::INFINITY; 3];
    let mask = Mask::from_valid((0..240).map(|i| i >= 40));
    assert_eq!(hdr(&test, &target, Some(&mask)).mean, 0.0);
    assert!(matches!(hdr_flip(&test, &reference, None, ColorSpace::LinearRec709), Err(MetricsError::NotFinite { .. })));
}

#[test]
fn what_overflows_in_the_conversion_has_a_flip() {
    // Pure red of ACEScg has 1.7 times the red in Rec.709.
    let mut reference = image(6, 4, |_| 0.5);
    reference.pixels[3] = [f32::MAX, 0.0, 0.0];
    let map = hdr_flip(&reference, &reference, None, ColorSpace::AcesCg).unwrap();
    let exposures = map.exposures.unwrap();
    assert!(map.mean == 0.0 && exposures.start_ev.is_finite() && exposures.count < 200, "{} {exposures:?}", map.mean);
}

#[test]
fn aces_primaries_are_converted() {
    // The same light in two colour spaces.
    let grey = image(12, 8, |i| radiance(0.0)(i / 3));
    let mut brighter = grey.clone();
    brighter.scale(1.3);
    let rec709 = hdr(&brighter, &grey, None).mean;
    let aces = hdr_flip(&brighter, &grey, None, ColorSpace::AcesCg).unwrap().mean;
    assert!((rec709 - aces).abs() < 1e-4, "{rec709} {aces}");
}
