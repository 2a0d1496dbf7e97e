//! Cameras of renders: paths made from the views, other image sizes; and what a pixel is made of.

use luxel_core::Image;

use crate::common::{SIDE, Workplace};

#[test]
fn a_path_is_rendered_and_written_as_cameras() {
    let place = Workplace::new();
    place.train("run", &[]);
    for path in ["orbit", "spiral", "between-views"] {
        let told = place.notes(&["render", "run", "--path", path, "--frames", "3", "-o", path]);
        assert!(told.contains("3 frames") && told.contains("cameras.json: 3 cameras"), "{told}");
        // The file makes the same frames.
        let again = format!("{path}-again");
        let cameras = format!("{path}/cameras.json");
        place.ok(&["render", "run", "--cameras", &cameras, "-o", &again]);
        for i in 0..3 {
            let (first, second) = (place.image(&format!("{path}/frame_0000{i}.exr")), place.image(&format!("{again}/frame_0000{i}.exr")));
            let light: f32 = first.pixels.iter().flatten().sum();
            let difference: f32 = first.pixels.iter().flatten().zip(second.pixels.iter().flatten()).map(|(a, b)| (a - b).abs()).sum();
            assert!(light > 0.0 && difference < 1e-3 * light, "{path} {i}: {difference} of {light}");
        }
        assert!(!place.path(path).join("frame_00003.exr").exists());
    }
    let orbit = ["render", "run", "--path", "orbit", "--frames", "3", "-o", "orbit"];
    assert!(place.notes(&orbit).contains("3 images exist already and are kept"));
    // Shards share the frames and the file.
    place.ok(&["render", "run", "--path", "orbit", "--frames", "4", "--shard", "1/2", "-o", "shards"]);
    place.ok(&["render", "run", "--path", "orbit", "--frames", "4", "--shard", "0/2", "-o", "shards"]);
    assert!((0..4).all(|i| place.path(&format!("shards/frame_0000{i}.exr")).is_file()));
    place.error(&["render", "run", "--path", "orbit", "--frames", "5", "-o", "shards"], &["exists already", "--overwrite"]);
    place.error(&["render", "run", "--path", "orbit", "--frames", "3-5", "-o", "x"], &["the number of frames"]);
    place.error(&["render", "run/point_cloud/iteration_40/point_cloud.ply", "--path", "orbit", "-o", "x"], &["give --data"]);
    for more in [["--cameras", "orbit/cameras.json"], ["--split", "all"]] {
        place.fails(2, &[&["render", "run", "--path", "orbit", "-o", "x"][..], &more].concat());
    }
}

#[test]
fn cameras_go_to_openusd_and_come_back() {
    let place = Workplace::new();
    place.train("run", &[]);
    let render = |args: &[&str]| place.ok(&[&["render", "run", "--exr-type", "float"][..], args].concat());
    let assert_equal = |first: &str, second: &str| {
        let (first, second) = (place.image(first), place.image(second));
        let light: f32 = first.pixels.iter().flatten().sum();
        let difference: f32 = first.pixels.iter().flatten().zip(second.pixels.iter().flatten()).map(|(a, b)| (a - b).abs()).sum();
        assert!(light > 0.0 && difference < 1e-3 * light, "{difference} of {light}");
    };
    render(&["--path", "orbit", "--frames", "3", "--write-cameras", "orbit.usda", "-o", "orbit"]);
    render(&["--cameras", "orbit.usda", "-o", "again"]);
    for i in 0..3 {
        assert_equal(&format!("orbit/frame_0000{i}.exr"), &format!("again/shot.000{i}.exr"));
    }
    // The data set's cameras, a prim each; one of them by its name; all of them as JSON.
    render(&["--split", "all", "--write-cameras", "views.usda", "-o", "views"]);
    let layer = std::fs::read_to_string(place.path("views.usda")).unwrap();
    let first = layer.split("def Camera \"").nth(1).and_then(|rest| rest.split('"').next()).unwrap().to_owned();
    let told = place.notes(&["render", "run", "--cameras", "views.usda", "--camera", &first, "--write-cameras", "one.json", "-o", "one"]);
    assert!(told.contains("views.usda: 1 camera") && told.contains("one.json: 1 camera"), "{told}");
    assert_eq!(luxel::read_cameras(place.path("one.json")).unwrap().len(), 1);
    let again = ["render", "run", "--split", "train", "--write-cameras", "views.usda", "-o", "train"];
    place.error(&again, &["views.usda", "exists already", "--overwrite"]);
    place.error(&["render", "run", "--cameras", "views.usda", "--camera", "nobody", "-o", "x"], &["no camera \"nobody\"", &first]);
    place.error(&["render", "run", "--cameras", "one.json", "--camera", "a", "-o", "x"], &["one of an OpenUSD file"]);
    place.error(&["render", "run", "--write-cameras", "cameras.usdz", "-o", "x"], &[".json", ".usda"]);
    // Centimetres of a layer are a hundredth of the scene's unknown unit, taken for a metre.
    std::fs::write(place.path("small.usda"), layer.replace("metersPerUnit = 1", "metersPerUnit = 0.01")).unwrap();
    let told = place.notes(&["render", "run", "--cameras", "small.usda", "--camera", &first, "-o", "small"]);
    assert!(told.contains("lengths times 0.010000: metersPerUnit is 0.01, the scene's 1, since it is unknown"), "{told}");
    place.fails(2, &["render", "run", "--camera", "a", "-o", "x"]);
}

#[test]
fn images_have_the_lens_and_the_shutter_that_are_asked_for() {
    let place = Workplace::new();
    place.train("run", &[]);
    place.ok(&["render", "run", "--path", "orbit", "--frames", "3", "-o", "sharp", "--exr-type", "float"]);
    fn lens<'a>(more: &[&'a str]) -> Vec<&'a str> {
        let path = ["render", "run", "--cameras", "sharp/cameras.json", "--exr-type", "float", "--lens-samples", "8"];
        [&path[..], more].concat()
    }
    let told = place.notes(&lens(&["--aperture", "0.3", "--focus-at", "12,12", "--alpha", "--depth", "-o", "lens"]));
    assert!(told.contains("in focus: ") && told.contains("8 samples of the lens an image; estimated error"), "{told}");
    let (sharp, blurred) = (place.image("sharp/frame_00001.exr"), place.image("lens/frame_00001.exr"));
    let light = |image: &Image| image.pixels.iter().flatten().sum::<f32>();
    assert!(sharp != blurred && (light(&blurred) / light(&sharp) - 1.0).abs() < 0.2, "{} of {}", light(&blurred), light(&sharp));
    // The same photographs are kept, others replace them only if that is asked for.
    let again = place.notes(&lens(&["--aperture", "0.3", "--focus-at", "12,12", "--alpha", "--depth", "-o", "lens"]));
    assert!(again.contains("3 images exist already and are kept"), "{again}");
    place.error(&lens(&["--aperture", "0.2", "--focus-at", "12,12", "--alpha", "--depth", "-o", "lens"]), &["--overwrite"]);
    place.ok(&lens(&["--shutter", "180", "--vary-samples", "-o", "moving"]));
    assert!(place.image("moving/frame_00001.exr") != sharp);
    // A focus of each frame comes from the file.
    let cameras = std::fs::read_to_string(place.path("sharp/cameras.json")).unwrap();
    std::fs::write(place.path("pull.json"), cameras.replace("\"file_path\"", "\"focus_distance\": 2.5, \"file_path\"")).unwrap();
    let pull = ["render", "run", "--cameras", "pull.json", "--exr-type", "float", "--lens-samples", "8", "--aperture", "0.3"];
    place.ok(&[&pull[..], &["--write-cameras", "pull.usda", "-o", "pull"]].concat());
    assert!(std::fs::read_to_string(place.path("pull.usda")).unwrap().contains("float focusDistance = 2.5"));
    place.ok(&lens(&["--aperture", "0.3", "--focus", "2.5", "-o", "stated"]));
    assert_eq!(place.image("pull/frame_00002.exr"), place.image("stated/frame_00002.exr"));
    place.error(&lens(&["--aperture", "0.3", "-o", "x"]), &["something in focus", "--focus DISTANCE"]);
    place.error(&lens(&["--f-stop", "2.8", "--focus", "1", "-o", "x"]), &["how long its unit is", "--aperture DIAMETER"]);
    place.error(&lens(&["--aperture", "0.3", "--focus-at", "99,0", "-o", "x"]), &["pixel 99,0 is outside"]);
    place.error(&["render", "run", "--shutter", "180", "-o", "x"], &["a camera that moves", "--path KIND"]);
    let panorama = ["render", "run", "--at=0,0,0", "--projection", "equirectangular", "--size", "32x16", "-o", "x"];
    place.error(&[&panorama[..], &["--aperture", "0.1", "--focus", "1"]].concat(), &["no plane of focus"]);
    for wrong in [&["--focus", "1"][..], &["--aperture", "0.1", "--focus", "-1"], &["--shutter", "400"], &["--aperture", "0.1", "--deep"]] {
        place.fails(2, &lens(&[wrong, &["-o", "x"]].concat()));
    }
}

#[test]
fn another_size_keeps_the_field_of_view_and_says_what_is_cropped() {
    let place = Workplace::new();
    place.train("run", &[]);
    let told = place.notes(&["render", "run", "--size", "48x24", "-o", "wide"]);
    assert!(told.contains("48x24: 50.0 % of the height"), "{told}");
    place.ok(&["render", "run", "--exr-type", "float", "-o", "own"]);
    let (wide, own) = (place.image("wide/000.exr"), place.image("own/000.exr"));
    assert_eq!([wide.width, wide.height, own.width], [48, 24, SIDE]);
    // The middle half of the rows, at twice the size: equal light but for the resolution.
    let sum = |image: &Image, rows: std::ops::Range<usize>| {
        rows.flat_map(|y| (0..image.width).map(move |x| (x, y))).map(|(x, y)| image.at(x, y)[1]).sum::<f32>()
    };
    let (a, b) = (sum(&wide, 0..24) / 4.0, sum(&own, 6..18));
    assert!((a / b - 1.0).abs() < 0.1, "{a} {b}");
    assert!(!place.notes(&["render", "run", "--size", "48x48", "-o", "large"]).contains("cropped"));
    place.fails(2, &["render", "run", "--size", "48", "-o", "x"]);
}

#[test]
fn a_pixel_is_picked_with_its_point_and_splats() {
    let place = Workplace::new();
    place.train("run", &[]);
    place.ok(&["render", "run", "--exr-type", "float", "--depth", "-o", "frames"]);
    let frame = place.image("frames/000.exr");
    let brightest = (0..SIDE * SIDE).max_by(|a, b| frame.pixels[*a][1].total_cmp(&frame.pixels[*b][1])).unwrap();
    let px = format!("{},{}", brightest % SIDE, brightest / SIDE);
    let args = ["pick", "run", "--view", "000", "--px", &px];
    let text = place.ok(&args);
    for part in ["view", "radiance", "luminance", "depth", "ground truth", "splats"] {
        assert!(text.contains(part), "{part}\n{text}");
    }
    let told: serde_json::Value = serde_json::from_str(&place.ok(&[&args[..], &["--json", "--count", "3"]].concat())).unwrap();
    assert_eq!(told["schema_version"], 1);
    for c in 0..3 {
        let (found, expected) = (told["radiance"][c].as_f64().unwrap(), f64::from(frame.pixels[brightest][c]));
        assert!((found - expected).abs() <= 1e-5 * expected.abs().max(1e-6), "{found} {expected}");
    }
    let splats = told["splats"].as_array().unwrap();
    let weight = |i: usize| splats[i]["weight"].as_f64().unwrap();
    assert!(splats.len() == 3 && weight(0) >= weight(1) && weight(1) >= weight(2) && weight(0) <= 1.0, "{told:#}");
    // The point is seen at the pixel.
    let point: Vec<f64> = (0..3).map(|i| told["point"][i].as_f64().unwrap()).collect();
    let cameras = luxel::Dataset::open(place.path("data")).unwrap().into_core();
    let view = cameras.test.iter().find(|view| view.stem() == "000").unwrap();
    let (at, depth) = view.camera.project([point[0], point[1], point[2]].into()).unwrap();
    assert!((at.x - (brightest % SIDE) as f64 - 0.5).abs() < 1e-3 && (at.y - (brightest / SIDE) as f64 - 0.5).abs() < 1e-3, "{at}");
    assert!((depth / told["depth_of_point"].as_f64().unwrap() - 1.0).abs() < 1e-6);
    let finished = place.events(&args, "finished");
    assert_eq!((finished.len(), &finished[0]["point"]), (1, &told["point"]), "{finished:?}");
    place.error(&["pick", "run", "--view", "000", "--px", "24,0"], &["24 x 24 pixels"]);
    place.error(&["pick", "run", "--view", "nine", "--px", "1,1"], &["view nine", "images/0"]);
    place.error(&["pick", "run/point_cloud/iteration_40/point_cloud.ply", "--view", "000", "--px", "1,1"], &["--data"]);
    place.fails(2, &["pick", "run", "--view", "000", "--px", "1"]);
}
