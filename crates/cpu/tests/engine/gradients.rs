//! Gradients of every parameter of every colour model: the oracle's exact ones against central differences in f64, and the engine's f32
//! ones against the oracle's.

use luxel_core::{Activation, Antialias, ColorModel, Cutoffs, LossConfig, RenderOptions, Splats, View};

use crate::fixture;
use crate::oracle::{self, ARRAYS};

/// One row of the table.
struct Case {
    name: String,
    splats: Splats,
    view: View,
    options: RenderOptions,
    loss: LossConfig,
}

fn lcd(chroma_degree: u8, luminance_degree: u8, activation: Activation) -> ColorModel {
    ColorModel::Lcd { chroma_degree, luminance_degree, activation }
}

fn case(model: ColorModel, antialias: Antialias, (label, cutoffs): (&str, Cutoffs), masked: bool, seed: u64) -> Case {
    // Not a multiple of any tile size.
    let camera = fixture::camera(27, 21);
    let mut splats = fixture::splats_with_special_cases(model, &camera, seed);
    if antialias == Antialias::Mip {
        splats.smoothing = fixture::smoothing(splats.len());
    }
    let mut name = format!("{} {label}", model.name());
    if antialias == Antialias::Mip {
        name += " mip";
    }
    if masked {
        name += " mask";
    }
    let options = fixture::options(cutoffs, antialias);
    Case { name, splats, view: fixture::view(&camera, masked, seed + 1000), options, loss: fixture::step(1, options).loss }
}

/// All colour models; cut-offs, anti-aliasing and mask alternate so that each meets each.
fn cases() -> Vec<Case> {
    let (hdr, parity) = (("hdr", Cutoffs::HDR), ("parity", Cutoffs::PARITY));
    let (off, mip) = (Antialias::Off, Antialias::Mip);
    let mut cases = Vec::new();
    for degree in 0..=5 {
        let even = degree % 2 == 0;
        let model = ColorModel::Sh { degree };
        cases.push(case(model, if even { off } else { mip }, if even { parity } else { hdr }, degree >= 4, degree.into()));
    }
    for degree in 0..=5 {
        let even = degree % 2 == 0;
        let model = lcd(degree, degree % 4, Activation::Softplus);
        cases.push(case(model, if even { mip } else { off }, if degree < 3 { hdr } else { parity }, !even, 10 + u64::from(degree)));
    }
    cases.push(case(lcd(3, 0, Activation::Softplus), off, hdr, false, 20));
    cases.push(case(lcd(3, 0, Activation::Exp), mip, hdr, true, 21));
    cases.push(case(lcd(3, 0, Activation::Relu), off, parity, false, 22));
    cases.push(case(lcd(1, 3, Activation::Exp), off, hdr, false, 23));
    cases.push(case(lcd(2, 2, Activation::Relu), mip, parity, true, 24));
    cases
}

/// Largest difference within an array, relative to the array's largest gradient, and where.
#[derive(Clone, Copy, Default)]
struct Worst {
    relative: f64,
    index: usize,
    found: f64,
    expected: f64,
}

/// By array of [`ARRAYS`]; `None` for arrays that the model lacks. `found` may be `None` where it could not be measured.
fn compare(splats: &Splats, found: &[Option<f64>], expected: &[f64]) -> [Option<Worst>; ARRAYS.len()] {
    let arrays = oracle::array_of_parameters(splats);
    let mut largest = [0f64; ARRAYS.len()];
    let mut first = [usize::MAX; ARRAYS.len()];
    for (i, (&array, value)) in arrays.iter().zip(expected).enumerate() {
        largest[array] = largest[array].max(value.abs());
        first[array] = first[array].min(i);
    }
    let mut worst = first.map(|first| (first != usize::MAX).then(Worst::default));
    for (i, ((&array, &expected), found)) in arrays.iter().zip(expected).zip(found).enumerate() {
        let Some(found) = *found else { continue };
        let relative = (found - expected).abs() / largest[array].max(f64::MIN_POSITIVE);
        let entry = worst[array].get_or_insert_default();
        if relative > entry.relative || relative.is_nan() {
            *entry = Worst { relative, index: i - first[array], found, expected };
        }
    }
    worst
}

fn check(case: &Case, worst: &[Option<Worst>; ARRAYS.len()], tolerance: f64, what: &str) {
    for (name, worst) in ARRAYS.iter().zip(worst) {
        if let Some(w) = worst {
            assert!(
                w.relative < tolerance,
                "{}: {name}[{}] {what}: {:e}, expected {:e}: {:.1e} of the array's largest, tolerance {tolerance:.0e}",
                case.name,
                w.index,
                w.found,
                w.expected,
                w.relative
            );
        }
    }
}

/// Central differences with h = 1e-5 leave h^2 of truncation, times third derivatives (up to 1e3 for positions in front of a
/// sub-pixel splat), and 1e-16 / h of rounding.
const DIFFERENCES_TOLERANCE: f64 = 1e-6;

#[test]
fn oracle_gradient_is_that_of_central_differences() {
    for case in cases() {
        let exact = oracle::differentiate(&case.splats, &case.view, &case.options, &case.loss);
        let numeric = oracle::central_differences(&case.splats, &case.view, &case.options, &case.loss);
        let measured = numeric.iter().flatten().count();
        let worst = compare(&case.splats, &numeric, &exact.gradient);
        for (a, w) in ARRAYS.iter().zip(&worst) { if let Some(w) = w { print!("{a} {:.1e} ", w.relative); } }
        println!("{} {measured} of {}", case.name, numeric.len());
        // A parameter next to a decision (a pixel's threshold) cannot be measured; few are.
        assert!(20 * measured >= 19 * numeric.len(), "{}: only {measured} of {} measured", case.name, numeric.len());
        check(&case, &worst, DIFFERENCES_TOLERANCE, "by tape against differences");
    }
}
