//! Data sets of every layout, good and bad, written to a temporary folder and read back.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use common::TestScene;
use glam::{DVec2, DVec3};
use luxel_core::{BadPixels, ColorSpace, Dataset, Distortion};
use luxel_io::{DatasetFormat, IoErrorKind, LoadOptions, Transfer, detect_format, load_dataset, parse_split, parse_transforms};
use proptest::prelude::*;

impl TestScene {
    /// Writes images of one colour each.
    fn exrs<S: AsRef<str>>(&self, names: impl IntoIterator<Item = S>) {
        for (i, name) in names.into_iter().enumerate() {
            self.exr(name.as_ref(), |_, _| [i as f32 + 0.5; 3]);
        }
    }

    fn load(&self) -> Dataset {
        self.read(&LoadOptions::default()).unwrap()
    }

    fn error(&self) -> String {
        self.read(&LoadOptions::default()).unwrap_err().to_string()
    }
}

/// Returns the rows of a camera-to-world matrix that looks along -z from (x, 0, 4).
fn pose(x: f64) -> String {
    format!("[[1,0,0,{x}],[0,1,0,0],[0,0,1,4],[0,0,0,1]]")
}

const LENS: &str = r#""fl_x": 20, "fl_y": 20, "cx": 8, "cy": 4, "w": 16, "h": 8"#;

/// Returns a transforms.json with these file paths, one unit apart.
fn transforms<S: AsRef<str>>(lens: &str, file_paths: &[S]) -> String {
    let frame = |(i, file): (usize, &S)| format!(r#"{{"file_path": {:?}, "transform_matrix": {}}}"#, file.as_ref(), pose(i as f64));
    let frames: Vec<String> = file_paths.iter().enumerate().map(frame).collect();
    format!("{{{lens}, \"frames\": [{}]}}", frames.join(", "))
}

/// Writes a COLMAP text model of the same cameras: `points` see each point in every image.
fn colmap(scene: &TestScene, folder: &str, camera: &str, lens: Distortion, names: &[&str], points: &[DVec3]) {
    scene.write(&format!("{folder}/cameras.txt"), camera);
    let (mut images, mut tracks) = (String::new(), vec![String::new(); points.len()]);
    for (i, name) in names.iter().enumerate() {
        // The rotation by half a turn about x takes OpenGL's axes to OpenCV's.
        writeln!(images, "{} 0 1 0 0 {} 0 4 1 {name}", i + 1, -(i as f64)).unwrap();
        for (k, p) in points.iter().enumerate() {
            let seen = lens.distort(DVec2::new(p.x - i as f64, -p.y) / (4.0 - p.z)) * 20.0 + DVec2::new(8.0, 4.0);
            write!(images, "{} {} {k} ", seen.x, seen.y).unwrap();
            write!(tracks[k], " {} {k}", i + 1).unwrap();
        }
        images.push('\n');
    }
    scene.write(&format!("{folder}/images.txt"), images);
    let point = |(k, p): (usize, &DVec3)| format!("{k} {} {} {} 1 2 3 0.1{}\n", p.x, p.y, p.z, tracks[k]);
    scene.write(&format!("{folder}/points3D.txt"), points.iter().enumerate().map(point).collect::<String>());
}

const PINHOLE: &str = "1 PINHOLE 16 8 20 20 8 4";

fn names(views: &[luxel_core::View]) -> Vec<&str> {
    views.iter().map(|view| view.name.as_str()).collect()
}

/// Returns the largest distance of an observation from where its point projects, and how many there
/// are.
fn reprojection(data: &Dataset) -> (f64, usize) {
    let (mut worst, mut count) = (0.0f64, 0);
    for point in &data.points {
        for o in &point.observations {
            let camera = &data.train[o.view as usize].camera;
            let (px, _) = camera.project(glam::Vec3::from(point.position).as_dvec3()).unwrap();
            worst = worst.max(px.distance(glam::Vec2::from(o.pixel_px).as_dvec2()));
            count += 1;
        }
    }
    (worst, count)
}

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
fn observations_follow_undistortion_and_reduction() {
    let lens = Distortion { k1: -0.2, k2: 0.05, p1: 0.002, p2: -0.001 };
    let points = [DVec3::new(0.5, 0.2, 0.0), DVec3::new(-0.3, -0.4, 1.0), DVec3::new(0.0, 0.0, -2.0)];
    let files = ["a.exr", "b.exr", "c.exr"];
    for (camera, distortion) in [(PINHOLE, Distortion::default()), ("1 OPENCV 16 8 20 20 8 4 -0.2 0.05 0.002 -0.001", lens)] {
        let scene = TestScene::new();
        for file in files {
            // Every pixel holds its own coordinates.
            scene.exr(&format!("images/{file}"), |x, y| [x as f32 + 0.5, y as f32 + 0.5, 0.0]);
        }
        colmap(&scene, "sparse/0", camera, distortion, &files, &points);
        for downscale in [1, 2] {
            let data = load_dataset(scene.path(), &LoadOptions { downscale, ..LoadOptions::default() }).unwrap();
            assert_eq!((names(&data.train), names(&data.test)), (vec!["images/b", "images/c"], vec!["images/a"]));
            assert_eq!(data.points.len(), 3);
            assert_eq!(data.points[0].rgb8, Some([1, 2, 3]));
            let (worst, count) = reprojection(&data);
            // Features outside of the small image are dropped, and those of the held-out view.
            assert!((2..=6).contains(&count), "{count}");
            assert!(worst < 1e-4, "{worst}");
            for point in &data.points {
                for o in &point.observations {
                    let view = &data.train[o.view as usize];
                    let p = glam::Vec3::from(point.position).as_dvec3() - view.camera.eye();
                    let feature = distortion.distort(DVec2::new(p.x, -p.y) / -p.z) * 20.0 + DVec2::new(8.0, 4.0);
                    let [x, y, _] = view.image.at(o.pixel_px[0] as usize, o.pixel_px[1] as usize);
                    // Half a pixel of the view, and what the lens stretches it by.
                    let off = DVec2::new(f64::from(x), f64::from(y)) - feature;
                    assert!(off.abs().max_element() <= 0.6 * f64::from(downscale), "{off}");
                }
            }
            let camera = &data.train[0].camera;
            assert!(camera.distortion.is_none());
            assert_eq!(camera.size_px.map(|s| s as usize), [data.train[0].image.width, data.train[0].image.height]);
        }
    }
}

#[test]
fn colmap_points_beside_transforms_share_the_cameras_frame() {
    let scene = TestScene::new();
    let files = ["images/a.exr", "images/b.exr"];
    scene.exrs(files);
    scene.write("split.json", r#"{"train": ["a", "b"], "test": []}"#);
    colmap(&scene, "sparse/0", PINHOLE, Distortion::default(), &["a.png", "b.png"], &[DVec3::new(0.5, 0.2, 0.0)]);
    scene.write("transforms.json", transforms(LENS, &files));
    let data = scene.load();
    assert_eq!(data.format, "nerfstudio transforms.json");
    assert_eq!(reprojection(&data).1, 2);
    assert!(reprojection(&data).0 < 1e-5);
    // A frame of its own without a word of how: the points would be wrong.
    let moved = transforms(LENS, &files).replace(&pose(1.0), &pose(3.0));
    scene.write("transforms.json", moved);
    let data = scene.load();
    assert!(data.points.is_empty() && data.warnings[0].contains("do not share a coordinate frame"), "{:?}", data.warnings);
    // With the word, they are moved along: here everything is twice as large.
    let scaled = format!("{LENS}, \"applied_transform\": [[2,0,0,0],[0,2,0,0],[0,0,2,0]]");
    let eyes = transforms(&scaled, &files).replace("[1,0,0,1]", "[1,0,0,2]").replace("[0,0,1,4]", "[0,0,1,8]");
    scene.write("transforms.json", eyes);
    let data = scene.load();
    assert_eq!(data.points[0].position, [1.0, 0.4, 0.0]);
    assert!(reprojection(&data).0 < 1e-5);
}

#[test]
fn ply_points_are_read() {
    let scene = TestScene::new();
    scene.exrs(["a.exr"]);
    let ply = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n1 2 3 4 5 6\n7 8 9 10 11 12\n";
    scene.write("cloud.ply", ply);
    scene.write("transforms.json", transforms(&format!(r#"{LENS}, "ply_file_path": "./cloud.ply""#), &["a.exr"]));
    let data = scene.load();
    assert_eq!(data.points[1].position, [7.0, 8.0, 9.0]);
    assert_eq!(data.points[1].rgb8, Some([10, 11, 12]));
    scene.write("cloud.ply", &ply[..ply.len() - 8]);
    assert!(scene.error().contains("cloud.ply"));
    scene.write("cloud.ply", ply.replace("vertex 2", "vertex 1099511627776"));
    assert!(scene.error().contains("cloud.ply"));
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

#[test]
fn no_images_are_an_error() {
    let scene = TestScene::new();
    scene.write("transforms.json", transforms::<&str>(LENS, &[]));
    assert!(scene.error().contains("no images"));
    scene.exrs(["a.exr"]);
    scene.write("transforms.json", transforms(LENS, &["a.exr"]));
    scene.write("split.json", r#"{"train": [], "test": ["a"]}"#);
    assert!(scene.error().contains("no training images among 1"));
    let scene = TestScene::new();
    colmap(&scene, "sparse", PINHOLE, Distortion::default(), &[], &[]);
    assert!(scene.error().contains("no registered images"));
}

#[test]
fn folders_that_are_no_data_set_say_what_was_looked_for_and_found() {
    let scene = TestScene::new();
    assert!(scene.error().ends_with("found an empty folder"));
    scene.write("notes.txt", "x");
    let error = scene.error();
    assert!(error.contains("expected transforms.json") && error.contains("sparse/0") && error.ends_with("found notes.txt"), "{error}");
    let missing = load_dataset(&scene.path().join("nowhere"), &LoadOptions::default()).unwrap_err();
    assert_eq!(missing.kind, IoErrorKind::System);
    assert!(load_dataset(&scene.path().join("notes.txt"), &LoadOptions::default()).unwrap_err().message.contains("is a file"));
    let wrong = LoadOptions { format: Some(DatasetFormat::Transforms), ..LoadOptions::default() };
    assert!(load_dataset(scene.path(), &wrong).unwrap_err().message.contains("not of format transforms"));
    let wrong = LoadOptions { format: Some(DatasetFormat::Colmap), ..LoadOptions::default() };
    assert!(load_dataset(scene.path(), &wrong).unwrap_err().message.contains("no COLMAP model"));
    let wrong = LoadOptions { downscale: 3, ..LoadOptions::default() };
    assert!(load_dataset(scene.path(), &wrong).unwrap_err().message.contains("expected 1, 2, 4 or 8"));
}

#[test]
fn missing_and_damaged_images_are_named_with_their_frame() {
    let scene = TestScene::new();
    scene.exrs(["a.exr"]);
    let json = scene.write("transforms.json", transforms(LENS, &["a.exr", "b.exr"]));
    let missing = scene.path().join("b.exr");
    assert_eq!(scene.error(), format!("{}: frame 1 (\"b.exr\"): image {} does not exist", json.display(), missing.display()));
    let whole = std::fs::read(scene.path().join("a.exr")).unwrap();
    for n in [0, 3, 100, whole.len() / 2, whole.len() - 1] {
        scene.write("b.exr", &whole[..n]);
        assert!(scene.error().starts_with(&missing.display().to_string()), "cut at {n}: {}", scene.error());
    }
}

#[test]
fn of_several_damaged_images_the_first_by_name_is_reported() {
    let scene = TestScene::new();
    // Sorted, the first is held out, and so read behind the training views.
    let files = ["a.exr", "b.exr", "c.exr", "d.exr"];
    scene.exrs(files);
    scene.write("transforms.json", transforms(LENS, &files));
    for bad in [&["c.exr", "d.exr"][..], &["b.exr", "c.exr"], &["a.exr", "b.exr", "d.exr"]] {
        scene.exrs(files);
        for file in bad {
            scene.write(file, "no image");
        }
        for _ in 0..20 {
            assert!(scene.error().starts_with(&scene.path().join(bad[0]).display().to_string()), "{bad:?}: {}", scene.error());
        }
    }
}

#[test]
fn truncated_split_and_text_model_are_errors_that_name_the_file_or_a_smaller_model() {
    let scene = TestScene::new();
    scene.exrs(["images/a.exr", "images/b.exr"]);
    let points = [DVec3::ZERO, DVec3::new(0.5, 0.1, 0.2)];
    colmap(&scene, "sparse/0", PINHOLE, Distortion::default(), &["a.exr", "b.exr"], &points);
    let split = r#"{"train": ["a"], "test": ["b"]}"#;
    scene.write("split.json", split);
    assert_eq!(scene.load().train.len(), 1);
    for n in 0..split.len() {
        scene.write("split.json", &split[..n]);
        assert!(scene.error().contains("split.json: not JSON"), "cut at {n}: {}", scene.error());
    }
    scene.write("split.json", split);
    for name in ["cameras.txt", "images.txt", "points3D.txt"] {
        let whole = std::fs::read(scene.path().join("sparse/0").join(name)).unwrap();
        for n in 0..whole.len() {
            scene.write(&format!("sparse/0/{name}"), &whole[..n]);
            match load_dataset(scene.path(), &LoadOptions::default()) {
                // Text may end behind any entry, and behind some digits of its last number.
                Ok(data) => assert!(data.train.len() + data.test.len() <= 2 && data.points.len() <= points.len()),
                Err(error) => assert!(error.to_string().contains(scene.path().to_str().unwrap()), "{name} cut at {n}: {error}"),
            }
        }
        scene.write(&format!("sparse/0/{name}"), whole);
    }
}

#[cfg(unix)]
#[test]
fn written_files_have_the_permissions_of_ordinary_ones() {
    use std::os::unix::fs::PermissionsExt as _;
    let scene = TestScene::new();
    let mode = |path: PathBuf| std::fs::metadata(path).unwrap().permissions().mode();
    let path = scene.path().join("out/atomic.txt");
    luxel_io::write_atomically(&path, |out| out.write_all(b"x").map_err(|e| luxel_io::IoError::system(&path, "write", &e))).unwrap();
    assert_eq!(mode(path.clone()), mode(scene.write("out/ordinary.txt", "x")));
    assert_eq!(std::fs::read_dir(scene.path().join("out")).unwrap().count(), 2, "nothing temporary is left");
}

#[test]
fn cameras_that_are_none_are_named_with_their_frame() {
    let scene = TestScene::new();
    scene.exrs(["a.exr", "b.exr"]);
    let good = transforms(LENS, &["a.exr", "b.exr"]);
    let with = |from: &str, to: &str| {
        scene.write("transforms.json", good.replace(from, to));
        scene.error()
    };
    assert!(with("[1,0,0,1]", "[0,0,0,1]").contains("frame 1 (\"b.exr\"): \"transform_matrix\" is not a rotation"));
    assert!(with("[1,0,0,1]", "[NaN,0,0,1]").contains("NaN and Infinity are not JSON numbers"));
    assert!(with("[1,0,0,1]", "[1e999,0,0,1]").contains("not JSON"));
    assert!(with("[1,0,0,1]", "[null,0,0,1]").contains("row 0 column 0 is null"));
    assert!(with(",[0,0,0,1]]", "]").contains("\"transform_matrix\" has 3 rows, expected 4"));
    assert!(with("\"fl_x\": 20", "\"fl_x\": 0").contains("focal length 0 x 20"));
    assert!(with("\"fl_x\": 20", "\"fl_x\": -1").contains("focal length -1"));
    assert!(with("\"w\": 16", "\"w\": 20").contains("the image is 16 x 8 pixels, its camera 20 x 8"));
    for camera in ["1 PINHOLE 16 8 0 20 8 4", "1 PINHOLE 16 8 20 nan 8 4"] {
        let scene = TestScene::new();
        scene.exrs(["images/a.exr"]);
        colmap(&scene, "sparse/0", camera, Distortion::default(), &["a.exr"], &[]);
        assert!(scene.error().contains("image 1 (\"a.exr\"): focal length"), "{}", scene.error());
    }
}

#[test]
fn smaller_copies_of_the_images_scale_their_cameras() {
    let scene = TestScene::new();
    scene.exrs(["a.exr"]);
    let lens = LENS.replace("16", "32").replace("\"h\": 8", "\"h\": 16");
    scene.write("transforms.json", transforms(&lens, &["a.exr"]));
    let camera = scene.load().train[0].camera.clone();
    assert_eq!((camera.size_px, camera.focal_px, camera.center_px), ([16, 8], DVec2::splat(10.0), DVec2::new(4.0, 2.0)));
}

#[test]
fn duplicate_names_are_an_error() {
    let scene = TestScene::new();
    scene.exrs(["a.exr"]);
    scene.write("transforms.json", transforms(LENS, &["a.exr", "./a.exr"]));
    assert!(scene.error().contains("frame 1 (\"./a.exr\"): the image is named \"a\" like that of"), "{}", scene.error());
    // A test view must not be trained on.
    scene.write("transforms_train.json", transforms(LENS, &["a.exr"]));
    scene.write("transforms_test.json", transforms(LENS, &["a.exr"]));
    assert!(scene.error().contains("expected each image once"));
}

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
    let data = load_dataset(scene.path(), &LoadOptions { downscale: 2, ..LoadOptions::default() }).unwrap();
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
fn fingerprint_follows_content_split_and_options() {
    let scene = TestScene::new();
    scene.exrs(["a.exr", "b.exr", "c.exr"]);
    scene.write("transforms.json", transforms(LENS, &["a.exr", "b.exr", "c.exr"]));
    let first = scene.load().fingerprint;
    assert_eq!(scene.load().fingerprint, first);
    let reduced = load_dataset(scene.path(), &LoadOptions { downscale: 2, ..LoadOptions::default() }).unwrap();
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
fn absurd_counts_and_missing_files_of_a_model_are_errors() {
    let scene = TestScene::new();
    scene.exrs(["images/a.exr"]);
    for (name, count) in [("cameras", 0u64), ("images", 0), ("points3D", 1 << 40)] {
        scene.write(&format!("sparse/0/{name}.bin"), count.to_le_bytes());
    }
    assert!(scene.error().contains("claims 1099511627776 points"), "{}", scene.error());
    // A model may lack points, but not images.
    std::fs::remove_file(scene.path().join("sparse/0/points3D.bin")).unwrap();
    assert!(scene.error().contains("no registered images"), "{}", scene.error());
    std::fs::remove_file(scene.path().join("sparse/0/images.bin")).unwrap();
    assert!(scene.error().contains("images.bin: cannot read"), "{}", scene.error());
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

#[test]
fn every_truncation_of_the_json_is_an_error() {
    let whole = transforms(LENS, &["a.exr"]);
    assert!(parse_transforms(Path::new("t"), whole.as_bytes()).is_ok());
    for n in 0..whole.len() {
        assert!(parse_transforms(Path::new("t"), &whole.as_bytes()[..n]).is_err(), "cut at {n}");
    }
}

proptest! {
    #[test]
    fn random_bytes_are_no_json_and_no_panic(bytes: Vec<u8>) {
        let _ = parse_transforms(Path::new("t"), &bytes);
        let _ = parse_split(Path::new("s"), &bytes);
    }

    #[test]
    fn damaged_json_does_not_panic(at in 0usize..1000, replacement in "[-0-9eE.,\\[\\]{}\":a-z]{0,4}") {
        let mut text = transforms(&format!("{LENS}, \"k1\": 0.1, \"applied_transform\": [[1,0,0,0],[0,1,0,0],[0,0,1,0]]"), &["a.exr", "b.exr"]);
        let at = at % text.len();
        text.replace_range(at..=at, &replacement);
        if let Ok(parsed) = parse_transforms(Path::new("t"), text.as_bytes()) {
            for frame in parsed.frames {
                let _ = frame.camera(frame.size_px().unwrap_or([16, 8]));
            }
        }
    }
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
