//! Tests metrics against independent implementations: the FLIP authors' program, scikit-image's
//! SSIM, ColorVideoVDP's PU21, and definitions in NumPy. Expected values are in
//! `oracles/metrics.json`, made by `scripts/metric_oracles.py` on the same generated images as
//! here.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

use luxel_core::{ColorSpace, Image};
use luxel_metrics::{
    DecadeError, FieldMetrics, FieldOptions, FlipChoice, FlipMap, MetricsError, field_metrics, hdr_flip, ldr_flip, ssim, ssim_interior,
    ssim_replicated,
};
use serde_json::Value;

/// Stride of the sampled pixels of the error maps in the file.
const MAP_STRIDE: usize = 13;

/// Numerical Recipes' linear congruential generator. It returns the upper 24 bits of 32 as a
/// fraction.
struct Random(u32);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(self.0 >> 8) / f64::from(1u32 << 24)
    }
}

struct Made {
    name: &'static str,
    reference: Image,
    test: Image,
}

impl Made {
    /// Generates a pair of images: `value` gives reference and test by column, row and channel.
    fn new(name: &'static str, size: [i32; 2], mut value: impl FnMut(i32, i32, i32, &mut Random) -> (f64, f64)) -> Self {
        let mut random = Random(1);
        let (mut reference, mut test) = (Vec::new(), Vec::new());
        for (y, x) in (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (y, x))) {
            let both = [0, 1, 2].map(|c| value(x, y, c, &mut random));
            reference.push(both.map(|(r, _)| r as f32));
            test.push(both.map(|(_, t)| t as f32));
        }
        let image = |pixels| Image::from_pixels(size[0] as usize, size[1] as usize, pixels).unwrap();
        Self { name, reference: image(reference), test: image(test) }
    }

    fn oracle(&self) -> Value {
        let file: Value = serde_json::from_str(include_str!("oracles/metrics.json")).unwrap();
        file["images"][self.name].clone()
    }

    fn planes(&self, channel: usize) -> [Vec<f64>; 2] {
        [&self.test, &self.reference].map(|image| image.pixels.iter().map(|p| f64::from(p[channel].clamp(0.0, 1.0))).collect())
    }
}

fn images() -> [Made; 6] {
    let noise = |_, _, _, random: &mut Random| {
        let (mantissa, exponent, gain) = (1.0 + random.next(), (random.next() * 18.0).floor() as i32 - 12, 0.75 + 0.5 * random.next());
        (mantissa * 2f64.powi(exponent), mantissa * 2f64.powi(exponent) * gain)
    };
    let lamp = |x: i32, y: i32, c: i32| {
        if (x - 20).pow(2) + (y - 16).pow(2) < 36 {
            return [48.0, 40.0, 28.0][c as usize];
        }
        let wall = 0.02 + 0.3 * (f64::from(x + 1) / 64.0) * (f64::from(c + 1) / 3.0);
        wall * if (x / 4 + y / 4) % 2 == 1 { 1.5 } else { 1.0 }
    };
    let tint = |x: i32, y: i32, c: i32| f64::from((x * 7 + y * 3) % 16 + 1) / 16.0 * 0.5f64.powi(c);
    let dim = |x: i32, y: i32| f64::from((x ^ y) % 8 + 1) * 2f64.powi(-9);
    [
        Made::new("noise", [37, 29], noise),
        Made::new("lamp", [64, 48], |x, y, c, _| (lamp(x, y, c), lamp((x - 1).max(0), y, c) * 1.05)),
        Made::new("tint", [40, 33], |x, y, c, _| (tint(x, y, c), if x > 20 { tint(x, y, 2 - c) } else { tint(x, y, c) * 0.9 })),
        Made::new("dim", [24, 20], |x, y, c, _| (dim(x, y), dim(x, y) + f64::from(c) * 2f64.powi(-11))),
        Made::new("edge", [32, 21], |x, y, _, _| (0.25, if x >= 16 || (x, y) == (6, 9) { 0.5 } else { 0.25 })),
        Made::new("dark_room", [30, 26], |x, y, c, random| {
            let light = if x < 8 && y < 12 { (1.0 + random.next()) * f64::from(c + 1) } else { 0.0 };
            (light, light * 1.25 + if y > 20 { 0.001 } else { 0.0 })
        }),
    ]
}

#[track_caller]
fn assert_close(what: &str, found: f64, expected: &Value, tolerance: f64) {
    let expected = expected.as_f64().unwrap_or_else(|| panic!("{what}: no expected value"));
    let difference = (found - expected).abs();
    // With --nocapture this prints the table of the documentation.
    println!("{what}: {found:.7} {expected:.7} off by {difference:.1e}");
    assert!(difference <= tolerance, "{what}: {found}, expected {expected}, off by {difference:.2e}");
}

#[test]
fn images_are_those_of_the_oracles() {
    for made in images() {
        let sum = |image: &Image| image.pixels.as_flattened().iter().map(|&v| f64::from(v)).sum::<f64>();
        let oracle = made.oracle();
        for (image, expected) in [(&made.reference, &oracle["sums"][0]), (&made.test, &oracle["sums"][1])] {
            assert_close(made.name, sum(image), expected, 1e-9 * sum(image));
        }
    }
}

/// One of the three treatments of the border.
type Ssim = fn(&[f64], &[f64], usize, usize) -> Result<f64, MetricsError>;

#[test]
fn ssim_is_that_of_scikit_image() {
    for made in images() {
        let oracle = &made.oracle()["ssim"];
        let mean = |of: Ssim| {
            let channel = |c| of(&made.planes(c)[0], &made.planes(c)[1], made.reference.width, made.reference.height).unwrap();
            (0..3).map(channel).sum::<f64>() / 3.0
        };
        for (border, found) in [("zeros", mean(ssim)), ("interior", mean(ssim_interior)), ("replicated", mean(ssim_replicated))] {
            assert_close(&format!("{} ssim {border}", made.name), found, &oracle[border], 1e-10);
        }
    }
}

fn field(made: &Made, peak_luminance: f32) -> FieldMetrics {
    let options = FieldOptions { peak_luminance, color_space: ColorSpace::LinearRec709, flip: FlipChoice::Skip };
    field_metrics(&made.test, &made.reference, None, &options).unwrap()
}

#[test]
fn pu21_is_that_of_color_video_vdp_and_scikit_image() {
    for made in images() {
        for expected in made.oracle()["pu21"].as_array().unwrap() {
            let peak = expected["peak_luminance"].as_f64().unwrap();
            let found = field(&made, peak as f32);
            // Luminance is f32 here: an error of 1e-7 of a value is 1e-6 dB of a difference of a
            // tenth.
            assert_close(&format!("{} pu21_psnr at {peak} cd/m2", made.name), found.pu21_psnr, &expected["psnr"], 1e-6);
            assert_close(&format!("{} pu21_ssim at {peak} cd/m2", made.name), found.pu21_ssim, &expected["ssim"], 1e-6);
        }
    }
}

#[test]
fn logarithms_and_decades_are_their_definitions() {
    for made in images() {
        let (oracle, found) = (made.oracle(), field(&made, 100.0));
        assert_close(&format!("{} log_rmse", made.name), found.log_rmse, &oracle["log_rmse"], 1e-7);
        let expected: Vec<DecadeError> = serde_json::from_value(oracle["relative_error_by_decade"].clone()).unwrap();
        let places = |errors: &[DecadeError]| errors.iter().map(|e| (e.decade, e.count)).collect::<Vec<_>>();
        assert_eq!(places(&found.relative_error_by_decade), places(&expected), "{}", made.name);
        for (found, expected) in found.relative_error_by_decade.iter().zip(&expected) {
            let off = (found.relative_error - expected.relative_error).abs().max((found.bias - expected.bias).abs());
            assert!(off <= 1e-6 * expected.relative_error.max(1.0), "{}: {found:?}, expected {expected:?}", made.name);
        }
    }
}

/// Tolerance of a pixel. Both programs are single precision with different orders of summation. In
/// flat areas features are rounding noise, and so are colours beside a bright area: the exponents
/// 0.5 and 0.7 turn 1e-7 into 1e-3.
const FLIP_PIXEL_TOLERANCE: f64 = 3e-3;
/// Tolerance of the mean, where the noise of [`FLIP_PIXEL_TOLERANCE`] is averaged.
const FLIP_MEAN_TOLERANCE: f64 = 5e-5;

fn assert_flip(what: &str, found: &FlipMap, expected: &Value) {
    assert_close(&format!("{what} mean"), found.mean, &expected["mean"], FLIP_MEAN_TOLERANCE);
    let expected = expected["every_13th"].as_array().unwrap();
    let sampled: Vec<f64> = found.error.iter().step_by(MAP_STRIDE).map(|&v| f64::from(v)).collect();
    assert_eq!(sampled.len(), expected.len());
    let off = |i: usize| (sampled[i] - expected[i].as_f64().unwrap()).abs();
    let worst = (0..sampled.len()).max_by(|&a, &b| off(a).total_cmp(&off(b))).unwrap();
    println!("{what} worst pixel off by {:.1e}", off(worst));
    assert!(off(worst) <= FLIP_PIXEL_TOLERANCE, "{what}: pixel {}: {}, expected {}", worst * MAP_STRIDE, sampled[worst], expected[worst]);
}

#[test]
fn ldr_flip_is_its_authors() {
    for made in images() {
        let clipped = |image: &Image| {
            let pixels = image.pixels.iter().map(|p| p.map(|v| v.clamp(0.0, 1.0))).collect();
            Image::from_pixels(image.width, image.height, pixels).unwrap()
        };
        let found = ldr_flip(&clipped(&made.test), &clipped(&made.reference), None).unwrap();
        assert_flip(&format!("{} ldr_flip", made.name), &found, &made.oracle()["ldr_flip"]);
    }
}

#[test]
fn hdr_flip_is_its_authors() {
    for made in images() {
        let found = hdr_flip(&made.test, &made.reference, None, ColorSpace::LinearRec709).unwrap();
        let oracle = &made.oracle()["hdr_flip"];
        let exposures = found.exposures.unwrap();
        assert_close(&format!("{} start exposure", made.name), exposures.start_ev.into(), &oracle["startExposure"], 1e-5);
        assert_close(&format!("{} stop exposure", made.name), exposures.stop_ev.into(), &oracle["stopExposure"], 1e-5);
        assert_eq!(u64::from(exposures.count), oracle["numExposures"].as_u64().unwrap());
        assert_flip(&format!("{} hdr_flip", made.name), &found, oracle);
    }
}
