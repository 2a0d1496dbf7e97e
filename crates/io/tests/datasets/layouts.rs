//! Which views a layout has, how they are split, and the digest of a data set.

use super::*;

#[test]
fn frames_are_sorted_by_name_and_every_eighth_is_held_out() {
    let scene = TestScene::new();
    let files: Vec<String> = (0..10).rev().map(|i| format!("images/{i}.exr")).collect();
    scene.exrs(&files);
    let json = scene.write("transforms.json", transforms(LENS, &files));
    let data = scene.load();
    assert_eq!(names(&data.test), ["images/0", "images/8"]);
    assert_eq!(names(&data.train), ["images/1", "images/2", "images/3", "images/4", "images/5", "images/6", "images/7", "images/9"]);
    assert_eq!(data.train[0].image.at(3, 2), [8.5; 3]);
    assert_eq!(data.train[0].camera.eye(), DVec3::new(8.0, 0.0, 4.0));
    assert_eq!((data.color_space, data.train[0].mask.is_none()), (ColorSpace::LinearRec709, true));
    assert!(data.warnings.is_empty(), "{:?}", data.warnings);
    // The file itself can be named, too.
    assert_eq!(load_dataset(&json, &LoadOptions::default()).unwrap().fingerprint, data.fingerprint);
}

#[test]
fn train_and_test_files_go_before_transforms_json() {
    let scene = TestScene::new();
    scene.exrs(["train/r_0.exr", "train/r_1.exr", "test/r_0.exr"]);
    let lens = r#""camera_angle_x": 0.9"#;
    scene.write("transforms_train.json", transforms(lens, &["./train/r_1", "./train/r_0"]));
    scene.write("transforms_test.json", transforms(lens, &["./test/r_0"]));
    scene.write("transforms_val.json", "not even JSON");
    scene.write("transforms.json", "not even JSON");
    let data = scene.load();
    assert_eq!((names(&data.train), names(&data.test)), (vec!["train/r_0", "train/r_1"], vec!["test/r_0"]));
    assert!((data.train[0].camera.focal_px.x - 8.0 / 0.45f64.tan()).abs() < 1e-9);
    assert_eq!(data.train[0].camera.center_px, DVec2::new(8.0, 4.0));
    assert_eq!(data.warnings, ["transforms_val.json is not used: its views are neither trained on nor tested"]);
    // Named by one of the two, both are read.
    let half = load_dataset(&scene.path().join("transforms_train.json"), &LoadOptions::default()).unwrap();
    assert_eq!(half.fingerprint, data.fingerprint);
}

#[test]
fn split_json_and_filenames_are_followed() {
    let scene = TestScene::new();
    let files = ["images/a.exr", "images/b.exr", "images/c.exr"];
    scene.exrs(files);
    scene.write("transforms.json", transforms(LENS, &files));
    scene.write("split.json", r#"{"train": ["images/c.exr"], "test": ["b"], "train_indices": [2]}"#);
    let data = scene.load();
    assert_eq!((names(&data.train), names(&data.test)), (vec!["images/c"], vec!["images/b"]));
    assert_eq!(data.warnings, ["left out, neither in train nor in test: image images/a"]);
    let own = format!(r#"{LENS}, "train_filenames": ["images/a.exr"], "val_filenames": ["images/b.exr"]"#);
    scene.write("transforms.json", transforms(&own, &files));
    let data = scene.load();
    assert_eq!((names(&data.train), names(&data.test)), (vec!["images/a"], vec!["images/b"]));
}

#[test]
fn one_image_is_trained_on_and_said() {
    let scene = TestScene::new();
    scene.exrs(["a.exr"]);
    scene.write("transforms.json", transforms(LENS, &["a.exr"]));
    let data = scene.load();
    assert_eq!((data.train.len(), data.test.len()), (1, 0));
    assert_eq!(data.warnings, ["no test views: no image is held out to measure quality with"]);
}

/// Writes a grey image of a size.
fn grey_png(scene: &TestScene, name: &str, size_px: [u32; 2]) {
    let path = scene.write(name, "");
    image::GrayImage::from_pixel(size_px[0], size_px[1], image::Luma([99])).save(path).unwrap();
}

#[test]
fn large_images_are_reduced_by_the_sizes_of_those_to_train_on() {
    let scene = TestScene::new();
    grey_png(&scene, "a.png", [3201, 4]);
    grey_png(&scene, "b.png", [20, 3300]);
    grey_png(&scene, "c.png", [1600, 2]);
    scene.write("transforms.json", transforms(r#""camera_angle_x": 0.9"#, &["a.png", "b.png", "c.png"]));
    let split = |train: &str, test: &str| scene.write("split.json", format!(r#"{{"train": [{train}], "test": [{test}]}}"#));
    let auto = LoadOptions { downscale: Downscale::Auto, transfer: Some(Transfer::Srgb), ..LoadOptions::default() };
    let chosen = || choose_downscale(scene.path(), &auto).map(|chosen| (chosen.factor, chosen.largest_px)).unwrap();
    // Held-out images follow those to train on.
    split(r#""a.png", "c.png""#, r#""b.png""#);
    assert_eq!(chosen(), (2, [3201, 4]));
    let data = scene.read(&auto).unwrap();
    assert_eq!(data.train.iter().map(|view| view.camera.size_px).collect::<Vec<_>>(), [[1600, 2], [800, 1]]);
    assert_eq!(data.test[0].camera.size_px, [10, 1650]);
    // It is the same data set as by the number.
    let by_two = LoadOptions { downscale: 2.into(), ..auto.clone() };
    assert_eq!(scene.read(&by_two).unwrap().fingerprint, data.fingerprint);
    split(r#""b.png""#, r#""a.png""#);
    assert_eq!(chosen(), (3, [20, 3300]));
    split(r#""c.png""#, r#""a.png", "b.png""#);
    assert_eq!(chosen(), (1, [1600, 2]));
    // Whatever else is wrong with a split, reading the images says it.
    split("", r#""a.png""#);
    assert_eq!(chosen(), (1, [0; 2]));
    assert!(scene.read(&auto).unwrap_err().message.contains("no training images"));
}

#[test]
fn fingerprint_follows_content_split_and_options() {
    let scene = TestScene::new();
    scene.exrs(["a.exr", "b.exr", "c.exr"]);
    scene.write("transforms.json", transforms(LENS, &["a.exr", "b.exr", "c.exr"]));
    let first = scene.load().fingerprint;
    assert_eq!(scene.load().fingerprint, first);
    let reduced = load_dataset(scene.path(), &LoadOptions { downscale: 2.into(), ..LoadOptions::default() }).unwrap();
    assert_ne!(reduced.fingerprint, first);
    scene.write("split.json", r#"{"train": ["a", "b"], "test": ["c"]}"#);
    let split = scene.load().fingerprint;
    assert_ne!(split, first);
    scene.exr("c.exr", |_, _| [9.0; 3]);
    assert_ne!(scene.load().fingerprint, split);
}

#[test]
fn colmap_model_may_be_named_itself_and_images_replace_its_copies() {
    let scene = TestScene::new();
    scene.exrs(["images/a b.exr", "images/sub/c.exr"]);
    colmap(&scene, "sparse", PINHOLE, Distortion::default(), &["a b.png", "sub/c.png"], &[]);
    let data = scene.load();
    assert_eq!((names(&data.test), names(&data.train)), (vec!["images/a b"], vec!["images/sub/c"]));
    assert!(data.warnings[0].starts_with("2 images are read in another format than COLMAP's copies"), "{:?}", data.warnings);
    let named = load_dataset(&scene.path().join("sparse"), &LoadOptions::default()).unwrap();
    assert_eq!(named.fingerprint, data.fingerprint);
    std::fs::remove_file(scene.path().join("images/a b.exr")).unwrap();
    assert!(scene.error().contains("image 1 (\"a b.png\"): image"), "{}", scene.error());
}

#[test]
fn hdr_nerf_frames_of_one_pose_are_one_view() {
    let scene = TestScene::new();
    scene.exrs(["train_hdr/hdr_000.exr", "train_hdr/hdr_001.exr", "test_hdr/hdr_000.exr"]);
    let lens = r#""camera_angle_x": 0.9"#;
    let exposures = transforms(lens, &["./train/r_0_0", "./train/r_0_1", "./train/r_1_0"]);
    scene.write("transforms_train.json", exposures.replace(&pose(1.0), &pose(0.0)));
    scene.write("transforms_test.json", transforms(lens, &["./test/r_0"]));
    assert_eq!(detect_format(scene.path()).unwrap(), DatasetFormat::HdrNerf);
    let data = scene.load();
    assert_eq!((names(&data.train), names(&data.test)), (vec!["train_hdr/hdr_000", "train_hdr/hdr_001"], vec!["test_hdr/hdr_000"]));
    assert_eq!(data.train[1].camera.eye(), DVec3::new(2.0, 0.0, 4.0));
    scene.write("transforms_train.json", exposures);
    assert!(scene.error().contains("another pose than frame 0"), "{}", scene.error());
    scene.write("transforms_train.json", transforms(lens, &["./train/r_7"]));
    assert!(scene.error().contains("hdr_007.exr does not exist"), "{}", scene.error());
}

#[test]
fn hdr_gs_holds_out_every_other_view_in_the_order_of_text() {
    let scene = TestScene::new();
    scene.exrs((0..35).map(|i| format!("exr/{i}.exr")));
    let images: Vec<String> = (0..35).map(|i| format!("{i}_1.png")).collect();
    let images: Vec<&str> = images.iter().map(String::as_str).collect();
    colmap(&scene, "sparse/0", PINHOLE, Distortion::default(), &images, &[]);
    assert_eq!(detect_format(scene.path()).unwrap(), DatasetFormat::HdrGs);
    assert_eq!(detect_format(&scene.path().join("sparse/0")).unwrap(), DatasetFormat::HdrGs);
    let data = scene.load();
    let mut train: Vec<usize> = data.train.iter().map(|v| v.stem().parse().unwrap()).collect();
    train.sort_unstable();
    assert_eq!(train, [0, 2, 3, 5, 7, 9, 11, 13, 15, 17, 19, 20, 22, 24, 26, 28, 31, 33]);
    assert_eq!(data.test.len(), 17);
    assert_eq!(data.train[0].name, "exr/0");
}

#[test]
fn gauss_hdr_splits_by_name() {
    let scene = TestScene::new();
    scene.exrs(["images_hdr/train_hdr_000.exr", "images_hdr/train_hdr_001.exr", "images_hdr/test_hdr_000.exr"]);
    let images = ["train_ldr_001_0.png", "train_ldr_000_2.png", "train_ldr_000_0.png", "test_ldr_000_0.png"];
    colmap(&scene, "sparse/0", PINHOLE, Distortion::default(), &images, &[]);
    assert_eq!(detect_format(scene.path()).unwrap(), DatasetFormat::GaussHdr);
    assert_eq!(detect_format(&scene.path().join("sparse/0")).unwrap(), DatasetFormat::GaussHdr);
    let data = scene.load();
    assert_eq!(names(&data.train), ["images_hdr/train_hdr_000", "images_hdr/train_hdr_001"]);
    assert_eq!(names(&data.test), ["images_hdr/test_hdr_000"]);
    // Of two exposures of a pose, the first by name counts: image 3.
    assert_eq!(data.train[0].camera.eye().x, 2.0);
}

#[test]
fn names_of_formats_are_read_back() {
    for format in DatasetFormat::ALL {
        assert_eq!(format.to_string().parse(), Ok(format));
    }
    assert!("nerf".parse::<DatasetFormat>().unwrap_err().to_string().contains("expected transforms, colmap"));
}
