//! Tests LPIPS against the reference package. Expected values are in `oracles/lpips.json`, made by
//! `scripts/lpips_oracle.py` with the same generated weights and images as here.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

use luxel_core::{ColorSpace, Image, Mask};
use luxel_metrics::{Lpips, LpipsError, LpipsNetwork, Tensors};
use serde_json::Value;

/// Returns a hash of index and seed as a fraction of 24 bits.
fn fraction(i: usize, seed: usize) -> f64 {
    let mut x = (i as u32).wrapping_mul(0x9E37_79B1).wrapping_add((seed as u32).wrapping_mul(0x0100_0193));
    x ^= x >> 15;
    x = x.wrapping_mul(0x85EB_CA77);
    x ^= x >> 13;
    x = x.wrapping_mul(0xC2B2_AE3D);
    x ^= x >> 16;
    f64::from(x >> 8) / f64::from(1u32 << 24)
}

fn tensor(name: &str, shape: Vec<usize>, seed: usize) -> (Vec<usize>, Vec<f32>) {
    let fan_in: usize = shape[1..].iter().product();
    let value = |u: f64| match name {
        _ if name.starts_with("lin") => u,
        _ if name.ends_with(".bias") => (2.0 * u - 1.0) * 0.05,
        _ => (2.0 * u - 1.0) * (6.0 / fan_in as f64).sqrt(),
    };
    let values = (0..shape.iter().product()).map(|i| value(fraction(i, seed)) as f32).collect();
    (shape, values)
}

fn oracle(network: LpipsNetwork) -> Value {
    let file: Value = serde_json::from_str(include_str!("oracles/lpips.json")).unwrap();
    file[network.name()].clone()
}

/// Returns tensors with the package's names, sorted as in the script.
fn tensors(oracle: &Value) -> Tensors {
    let shapes = oracle["tensors"].as_object().unwrap();
    let mut names: Vec<&String> = shapes.keys().collect();
    names.sort();
    let shape = |name: &str| serde_json::from_value(shapes[name].clone()).unwrap();
    names.into_iter().enumerate().map(|(seed, name)| (name.clone(), tensor(name, shape(name), seed))).collect()
}

fn images(width: usize, height: usize) -> [Image; 2] {
    let image = |value: &dyn Fn(f64, f64, f64) -> f64| {
        let pixel = |i: usize| {
            let gradient = (i % width) as f64 / width as f64;
            [0, 1, 2].map(|c| value(gradient, fraction(3 * i + c, 77), fraction(3 * (width * height + i) + c, 77)) as f32)
        };
        Image::from_pixels(width, height, (0..width * height).map(pixel).collect()).unwrap()
    };
    [image(&|gradient, u, _| 0.5 * gradient + 0.5 * u), image(&|gradient, u, v| 0.4 * gradient + 0.25 * u + 0.25 * v)]
}

fn assert_is_the_packages(network: LpipsNetwork) {
    let oracle = oracle(network);
    let lpips = Lpips::from_tensors(&tensors(&oracle)).unwrap();
    assert_eq!(lpips.network(), network);
    let side = |i: usize| oracle["size"][i].as_u64().unwrap() as usize;
    let [first, second] = images(side(0), side(1));
    let (found, expected) = (lpips.distance(&first, &second).unwrap(), oracle["distance"].as_f64().unwrap());
    println!("{} {found:.8} {expected:.8} off by {:.1e}", network.name(), (found / expected - 1.0).abs());
    // Single precision through up to thirteen convolutions of up to 4608 terms.
    assert!((found / expected - 1.0).abs() < 1e-5, "{found}, expected {expected}");
    assert_eq!(lpips.distance(&first, &first).unwrap(), 0.0);
}

#[test]
fn alexnet_is_the_reference_packages() {
    assert_is_the_packages(LpipsNetwork::Alex);
}

#[test]
fn vgg_is_the_reference_packages() {
    assert_is_the_packages(LpipsNetwork::Vgg);
}

#[test]
fn radiance_is_shown_under_the_mu_law_and_masked_pixels_do_not_count() {
    let lpips = Lpips::from_tensors(&tensors(&oracle(LpipsNetwork::Alex))).unwrap();
    let [mut prediction, mut target] = images(40, 33);
    let of = |p: &Image, t: &Image, mask: Option<&Mask>| lpips.radiance_distance(p, t, mask, 5000.0, ColorSpace::LinearRec709).unwrap();
    let before = of(&prediction, &target, None);
    assert!(before > 0.0);
    prediction.scale(64.0);
    target.scale(64.0);
    assert!((of(&prediction, &target, None) / before - 1.0).abs() < 1e-4, "the unit of radiance matters");
    let mut spoilt = target.clone();
    spoilt.pixels[7] = [f32::NAN, 1e9, -3.0];
    let mask = Mask::from_valid((0..40 * 33).map(|i| i != 7));
    assert_eq!(of(&spoilt, &target, Some(&mask)), 0.0);
    assert_eq!(of(&target, &spoilt, Some(&mask)), 0.0);
    let black = Image::filled(40, 33, [0.0; 3]);
    assert_eq!(of(&black, &black, None), 0.0);
}

#[test]
fn unknown_networks_and_unusable_images_are_errors() {
    let oracle = oracle(LpipsNetwork::Alex);
    let whole = tensors(&oracle);
    assert!(matches!(Lpips::from_tensors(&Tensors::new()), Err(LpipsError::UnknownNetwork { .. })));
    let error = |change: &dyn Fn(&mut Tensors)| {
        let mut tensors = whole.clone();
        change(&mut tensors);
        Lpips::from_tensors(&tensors).unwrap_err().to_string()
    };
    let missing = error(&|tensors| drop(tensors.remove("lin3.model.1.weight")));
    assert_eq!(missing, "tensor \"lin3.model.1.weight\" is missing, expected the shape [1, 256, 1, 1] and finite values");
    let turned = error(&|tensors| tensors.get_mut("net.slice2.3.weight").unwrap().0.swap(0, 1));
    assert!(turned.contains("[64, 192, 5, 5]") && turned.contains("[192, 64, 5, 5]"), "{turned}");
    for value in [f32::NAN, f32::INFINITY] {
        assert!(error(&|tensors| tensors.get_mut("net.slice1.0.bias").unwrap().1[3] = value).contains("not finite"));
    }
    let lpips = Lpips::from_tensors(&whole).unwrap();
    let (small, image) = (Image::filled(30, 31, [0.5; 3]), Image::filled(31, 31, [0.5; 3]));
    assert!(matches!(lpips.distance(&small, &small), Err(LpipsError::TooSmall { min: 31, .. })));
    assert_eq!(lpips.distance(&image, &image).unwrap(), 0.0);
    assert!(matches!(lpips.distance(&small, &image), Err(LpipsError::Metrics(_))));
}

#[test]
fn weights_beyond_single_precision_are_an_error_and_no_distance() {
    let mut tensors = tensors(&oracle(LpipsNetwork::Alex));
    for (_, (_, values)) in tensors.iter_mut().filter(|(name, _)| name.starts_with("net.")) {
        values.iter_mut().for_each(|value| *value = 3e38 * value.signum());
    }
    let [first, second] = images(40, 36);
    let found = Lpips::from_tensors(&tensors).unwrap().distance(&first, &second);
    assert!(matches!(found, Err(LpipsError::Overflow { network: "alex" })), "{found:?}");
}
