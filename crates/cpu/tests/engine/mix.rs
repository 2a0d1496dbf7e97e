//! Mixes of light: a render is the weighted sum of the renders of the lights.

use luxel_core::edit::{MaskShares, ShMap};
use luxel_core::{
    Antialias, Camera, CameraProjection, ColorSpace, Cutoffs, Edit, Engine, Image, RadianceScale, RasterConfig, RenderOptions, Scene,
    Similarity, Splats,
};
use luxel_cpu::CpuEngine;

use crate::fixture;

fn loaded(splats: &Splats) -> CpuEngine {
    let mut engine = CpuEngine::new(1).unwrap();
    engine.load(splats, None).unwrap();
    engine
}

/// Returns the weighted sum of renders.
fn sum(lights: &[(Splats, f32)], camera: &Camera, options: &RenderOptions) -> Image {
    let mut total: Option<Image> = None;
    for (splats, gain) in lights {
        let mut image = loaded(splats).render(camera, options).unwrap();
        image.pixels.as_flattened_mut().iter_mut().for_each(|value| *value *= gain);
        total = Some(match total {
            None => image,
            Some(total) => total.plus(image),
        });
    }
    total.unwrap()
}

fn assert_equal_to_rounding(found: &Image, expected: &Image, what: &str) {
    for (found, expected) in found.pixels.as_flattened().iter().zip(expected.pixels.as_flattened()) {
        assert!((found - expected).abs() <= 5e-6 * expected.abs() + 1e-9, "{what}: {found} {expected}");
    }
}

fn mixed(lights: &[(Splats, f32)]) -> Splats {
    fixture::mix(&lights.iter().map(|(splats, gain)| (splats, *gain)).collect::<Vec<_>>())
}

#[test]
fn a_render_of_a_mix_is_the_weighted_sum_of_renders() {
    let pinhole = fixture::camera(64, 48);
    let lights = fixture::three_lights(&pinhole, 150);
    let mix = mixed(&lights);
    let panorama = fixture::wide_camera(CameraProjection::Equirectangular, 64, 32);
    for (camera, cutoffs, antialias, samples, active_degree) in [
        (&pinhole, Cutoffs::HDR, Antialias::Pixel, 1, 5),
        (&pinhole, Cutoffs::PARITY, Antialias::Off, 1, 5),
        (&pinhole, Cutoffs::HDR, Antialias::Off, 2, 5),
        (&pinhole, Cutoffs::HDR, Antialias::Off, 1, 1),
        (&panorama, Cutoffs::HDR, Antialias::Pixel, 1, 5),
    ] {
        let options = RenderOptions { raster: RasterConfig { cutoffs, antialias, samples }, background: [0.0; 3], active_degree };
        let expected = sum(&lights, camera, &options);
        assert!(expected.pixels.iter().any(|p| p[0] > 0.1));
        let what = format!("{antialias:?} {samples} {active_degree} {:?}", camera.projection);
        assert_equal_to_rounding(&loaded(&mix).render(camera, &options).unwrap(), &expected, &what);
        let layers = loaded(&mix).render_layers(camera, &options).unwrap();
        assert_equal_to_rounding(&layers.image, &expected, &what);
    }
}

#[test]
fn the_background_is_there_once() {
    let camera = fixture::camera(32, 24);
    let splats = fixture::three_lights(&camera, 40).swap_remove(0).0;
    let options = RenderOptions { background: [3.0, 2.0, 1.0], ..RenderOptions::default() };
    let expected = loaded(&splats).render(&camera, &options).unwrap();
    let half = mixed(&[(splats.clone(), 0.5), (splats, 0.5)]);
    let found = loaded(&half).render(&camera, &options).unwrap();
    for (found, expected) in found.pixels.as_flattened().iter().zip(expected.pixels.as_flattened()) {
        assert!((found - expected).abs() <= 5e-6 * expected, "{found} {expected}");
    }
}

#[test]
fn an_edit_of_a_light_is_the_mix_of_another_weight() {
    let camera = fixture::camera(48, 36);
    let mut lights = fixture::three_lights(&camera, 80);
    let raster = RasterConfig::default();
    let mut scene = Scene {
        splats: mixed(&lights),
        radiance_scale: RadianceScale::ONE,
        color_space: ColorSpace::default(),
        raster,
        edits: Vec::new(),
        world_from_local: Similarity::IDENTITY,
        metres_per_unit: None,
    };
    let edit: Edit = "light 2:4; gain 0.5; light 3:0".parse().unwrap();
    assert_eq!(edit.to_string(), "where all; light 2:4; gain 0.5; light 3:0");
    edit.apply(&mut scene, &MaskShares::new(), ShMap::Luminance).unwrap();
    for ((_, gain), factor) in lights.iter_mut().zip([0.5, 2.0, 0.0]) {
        *gain *= factor;
    }
    let options = RenderOptions { raster, ..RenderOptions::default() };
    assert_equal_to_rounding(&loaded(&scene.splats).render(&camera, &options).unwrap(), &sum(&lights, &camera, &options), "edited");
    let before = scene.clone();
    let none = "light 4:1".parse::<Edit>().unwrap().apply(&mut scene, &MaskShares::new(), ShMap::Luminance).unwrap_err();
    assert!(none.to_string().contains("light 4: the scene has 3 lights"), "{none}");
    assert_eq!(scene, before);
}

#[test]
fn a_turned_mix_has_its_colours_in_the_turned_directions() {
    let camera = fixture::camera(48, 36);
    let mut lights = fixture::three_lights(&camera, 80);
    let turn = Similarity::turn(glam::DMat3::from_rotation_y(0.7)).unwrap();
    let mut mix = mixed(&lights);
    turn.apply(&mut mix);
    lights.iter_mut().for_each(|(splats, _)| turn.apply(splats));
    assert_eq!(mix.sh, mixed(&lights).sh);
    assert_eq!(mix.raw_luminance, mixed(&lights).raw_luminance);
}

#[test]
fn a_mask_and_counts_are_of_all_lights() {
    let camera = fixture::camera(48, 36);
    let lights = fixture::three_lights(&camera, 60);
    let mut mix = loaded(&mixed(&lights));
    let options = RenderOptions::default();
    let mask: Vec<f32> = (0..48 * 36).map(|i| f32::from(u8::from(i % 48 < 24))).collect();
    let found = mix.contributions(&camera, &options, &mask).unwrap();
    let parts: Vec<_> = lights.iter().map(|(splats, _)| loaded(splats).contributions(&camera, &options, &mask).unwrap()).collect();
    for i in 0..60 {
        let light: f32 = parts.iter().zip(&lights).map(|(part, (_, gain))| gain * part.light[i]).sum();
        let blended = parts.iter().map(|part| part.blended[i]).sum::<f32>() / 3.0;
        assert!((found.light[i] - light).abs() <= 1e-5 * light && (found.blended[i] - blended).abs() <= 1e-5 * blended, "{i}");
    }
    let count = |splats: &Splats| loaded(splats).evaluations(&camera, &options).unwrap().unwrap().alive;
    assert_eq!(count(&mixed(&lights)), lights.iter().map(|(splats, _)| count(splats)).sum());
}

#[test]
fn a_mix_is_not_trained() {
    let camera = fixture::camera(32, 24);
    let lights = fixture::three_lights(&camera, 20);
    let mut engine = loaded(&mixed(&lights));
    let (view, step) = (fixture::view(&camera, false, 5), fixture::step(1, RenderOptions::default()));
    for error in [engine.train_step(&view, &step).unwrap_err(), engine.camera_gradient(&view, &step).unwrap_err()] {
        assert!(error.to_string().contains("mix of lights"), "{error}");
    }
}
