//! Edits of light as the engine renders them, and the splats that a mask selects.

use luxel_core::edit::{MaskShares, ShMap};
use luxel_core::{
    Activation, Antialias, Camera, CameraProjection, ColorModel, ColorSpace, Cutoffs, Edit, Engine, Image, RadianceScale, RasterConfig,
    RenderOptions, Scene, Selection, Splats, luminance_sum,
};
use luxel_cpu::CpuEngine;

use crate::{fixture, oracle};

fn lcd(activation: Activation) -> ColorModel {
    ColorModel::Lcd { chroma_degree: 3, luminance_degree: 0, activation }
}

fn scene(splats: Splats, cutoffs: Cutoffs) -> Scene {
    let raster = RasterConfig { cutoffs, antialias: Antialias::Off, ..RasterConfig::default() };
    Scene {
        splats,
        radiance_scale: RadianceScale::new(3.0).unwrap(),
        color_space: ColorSpace::LinearRec709,
        raster,
        edits: Vec::new(),
        world_from_local: luxel_core::Similarity::IDENTITY,
        metres_per_unit: None,
    }
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

/// Scenes under every colour model and both kinds of cut-offs, of splats below, between and above
/// the radiances at which cut-offs follow it.
fn scenes(camera: &Camera, splats: usize) -> Vec<Scene> {
    let lobed = ColorModel::Lcd { chroma_degree: 2, luminance_degree: 2, activation: Activation::Softplus };
    let (sh, log) = (ColorModel::Sh { degree: 3 }, ColorModel::LogSh { degree: 2 });
    let models = [lcd(Activation::Softplus), lcd(Activation::Exp), lcd(Activation::Relu), lobed, sh, log];
    let mut scenes: Vec<Scene> = models.into_iter().map(|model| scene(fixture::splats(model, splats, camera, 3), Cutoffs::HDR)).collect();
    scenes.push(scene(fixture::splats(lcd(Activation::Softplus), splats, camera, 3), Cutoffs::PARITY));
    let lights = fixture::three_lights(camera, splats);
    scenes.push(scene(fixture::mix(&lights.iter().map(|(splats, gain)| (splats, *gain)).collect::<Vec<_>>()), Cutoffs::HDR));
    scenes
}

fn values(image: &Image) -> &[f32] {
    image.pixels.as_flattened()
}

#[test]
fn a_gain_multiplies_every_pixel_whatever_it_is() {
    for camera in [fixture::camera(64, 48), fixture::wide_camera(CameraProjection::Equirectangular, 64, 32)] {
        for before in scenes(&camera, 150) {
            let found = render(&before, &camera);
            // What is added is 0 or more, so that the roundings of some tens of splats are relative
            // to the sum.
            for gain in [1.0 / 1024.0, 0.03, 0.7, 3.0, 100.0, 1024.0] {
                let edited = edited(&before, &format!("gain {gain}"));
                let label = format!("{} {:?} {gain}", before.splats.color_model.name(), before.raster.cutoffs);
                for (b, a) in values(&found).iter().zip(values(&render(&edited, &camera))) {
                    assert!((a - gain * b).abs() <= 3e-6 * gain * b, "{label}: {a} {}", gain * b);
                }
            }
            let there_and_back = edited(&edited(&before, "gain 8"), "stops -3");
            assert_eq!(there_and_back.splats, before.splats);
        }
    }
}

#[test]
fn a_map_on_a_selection_changes_the_light_of_its_splats_and_nothing_else() {
    let camera = fixture::camera(64, 48);
    let mut untouched = 0;
    // Few splats, so that there are pixels beyond those that are selected.
    for before in scenes(&camera, 30) {
        for (selection, map) in [("L > p80", "gain 30"), ("L < p30", "gain 0.01"), ("L in p20..p60", "stops 4")] {
            let after = edited(&before, &format!("where {selection}; {map}"));
            let of_selected = Scene { splats: only(&before, selection), ..before.clone() };
            let [b, a, selected] = [&before, &after, &of_selected].map(|scene| render(scene, &camera));
            let gain = edited(&before, map).luminance(0) / before.luminance(0);
            let label = format!("{}: {selection}; {map}", before.splats.color_model.name());
            for ((b, a), selected) in values(&b).iter().zip(values(&a)).zip(values(&selected)) {
                let expected = b + (gain - 1.0) * selected;
                // The difference has the roundings of what it is made of.
                assert!((a - expected).abs() <= 5e-6 * (b + gain * selected), "{label}: {a} {expected}");
                assert!(*selected > 0.0 || a == b, "{label}: {a} {b} where none of the selected is");
            }
            untouched += values(&selected).iter().filter(|value| **value == 0.0).count();
        }
    }
    assert!(untouched > 1000, "{untouched}");
}

/// Returns the splats with only the light of those that are selected.
fn only(scene: &Scene, selection: &str) -> Splats {
    let selection: Selection = selection.parse().unwrap();
    let weights = selection.weights(scene, &MaskShares::new()).unwrap();
    Splats { gain: weights, ..scene.splats.clone() }
}

#[test]
fn harmonics_fitted_to_a_map_reach_no_pixel_that_they_did_not() {
    let camera = fixture::camera(64, 48);
    let (mut beyond, mut edits) = (0, 0);
    for model in [ColorModel::Sh { degree: 3 }, ColorModel::LogSh { degree: 2 }] {
        let before = scene(fixture::splats(model, 30, &camera, 3), Cutoffs::HDR);
        for selection in ["L > p80", "L in p50..p90"] {
            for map in ["power 1.6", "power 0.5", "compress-above 0.3:4", "lift-below 20:0.7"] {
                let after = edited(&before, &format!("where {selection}; {map}"));
                let of_selected = Scene { splats: only(&before, selection), ..before.clone() };
                let [b, a, selected] = [&before, &after, &of_selected].map(|scene| render(scene, &camera));
                let outside = || (0..b.pixels.len()).filter(|i| selected.pixels[*i] == [0.0; 3]);
                let changed = outside().filter(|i| a.pixels[*i] != b.pixels[*i]).count();
                assert_eq!(changed, 0, "{}: {selection}; {map}", model.name());
                beyond += outside().count();
                edits += usize::from(a != b);
            }
        }
    }
    assert!(beyond > 100 && edits > 8, "{beyond} pixels beyond the selected splats, {edits} edits that change the image");
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

/// The contributions of splats to an image, in f64 over all pixels.
struct Given {
    /// Masked, blended and unoccluded weights of every splat, and its light.
    sums: [Vec<f64>; 4],
    /// For each splat how far a pixel that is nearly decided the other way (alpha or transmittance
    /// within 1e-4 of its threshold) could move them.
    open: Vec<f64>,
    /// Largest channel of every splat's radiance, 0 for those that are not on the screen.
    brightest: Vec<f64>,
    /// Pairs of a splat and a pixel: above the threshold, blended, and nearly decided the other
    /// way.
    touched: u64,
    alive: u64,
    undecided: u64,
}

fn contributions_of_oracle(splats: &Splats, camera: &Camera, options: &RenderOptions, mask: &[f32]) -> Given {
    let cutoffs = options.raster.cutoffs;
    let near = |value: f64, threshold: f64| (value / threshold - 1.0).abs() < 1e-4;
    let mut sums = [(); 4].map(|()| vec![0.0; splats.len()]);
    let mut open = vec![0.0; splats.len()];
    let [mut touched, mut alive, mut undecided] = [0; 3];
    let rendered = oracle::image(splats, camera, options);
    let mut brightest = vec![0.0; splats.len()];
    rendered.ellipses.iter().for_each(|e| brightest[e.splat] = e.radiance.into_iter().fold(0.0, f64::max));
    let width = camera.size_px[0] as usize;
    for (pixel, painted) in mask.iter().enumerate() {
        let center = [pixel % width, pixel / width].map(|c| c as f64 + 0.5);
        let (mut transmittance, mut is_finished, mut is_open) = (1.0, false, false);
        for e in &rendered.ellipses {
            let d = [0, 1].map(|a| center[a] - e.mean_px[a]);
            let power = e.conic[0] * d[0] * d[0] + 2.0 * e.conic[1] * d[0] * d[1] + e.conic[2] * d[1] * d[1];
            let alpha = (e.opacity * (-0.5 * power).exp()).min(cutoffs.max_alpha.into());
            is_open |= near(alpha, e.threshold);
            if alpha >= e.threshold {
                let left = transmittance * (1.0 - alpha);
                is_open |= near(left, cutoffs.min_transmittance.into());
                is_finished |= left < f64::from(cutoffs.min_transmittance);
                sums[2][e.splat] += alpha;
                touched += 1;
                if !is_finished {
                    alive += 1;
                    sums[1][e.splat] += transmittance * alpha;
                    let masked = transmittance * alpha * f64::from(*painted);
                    sums[0][e.splat] += masked;
                    sums[3][e.splat] += masked * brightest[e.splat];
                    transmittance = left;
                }
            }
            open[e.splat] += if is_open { alpha } else { 0.0 };
            undecided += u64::from(is_open);
        }
    }
    Given { sums, open, brightest, touched, alive, undecided }
}

#[test]
fn contributions_are_those_of_the_oracle() {
    let models = [ColorModel::Sh { degree: 1 }, lcd(Activation::Softplus)];
    for (model, cutoffs, antialias) in [
        (models[0], Cutoffs::PARITY, Antialias::Off),
        (models[1], Cutoffs::HDR, Antialias::Off),
        (models[1], Cutoffs::HDR, Antialias::Pixel),
        (models[1], Cutoffs::HDR, Antialias::Mip),
        (models[0], Cutoffs::PARITY, Antialias::Mip),
    ] {
        // Several tiles, the last ones cut; splats that are opaque, hidden, beside the image and
        // behind the camera.
        let camera = fixture::camera(75, 41);
        let mut splats = fixture::splats_with_special_cases(model, &camera, 21);
        splats.smoothing = fixture::smoothing(splats.len());
        // A small one behind two large ones that are nearly opaque.
        for (i, log_scale, opacity_logit) in [(3, 0.2, 3.5), (4, 0.2, 3.5), (5, -2.2, 3.0)] {
            splats.log_scale[i] = [log_scale; 3];
            splats.opacity_logit[i] = opacity_logit;
        }
        let options = fixture::options(cutoffs, antialias);
        let mask: Vec<f32> = (0..75 * 41).map(|i| (i % 7) as f32 / 6.0).collect();
        let mut engine = CpuEngine::new(2).unwrap();
        engine.load(&splats, None).unwrap();
        let found = engine.contributions(&camera, &options, &mask).unwrap();
        let counted = engine.evaluations(&camera, &options).unwrap().unwrap();
        let Given { sums: expected, open, brightest, touched, alive, undecided } =
            contributions_of_oracle(&splats, &camera, &options, &mask);
        let label = format!("{} {cutoffs:?} {antialias:?}", model.name());
        for (name, found, expected) in [
            ("masked", &found.masked, &expected[0]),
            ("blended", &found.blended, &expected[1]),
            ("unoccluded", &found.unoccluded, &expected[2]),
            ("light", &found.light, &expected[3]),
        ] {
            assert_eq!(found.len(), splats.len());
            for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
                // The light of a unit of weight.
                let unit = if name == "light" { brightest[i] } else { 1.0 };
                let tolerance = 1e-4 * expected + (1e-5 + open[i]) * unit;
                assert!((f64::from(*found) - expected).abs() <= tolerance, "{label}: {name} of splat {i} is {found}, expected {expected}");
            }
        }
        assert!(undecided < alive / 20, "{label}: {undecided} of {alive}");
        assert!(counted.alive.abs_diff(alive) <= undecided, "{label}: {counted:?}, expected {alive} within {undecided}");
        assert!(
            counted.touched.is_multiple_of(16) && counted.touched + undecided >= touched,
            "{label}: {counted:?}, above the threshold {touched}"
        );
        // The scene has all cases: few pixels are undecided; some splats are visible, some hidden,
        // some off the screen.
        assert!(open.iter().sum::<f64>() < 0.01 * expected[1].iter().sum::<f64>(), "{label}");
        let hidden = (0..splats.len()).filter(|i| expected[1][*i] < 0.05 * expected[2][*i]).count();
        let absent = expected[2].iter().filter(|sum| **sum == 0.0).count();
        assert!(hidden > 0 && absent > 0 && hidden + absent < splats.len() / 2, "{label}: {hidden} {absent}");
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
    let sum =
        |values: &[f32], weight: &dyn Fn(usize) -> f64| values.iter().enumerate().map(|(i, v)| f64::from(*v) * weight(i)).sum::<f64>();
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
