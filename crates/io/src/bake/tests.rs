use luxel_core::{Activation, Conversion, RadianceScale, synthetic};
use proptest::prelude::*;

use super::*;

fn scene(model: ColorModel, color_space: ColorSpace) -> Scene {
    let splats = synthetic::room(40, 3).with_color_model(model).unwrap();
    Scene {
        splats,
        radiance_scale: RadianceScale::new(2.5).unwrap(),
        color_space,
        raster: RasterConfig::default(),
        edits: Vec::new(),
        world_from_local: Similarity::IDENTITY,
        metres_per_unit: None,
    }
}

const LCD: ColorModel = ColorModel::Lcd { chroma_degree: 3, luminance_degree: 0, activation: Activation::Softplus };
const DIRECTIONS: [[f32; 3]; 3] = [[0.0, 0.0, 1.0], [0.6, -0.8, 0.0], [-0.48, 0.6, 0.64]];

fn linear(color_space: ColorSpace, exposure_ev: f32) -> BakeOptions {
    BakeOptions { appearance: Appearance::Linear { color_space, exposure_ev }, max_degree: 3 }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn linear_bakes_of_harmonics_are_exact_in_every_space(from in 0usize..5, to in 0usize..5, ev in -3f32..3.0) {
        let (from, to) = (ColorSpace::ALL[from], ColorSpace::ALL[to]);
        let scene = scene(ColorModel::Sh { degree: 3 }, from);
        let baked = Baked::new(&scene, &linear(to, ev));
        let (conversion, factor) = (Conversion::between(from, to), 2.5 * ev.exp2());
        prop_assert_eq!(baked.scene.color_space, to);
        for i in 0..scene.splats.len() {
            for v in DIRECTIONS {
                let before = scene.splats.radiance(i, v);
                if before.contains(&0.0) {
                    continue;
                }
                let expected = conversion.apply(before.map(|c| c * factor));
                let found = baked.scene.splats.radiance(i, v);
                let size = 1e-5 * (1.0 + factor);
                prop_assert!((0..3).all(|c| (found[c] - expected[c].max(0.0)).abs() < size), "{:?} {:?}", found, expected);
            }
        }
    }

    #[test]
    fn linear_bakes_of_luminance_and_chromaticity_are_near(to in 0usize..5) {
        let to = ColorSpace::ALL[to];
        let scene = scene(LCD, ColorSpace::LinearRec709);
        let baked = Baked::new(&scene, &linear(to, 0.0));
        let conversion = Conversion::between(ColorSpace::LinearRec709, to);
        let (mut error, mut size) = (0.0, 0.0);
        for i in 0..scene.splats.len() {
            for v in DIRECTIONS {
                let expected = conversion.apply(scene.splats.radiance(i, v).map(|c| 2.5 * c));
                let found = baked.scene.splats.radiance(i, v);
                for c in 0..3 {
                    error += (found[c] - expected[c]).abs();
                    size += expected[c].abs();
                }
            }
        }
        prop_assert!(error < 0.05 * size, "{} of {}", error, size);
    }
}

#[test]
fn a_record_brings_a_scene_back_to_its_world() {
    let scene = scene(ColorModel::Sh { degree: 3 }, ColorSpace::AcesCg);
    let mut baked = Baked::new(&scene, &linear(ColorSpace::AcesCg, 0.0));
    let before = baked.scene.clone();
    let turn = glam::DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z);
    baked.transform(&Similarity::turn(turn).unwrap());
    assert_ne!(baked.scene.splats.position, before.splats.position);
    let record = BakeRecord::parse(&BakeRecord::from_bake(&baked).json().unwrap()).unwrap();
    let back = record.scene(baked.scene.splats.clone()).unwrap();
    assert_eq!((back.color_space, back.raster, &back.splats.position), (before.color_space, before.raster, &before.splats.position));
    for v in DIRECTIONS {
        let (a, b) = (back.splats.radiance(7, v), before.splats.radiance(7, v));
        assert!((0..3).all(|c| (a[c] - b[c]).abs() < 1e-5), "{a:?} {b:?}");
    }
}

#[test]
fn splats_that_leave_the_numbers_of_their_world_are_refused() {
    let mut baked = Baked::new(&scene(ColorModel::Sh { degree: 1 }, ColorSpace::LinearRec709), &linear(ColorSpace::LinearRec709, 0.0));
    baked.scene.splats.position[3] = [9.0; 3];
    let small = Similarity::new(glam::DMat3::IDENTITY, 1.2e-38, DVec3::ZERO).unwrap();
    baked.file_from_world = small;
    let json = BakeRecord::from_bake(&baked).json().unwrap();
    let error = BakeRecord::parse(&json).unwrap().scene(baked.scene.splats).unwrap_err();
    assert!(error.contains("position") && error.contains("the size"), "{error}");
    let smaller = json.replace("1.2e-38", "1e-300");
    assert!(BakeRecord::parse(&smaller).unwrap_err().contains("positive scale"));
}

#[test]
fn damaged_records_are_refused() {
    let scene = scene(LCD, ColorSpace::AcesCg);
    let mut baked = Baked::new(&scene, &BakeOptions { appearance: Appearance::PREVIEW, max_degree: 1 });
    assert_eq!(baked.scene.splats.color_model, ColorModel::Sh { degree: 1 });
    let turn = glam::DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z);
    baked.transform(&Similarity::turn(turn).unwrap());
    let json = BakeRecord::from_bake(&baked).json().unwrap();
    assert!(BakeRecord::parse(&json).is_ok());
    for (from, to) in [("\"version\":1", "\"version\":2"), ("linear-rec709", "cmyk"), ("\"scale\":1.0", "\"scale\":0.0"), ("-1.0", "-2.0")]
    {
        assert_ne!(json.replace(from, to), json, "{from}");
        assert!(BakeRecord::parse(&json.replace(from, to)).is_err(), "{to}");
    }
}

/// Returns a scene of a display's colours, between 0 and 1.
fn display_scene() -> Scene {
    let mut scene = scene(ColorModel::Sh { degree: 2 }, ColorSpace::DisplaySrgb);
    scene.radiance_scale = RadianceScale::ONE;
    scene.splats.sh.iter_mut().for_each(|k| *k = k.clamp(-0.8, 0.8));
    scene.raster.antialias = Antialias::Mip;
    scene
}

#[test]
fn colours_of_a_display_stay_what_they_are_in_a_display_bake() {
    let scene = display_scene();
    let baked = Baked::new(&scene, &BakeOptions { appearance: Appearance::preview_of(scene.color_space), max_degree: 3 });
    assert_eq!((&baked.scene, baked.exposure), (&scene, 1.0));
    // A bake of radiance is colours of a display from then on: a second one changes nothing.
    let radiance = self::scene(LCD, ColorSpace::LinearRec709);
    let once = Baked::new(&radiance, &BakeOptions { appearance: Appearance::PREVIEW, max_degree: 3 }).scene;
    assert_eq!(once.color_space, ColorSpace::DisplaySrgb);
    let twice = Baked::new(&once, &BakeOptions { appearance: Appearance::preview_of(once.color_space), max_degree: 3 });
    assert_eq!(twice.scene, once);
}

#[test]
fn another_curve_or_exposure_is_of_the_light_that_the_colours_are() {
    let scene = display_scene();
    let bake = |tonemap, exposure_ev| {
        let appearance = Appearance::Display { tonemap, exposure_ev };
        let mut scene = scene.clone();
        scene.splats = scene.splats.with_color_model(ColorModel::Sh { degree: 0 }).unwrap();
        (scene.splats.clone(), Baked::new(&scene, &BakeOptions { appearance, max_degree: 0 }))
    };
    for (tonemap, exposure_ev) in [(Tonemap::Reinhard, 0.0), (Tonemap::None, -1.0)] {
        let (before, baked) = bake(tonemap, exposure_ev);
        for i in 0..before.len() {
            let light = ColorSpace::DisplaySrgb.light(before.radiance(i, DIRECTIONS[0])).map(|v| v * exposure_ev.exp2());
            let (found, expected) = (baked.scene.splats.radiance(i, DIRECTIONS[0]), tonemap.encode(light));
            assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 1e-4), "{tonemap}: {found:?} {expected:?}");
        }
    }
    // Light in another space.
    let linear = Baked::new(&scene, &linear(ColorSpace::LinearRec709, 0.0));
    assert_eq!(linear.scene.color_space, ColorSpace::LinearRec709);
    let (before, after) = (scene.splats.base_radiance(3), linear.scene.splats.base_radiance(3));
    assert!(before.iter().zip(after).all(|(code, light)| *code < 0.05 || light < *code), "{before:?} {after:?}");
}
