//! `luxel mesh`: a proxy mesh of a scene.

use crate::common::Workplace;

/// Options that take little time, and keep what a scene of few steps has of surfaces.
const QUICK: [&str; 6] = ["--image-size", "64", "--voxel", "0.05", "--min-island", "0.01"];

fn words<'a>(words: &[&'a str]) -> Vec<&'a str> {
    [words, &QUICK].concat()
}

#[test]
fn every_format_is_written_and_the_same_for_any_number_of_threads() {
    let place = Workplace::new();
    place.train("run", &[]);
    for name in ["a.usdc", "a.usda", "a.usdz", "a.glb", "a.ply", "a.obj"] {
        let told = place.events(&words(&["mesh", "run", "-o", name]), "finished");
        assert!(told[0]["triangles"].as_u64().unwrap() > 10, "{told:?}");
        assert!(place.path(name).metadata().unwrap().len() > 500, "{name}");
    }
    place.ok(&words(&["mesh", "run", "-o", "b.ply", "--threads", "1"]));
    assert!(std::fs::read(place.path("a.ply")).unwrap() == std::fs::read(place.path("b.ply")).unwrap());
    // As many as asked for, or what the topology leaves.
    let few = place.events(&words(&["mesh", "run", "-o", "c.glb", "--triangles", "8"]), "finished");
    assert!(few[0]["triangles"].as_u64() < few[0]["triangles_before"].as_u64(), "{few:?}");
    // The cameras of a file look at a scene without its run.
    place.ok(&["render", "run", "-o", "frames", "--split", "train", "--write-cameras", "views.json"]);
    let scene = std::fs::read_dir(place.path("run/point_cloud")).unwrap().next().unwrap().unwrap().path().join("point_cloud.ply");
    let bare = place.events(&words(&["mesh", scene.to_str().unwrap(), "--cameras", "views.json", "-o", "d.ply"]), "finished");
    assert!(bare[0]["triangles"].as_u64().unwrap() > 10, "{bare:?}");
}

#[test]
fn what_makes_no_mesh_is_an_error_with_a_remedy() {
    let place = Workplace::new();
    place.train("run", &[]);
    let scene = std::fs::read_dir(place.path("run/point_cloud")).unwrap().next().unwrap().unwrap().path().join("point_cloud.ply");
    let scene = scene.to_str().unwrap();
    place.error(&["mesh", "run", "-o", "a.stl"], &["a.stl", "found the extension .stl", ".usdc"]);
    place.error(&["mesh", scene, "-o", "a.ply"], &["a scene file has no cameras", "--data", "--cameras"]);
    let views = luxel_io::read_camera_path(&place.path("data/transforms.json"), None).unwrap();
    std::fs::write(place.path("two.json"), luxel_io::camera_file_text(&views[..2])).unwrap();
    place.error(&["mesh", scene, "--cameras", "two.json", "-o", "a.ply"], &["2 depth images, expected at least 3", "--cameras"]);
    place.error(&words(&["mesh", "run", "-o", "a.ply", "--max-depth", "0.001"]), &["no pixel shows a surface", "raise --max-depth"]);
    place.error(&["mesh", "run", "-o", "a.ply", "--image-size", "64", "--voxel", "1e-9"], &["voxels of 1.000e-9", "MiB", "raise --voxel"]);
    place.error(&["mesh", "run", "-o", "a.ply", "--image-size", "64", "--min-island", "1000"], &["across", "lower --min-island"]);
    place.fails(2, &["mesh", "run", "-o", "a.ply", "--voxel", "0"]);
    assert!(!place.path("a.ply").exists());
    std::fs::write(place.path("a.ply"), "kept").unwrap();
    place.error(&["mesh", "run", "-o", "a.ply"], &["exists already", "--overwrite"]);
}
