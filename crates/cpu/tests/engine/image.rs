//! The engine's images: compared with the oracle's, and properties that any renderer of radiance
//! must have.

use luxel_core::{Activation, Antialias, Camera, ColorModel, Cutoffs, Engine, Image, RenderOptions, Splats, luminance_sum};
use luxel_cpu::{CpuEngine, InstructionSet};

use crate::fixture;
use crate::oracle;

const LCD: ColorModel = ColorModel::Lcd { chroma_degree: 3, luminance_degree: 0, activation: Activation::Softplus };

fn render(splats: &Splats, camera: &Camera, options: &RenderOptions) -> Image {
    let mut engine = CpuEngine::new(1).unwrap();
    engine.load(splats, None).unwrap();
    engine.render(camera, options).unwrap()
}

fn on_black(cutoffs: Cutoffs) -> RenderOptions {
    RenderOptions { background: [0.0; 3], ..fixture::options(cutoffs, Antialias::Off) }
}

/// Relative rounding of a pixel: exponents of alpha up to 17 in f32, summed over splats.
const ROUNDING: f64 = 2e-5;
/// A pixel whose alpha or transmittance is this near (relatively) to a threshold may fall on either
/// side of it.
const BAND: f64 = 1e-4;
/// A ray whose angle to a splat is this near to a right angle (cosine) may see the splat or not:
/// both directions and their product are rounded to f32.
const EDGE: f64 = 1e-6;

/// Compares `image` with the oracle's: tightly where decisions are clear; elsewhere by no more than
/// the decision can change.
pub fn assert_is_oracles(image: &Image, splats: &Splats, camera: &Camera, options: &RenderOptions, name: &str) {
    let expected = oracle::image(splats, camera, options);
    assert_eq!(image.pixels.len(), expected.pixels.len());
    let cutoffs = options.raster.cutoffs;
    let brightest = expected.ellipses.iter().flat_map(|e| e.radiance).fold(1.0, f64::max);
    let band = brightest * f64::from(cutoffs.min_alpha.max(cutoffs.min_transmittance));
    for (i, (found, expected_pixel)) in image.pixels.iter().zip(&expected.pixels).enumerate() {
        for c in 0..3 {
            let (found, expected_value) = (f64::from(found[c]), expected_pixel[c]);
            let decision = match (expected.margin[i] < BAND, expected.edge[i] < EDGE) {
                (_, true) => brightest,
                (true, false) => band,
                (false, false) => 0.0,
            };
            let tolerance = ROUNDING * expected_value.max(1e-3) + decision;
            assert!(
                (found - expected_value).abs() <= tolerance,
                "{name}: pixel {}, {} channel {c}: {found:e}, expected {expected_value:e}, tolerance {tolerance:.1e}",
                i % image.width,
                i / image.width
            );
        }
    }
    // Few pixels may be in the band.
    let unclear = expected.margin.iter().zip(&expected.edge).filter(|(margin, edge)| **margin < BAND || **edge < EDGE).count();
    assert!(unclear * 20 <= image.pixels.len(), "{name}: {unclear} of {} pixels are at a threshold", image.pixels.len());
}

fn models() -> Vec<ColorModel> {
    let mut models: Vec<_> = (0..=5).map(|degree| ColorModel::Sh { degree }).collect();
    for activation in [Activation::Softplus, Activation::Exp, Activation::Relu] {
        models.extend((0..=5).map(|chroma_degree| ColorModel::Lcd { chroma_degree, luminance_degree: chroma_degree % 4, activation }));
    }
    models.extend([0, 3].map(|degree| ColorModel::LogSh { degree }));
    models
}

#[test]
fn image_is_the_oracles() {
    for (size, count) in [([64, 40], 60), ([37, 53], 60), ([8, 8], 16), ([1, 1], 16), ([9, 7], 16)] {
        let camera = fixture::camera(size[0], size[1]);
        for (seed, model) in models().into_iter().enumerate() {
            for antialias in [Antialias::Off, Antialias::Pixel, Antialias::Mip] {
                for (label, cutoffs) in [("parity", Cutoffs::PARITY), ("hdr", Cutoffs::HDR)] {
                    let seed = seed as u64 + 50;
                    let mut splats = match count {
                        16 => fixture::splats_with_special_cases(model, &camera, seed),
                        _ => fixture::splats(model, count, &camera, seed),
                    };
                    splats.smoothing = fixture::smoothing(splats.len());
                    let options = fixture::options(cutoffs, antialias);
                    let name = format!("{} {antialias:?} {label} {size:?}", model.name());
                    assert_is_oracles(&render(&splats, &camera, &options), &splats, &camera, &options, &name);
                }
            }
        }
    }
}

#[test]
fn harmonics_above_the_active_degree_are_not_seen() {
    let camera = fixture::camera(24, 20);
    let splats = fixture::splats(ColorModel::Lcd { chroma_degree: 5, luminance_degree: 3, activation: Activation::Exp }, 30, &camera, 3);
    for active_degree in 0..=5 {
        let options = RenderOptions { active_degree, ..fixture::options(Cutoffs::HDR, Antialias::Off) };
        assert_is_oracles(&render(&splats, &camera, &options), &splats, &camera, &options, &format!("active degree {active_degree}"));
    }
}

#[test]
fn image_of_scaled_luminance_is_the_scaled_image_on_black() {
    // The thresholds of the parity preset do not depend on radiance, so the property is exact up to
    // rounding.
    let camera = fixture::camera(40, 30);
    for (activation, luminance_degree) in [(Activation::Softplus, 0), (Activation::Exp, 3), (Activation::Relu, 3)] {
        let model = ColorModel::Lcd { chroma_degree: 3, luminance_degree, activation };
        let splats = fixture::splats(model, 60, &camera, 11);
        let reference = render(&splats, &camera, &on_black(Cutoffs::PARITY));
        for factor in [0.125f32, 3.0, 1000.0] {
            let mut scaled = splats.clone();
            let width = model.luminance_coefficients();
            for raw in scaled.raw_luminance.chunks_mut(width) {
                match activation {
                    Activation::Softplus => raw[0] = activation.inverse(factor * activation.apply(raw[0])),
                    Activation::Exp => raw[0] += factor.ln(),
                    Activation::Relu => raw.iter_mut().for_each(|l| *l *= factor),
                }
            }
            let image = render(&scaled, &camera, &on_black(Cutoffs::PARITY));
            for (i, (found, pixel)) in image.pixels.as_flattened().iter().zip(reference.pixels.as_flattened()).enumerate() {
                let expected = factor * pixel;
                // The inverse of an activation in f32: 1e-7 of a raw luminance of up to 10, and of
                // softplus' far tail.
                assert!(
                    (found - expected).abs() <= 1e-5 * expected + 1e-7,
                    "{activation:?} x {factor} value {i}: {found:e}, expected {expected:e}"
                );
            }
        }
    }
}

#[test]
fn scaling_luminance_leaves_chromaticity() {
    let camera = fixture::camera(40, 30);
    let mut splats = fixture::splats(LCD, 1, &camera, 5);
    splats.position[0] = fixture::unproject(&camera, [20.0, 15.0], 3.0);
    splats.log_scale[0] = [-0.5; 3];
    splats.opacity_logit[0] = 1.0;
    let mut reference: Option<[f32; 3]> = None;
    for luminance in [1e-3f32, 0.5, 1e4] {
        splats.raw_luminance[0] = Activation::Softplus.inverse(luminance);
        for (i, pixel) in
            render(&splats, &camera, &on_black(Cutoffs::HDR)).pixels.iter().enumerate().filter(|(_, p)| luminance_sum(**p) > 0.0)
        {
            let chromaticity = pixel.map(|c| c / luminance_sum(*pixel));
            let expected = *reference.get_or_insert(chromaticity);
            for c in 0..3 {
                assert!((chromaticity[c] - expected[c]).abs() < 1e-6, "pixel {i} at {luminance}: {chromaticity:?}, expected {expected:?}");
            }
        }
    }
    assert!(reference.is_some());
}

#[test]
fn order_of_splats_does_not_matter() {
    let camera = fixture::camera(50, 34);
    let splats = fixture::splats(LCD, 90, &camera, 12);
    let shuffled = splats.select((0..90).map(|i| i * 37 % 90));
    let options = fixture::options(Cutoffs::HDR, Antialias::Off);
    assert_eq!(render(&splats, &camera, &options), render(&shuffled, &camera, &options));
}

#[test]
fn instruction_set_does_not_matter_beyond_rounding() {
    let camera = fixture::camera(50, 34);
    let splats = fixture::splats(LCD, 90, &camera, 13);
    let options = fixture::options(Cutoffs::HDR, Antialias::Mip);
    let mut engine = CpuEngine::new(1).unwrap();
    engine.set_instruction_set(InstructionSet::Baseline).unwrap();
    engine.load(&splats, None).unwrap();
    assert_is_oracles(&engine.render(&camera, &options).unwrap(), &splats, &camera, &options, "baseline");
}

#[test]
fn empty_scene_is_the_background() {
    let camera = fixture::camera(19, 11);
    let options = fixture::options(Cutoffs::HDR, Antialias::Off);
    let image = render(&Splats::empty(LCD), &camera, &options);
    assert_eq!(image, Image::filled(19, 11, options.background));
    // The image of an engine that never loaded a scene is the background, too.
    assert_eq!(CpuEngine::new(1).unwrap().render(&camera, &options).unwrap(), image);
}

#[test]
fn splat_behind_the_camera_is_not_seen() {
    let camera = fixture::camera(19, 11);
    let options = fixture::options(Cutoffs::HDR, Antialias::Off);
    let mut splats = fixture::splats(LCD, 1, &camera, 1);
    for depth in [-3.0, -1e-3, 0.0, 0.009] {
        splats.position[0] = fixture::unproject(&camera, [9.0, 5.0], depth);
        splats.log_scale[0] = [2.0; 3];
        assert_eq!(render(&splats, &camera, &options), Image::filled(19, 11, options.background), "depth {depth}");
    }
}

#[test]
fn splat_on_a_pixel_shows_its_opacity_there() {
    let camera = Camera { center_px: [10.0, 6.0].into(), focal_px: [20.0, 20.0].into(), ..fixture::camera(21, 13) };
    let mut splats = fixture::splats(ColorModel::Sh { degree: 0 }, 1, &camera, 1);
    splats.position[0] = fixture::unproject(&camera, [10.5, 6.5], 3.0);
    splats.log_scale[0] = [-1.5; 3];
    splats.opacity_logit[0] = 0.0;
    splats.sh = ColorModel::Sh { degree: 0 }.constant([4.0, 2.0, 0.5]).0.to_vec();
    let image = render(&splats, &camera, &on_black(Cutoffs::PARITY));
    let center = image.at(10, 6);
    for (found, expected) in center.into_iter().zip([2.0f32, 1.0, 0.25]) {
        assert!((found - expected).abs() < 1e-5 * expected, "{center:?}");
    }
    for (x, y) in [(10, 7), (10, 5), (9, 6), (11, 6)] {
        assert!(image.at(x, y)[0] < center[0] && image.at(x, y)[0] > 0.0);
    }
}

#[test]
fn splat_that_fills_the_screen_is_the_oracles() {
    let camera = fixture::camera(61, 45);
    for (log_scale, depth) in [(1.0, 2.0), (3.0, 5.0), (7.0, 2000.0)] {
        let mut splats = fixture::splats(LCD, 2, &camera, 1);
        splats.position[0] = fixture::unproject(&camera, [30.0, 20.0], depth);
        splats.log_scale[0] = [log_scale; 3];
        splats.opacity_logit[0] = 0.5;
        let options = fixture::options(Cutoffs::HDR, Antialias::Off);
        assert_is_oracles(&render(&splats, &camera, &options), &splats, &camera, &options, &format!("log scale {log_scale}"));
    }
}

#[test]
fn camera_inside_a_splat_is_the_oracles() {
    let camera = fixture::camera(33, 25);
    let mut splats = fixture::splats(LCD, 3, &camera, 1);
    for (i, depth) in [0.011, 0.05, 0.4].into_iter().enumerate() {
        splats.position[i] = fixture::unproject(&camera, [11.0 + 4.0 * i as f64, 12.0], depth);
        splats.log_scale[i] = [0.0, 0.3, -0.2];
        splats.opacity_logit[i] = -1.0;
    }
    let options = fixture::options(Cutoffs::HDR, Antialias::Off);
    assert_is_oracles(&render(&splats, &camera, &options), &splats, &camera, &options, "camera inside");
}
