//! Edits of light as the engine shows them, and which splats a mask means.

use luxel_core::edit::{MaskShares, ShMap};
use luxel_core::{
    Activation, Antialias, Camera, ColorModel, ColorSpace, Cutoffs, Edit, Engine, Image, RasterConfig, RenderOptions, Scene, Splats,
    luminance_sum,
};
use luxel_cpu::CpuEngine;

use crate::fixture;

fn lcd(activation: Activation) -> ColorModel {
    ColorModel::Lcd { chroma_degree: 3, luminance_degree: 0, activation }
}

fn scene(splats: Splats, cutoffs: Cutoffs) -> Scene {
    let raster = RasterConfig { cutoffs, antialias: Antialias::Off };
    Scene { splats, radiance_scale: 3.0, color_space: ColorSpace::LinearRec709, raster, edits: Vec::new() }
}

fn edited(scene: &Scene, text: &str) -> Scene {
    let mut scene = scene.clone();
    for edit in Edit::parse_all(text).unwrap() {
        edit.apply(&mut scene, &MaskShares::new(), ShMap::Luminance).unwrap();
    }
    scene
}

fn render(scene: &Scene, camera: &Camera) -> Image {
    let mut engine = CpuEngine::new(1).unwrap();
    engine.load(&scene.splats, None).unwrap();
    engine.render(camera, &RenderOptions { raster: scene.raster, ..RenderOptions::default() }).unwrap()
}

/// Calls `check` with every value of the image before and after a gain, and the gain.
fn each_value(model: ColorModel, cutoffs: Cutoffs, gain: f32, check: impl Fn(f32, f32)) {
    let camera = fixture::camera(64, 48);
    let before = scene(fixture::splats(model, 120, &camera, 3), cutoffs);
    let after = render(&edited(&before, &format!("gain {gain}")), &camera);
    for (b, a) in render(&before, &camera).pixels.as_flattened().iter().zip(after.pixels.as_flattened()) {
        check(*b, *a);
    }
}

#[test]
fn gain_multiplies_every_pixel_on_black() {
    // Nothing but exponents change: to the bit.
    for gain in [0.25, 8.0] {
        each_value(lcd(Activation::Relu), Cutoffs::PARITY, gain, |b, a| assert_eq!(a, gain * b));
    }
    // To the rounding of the activation's inverse, and of the offset of 1/2.
    for gain in [0.03, 0.7, 3.0, 100.0] {
        for model in [lcd(Activation::Softplus), lcd(Activation::Exp), lcd(Activation::Relu), ColorModel::Sh { degree: 3 }] {
            each_value(model, Cutoffs::PARITY, gain, |b, a| {
                assert!((a - gain * b).abs() <= 2e-5 * gain * b + 1e-6 * (1.0 + gain), "{}: {a} {}", model.name(), gain * b);
            });
        }
    }
}

#[test]
fn cutoffs_that_follow_radiance_keep_a_gain_within_what_they_skip() {
    for gain in [0.1, 4.0] {
        // 120 splats, each skipped below the threshold once, and what is behind finished pixels.
        let skipped = 120.0 * Cutoffs::HDR.min_contribution * f32::max(gain, 1.0);
        each_value(lcd(Activation::Softplus), Cutoffs::HDR, gain, |b, a| {
            assert!((a - gain * b).abs() <= 1e-3 * gain * b + skipped, "{a} {}", gain * b);
        });
    }
}

#[test]
fn any_map_moves_a_pixel_along_the_colours_of_its_splats() {
    // Splats of one chromaticity: whatever the map, so are all pixels.
    let camera = fixture::camera(48, 48);
    let model = lcd(Activation::Softplus);
    let mut splats = fixture::splats(model, 80, &camera, 5);
    let k = 3 * model.sh_coefficients();
    for sh in splats.sh.chunks_exact_mut(k) {
        sh.fill(0.0);
        sh[..3].copy_from_slice(&model.constant([0.6, 0.3, 0.1]).0);
    }
    let before = scene(splats, Cutoffs::HDR);
    for edit in ["power 1.2", "compress-above 0.1:4", "where L < p50 ~2; lift-below 1:0.7", "curve 0.01:0.1,1:1,10:2"] {
        for pixel in render(&edited(&before, edit), &camera).pixels {
            let luminance = luminance_sum(pixel);
            for (channel, share) in pixel.iter().zip([0.6, 0.3, 0.1]) {
                assert!((channel - share * luminance).abs() <= 3e-3 * luminance, "{edit}: {pixel:?}");
            }
        }
    }
}

#[test]
fn contributions_are_the_images_weights() {
    let camera = fixture::camera(70, 45);
    let model = ColorModel::Sh { degree: 0 };
    let mut before = scene(fixture::splats(model, 150, &camera, 9), Cutoffs::PARITY);
    // One channel with the index of the splat, one with 1.
    for (i, sh) in before.splats.sh.chunks_exact_mut(3).enumerate() {
        sh.copy_from_slice(&model.constant([i as f32 / 150.0, 1.0, 0.0]).0);
    }
    let image = render(&before, &camera);
    let mask: Vec<f32> = (0..image.pixels.len()).map(|i| if i % 70 > 30 { 1.0 } else { 0.25 }).collect();
    let contributions = |threads| {
        let mut engine = CpuEngine::new(threads).unwrap();
        engine.load(&before.splats, None).unwrap();
        engine.contributions(&camera, &RenderOptions { raster: before.raster, ..RenderOptions::default() }, &mask).unwrap()
    };
    let found = contributions(1);
    assert_eq!(found, contributions(3));
    let sum = |values: &[f32], weight: &dyn Fn(usize) -> f64| {
        values.iter().enumerate().map(|(i, v)| f64::from(*v) * weight(i)).sum::<f64>()
    };
    let of_image = |channel: usize, mask: &dyn Fn(usize) -> f32| {
        image.pixels.iter().enumerate().map(|(i, p)| f64::from(p[channel]) * f64::from(mask(i))).sum::<f64>()
    };
    let pairs = [
        (sum(&found.blended, &|_| 1.0), of_image(1, &|_| 1.0)),
        (sum(&found.blended, &|i| i as f64 / 150.0), of_image(0, &|_| 1.0)),
        (sum(&found.masked, &|_| 1.0), of_image(1, &|i| mask[i])),
        (sum(&found.masked, &|i| i as f64 / 150.0), of_image(0, &|i| mask[i])),
    ];
    for (found, expected) in pairs {
        assert!((found - expected).abs() < 1e-4 * expected, "{found} {expected}");
    }
    for i in 0..150 {
        assert!(found.masked[i] <= found.blended[i] * 1.0001 && found.blended[i] <= found.unoccluded[i] * 1.0001, "splat {i}");
    }
    let refused = CpuEngine::new(1).unwrap().contributions(&camera, &RenderOptions::default(), &mask[1..]);
    assert!(refused.unwrap_err().to_string().contains("mask holds"));
}
