//! Data sets that are odd and all the same readable: what is read of them, and the warnings.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use std::fmt::Write as _;
use std::io::Cursor;

use common::{SIZE, TestScene};
use luxel_core::Dataset;
use luxel_io::{LoadOptions, Transfer, encode_jpeg};
use tiff::encoder::{Rational, TiffEncoder, colortype};
use tiff::tags::Tag;

const LENS: &str = r#""fl_x": 20, "fl_y": 20, "cx": 8, "cy": 4, "w": 16, "h": 8"#;
const PINHOLE: &str = "1 PINHOLE 16 8 20 20 8 4\n";

/// Returns a transforms.json of images one unit apart.
fn transforms(lens: &str, file_paths: &[&str]) -> String {
    let frame = |(i, file): (usize, &&str)| {
        format!(r#"{{"file_path": {file:?}, "transform_matrix": [[1,0,0,{i}],[0,1,0,0],[0,0,1,4],[0,0,0,1]]}}"#)
    };
    format!("{{{lens}, \"frames\": [{}]}}", file_paths.iter().enumerate().map(frame).collect::<Vec<_>>().join(", "))
}

/// Writes cameras.txt and images.txt of images without features, one unit apart.
fn colmap(scene: &TestScene, folder: &str, names: &[&str]) {
    scene.write(&format!("{folder}/cameras.txt"), PINHOLE);
    let mut images = String::new();
    for (i, name) in names.iter().enumerate() {
        writeln!(images, "{} 0 1 0 0 {} 0 4 1 {name}\n", i + 1, -(i as f64)).unwrap();
    }
    scene.write(&format!("{folder}/images.txt"), images);
}

fn load(scene: &TestScene) -> Dataset {
    scene.read(&LoadOptions { transfer: Some(Transfer::Linear), ..LoadOptions::default() }).unwrap()
}

fn views(data: &Dataset) -> [usize; 2] {
    [data.train.len(), data.test.len()]
}

/// Asserts that one of the warnings has all of `parts`.
fn assert_said(data: &Dataset, parts: &[&str]) {
    assert!(data.warnings.iter().any(|line| parts.iter().all(|part| line.contains(part))), "{parts:?}: {:?}", data.warnings);
}

fn grey(scene: &TestScene, names: &[&str]) {
    names.iter().for_each(|name| scene.exr(name, |_, _| [0.5; 3]));
}

#[test]
fn the_model_with_the_most_images_is_read() {
    let scene = TestScene::new();
    grey(&scene, &["images/a.exr", "images/b.exr", "images/c.exr"]);
    colmap(&scene, "sparse/0", &["a.exr"]);
    colmap(&scene, "sparse/1", &["a.exr", "b.exr", "c.exr"]);
    let data = load(&scene);
    assert_eq!(views(&data), [2, 1]);
    assert_said(&data, &["2 COLMAP models", "sparse/1 with 3 images is read", "sparse/0 with 1"]);
    // The folder of another names that.
    let other = luxel_io::load_dataset(&scene.path().join("sparse/0"), &LoadOptions::default()).unwrap();
    assert_eq!(views(&other), [1, 0]);
    assert_said(&other, &["2 of 3 images have no pose in the COLMAP model and are left out (images/b, images/c)"]);
}

#[test]
fn a_model_without_points_starts_from_the_cameras_or_from_its_ply() {
    let scene = TestScene::new();
    grey(&scene, &["images/a.exr", "images/b.exr"]);
    colmap(&scene, "sparse/0", &["a.exr", "b.exr"]);
    let data = load(&scene);
    assert!(data.points.is_empty());
    assert_said(&data, &["points3D.txt does not exist", "training starts from the cameras"]);
    let head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    scene.write("sparse/0/points3D.ply", format!("{head}1 2 3\nnan 2 3\n4 5 6\n"));
    let data = load(&scene);
    assert_eq!(data.points.iter().map(|point| point.position).collect::<Vec<_>>(), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    assert_said(&data, &["points are those of", "points3D.ply"]);
    assert_said(&data, &["left out without a finite position: 1 point"]);
    // A binary model, too.
    let count = |n: u64| n.to_le_bytes();
    std::fs::remove_file(scene.path().join("sparse/0/points3D.ply")).unwrap();
    let camera = [&count(1)[..], &1u32.to_le_bytes(), &1u32.to_le_bytes(), &count(16), &count(8)].concat();
    scene.write("sparse/0/cameras.bin", [camera, [20.0f64, 20.0, 8.0, 4.0].map(f64::to_le_bytes).concat()].concat());
    let pose = [0.0f64, 1.0, 0.0, 0.0, 0.0, 0.0, 4.0].map(f64::to_le_bytes).concat();
    let image = [&count(1)[..], &1u32.to_le_bytes(), &pose, &1u32.to_le_bytes(), b"a.exr\0", &count(0)].concat();
    scene.write("sparse/0/images.bin", image);
    assert_said(&load(&scene), &["points3D.bin does not exist"]);
}

#[test]
fn frames_without_images_are_left_out_while_most_images_are_there() {
    let scene = TestScene::new();
    grey(&scene, &["a.exr", "b.exr", "c.exr"]);
    scene.write("transforms.json", transforms(LENS, &["a.exr", "./gone.exr", "b.exr", "c.exr", "lost.exr"]));
    let data = load(&scene);
    assert_eq!(views(&data), [2, 1]);
    assert_said(&data, &["2 of 5 frames name images that do not exist, and are left out (./gone.exr, lost.exr)"]);
    // Lists of the split may name them, too.
    let lists = r#""train_filenames": ["a.exr", "gone.exr", "b.exr"], "test_filenames": ["c.exr"], "val_filenames": []"#;
    scene.write("transforms.json", transforms(&format!("{LENS}, {lists}"), &["a.exr", "./gone.exr", "b.exr", "c.exr"]));
    assert_eq!(views(&load(&scene)), [2, 1]);
    // Half of them is no remainder of a set.
    scene.write("transforms.json", transforms(LENS, &["a.exr", "x.exr", "b.exr", "y.exr"]));
    let error = scene.read(&LoadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("frame 1 (\"x.exr\")"), "{error}");
}

#[test]
fn photographs_that_were_exposed_differently_are_said_to_be() {
    let scene = TestScene::new();
    let photo = |fraction: u32| {
        let mut file = Cursor::new(Vec::new());
        let mut tiff = TiffEncoder::new(&mut file).unwrap();
        let mut image = tiff.new_image::<colortype::RGB8>(SIZE[0] as u32, SIZE[1] as u32).unwrap();
        image.encoder().write_tag(Tag::Unknown(0x829a), Rational { n: 1, d: fraction }).unwrap();
        image.write_data(&[99; 3 * SIZE[0] * SIZE[1]]).unwrap();
        file.into_inner()
    };
    scene.write("transforms.json", transforms(LENS, &["a.tif", "b.tif"]));
    scene.write("a.tif", photo(60));
    scene.write("b.tif", photo(64));
    assert!(!load(&scene).warnings.iter().any(|line| line.contains("exposures")));
    scene.write("b.tif", photo(240));
    assert_said(&load(&scene), &["the exposures of 2 photographs", "differ by up to 2.0 stops", "exposure compensation"]);
}

#[test]
fn radiance_in_any_float_format_goes_before_the_copies_that_colmap_ran_on() {
    let scene = TestScene::new();
    let pixels = |value: f32| vec![value; 3 * SIZE[0] * SIZE[1]];
    let jpeg = encode_jpeg(SIZE[0], SIZE[1], &[128; 3 * 16 * 8], 90).unwrap();
    let mut float = Cursor::new(Vec::new());
    TiffEncoder::new(&mut float).unwrap().write_image::<colortype::RGB32Float>(16, 8, &pixels(150.0)).unwrap();
    let mut integer = Cursor::new(Vec::new());
    TiffEncoder::new(&mut integer).unwrap().write_image::<colortype::RGB8>(16, 8, &[9; 3 * 16 * 8]).unwrap();
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (8, 16, 3), }";
    let header = format!("{header:<117}\n");
    let npy = [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes()].concat();
    let npy = [npy, pixels(70.0).iter().flat_map(|v| v.to_le_bytes()).collect()].concat();
    for name in ["a", "b", "c"] {
        scene.write(&format!("images/{name}.jpg"), &jpeg);
    }
    scene.write("images/a.tif", float.get_ref());
    scene.write("images/b.npy", npy);
    scene.write("images/c.tif", integer.get_ref());
    colmap(&scene, "sparse/0", &["a.jpg", "b.jpg", "c.jpg"]);
    scene.write("split.json", r#"{"train": ["a", "b", "c"], "test": []}"#);
    let data = load(&scene);
    let first = |i: usize| data.train[i].image.at(0, 0)[0];
    assert_eq!([first(0), first(1)], [150.0, 70.0]);
    // Integers of a TIFF are no radiance.
    assert!((0.1..0.9).contains(&first(2)), "{}", first(2));
    assert_said(&data, &["2 images are read in another format than COLMAP's copies"]);
    // A description that names the copies itself is followed, and the radiance is named.
    std::fs::remove_dir_all(scene.path().join("sparse")).unwrap();
    scene.write("transforms.json", transforms(LENS, &["images/a.jpg", "images/b.jpg", "images/c.jpg"]));
    let data = load(&scene);
    assert!(data.train[0].image.at(0, 0)[0] < 1.0);
    assert_said(&data, &["2 images are not radiance and have radiance beside them", "images/a.tif beside"]);
}

#[test]
fn validation_views_are_the_test_views_where_there_are_no_others() {
    let scene = TestScene::new();
    grey(&scene, &["a.exr", "b.exr", "c.exr"]);
    scene.write("transforms_train.json", transforms(LENS, &["a.exr", "b.exr"]));
    scene.write("transforms_val.json", transforms(LENS, &["c.exr"]));
    let data = load(&scene);
    assert_eq!(views(&data), [2, 1]);
    assert_eq!(data.warnings[0], "no transforms_test.json: the views of transforms_val.json are the test views");
    assert_eq!(data.format, "transforms_train.json and transforms_val.json");
}

#[test]
fn names_in_other_forms_are_found() {
    let scene = TestScene::new();
    // Composed in the description, decomposed on the disk.
    grey(&scene, &["images/Bu\u{308}ro_0.exr", "images/Bu\u{308}ro_1.EXR"]);
    scene.write("transforms.json", transforms(LENS, &["images/B\u{fc}ro_0.exr", "images/B\u{fc}ro_1.exr"]));
    scene.write("split.json", "{\"train\": [\"Bu\u{308}ro_0\"], \"test\": [\"B\u{fc}ro_1\"]}");
    let data = load(&scene);
    assert_eq!(views(&data), [1, 1]);
    assert_said(&data, &["found under names of another case: 1 file, such as"]);
}

#[test]
fn lenses_that_cannot_be_are_named_with_their_values() {
    let scene = TestScene::new();
    grey(&scene, &["a.exr", "b.exr"]);
    scene.write("transforms.json", transforms(r#""camera_angle_x": 5.86e-6"#, &["a.exr", "b.exr"]));
    assert_said(&load(&scene), &["\"camera_angle_x\" is 0.00000586 radians", "3.4e-4 degrees", "; 1 more view is like this"]);
    scene.write("transforms.json", transforms(r#""fl_x": 0.5, "w": 16, "h": 8"#, &["a.exr", "b.exr"]));
    assert_said(&load(&scene), &["\"fl_x\" is 0.5 px", "degrees"]);
    scene.write("transforms.json", transforms(r#""fl_x": 20, "cx": 0.5, "cy": 0.5"#, &["a.exr", "b.exr"]));
    assert_said(&load(&scene), &["principal point is 0.5, 0.5 px"]);
    scene.write("transforms.json", transforms(r#""fl_x": 8, "k1": -0.9"#, &["a.exr", "b.exr"]));
    assert_said(&load(&scene), &["k1 -0.9", "folds back at"]);
    scene.write("transforms.json", transforms(r#""fl_x": 20, "k1": -0.2"#, &["a.exr", "b.exr"]));
    assert!(!load(&scene).warnings.iter().any(|line| line.contains("folds")));
}

#[test]
fn views_without_light_or_distance_are_named() {
    let scene = TestScene::new();
    grey(&scene, &["images/a.exr", "images/b.exr"]);
    scene.exr("images/c.exr", |_, _| [0.0; 3]);
    scene.exr("images/d.exr", |_, _| [-1.0; 3]);
    let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n";
    scene.write("cloud.ply", ply);
    let lens = format!(r#"{LENS}, "ply_file_path": "cloud.ply""#);
    let json = transforms(&lens, &["images/a.exr", "images/b.exr", "images/c.exr", "images/d.exr"]);
    scene.write("transforms.json", &json);
    let data = load(&scene);
    assert_said(&data, &["1 view is black", "(images/c.exr)"]);
    assert_said(&data, &["1 view is without a single usable pixel", "(images/d.exr)"]);
    assert_said(&data, &["a single point"]);
    assert!(!data.warnings.iter().any(|line| line.contains("one place")), "{:?}", data.warnings);
    for i in 1..4 {
        let moved = json.replace(&format!("[1,0,0,{i}]"), "[1,0,0,0]");
        scene.write(
            "transforms.json",
            if i == 3 {
                json.replace("[1,0,0,1]", "[1,0,0,0]").replace("[1,0,0,2]", "[1,0,0,0]").replace("[1,0,0,3]", "[1,0,0,0]")
            } else {
                moved
            },
        );
        assert_eq!(load(&scene).warnings.iter().any(|line| line.contains("all 4 cameras are in one place")), i == 3);
    }
}

#[test]
fn masks_are_counted_with_what_they_hide() {
    let scene = TestScene::new();
    grey(&scene, &["images/a.exr", "images/b.exr"]);
    scene.write("transforms.json", transforms(LENS, &["images/a.exr", "images/b.exr"]));
    scene.png("masks/a.png", |x, _| if x < 8 { [0, 0, 0, 255] } else { [255; 4] });
    let data = load(&scene);
    assert_said(&data, &["1 of 2 views have masks, from ", "/masks, which hide 50.0 % of their pixels"]);
}

/// Inserts an Exif segment with this orientation behind the start of a JPEG.
fn with_orientation(jpeg: &[u8], orientation: u8) -> Vec<u8> {
    let tiff = [&b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0"[..], &[orientation, 0, 0, 0], &[0; 4]].concat();
    let block = [&b"Exif\0\0"[..], &tiff].concat();
    [&jpeg[..2], &[0xff, 0xe1], &(block.len() as u16 + 2).to_be_bytes(), &block, &jpeg[2..]].concat()
}

#[test]
fn images_are_turned_where_their_cameras_are() {
    let scene = TestScene::new();
    // Bright in the upper left quarter as stored: the upper right one of the turned image.
    let level = |i: usize| if i % 16 < 8 && i / 16 < 4 { 255 } else { 0 };
    let rgb: Vec<u8> = (0..16 * 8).flat_map(|i| [level(i); 3]).collect();
    let jpeg = encode_jpeg(16, 8, &rgb, 100).unwrap();
    let portrait = r#""fl_x": 20, "cx": 4, "cy": 8, "w": 8, "h": 16"#;
    for (orientation, bright) in [(6u8, [6, 2]), (8, [1, 13]), (5, [1, 2]), (7, [6, 13])] {
        scene.write("a.jpg", with_orientation(&jpeg, orientation));
        scene.write("transforms.json", transforms(portrait, &["a.jpg"]));
        let data = load(&scene);
        let image = &data.train[0].image;
        assert_eq!([image.width, image.height], [8, 16]);
        let [x, y] = bright;
        assert!(image.at(x, y)[1] > 0.9 && image.at(7 - x, 15 - y)[1] < 0.1, "orientation {orientation}");
        assert_said(&data, &[&format!("turned by EXIF orientation {orientation}")]);
    }
    // Cameras of the stored pixels leave them as they are.
    scene.write("transforms.json", transforms(LENS, &["a.jpg"]));
    let data = load(&scene);
    assert_eq!([data.train[0].image.width, data.train[0].image.height], [16, 8]);
    assert!(!data.warnings.iter().any(|line| line.contains("EXIF")), "{:?}", data.warnings);
    // Where both fit, a warning tells which is read.
    scene.write("a.jpg", with_orientation(&jpeg, 3));
    assert_said(&load(&scene), &["EXIF orientation 3 is not applied"]);
}
