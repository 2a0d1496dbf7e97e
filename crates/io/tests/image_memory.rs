//! Data sets whose images have no room in memory: what is stored, what is read again, and what
//! happens to caches that are damaged, stale or cannot be written.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

#[allow(dead_code, reason = "other tests use the rest")]
mod common;

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use common::{SIZE, TestScene};
use luxel_core::{Dataset, Image, View};
use luxel_io::{
    ExrOptions, ExrSample, ImageMemory, IoError, LoadOptions, LoadProgress, Loading, MAX_RELATIVE_ERROR, ViewPlace, load_dataset,
    load_dataset_within, write_exr,
};

const VIEWS: usize = 12;
/// Room for five decoded images: three in use, and two of twelve stored ones, or a few more as half
/// floats.
const ROOM: ImageMemory = ImageMemory::Bytes(5 * 12 * (SIZE[0] * SIZE[1]) as u64);

fn value(view: usize, x: usize, y: usize) -> [f32; 3] {
    let base = 0.37 + (view * 131 + y * 17 + x) as f32 / 7.0;
    [base * 900.0, base, base * 1e-3]
}

/// Writes views of these samples, which see the space around the origin, and a mask of the first.
fn scene(sample: ExrSample) -> TestScene {
    let scene = TestScene::new();
    let mut frames = Vec::new();
    for i in 0..VIEWS {
        let pixels = (0..SIZE[0] * SIZE[1]).map(|at| value(i, at % SIZE[0], at / SIZE[0])).collect();
        let image = Image::from_pixels(SIZE[0], SIZE[1], pixels).unwrap();
        write_exr(&scene.path().join(format!("data/images/{i:03}.exr")), &image, &ExrOptions { sample, ..ExrOptions::default() }).unwrap();
        frames.push(format!(r#"{{"file_path": "images/{i:03}.exr", "transform_matrix": [[1,0,0,{i}],[0,1,0,0],[0,0,1,4],[0,0,0,1]]}}"#));
    }
    scene.png("data/masks/001.png", |x, _| if x < 5 { [0, 0, 0, 255] } else { [255; 4] });
    let lens = r#""fl_x": 20, "fl_y": 20, "cx": 8, "cy": 4, "w": 16, "h": 8"#;
    scene.write("data/transforms.json", format!("{{{lens}, \"frames\": [{}]}}", frames.join(", ")));
    scene
}

fn cache(scene: &TestScene) -> PathBuf {
    scene.path().join("run.images")
}

fn read(scene: &TestScene, options: &LoadOptions) -> Result<Dataset, IoError> {
    let cache = cache(scene);
    let loading = Loading { image_memory: ROOM, cache: Some(&cache), ..Loading::default() };
    load_dataset_within(&scene.path().join("data"), options, &loading)
}

fn within(scene: &TestScene) -> Dataset {
    read(scene, &LoadOptions::default()).unwrap()
}

fn in_memory(scene: &TestScene) -> Dataset {
    load_dataset(&scene.path().join("data"), &LoadOptions::default()).unwrap()
}

fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().map(|entry| entry.unwrap().path());
    let mut found: Vec<PathBuf> = entries.filter(|path| path.extension().is_some_and(|e| e == extension)).collect();
    found.sort();
    found
}

/// Asserts that two views are the same but for the error of storing, which is `error` of a value.
fn assert_close(stored: &View, exact: &View, error: f32) {
    assert!(!stored.is_in_memory());
    let loaded = stored.loaded().unwrap();
    for (found, value) in loaded.image.pixels.as_flattened().iter().zip(exact.image.pixels.as_flattened()) {
        assert!((found - value).abs() <= error * value, "{}: {found} {value}", stored.name);
    }
    assert_eq!((&loaded.mask, &loaded.camera, &loaded.name), (&exact.mask, &exact.camera, &exact.name));
    assert!(!stored.is_in_memory());
}

#[test]
fn images_of_half_floats_stay_exact_and_the_data_set_is_the_same() {
    let scene = scene(ExrSample::Half);
    let (exact, stored) = (in_memory(&scene), within(&scene));
    assert_eq!((&stored.fingerprint, &stored.warnings, stored.train.len()), (&exact.fingerprint, &exact.warnings, exact.train.len()));
    for (stored, exact) in stored.train.iter().chain(&stored.test).zip(exact.train.iter().chain(&exact.test)) {
        assert_close(stored, exact, 0.0);
    }
    // Test views are not stored.
    assert_eq!(files(&cache(&scene), "image").len(), exact.train.len());
    assert_eq!(files(&cache(&scene), "mask").len(), 1);
}

#[test]
fn single_floats_are_within_the_stated_error_and_test_views_exact() {
    let scene = scene(ExrSample::Float);
    let (exact, stored) = (in_memory(&scene), within(&scene));
    for (stored, exact) in stored.train.iter().zip(&exact.train) {
        assert_close(stored, exact, MAX_RELATIVE_ERROR);
    }
    for (stored, exact) in stored.test.iter().zip(&exact.test) {
        assert_close(stored, exact, 0.0);
    }
    let differs = |view: usize| *stored.train[view].loaded().unwrap().image != *exact.train[view].image;
    assert!((0..exact.train.len()).any(differs), "halves were stored");
}

#[test]
fn a_cache_is_used_again_and_only_for_the_same_files_and_options() {
    let scene = scene(ExrSample::Half);
    let written =
        || -> Vec<_> { files(&cache(&scene), "image").iter().map(|path| std::fs::metadata(path).unwrap().modified().unwrap()).collect() };
    let first = within(&scene);
    let times = written();
    let again = within(&scene);
    assert_eq!((written(), &again.fingerprint), (times.clone(), &first.fingerprint));
    // Another reduction: other files, and the old ones are gone.
    let halved = read(&scene, &LoadOptions { downscale: 2.into(), ..LoadOptions::default() }).unwrap();
    assert!(halved.train.iter().all(View::is_in_memory), "a quarter of the pixels has room");
    // A changed image is read anew, and what was stored of it is replaced.
    let image = Image::filled(SIZE[0], SIZE[1], [7.0; 3]);
    write_exr(&scene.path().join("data/images/001.exr"), &image, &ExrOptions::default()).unwrap();
    let changed = within(&scene);
    assert_ne!(changed.fingerprint, first.fingerprint);
    assert_eq!(changed.train[0].loaded().unwrap().image.pixels[40], [7.0; 3]);
    assert_eq!(written().iter().filter(|time| !times.contains(time)).count(), 1);
}

#[test]
fn files_of_views_that_are_gone_are_removed_and_others_stay() {
    let scene = scene(ExrSample::Half);
    within(&scene);
    let notes = scene.write("run.images/notes.txt", "mine");
    let before = files(&cache(&scene), "image");
    let json = scene.path().join("data/transforms.json");
    let text = std::fs::read_to_string(&json).unwrap();
    // One pose is another one now.
    std::fs::write(&json, text.replace("[1,0,0,3]", "[1,0,0,3.5]")).unwrap();
    within(&scene);
    let after = files(&cache(&scene), "image");
    assert_eq!((after.len(), after.iter().filter(|path| !before.contains(path)).count()), (before.len(), 1));
    assert!(notes.is_file());
}

#[test]
fn damaged_and_missing_files_are_made_anew() {
    let scene = scene(ExrSample::Half);
    let exact = in_memory(&scene);
    within(&scene);
    let stored = files(&cache(&scene), "image");
    let whole: Vec<Vec<u8>> = stored.iter().map(|path| std::fs::read(path).unwrap()).collect();
    let mut flipped = whole[0].clone();
    *flipped.last_mut().unwrap() ^= 1;
    std::fs::write(&stored[0], flipped).unwrap();
    std::fs::write(&stored[1], &whole[1][..60]).unwrap();
    std::fs::remove_file(&stored[2]).unwrap();
    std::fs::write(&files(&cache(&scene), "json")[3], "{}").unwrap();
    std::fs::write(&files(&cache(&scene), "mask")[0], "").unwrap();
    let dataset = within(&scene);
    // And while the data set is in use.
    std::fs::write(&stored[4], "nothing").unwrap();
    std::fs::remove_file(&stored[5]).unwrap();
    for (stored, exact) in dataset.train.iter().zip(&exact.train) {
        assert_close(stored, exact, 0.0);
    }
    assert_eq!(stored.iter().map(|path| std::fs::read(path).unwrap()).collect::<Vec<_>>(), whole);
}

#[test]
fn a_source_that_changes_while_it_is_used_is_an_error() {
    let scene = scene(ExrSample::Half);
    let dataset = within(&scene);
    write_exr(&scene.path().join("data/images/000.exr"), &Image::filled(SIZE[0], SIZE[1], [7.0; 3]), &ExrOptions::default()).unwrap();
    let error = dataset.test[0].loaded().unwrap_err();
    assert!(error.message.contains("000.exr: the file changed since the data set was read"), "{error}");
    assert!(dataset.test[0].image.pixels[0][0].is_nan(), "nothing computed from it passes for a result");
}

#[test]
fn what_memory_and_disk_refuse_is_an_error_with_a_remedy() {
    let scene = scene(ExrSample::Half);
    let cache = cache(&scene);
    let read = |image_memory| {
        load_dataset_within(
            &scene.path().join("data"),
            &LoadOptions::default(),
            &Loading { image_memory, cache: Some(&cache), ..Loading::default() },
        )
    };
    let error = read(ImageMemory::Bytes(4000)).unwrap_err();
    assert!(error.message.contains("3 are in memory at the same time"), "{error}");
    assert!(error.remedy.unwrap().options().eq(["image_memory", "downscale"]));
    scene.write("run.images", "a file in the way");
    let error = read(ROOM).unwrap_err();
    assert!(error.to_string().contains("run.images"), "{error}");
    assert!(error.remedy.unwrap().options().any(|option| option == "image_memory"));
}

#[test]
fn without_a_cache_views_are_decoded_from_their_files() {
    let scene = scene(ExrSample::Float);
    let exact = in_memory(&scene);
    let events = Mutex::new(Vec::new());
    let progress = |event: LoadProgress| events.lock().unwrap().push(event);
    let loading = Loading { image_memory: ROOM, cache: None, progress: Some(&progress), check: None, keep: None };
    let dataset = load_dataset_within(&scene.path().join("data"), &LoadOptions::default(), &loading).unwrap();
    for (stored, exact) in dataset.train.iter().chain(&dataset.test).zip(exact.train.iter().chain(&exact.test)) {
        assert_close(stored, exact, 0.0);
    }
    assert_eq!(dataset.fingerprint, exact.fingerprint);
    let events = events.into_inner().unwrap();
    let LoadProgress::Planned(plan) = &events[0] else { panic!("{:?}", events[0]) };
    assert_eq!((plan.images, plan.fits(), plan.memory_bytes()), (VIEWS, false, ROOM.bytes()));
    assert_eq!(events.len(), 1 + VIEWS);
    let done: Vec<usize> =
        events.iter().filter_map(|event| if let LoadProgress::View { done, .. } = event { Some(*done) } else { None }).collect();
    assert_eq!(done.iter().max(), Some(&VIEWS));
}

#[test]
fn views_that_are_not_kept_are_read_from_their_files_exactly() {
    let scene = scene(ExrSample::Float);
    let exact = in_memory(&scene);
    let keep = |place| matches!(place, ViewPlace::Train(view) if view % 3 == 1);
    let part = load_dataset_within(
        &scene.path().join("data"),
        &LoadOptions::default(),
        &Loading { cache: Some(&cache(&scene)), keep: Some(&keep), ..Loading::default() },
    )
    .unwrap();
    assert!(part.fingerprint == exact.fingerprint && !cache(&scene).exists());
    for (i, (view, exact)) in part.train.iter().zip(&exact.train).enumerate() {
        assert_eq!(view.is_in_memory(), i % 3 == 1, "{i}");
        let loaded = view.loaded().unwrap();
        assert!(loaded.image == exact.image && loaded.mask == exact.mask && loaded.camera == exact.camera, "{i}");
    }
    assert!(part.test.iter().all(|view| !view.is_in_memory()));
}
