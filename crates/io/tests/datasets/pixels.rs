//! Values of images: bad pixels, curves, colour spaces.

use super::*;

#[test]
fn bad_pixels_are_counted_zeroed_and_masked() {
    let scene = TestScene::new();
    let bad = |x, y| match (x, y) {
        (0, 0) => [f32::NAN, -1.0, f32::INFINITY],
        (1, 0) => [1.0, f32::INFINITY, -1.0],
        (2, 0) | (3, 0) => [1.0, 1.0, -0.5],
        _ => [2.0; 3],
    };
    scene.exr("a.exr", bad);
    scene.exrs(["b.exr"]);
    scene.write("transforms.json", transforms(LENS, &["a.exr", "b.exr"]));
    scene.write("split.json", r#"{"train": ["a", "b"], "test": []}"#);
    let data = scene.load();
    assert_eq!(data.bad_pixels, [BadPixels { name: "a".to_owned(), nan: 1, infinite: 1, negative: 2 }]);
    assert_eq!((data.train[0].is_valid(3), data.train[0].is_valid(4)), (false, true));
    assert_eq!((data.train[0].image.at(0, 0), data.train[0].image.at(4, 0)), ([0.0; 3], [2.0; 3]));
    assert!(data.train[1].mask.is_none());
    // Reduced, a block with a bad pixel is never darker than its good ones: it is either masked or
    // their average.
    let data = load_dataset(scene.path(), &LoadOptions { downscale: 2.into(), ..LoadOptions::default() }).unwrap();
    let view = &data.train[0];
    for i in 0..view.image.pixels.len() {
        assert!(!view.is_valid(i) || view.image.pixels[i] == [2.0; 3], "{i}: {:?}", view.image.pixels[i]);
    }
}

#[test]
fn eight_bit_images_need_a_transfer_and_warn_once() {
    let scene = TestScene::new();
    for name in ["a.png", "b.png", "c.png"] {
        scene.png(name, |_, _| [255, 51, 0, 51]);
    }
    scene.write("transforms.json", transforms(LENS, &["a.png", "b.png", "c.png"]));
    let error = scene.read(&LoadOptions::default()).unwrap_err();
    assert!(error.remedy.as_ref().is_some_and(|remedy| remedy.to_string().contains("transfer")), "{error}");
    let data = load_dataset(scene.path(), &LoadOptions { transfer: Some(Transfer::Linear), ..LoadOptions::default() }).unwrap();
    let not_hdr: Vec<_> = data.warnings.iter().filter(|w| w.contains("not HDR")).collect();
    assert_eq!(not_hdr, ["3 images (a, b, c): 8 bits: not HDR"]);
    // Straight alpha over black.
    let [r, g, b] = data.train[0].image.at(0, 0);
    assert!((r - 0.2).abs() < 1e-6 && (g - 0.04).abs() < 1e-6 && b == 0.0, "{r} {g} {b}");
}

#[test]
fn images_of_different_colour_spaces_are_refused() {
    let scene = TestScene::new();
    scene.exrs(["a.exr", "b.exr"]);
    let path = scene.path().join("b.exr");
    let mut image = exr::prelude::read_first_flat_layer_from_file(&path).unwrap();
    let xy = |[x, y]: [f32; 2]| exr::prelude::Vec2(x, y);
    let [red, green, blue, white] = ColorSpace::AcesCg.chromaticities().map(xy);
    image.attributes.chromaticities = Some(exr::meta::attribute::Chromaticities { red, green, blue, white });
    exr::prelude::WritableImage::write(&image).to_file(&path).unwrap();
    scene.write("transforms.json", transforms(LENS, &["a.exr", "b.exr"]));
    assert!(scene.error().contains("acescg") && scene.error().contains("linear-rec709"), "{}", scene.error());
    // With the option for the one that states none, both agree.
    let options = LoadOptions { color_space: Some(ColorSpace::AcesCg), ..LoadOptions::default() };
    assert_eq!(load_dataset(scene.path(), &options).unwrap().color_space, ColorSpace::AcesCg);
}

#[test]
fn wide_spaces_are_converted_to_the_one_scenes_are_trained_in() {
    let scene = TestScene::new();
    scene.exrs(["a.exr"]);
    scene.write("transforms.json", transforms(LENS, &["a.exr"]));
    let before = load_dataset(scene.path(), &LoadOptions::default()).unwrap().train[0].image.clone();
    let path = scene.path().join("a.exr");
    let mut image = exr::prelude::read_first_flat_layer_from_file(&path).unwrap();
    let [red, green, blue, white] = ColorSpace::Aces2065.chromaticities().map(|[x, y]| exr::prelude::Vec2(x, y));
    image.attributes.chromaticities = Some(exr::meta::attribute::Chromaticities { red, green, blue, white });
    exr::prelude::WritableImage::write(&image).to_file(&path).unwrap();
    let data = load_dataset(scene.path(), &LoadOptions::default()).unwrap();
    assert_eq!(data.color_space, ColorSpace::LinearRec709);
    assert!(data.warnings.iter().any(|w| w.contains("converted to linear Rec.709 from aces2065-1")), "{:?}", data.warnings);
    let expected = ColorSpace::Aces2065.to_rec709(before.at(1, 1));
    let found = data.train[0].image.at(1, 1);
    // What the matrix alone makes negative is no damage.
    assert!((0..3).all(|c| (found[c] - expected[c].max(0.0)).abs() < 1e-5), "{found:?} {expected:?}");
    assert!(data.bad_pixels.is_empty(), "{:?}", data.bad_pixels);
}

#[test]
fn a_curve_that_no_image_has_a_use_for_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let image = luxel_core::Image { width: 4, height: 4, pixels: vec![[0.5; 3]; 16] };
    luxel_io::write_exr(&folder.path().join("a.exr"), &image, &luxel_io::ExrOptions::default()).unwrap();
    let json = r#"{"fl_x": 4, "metres_per_unit": 0.5, "frames": [{"file_path": "a.exr", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#;
    std::fs::write(folder.path().join("transforms.json"), json).unwrap();
    let load = |transfer| load_dataset(folder.path(), &LoadOptions { transfer, ..LoadOptions::default() }).unwrap();
    let has_line = |dataset: &Dataset| dataset.warnings.iter().any(|w| w.contains("the transfer curve linear has no effect"));
    let dataset = load(Some(Transfer::Linear));
    assert!(has_line(&dataset) && dataset.metres_per_unit == Some(0.5), "{:?}", dataset.warnings);
    assert!(!has_line(&load(None)));
}
