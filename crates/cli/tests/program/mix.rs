//! Light that is trained on frozen geometry, and mixed.

use luxel_core::Scene;

use crate::common::Workplace;

fn scene(place: &Workplace, name: &str) -> Scene {
    luxel_io::read_scene_ply(&place.path(name)).unwrap()
}

const PLY: &str = "point_cloud/iteration_40/point_cloud.ply";

#[test]
fn lights_are_trained_on_frozen_geometry_and_add() {
    let place = Workplace::new();
    place.train("day", &[]);
    let lamp = ["train", "data", "-o", "lamp", "--from", "day", "--freeze", "geometry", "--method", "sh2"];
    place.ok(&[&lamp[..], &["--iterations", "40", "--threads", "2", "--device", "cpu"]].concat());
    let (day, lamp) = (scene(&place, &format!("day/{PLY}")), scene(&place, &format!("lamp/{PLY}")));
    assert_eq!((&day.splats.position, &day.splats.rotation), (&lamp.splats.position, &lamp.splats.rotation));
    assert_eq!((&day.splats.log_scale, &day.splats.opacity_logit), (&lamp.splats.log_scale, &lamp.splats.opacity_logit));
    assert_eq!(day.raster, lamp.raster);
    // A run that ended before its first checkpoint begins again at its scene.
    for folder in ["checkpoints", "point_cloud"] {
        std::fs::remove_dir_all(place.path(&format!("lamp/{folder}"))).unwrap();
    }
    place.ok(&["train", "--resume", "-o", "lamp"]);
    assert_eq!(scene(&place, &format!("lamp/{PLY}")), lamp);
    place.ok(&["train", "--resume", "-o", "lamp", "--iterations", "50"]);

    place.ok(&["mix", "day", &format!("lamp/{PLY}"), "--weights", "1,0.3", "-o", "both.ply"]);
    let both = scene(&place, "both.ply");
    assert_eq!(both.splats.color_model.name(), "lcd+sh2");
    assert!(both.edits.last().unwrap().starts_with("mix "), "{:?}", both.edits);
    let told: serde_json::Value = serde_json::from_str(&place.ok(&["info", "both.ply", "--json"])).unwrap();
    assert_eq!(told["lights"], 2);
    for (scene, folder) in [("day", "a"), (&*format!("lamp/{PLY}"), "b"), ("both.ply", "c")] {
        place.ok(&["render", scene, "--data", "data", "--exr-type", "float", "-o", folder]);
    }
    let [a, b, c] = ["a", "b", "c"].map(|folder| place.image(&format!("{folder}/000.exr")));
    for ((a, b), c) in a.pixels.as_flattened().iter().zip(b.pixels.as_flattened()).zip(c.pixels.as_flattened()) {
        let expected = a + 0.3 * b;
        assert!((c - expected).abs() <= 1e-5 * expected.abs() + 1e-9, "{c} {expected}");
    }

    // A light is switched off, in a stack and in a render.
    place.ok(&["edit", "both.ply", "--light", "2:0", "-o", "off.ply"]);
    place.ok(&["render", "both.ply", "--edit", "light 2:0", "--data", "data", "--exr-type", "float", "-o", "d"]);
    place.ok(&["render", "off.ply", "--data", "data", "--exr-type", "float", "-o", "e"]);
    let off = place.image("e/000.exr");
    assert_eq!(off, place.image("d/000.exr"));
    for (off, a) in off.pixels.as_flattened().iter().zip(a.pixels.as_flattened()) {
        assert!((off - a).abs() <= 1e-5 * a.abs() + 1e-9, "{off} {a}");
    }
    // A mix mixes, exports and probes like any scene.
    place.ok(&["mix", "both.ply", "day", "-o", "three.ply"]);
    assert_eq!(scene(&place, "three.ply").splats.color_model.lights(), 3);
    place.ok(&["export", "both.ply", "-o", "both.glb"]);
    place.error(&["export", "both.ply", "--data", "data", "-o", "both.html"], &["mix of lights"]);
}

/// Returns the arguments of a training into a new folder.
fn train<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&["train", "data", "-o", "new"][..], more].concat()
}

#[test]
fn what_cannot_be_mixed_or_frozen_is_said() {
    let place = Workplace::new();
    place.train("day", &[]);
    place.train("other", &["--seed", "5"]);
    place.error(&["mix", "day", "other", "-o", "x.ply"], &["day and other cannot be mixed", "--freeze geometry"]);
    place.error(&["mix", "day", "--weights", "1,2", "-o", "x.ply"], &["2 weights for 1 scene"]);
    place.fails(2, &["mix", "day", "--weights", "-1", "-o", "x.ply"]);
    place.fails(2, &["mix", "-o", "x.ply"]);
    place.error(&["mix", "day", "-o", "x.usda"], &[".ply"]);
    place.error(&["edit", "day", "--light", "1:2", "-o", "x.ply"], &["one light", "luxel mix"]);
    place.fails(2, &["edit", "day", "--light", "0:2", "-o", "x.ply"]);
    place.error(&train(&["--freeze", "geometry"]), &["--from"]);
    let frozen = ["--from", "day", "--freeze", "geometry"];
    for option in ["--densify-from=5", "--max-splats=9", "--antialias=off", "--refine-poses", "--position-lr=1", "--init-points=9"] {
        place.error(&train(&[&frozen[..], &[option]].concat()), &[option.split('=').next().unwrap()]);
    }
    place.error(&train(&["--from", "day", "--init-points", "9"]), &["--init-points: has no effect with --from; leave one of them out"]);
    place.error(&train(&["--from", "nowhere"]), &["nowhere", "scene to start from"]);
    place.error(&["train", "data", "-o", "day", "--overwrite", "--from", "day"], &["in the output folder"]);
    assert!(!place.path("new").exists() && !place.path("x.ply").exists());
}
