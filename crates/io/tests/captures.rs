//! Masks, noise and captured LDR images of data sets: each layout written to a temporary folder and
//! read back.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use std::io::Cursor;

use common::{SIZE, TestScene};
use luxel_core::{NoiseModel, PixelValues, Remedy, View};
use luxel_io::{DatasetFormat, Exposures, LoadOptions, MaskSource, Supervision, Transfer, detect_format, load_dataset};
use tiff::encoder::TiffValue;
use tiff::encoder::colortype::{ColorType, RGB16, RGB32Float, RGBA16, RGBA32Float};
use tiff::tags::ExtraSamples;

const LENS: &str = r#""fl_x": 20, "fl_y": 20, "cx": 8, "cy": 4, "w": 16, "h": 8"#;

impl TestScene {
    fn flat(&self, name: &str, value: f32) {
        self.exr(name, |_, _| [value; 3]);
    }

    fn grey(&self, name: &str, value: u8) {
        self.png(name, |_, _| [value, value, value, 255]);
    }

    fn error(&self, options: &LoadOptions) -> String {
        self.read(options).unwrap_err().to_string()
    }
}

/// Returns a transforms.json of frames: file, place along x, more keys.
fn transforms(frames: &[(&str, f64, &str)]) -> String {
    let frame = |(file, x, more): &(&str, f64, &str)| {
        format!(r#"{{"file_path": {file:?}, "transform_matrix": [[1,0,0,{x}],[0,1,0,0],[0,0,1,4],[0,0,0,1]]{more}}}"#)
    };
    format!("{{{LENS}, \"frames\": [{}]}}", frames.iter().map(frame).collect::<Vec<_>>().join(", "))
}

fn split(scene: &TestScene, train: &[&str], test: &[&str]) {
    let list = |names: &[&str]| names.iter().map(|name| format!("{name:?}")).collect::<Vec<_>>().join(", ");
    scene.write("split.json", format!("{{\"train\": [{}], \"test\": [{}]}}", list(train), list(test)));
}

fn masked(masks: MaskSource) -> LoadOptions {
    LoadOptions { masks, ..LoadOptions::default() }
}

fn ldr(exposures: Exposures) -> LoadOptions {
    LoadOptions { supervision: Supervision::Ldr, exposures, ..LoadOptions::default() }
}

fn recorded(view: &View) -> Option<f32> {
    match view.values {
        PixelValues::Radiance => None,
        PixelValues::Recorded { exposure_s } => Some(exposure_s),
    }
}

fn names(views: &[View]) -> Vec<&str> {
    views.iter().map(|view| view.name.as_str()).collect()
}

/// Returns two images, the left half of whose masks is black.
fn two_with_masks(folder: &str) -> TestScene {
    let scene = TestScene::new();
    scene.flat("images/a.exr", 1.0);
    scene.flat("images/b.exr", 2.0);
    scene.write("transforms.json", transforms(&[("images/a.exr", 0.0, ""), ("images/b.exr", 1.0, "")]));
    split(&scene, &["a", "b"], &[]);
    let half = |x: u32| if x < 8 { [0, 0, 0, 255] } else { [255, 255, 255, 255] };
    scene.png(&format!("{folder}/a.png"), |x, _| half(x));
    scene.png(&format!("{folder}/b.exr.png"), |x, _| half(x));
    scene
}

#[test]
fn masks_beside_a_data_set_are_used_unless_they_are_not_wanted() {
    let scene = two_with_masks("masks");
    let data = scene.read(&LoadOptions::default()).unwrap();
    for view in &data.train {
        assert!((0..16).all(|x| view.is_valid(x) == (x >= 8)), "{}", view.name);
    }
    let off = scene.read(&masked(MaskSource::Off)).unwrap();
    assert!(off.train.iter().all(|view| view.mask.is_none()));
    assert_ne!(off.fingerprint, data.fingerprint);
}

#[test]
fn masks_of_a_folder_are_found_by_the_images_names() {
    let scene = two_with_masks("elsewhere");
    assert!(scene.read(&LoadOptions::default()).unwrap().train.iter().all(|view| view.mask.is_none()));
    let folder = scene.path().join("elsewhere");
    let data = scene.read(&masked(MaskSource::Folder(folder.clone()))).unwrap();
    assert!(data.train.iter().all(|view| view.mask.is_some()));
    std::fs::remove_file(folder.join("b.exr.png")).unwrap();
    let data = scene.read(&masked(MaskSource::Folder(folder.clone()))).unwrap();
    assert!(data.warnings.iter().any(|w| w.contains("no mask for 1 of 2 images (images/b)")), "{:?}", data.warnings);
    std::fs::remove_file(folder.join("a.png")).unwrap();
    assert!(scene.error(&masked(MaskSource::Folder(folder.clone()))).contains("expected a.png"));
    assert!(scene.error(&masked(MaskSource::Folder(folder.join("none")))).contains("is not a folder"));
}

#[test]
fn a_mask_is_of_its_images_size_and_follows_it_through_a_reduction() {
    let scene = two_with_masks("masks");
    let half = scene.read(&LoadOptions { downscale: 2.into(), ..LoadOptions::default() }).unwrap();
    assert!((0..8).all(|x| half.train[0].is_valid(x) == (x >= 4)));
    image::RgbaImage::new(4, 4).save(scene.path().join("masks/a.png")).unwrap();
    let error = scene.error(&LoadOptions::default());
    assert!(error.contains("a mask of 4 x 4 pixels, its image has 16 x 8"), "{error}");
}

#[test]
fn grey_masks_and_alpha_are_weights() {
    let scene = TestScene::new();
    scene.png("images/a.png", |x, _| [200, 200, 200, if x < 8 { 51 } else { 255 }]);
    scene.write("transforms.json", transforms(&[("images/a.png", 0.0, ", \"mask_path\": \"m/0.png\"")]));
    scene.png("m/0.png", |_, y| if y < 4 { [102, 102, 102, 255] } else { [255, 255, 255, 255] });
    let options = |masks| LoadOptions { transfer: Some(Transfer::Linear), ..masked(masks) };
    let of_file = scene.read(&options(MaskSource::Auto)).unwrap();
    let weights = &of_file.train[0].mask.as_ref().unwrap().weights;
    assert!((weights[0] - 0.4).abs() < 1e-6 && weights[16 * 7] == 1.0, "{weights:?}");
    // Without alpha as a mask the colour is composited over black.
    assert!(of_file.train[0].image.pixels[0][0] < 0.2);
    let alpha = scene.read(&options(MaskSource::Alpha)).unwrap();
    let weights = &alpha.train[0].mask.as_ref().unwrap().weights;
    assert!((weights[0] - 0.2).abs() < 1e-6 && weights[15] == 1.0 && alpha.train[0].image.pixels[0][0] > 0.7);
    assert_ne!(alpha.fingerprint, scene.read(&options(MaskSource::Off)).unwrap().fingerprint);
    scene.flat("images/a.png", 1.0);
    assert!(scene.error(&options(MaskSource::Alpha)).contains("has no alpha channel"));
    std::fs::remove_file(scene.path().join("m/0.png")).unwrap();
    assert!(scene.error(&options(MaskSource::Auto)).contains("its mask"));
}

/// Opacity of the TIFF files.
const ALPHA: f32 = 0.25;

/// Returns an image of one pixel over and over.
fn tiff_of<C: ColorType>(pixel: [C::Inner; 4], alpha: Option<ExtraSamples>) -> Vec<u8>
where
    C::Inner: Copy,
    [C::Inner]: TiffValue,
{
    let mut out = Cursor::new(Vec::new());
    let mut encoder = tiff::encoder::TiffEncoder::new(&mut out).unwrap();
    let mut image = encoder.new_image::<C>(SIZE[0] as u32, SIZE[1] as u32).unwrap();
    if let Some(alpha) = alpha {
        image.extra_samples(&[alpha]).unwrap();
    }
    image.write_data(&pixel.repeat(SIZE[0] * SIZE[1])).unwrap();
    out.into_inner()
}

/// Returns the pixels of the image that are trained on, and its first weight.
fn trained_on(tiff: &[u8], transfer: Transfer, masks: MaskSource) -> (f32, f32) {
    let scene = TestScene::new();
    scene.write("a.tif", tiff);
    scene.write("transforms.json", transforms(&[("a.tif", 0.0, "")]));
    let data = scene.read(&LoadOptions { transfer: Some(transfer), ..masked(masks) }).unwrap();
    let view = &data.train[0];
    (view.image.pixels[0][1], view.mask.as_ref().map_or(1.0, |mask| mask.weights[0]))
}

fn assert_light(tiff: &[u8], transfer: Transfer, light: f32) {
    let (over_black, _) = trained_on(tiff, transfer, MaskSource::Off);
    assert!((over_black - light * ALPHA).abs() < 1e-4, "over black: {over_black}, expected {}", light * ALPHA);
    let (straight, weight) = trained_on(tiff, transfer, MaskSource::Alpha);
    assert!(
        (straight - light).abs() < 1e-4 && (weight - ALPHA).abs() < 1e-4,
        "under a mask: {straight} of weight {weight}, expected {light}"
    );
}

#[test]
fn integers_are_multiplied_once() {
    const CODE: f32 = 0.6;
    let pixel = |code: f32| [code, code, code, ALPHA].map(|v| (v * 65535.0).round() as u16);
    // IEC 61966-2-1 of CODE.
    for (transfer, light) in [(Transfer::Linear, CODE), (Transfer::Srgb, 0.318_547)] {
        assert_light(&tiff_of::<RGB16>(pixel(CODE), Some(ExtraSamples::UnassociatedAlpha)), transfer, light);
        assert_light(&tiff_of::<RGB16>(pixel(CODE * ALPHA), Some(ExtraSamples::AssociatedAlpha)), transfer, light);
        assert_light(&tiff_of::<RGBA16>(pixel(CODE), None), transfer, light);
    }
}

#[test]
fn floats_are_multiplied_once() {
    const LIGHT: f32 = 3.0;
    let pixel = |light: f32| [light, light, light, ALPHA];
    assert_light(&tiff_of::<RGB32Float>(pixel(LIGHT), Some(ExtraSamples::UnassociatedAlpha)), Transfer::Linear, LIGHT);
    assert_light(&tiff_of::<RGB32Float>(pixel(LIGHT * ALPHA), Some(ExtraSamples::AssociatedAlpha)), Transfer::Linear, LIGHT);
    assert_light(&tiff_of::<RGBA32Float>(pixel(LIGHT * ALPHA), None), Transfer::Linear, LIGHT);
}

#[test]
fn noise_is_as_the_frames_state_it() {
    let scene = TestScene::new();
    for name in ["a", "b", "c"] {
        scene.flat(&format!("images/{name}.exr"), 1.0);
    }
    let frames = [
        ("images/a.exr", 0.0, r#", "noise": [0.01, 0.002]"#),
        ("images/b.exr", 1.0, r#", "iso": 400, "white": 2"#),
        ("images/c.exr", 2.0, ""),
    ];
    scene.write("transforms.json", transforms(&frames));
    split(&scene, &["a", "b", "c"], &[]);
    let data = scene.read(&LoadOptions::default()).unwrap();
    let found: Vec<_> = data.train.iter().map(|view| view.noise).collect();
    assert_eq!(found, [Some(NoiseModel { read: 0.01, shot: 0.002 }), Some(NoiseModel::from_iso(400.0, 2.0)), None]);
    for bad in [r#", "noise": [1]"#, r#", "noise": [-1, 0]"#, r#", "iso": 0"#, r#", "iso": "low""#, r#", "exposure": -1"#] {
        scene.write("transforms.json", transforms(&[("images/a.exr", 0.0, bad)]));
        let error = scene.error(&LoadOptions::default());
        assert!(error.contains("frame 0"), "{bad}: {error}");
    }
}

/// Returns two poses of three exposures and one held-out pose of radiance.
fn bracketed() -> TestScene {
    let scene = TestScene::new();
    let mut frames = Vec::new();
    let files: Vec<(String, f64, String)> = (0..2)
        .flat_map(|pose| {
            (0..3).map(move |k| (format!("ldr/{pose}_{k}.png"), f64::from(pose), format!(", \"exposure\": {}", 0.5 * f64::from(1 << k))))
        })
        .collect();
    for (i, (file, x, more)) in files.iter().enumerate() {
        scene.grey(file, 50 + 10 * i as u8);
        frames.push((file.as_str(), *x, more.as_str()));
    }
    scene.flat("hdr/2.exr", 3.0);
    frames.push(("hdr/2.exr", 2.0, ""));
    scene.write("transforms.json", transforms(&frames));
    split(&scene, &["0_0", "0_1", "0_2", "1_0", "1_1", "1_2"], &["hdr/2"]);
    scene
}

#[test]
fn recordings_are_read_as_they_are_with_their_exposures() {
    let data = bracketed().read(&ldr(Exposures::All)).unwrap();
    let exposures: Vec<_> = data.train.iter().map(recorded).collect();
    assert_eq!(exposures, [0.5, 1.0, 2.0, 0.5, 1.0, 2.0].map(Some));
    assert!((data.train[1].image.pixels[0][0] - 60.0 / 255.0).abs() < 1e-6);
    assert_eq!((recorded(&data.test[0]), data.test[0].image.pixels[0]), (None, [3.0; 3]));
    assert!(data.warnings.is_empty(), "{:?}", data.warnings);
    // Reduced in linear light and recorded again: one colour stays.
    let half = bracketed().read(&LoadOptions { downscale: 2.into(), ..ldr(Exposures::All) }).unwrap();
    assert!((half.train[1].image.pixels[0][0] - 60.0 / 255.0).abs() < 1e-5);
}

#[test]
fn recordings_are_reduced_without_blocks_that_are_saturated_in_part() {
    let scene = TestScene::new();
    scene.png("a.png", |x, _| if x < 5 { [255, 255, 255, 255] } else { [200, 0, 90, 255] });
    scene.write("transforms.json", transforms(&[("a.png", 0.0, ", \"exposure\": 1")]));
    let data = scene.read(&LoadOptions { downscale: 2.into(), ..ldr(Exposures::All) }).unwrap();
    let valid: Vec<bool> = (0..4).map(|x| data.train[0].is_valid(x)).collect();
    assert_eq!(valid, [true, true, false, true]);
    // With a lens, too: the pixels between.
    let lens = ", \"exposure\": 1, \"k1\": 0.001";
    scene.write("transforms.json", transforms(&[("a.png", 0.0, lens)]));
    let view = &scene.read(&ldr(Exposures::All)).unwrap().train[0];
    let of_row = |i: usize| view.image.pixels[i][0];
    let between = (0..view.image.pixels.len()).filter(|i| of_row(*i) > 0.8 && of_row(*i) < 0.99 && view.is_valid(*i)).count();
    assert_eq!(between, 0);
}

#[test]
fn brackets_are_thinned_out_to_what_is_asked_for() {
    let scene = bracketed();
    assert_eq!(names(&scene.read(&ldr(Exposures::Single)).unwrap().train), ["ldr/0_0", "ldr/1_1"]);
    assert_eq!(names(&scene.read(&ldr(Exposures::Of(vec![0, 2]))).unwrap().train), ["ldr/0_0", "ldr/0_2", "ldr/1_0", "ldr/1_2"]);
    assert!(scene.error(&ldr(Exposures::Of(vec![7]))).contains("no bracket has exposures 7"));
}

#[test]
fn recordings_without_exposure_and_radiance_to_train_on_are_refused() {
    let scene = bracketed();
    split(&scene, &["0_0", "hdr/2"], &[]);
    assert!(scene.error(&ldr(Exposures::All)).contains("holds radiance, expected a captured LDR image"));
    scene.write("transforms.json", transforms(&[("ldr/0_0.png", 0.0, ""), ("ldr/0_1.png", 1.0, "")]));
    split(&scene, &["0_0"], &["0_1"]);
    assert!(scene.error(&ldr(Exposures::All)).contains("has no \"exposure\""));
}

fn pair(scene: &TestScene) {
    let frame = |file: &str, x: f64| transforms(&[(file, x, "")]).replace(LENS, "\"camera_angle_x\": 0.8");
    scene.write("transforms_train.json", frame("train/r_0", 0.0));
    scene.write("transforms_test.json", frame("test/r_0", 1.0));
    for part in ["train", "test"] {
        for k in 0..3 {
            scene.grey(&format!("{part}/r_0_{k}.png"), 40 * (k + 1));
        }
        scene.write(&format!("exposure_{part}.json"), format!(r#"{{"{part}/r_0_0.png": 0.25, "r_0_1.png": 1.0, "r_0_2.png": 4}}"#));
    }
    std::fs::create_dir_all(scene.path().join("train_hdr")).unwrap();
}

#[test]
fn hdr_nerf_scenes_give_recordings_with_and_without_ground_truth() {
    let scene = TestScene::new();
    pair(&scene);
    let data = scene.read(&ldr(Exposures::All)).unwrap();
    assert_eq!((names(&data.train), data.test.len()), (vec!["train/r_0_0", "train/r_0_1", "train/r_0_2"], 3));
    assert_eq!(data.test.iter().map(recorded).collect::<Vec<_>>(), [0.25, 1.0, 4.0].map(Some));
    scene.flat("test_hdr/hdr_000.exr", 5.0);
    let data = scene.read(&ldr(Exposures::Of(vec![1]))).unwrap();
    assert_eq!((names(&data.train), names(&data.test)), (vec!["train/r_0_1"], vec!["test_hdr/hdr_000"]));
    assert_eq!(recorded(&data.test[0]), None);
    // As radiance the training images are missing.
    assert!(scene.error(&LoadOptions::default()).contains("does not exist"));
    scene.write("exposure_train.json", r#"{"r_0_0.png": 0}"#);
    assert!(scene.error(&ldr(Exposures::All)).contains("expected seconds"));
}

fn npy(rows: &[[f64; 18]]) -> Vec<u8> {
    let mut header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({}, 18), }}", rows.len());
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(rows.as_flattened().iter().flat_map(|v| v.to_le_bytes()));
    bytes
}

/// Returns a row of LLFF's table: a camera at (x, 0, 4) that looks along -z; down is -y.
fn row(x: f64, exposure_s: f64) -> [f64; 18] {
    [0.0, 1.0, 0.0, x, 8.0, -1.0, 0.0, 0.0, 0.0, 16.0, 0.0, 0.0, 1.0, 4.0, 20.0, 1.0, 9.0, exposure_s]
}

#[test]
fn hdr_nerf_real_scenes_are_brackets_of_a_table() {
    let scene = TestScene::new();
    let rows: Vec<_> = (0..9).flat_map(|i| [0.125, 2.0].map(|t| row(f64::from(i), t))).collect();
    for i in 0..9 {
        for k in 0..2 {
            scene.grey(&format!("input_images/00{i}_{k}.png"), 99);
        }
    }
    scene.write("poses_bounds_exps.npy", npy(&rows));
    assert_eq!(detect_format(scene.path()).unwrap(), DatasetFormat::HdrNerfReal);
    let data = scene.read(&ldr(Exposures::All)).unwrap();
    // Poses 0 and 8 are held out.
    assert_eq!((data.train.len(), data.test.len()), (14, 4));
    assert_eq!((data.train[0].name.as_str(), recorded(&data.train[1])), ("input_images/001_0", Some(2.0)));
    let camera = &data.train[2].camera;
    assert_eq!((camera.eye().to_array(), camera.size_px), ([2.0, 0.0, 4.0], [16, 8]));
    assert!(camera.project(glam::DVec3::new(2.0, 1.0, 0.0)).unwrap().0.y < 4.0);
    let error = scene.read(&LoadOptions::default()).unwrap_err();
    assert_eq!(error.remedy, Some(Remedy::set("supervision", "ldr")), "{error}");
    scene.write("poses_bounds_exps.npy", npy(&rows[1..]));
    assert!(scene.error(&ldr(Exposures::All)).contains("expected one row per image"));
    scene.write("poses_bounds_exps.npy", &npy(&rows)[..400]);
    assert!(scene.error(&ldr(Exposures::All)).contains("damaged"));
}

/// Writes a COLMAP model as text, of images side by side.
fn model(scene: &TestScene, images: &[String]) {
    scene.write("sparse/0/cameras.txt", "1 PINHOLE 16 8 20 20 8 4\n");
    let line = |(i, name): (usize, &String)| format!("{} 1 0 0 0 {} 0 0 1 {name}\n\n", i + 1, i / 2);
    scene.write("sparse/0/images.txt", images.iter().enumerate().map(line).collect::<String>());
    scene.write("sparse/0/points3D.txt", "1 0 0 5 9 9 9 0.5\n");
}

#[test]
fn masks_are_found_where_the_model_itself_is_named() {
    let scene = two_with_masks("masks");
    std::fs::remove_file(scene.path().join("transforms.json")).unwrap();
    model(&scene, &["a.exr".to_owned(), "b.exr".to_owned()]);
    let data = scene.read(&LoadOptions::default()).unwrap();
    let named = load_dataset(&scene.path().join("sparse/0"), &LoadOptions::default()).unwrap();
    assert!(named.train.len() == 2 && named.train.iter().all(|view| view.mask.is_some()));
    assert_eq!(named.fingerprint, data.fingerprint);
}

#[test]
fn repacked_scenes_give_recordings_with_and_without_ground_truth() {
    let scene = TestScene::new();
    let images: Vec<String> = ["train_ldr_000", "test_ldr_000"].iter().flat_map(|v| (0..2).map(move |k| format!("{v}_{k}.png"))).collect();
    images.iter().for_each(|name| scene.grey(&format!("images/{name}"), 99));
    model(&scene, &images);
    let seconds: Vec<String> = images.iter().enumerate().map(|(i, name)| format!("{name:?}: {}", 0.5 + (i % 2) as f64)).collect();
    scene.write("exposure.json", format!("{{{}}}", seconds.join(", ")));
    assert_eq!(detect_format(scene.path()).unwrap(), DatasetFormat::GaussHdr);
    assert_eq!(detect_format(&scene.path().join("sparse/0")).unwrap(), DatasetFormat::GaussHdr);
    let data = scene.read(&ldr(Exposures::All)).unwrap();
    assert_eq!(names(&data.train), ["images/train_ldr_000_0", "images/train_ldr_000_1"]);
    assert_eq!(data.test.iter().map(recorded).collect::<Vec<_>>(), [0.5, 1.5].map(Some));
    scene.flat("images_hdr/test_hdr_000.exr", 3.0);
    assert_eq!(names(&scene.read(&ldr(Exposures::All)).unwrap().test), ["images_hdr/test_hdr_000"]);

    let scene = TestScene::new();
    let images: Vec<String> = (0..2).flat_map(|view| (0..2).map(move |k| format!("{view}_{k}.png"))).collect();
    images.iter().for_each(|name| scene.grey(&format!("images/{name}"), 99));
    model(&scene, &images);
    let as_hdr_gs = || LoadOptions { format: Some(DatasetFormat::HdrGs), ..ldr(Exposures::All) };
    let data = scene.read(&as_hdr_gs()).unwrap();
    assert_eq!(data.train.iter().chain(&data.test).map(recorded).collect::<Vec<_>>(), [0.125, 0.5, 0.125, 0.5].map(Some));
    scene.flat("exr/1.exr", 3.0);
    assert_eq!(names(&scene.read(&as_hdr_gs()).unwrap().test), ["exr/1"]);
    // Stated exposures take the place of the assumed ones, and must be complete.
    scene.write("exposure_train.json", r#"{"0_0": 0.5, "0_1": 2.0, "1_0": 4.0, "1_1": 8.0}"#);
    let data = scene.read(&as_hdr_gs()).unwrap();
    assert_eq!(data.train.iter().map(recorded).collect::<Vec<_>>(), [0.5, 2.0].map(Some));
    scene.write("exposure_train.json", r#"{"0_0": 0.5}"#);
    let error = scene.read(&as_hdr_gs()).unwrap_err().to_string();
    assert!(error.contains("no exposure of \"0_1\""), "{error}");
}

/// HDR-NeRF's layout with radiance and three captured images of each of two training poses.
fn pairs() -> TestScene {
    let scene = TestScene::new();
    let frame = |part: &str, pose: usize, k: usize, x: f64| {
        format!(r#"{{"file_path": "{part}/r_{pose}_{k}", "transform_matrix": [[1,0,0,{x}],[0,1,0,0],[0,0,1,4],[0,0,0,1]]}}"#)
    };
    let mut frames = Vec::new();
    for pose in 0..2 {
        scene.flat(&format!("train_hdr/hdr_{pose:03}.exr"), 0.5 + pose as f32);
        for k in 0..3 {
            scene.grey(&format!("train/r_{pose}_{k}.png"), 40 + 60 * k as u8);
            frames.push(frame("train", pose, k, pose as f64));
        }
    }
    scene.flat("test_hdr/hdr_000.exr", 0.7);
    let file = |frames: &[String]| format!("{{{LENS}, \"frames\": [{}]}}", frames.join(", "));
    scene.write("transforms_train.json", file(&frames));
    scene.write("transforms_test.json", file(&[frame("test", 0, 0, 0.5)]));
    let exposure = |pose: usize| format!(r#""r_{pose}_0.png": 0.5, "r_{pose}_1.png": 2, "r_{pose}_2.png": 8"#);
    scene.write("exposure_train.json", format!("{{{}, {}}}", exposure(0), exposure(1)));
    scene
}

fn both(exposures: Exposures) -> LoadOptions {
    LoadOptions { supervision: Supervision::Both, exposures, ..LoadOptions::default() }
}

#[test]
fn radiance_has_the_captured_images_of_its_pose_beside_it() {
    let scene = pairs();
    let data = scene.read(&both(Exposures::All)).unwrap();
    let radiance = scene.read(&LoadOptions::default()).unwrap();
    assert_eq!((names(&data.train), names(&data.test)), (names(&radiance.train), names(&radiance.test)));
    assert_ne!(data.fingerprint, radiance.fingerprint);
    for (pose, view) in data.train.iter().enumerate() {
        assert!((view.image.pixels[0][0] - (0.5 + pose as f32)).abs() < 1e-3 && view.values == PixelValues::Radiance);
        let expected: Vec<String> = (0..3).map(|k| format!("train/r_{pose}_{k}")).collect();
        assert_eq!(names(&view.recordings), expected.iter().map(String::as_str).collect::<Vec<_>>());
        assert_eq!(view.recordings.iter().map(recorded).collect::<Vec<_>>(), [Some(0.5), Some(2.0), Some(8.0)]);
        assert!((view.recordings[1].image.pixels[0][0] - 100.0 / 255.0).abs() < 1e-6);
    }
    assert!(data.test[0].recordings.is_empty() && radiance.train[0].recordings.is_empty());
    let some = scene.read(&both(Exposures::Of(vec![0, 2]))).unwrap();
    assert_eq!(some.train[1].recordings.iter().map(recorded).collect::<Vec<_>>(), [Some(0.5), Some(8.0)]);
    let half = scene.read(&LoadOptions { downscale: 2.into(), ..both(Exposures::Single) }).unwrap();
    assert_eq!((half.train[0].recordings.len(), half.train[0].recordings[0].camera.size_px), (1, [8, 4]));
}

#[test]
fn pairs_that_are_not_whole_are_refused() {
    let scene = pairs();
    scene.write("exposure_train.json", r#"{"r_0_0.png": 0.5, "r_0_1.png": 2, "r_0_2.png": 8, "r_1_0.png": 0.5, "r_1_1.png": 2}"#);
    let error = scene.error(&both(Exposures::All));
    assert!(error.contains("2 captured images of known exposure of view train_hdr/hdr_001, other views have 3"), "{error}");
    let scene = pairs();
    image::RgbaImage::new(8, 8).save(scene.path().join("train/r_1_2.png")).unwrap();
    assert!(scene.error(&both(Exposures::All)).contains("8 x 8"));
    let scene = pairs();
    std::fs::remove_file(scene.path().join("train_hdr/hdr_001.exr")).unwrap();
    assert!(scene.error(&both(Exposures::All)).contains("hdr_001.exr does not exist"));
    let plain = two_with_masks("masks");
    let error = plain.read(&both(Exposures::All)).unwrap_err();
    assert!(error.to_string().contains("no captured LDR images with exposures beside the radiance"), "{error}");
}

#[test]
fn frames_of_one_pose_in_a_transforms_json_are_pairs() {
    let scene = TestScene::new();
    let mut frames = Vec::new();
    for (name, x) in [("a", 0.0), ("b", 1.0)] {
        scene.flat(&format!("images/{name}.exr"), 1.0);
        scene.grey(&format!("images/{name}_0.png"), 90);
        frames.push((format!("images/{name}.exr"), x, ""));
        frames.push((format!("images/{name}_0.png"), x, ", \"exposure\": 0.25"));
    }
    let given: Vec<(&str, f64, &str)> = frames.iter().map(|(file, x, more)| (file.as_str(), *x, *more)).collect();
    scene.write("transforms.json", transforms(&given));
    split(&scene, &["images/a", "images/b"], &[]);
    let data = scene.read(&both(Exposures::All)).unwrap();
    assert_eq!(names(&data.train), ["images/a", "images/b"]);
    assert_eq!(recorded(&data.train[1].recordings[0]), Some(0.25));
    scene.write("transforms.json", transforms(&given[1..]));
    assert!(scene.error(&both(Exposures::All)).contains("no radiance image has the pose of the captured image"));
}

#[test]
fn images_of_a_display_curve_are_developed_and_others_are_light() {
    let is_developed = |name: &str, transfer: Option<Transfer>| {
        let scene = TestScene::new();
        match name {
            "png" => (0..9).for_each(|i| scene.grey(&format!("{i}.png"), 100)),
            _ => (0..9).for_each(|i| scene.flat(&format!("{i}.exr"), 0.5)),
        }
        let files: Vec<String> = (0..9).map(|i| format!("{i}.{name}")).collect();
        let frames: Vec<(&str, f64, &str)> = files.iter().map(|file| (file.as_str(), 0.0, "")).collect();
        scene.write("transforms.json", transforms(&frames));
        scene.read(&LoadOptions { transfer, ..LoadOptions::default() }).unwrap().is_developed
    };
    assert!(is_developed("png", Some(Transfer::Srgb)));
    let light = [("png", Some(Transfer::Linear)), ("png", Some(Transfer::LogC4)), ("exr", None)];
    assert_eq!(light.map(|(name, transfer)| is_developed(name, transfer)), [false; 3]);
}
