//! Gradients of every parameter of every colour model: the oracle's exact ones against central
//! differences in f64, and the engine's f32 ones against the oracle's.

use luxel_core::engine::{DensifyStats, StepConfig};
use luxel_core::{Activation, Antialias, Camera, ColorModel, Cutoffs, Engine, LossWeights, RenderOptions, Splats, StepReport, View};
use luxel_cpu::CpuEngine;

use crate::fixture;
use crate::oracle::{self, ARRAYS};

/// One row of the table.
pub struct Case {
    pub name: String,
    pub splats: Splats,
    pub view: View,
    pub options: RenderOptions,
    pub loss: LossWeights,
}

pub fn lcd(chroma_degree: u8, luminance_degree: u8, activation: Activation) -> ColorModel {
    ColorModel::Lcd { chroma_degree, luminance_degree, activation }
}

/// Not a multiple of any tile size.
const SIZE_PX: [u32; 2] = [21, 13];

pub fn case(model: ColorModel, antialias: Antialias, cutoffs: (&str, Cutoffs), masked: bool, seed: u64) -> Case {
    case_of_camera(&fixture::camera(SIZE_PX[0], SIZE_PX[1]), model, antialias, cutoffs, masked, seed)
}

/// Returns a case with a given camera.
pub fn case_of_camera(
    camera: &Camera,
    model: ColorModel,
    antialias: Antialias,
    (label, cutoffs): (&str, Cutoffs),
    masked: bool,
    seed: u64,
) -> Case {
    let mut splats = fixture::splats_with_special_cases(model, camera, seed);
    if antialias == Antialias::Mip {
        splats.smoothing = fixture::smoothing(splats.len());
    }
    let mut name = format!("{} {label}", model.name());
    match antialias {
        Antialias::Off => {}
        Antialias::Pixel => name += " pixel",
        Antialias::Mip => name += " mip",
    }
    if masked {
        name += " mask";
    }
    let options = fixture::options(cutoffs, antialias);
    let mut loss = fixture::step(1, options).loss;
    if seed.is_multiple_of(2) {
        loss.squared_share = 0.0;
    } else {
        name += " squared";
    }
    Case { name, splats, view: fixture::view(camera, masked, seed + 1000), options, loss }
}

/// Returns the case with supersampling.
pub fn sampled(mut case: Case, samples: u8) -> Case {
    case.options.raster.samples = samples;
    case.name += &format!(" {samples}x{samples} samples");
    case
}

/// Returns cases of all colour models; cut-offs, anti-aliasing and mask alternate so that all
/// combinations occur.
pub fn cases() -> Vec<Case> {
    let (hdr, parity) = (("hdr", Cutoffs::HDR), ("parity", Cutoffs::PARITY));
    let (off, pixel, mip) = (Antialias::Off, Antialias::Pixel, Antialias::Mip);
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
    cases.push(case(lcd(3, 0, Activation::Softplus), pixel, hdr, false, 25));
    cases.push(case(ColorModel::Sh { degree: 3 }, pixel, parity, true, 26));
    cases.push(case(ColorModel::LogSh { degree: 3 }, pixel, hdr, true, 29));
    cases.push(case(ColorModel::LogSh { degree: 2 }, off, parity, false, 30));
    cases.push(sampled(case(lcd(3, 0, Activation::Softplus), pixel, hdr, true, 27), 2));
    cases.push(sampled(case(lcd(2, 1, Activation::Softplus), off, parity, false, 28), 3));
    cases
}

/// Gradients smaller than this share of their array's largest are compared by their absolute
/// difference only.
const SIZEABLE: f64 = 1e-3;

/// The largest difference within an array, relative to the array's largest gradient, and where; and
/// the largest relative to the gradient itself among the sizeable ones.
#[derive(Clone, Copy, Default)]
pub struct Worst {
    relative: f64,
    element: f64,
    index: usize,
    found: f64,
    expected: f64,
}

/// Compares each array of [`ARRAYS`]; `None` for arrays that the model does not have. `found` may
/// be `None` where it could not be measured.
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
        let difference = (found - expected).abs();
        let relative = difference / largest[array].max(f64::MIN_POSITIVE);
        let entry = worst[array].get_or_insert_default();
        if relative > entry.relative || relative.is_nan() {
            *entry = Worst { relative, index: i - first[array], found, expected, ..*entry };
        }
        if expected.abs() > SIZEABLE * largest[array] {
            entry.element = entry.element.max(difference / expected.abs());
        }
    }
    worst
}

pub fn check(case: &Case, worst: &[Option<Worst>; ARRAYS.len()], tolerance: f64, what: &str) {
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
            let limit = tolerance / SIZEABLE.sqrt();
            assert!(w.element < limit, "{}: {name} {what}: {:.1e} of a sizeable gradient, tolerance {limit:.0e}", case.name, w.element);
        }
    }
}

/// Central differences with h = 1e-5 leave h^2 of truncation, times third derivatives (large for
/// rotations of thin splats), and 1e-16 / h of rounding, against arrays whose largest gradient is
/// about 1e-4.
pub const DIFFERENCES_TOLERANCE: f64 = 1e-6;

/// f32 carries 6e-8; an exponent of alpha of up to 17 and SSIM's variances (differences of squares
/// of order 1 against C2 = 9e-4) cost up to two digits each. Relative to an array's largest
/// gradient; sizeable gradients themselves may be off by 30 times as much.
pub const ENGINE_TOLERANCE: f64 = 2e-5;

pub fn engine_gradient(case: &Case) -> (StepReport, Splats, DensifyStats) {
    let mut engine = CpuEngine::new(1).unwrap();
    engine.load(&case.splats, None).unwrap();
    let step = StepConfig { loss: case.loss, ..fixture::step(1, case.options) };
    let (report, gradient) = engine.gradients(&case.view, &step).unwrap();
    (report, gradient, engine.densify_stats().unwrap())
}

pub fn against_differences(case: &Case) -> [Option<Worst>; ARRAYS.len()] {
    let exact = oracle::differentiate(&case.splats, &case.view, &case.options, &case.loss);
    let numeric = oracle::central_differences(&case.splats, &case.view, &case.options, &case.loss);
    let measured = numeric.iter().flatten().count();
    // A parameter next to a decision (a pixel's threshold) cannot be measured; there are few.
    assert!(50 * measured >= 49 * numeric.len(), "{}: only {measured} of {} measured", case.name, numeric.len());
    compare(&case.splats, &numeric, &exact.gradient)
}

pub fn against_oracle(case: &Case) -> [Option<Worst>; ARRAYS.len()] {
    let exact = oracle::differentiate(&case.splats, &case.view, &case.options, &case.loss);
    let (_, gradient, _) = engine_gradient(case);
    let found: Vec<_> = oracle::flatten(&gradient).into_iter().map(Some).collect();
    compare(&case.splats, &found, &exact.gradient)
}

#[test]
fn oracle_gradient_is_that_of_central_differences() {
    let cases = cases();
    std::thread::scope(|scope| {
        for cases in cases.chunks(cases.len().div_ceil(2)) {
            scope.spawn(move || {
                for case in cases {
                    check(case, &against_differences(case), DIFFERENCES_TOLERANCE, "by differences");
                }
            });
        }
    });
}

#[test]
fn engine_gradient_is_the_oracles() {
    let cases: Vec<_> = cases().into_iter().map(|case| (against_oracle(&case), case)).collect();
    for (worst, case) in &cases {
        for (a, w) in ARRAYS.iter().zip(worst) {
            if let Some(w) = w {
                print!("{a} {:.1e}@{} ", w.relative, w.index);
            }
        }
        println!("{} ", case.name);
    }
    for (worst, case) in &cases {
        check(case, worst, ENGINE_TOLERANCE, "by the engine");
    }
}

/// Returns cases with images of a pixel, of a row, of a whole block and tile, and of a bit more;
/// the special cases scale with the image.
fn cases_of_sizes() -> Vec<Case> {
    [[1, 1], [1, 40], [40, 1], [4, 4], [32, 32], [17, 9], [33, 16], [65, 37]]
        .into_iter()
        .enumerate()
        .map(|(i, size)| {
            let antialias = if i % 2 == 0 { Antialias::Off } else { Antialias::Mip };
            let (camera, model) = (fixture::camera(size[0], size[1]), lcd(2, 1, Activation::Softplus));
            let mut case = case_of_camera(&camera, model, antialias, ("hdr", Cutoffs::HDR), i > 4, 90 + i as u64);
            case.name = format!("{} {size:?}", case.name);
            case
        })
        .collect()
}

#[test]
fn engine_gradient_is_the_oracles_at_any_size() {
    for case in cases_of_sizes() {
        check(&case, &against_oracle(&case), ENGINE_TOLERANCE, "by the engine");
    }
}

/// Tests more splats behind each pixel than the engine processes at once in any of its loops, on
/// both sides of a tile's edge.
#[test]
fn engine_gradient_is_the_oracles_where_many_splats_meet() {
    const COUNT: usize = 180;
    for (cutoffs, antialias) in [(Cutoffs::HDR, Antialias::Mip), (Cutoffs::PARITY, Antialias::Off)] {
        let mut case = case_of_camera(&fixture::camera(36, 10), lcd(1, 1, Activation::Softplus), antialias, ("crowd", cutoffs), false, 7);
        case.splats = fixture::splats(lcd(1, 1, Activation::Softplus), COUNT, &case.view.camera, 8);
        for (opacity_logit, log_scale) in case.splats.opacity_logit.iter_mut().zip(&mut case.splats.log_scale) {
            *opacity_logit = 0.3 * *opacity_logit - 3.5;
            *log_scale = log_scale.map(|s| s + 0.8);
        }
        if antialias == Antialias::Mip {
            case.splats.smoothing = fixture::smoothing(COUNT);
        }
        check(&case, &against_oracle(&case), ENGINE_TOLERANCE, "by the engine");
    }
}

#[test]
fn engine_loss_is_the_oracles() {
    for case in cases().into_iter().chain(cases_of_sizes()) {
        let exact = oracle::differentiate(&case.splats, &case.view, &case.options, &case.loss).loss;
        let (report, ..) = engine_gradient(&case);
        for (name, found, expected) in [("loss", report.loss, exact.total), ("l1", report.l1, exact.l1), ("ssim", report.ssim, exact.ssim)]
        {
            // Sums over a few thousand f32 of order 1.
            assert!((f64::from(found) - expected).abs() < 2e-6, "{}: {name} {found}, expected {expected}", case.name);
        }
    }
}

#[test]
fn engine_statistics_are_the_oracles() {
    for case in cases() {
        let exact = oracle::differentiate(&case.splats, &case.view, &case.options, &case.loss);
        let (_, _, stats) = engine_gradient(&case);
        let arrays = [("gradient", &stats.gradient, &exact.mean_gradient), ("abs_gradient", &stats.abs_gradient, &exact.abs_mean_gradient)];
        for (name, found, expected) in arrays {
            let largest = expected.iter().fold(0.0, |a: f64, b| a.max(*b));
            for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
                let error = (f64::from(*found) - expected).abs() / largest;
                assert!(error < ENGINE_TOLERANCE, "{}: {name}[{i}] {found:e}, expected {expected:e}", case.name);
            }
        }
        // Behind the camera: never visible. Special cases in front of it: visible.
        assert_eq!(stats.views[0], 0, "{}", case.name);
        assert_eq!(stats.views[3], 1, "{}", case.name);
    }
}

/// Writes the tables of `docs/src/reference/generated/gradients.md`.
#[test]
#[ignore = "a tool: cargo test --release -p luxel-cpu --test engine gradient_report -- --ignored"]
fn gradient_report() {
    use std::fmt::Write as _;
    let mut report = String::from(REPORT_HEAD);
    for (title, measure) in [
        ("The oracle's exact gradient against central differences, f64", against_differences as fn(&Case) -> _),
        ("The engine's gradient against the oracle's, f32", against_oracle),
    ] {
        writeln!(report, "\n## {title}\n\n| case | {} |\n|---|{}", ARRAYS.join(" | "), "---|".repeat(ARRAYS.len())).unwrap();
        let mut worst = Worst::default();
        for case in cases() {
            let row = measure(&case);
            let cells = row.map(|w| w.map_or(String::new(), |w| format!("{:.1e} / {:.1e}", w.relative, w.element)));
            writeln!(report, "| {} | {} |", case.name, cells.join(" | ")).unwrap();
            for w in row.into_iter().flatten() {
                worst.relative = worst.relative.max(w.relative);
                worst.element = worst.element.max(w.element);
            }
        }
        writeln!(report, "| **worst** | {:.1e} / {:.1e} |{}", worst.relative, worst.element, " |".repeat(ARRAYS.len() - 1)).unwrap();
    }
    print!("{report}");
    std::fs::write(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/src/reference/generated/gradients.md"), report).unwrap();
}

const REPORT_HEAD: &str = "\
# Gradients

The errors of the training objective's gradients, for every parameter of every colour model. Written by
`cargo test --release -p luxel-cpu --test engine gradient_report -- --ignored`. The tests
`oracle_gradient_is_that_of_central_differences` and `engine_gradient_is_the_oracles` hold every
number below a bound.

The oracle is a second implementation in f64 without tiles, differentiated exactly by a tape. Each
case is a scene of 16 splats on 21x13 pixels with everything that a splat can be: behind the camera,
beside the frustum with a clamped Jacobian, opaque ones behind each other (alpha capped, pixels
finished early), with clipped chromaticity channels, smaller than a pixel, with an unnormalised
quaternion. Background and regularisers are not zero, and radiance spans four decades. `parity` and
`hdr` are the presets of cut-offs, `pixel` is the pixel filter, `mip` that and the 3D filter, `mask`
an image with masked pixels, `2x2 samples` supersampling.

Each cell has two numbers: the largest difference in the array relative to the largest gradient of
the array, and the largest difference relative to the gradient itself among gradients above 1/1000
of the largest. An empty cell: the model has no such parameter.
";
