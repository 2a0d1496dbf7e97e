//! Data sets that are wrong: the message names file, place and what was expected.

use super::*;

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
    for factor in [0, 17] {
        let wrong = LoadOptions { downscale: factor.into(), ..LoadOptions::default() };
        let message = load_dataset(scene.path(), &wrong).unwrap_err().message;
        assert_eq!(message, format!("reduction by {factor}, expected auto or a whole number from 1 to 16"));
    }
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
fn absurd_counts_and_missing_files_of_a_model_are_errors() {
    let scene = TestScene::new();
    scene.exrs(["images/a.exr"]);
    for (name, count) in [("cameras", 0u64), ("images", 0), ("points3D", 1_000_000)] {
        scene.write(&format!("sparse/0/{name}.bin"), count.to_le_bytes());
    }
    assert!(scene.error().contains("claims 1000000 points"), "{}", scene.error());
    // A model may lack points, but not images.
    std::fs::remove_file(scene.path().join("sparse/0/points3D.bin")).unwrap();
    assert!(scene.error().contains("no registered images"), "{}", scene.error());
    std::fs::remove_file(scene.path().join("sparse/0/images.bin")).unwrap();
    assert!(scene.error().contains("images.bin: cannot read"), "{}", scene.error());
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
        let _ = parse_block(Path::new("b"), &bytes);
    }

    #[test]
    fn damaged_blocks_do_not_panic(at in 0usize..1000, replacement in "[-0-9eE.,\\[\\]{}\":a-z]{0,4}") {
        let block = luxel_io::Block {
            dataset: "whole".into(),
            views: vec!["images/000".to_owned()],
            radiance_scale: 1.5,
            axes: [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
            core: [[None, Some(0.5)], [None, None]],
            reach: [[None, Some(0.7)], [None, None]],
        };
        let mut text = serde_json::to_string(&block).unwrap();
        prop_assert_eq!(parse_block(Path::new("b"), text.as_bytes()).unwrap(), block);
        let at = at % text.len();
        text.replace_range(at..at + 1, &replacement);
        if let Ok(found) = parse_block(Path::new("b"), text.as_bytes()) {
            prop_assert!(found.radiance_scale > 0.0);
        }
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
