//! Edits of light from outside: scenes written, renders, masks, reports, comparisons.

use luxel_core::{
    Activation, Antialias, ColorModel, ColorSpace, Cutoffs, Image, RadianceScale, RasterConfig, Scene, Splat, Splats, luminance_sum,
};

use crate::common::{SIDE, Workplace};

const PLY: &str = "run/point_cloud/iteration_40/point_cloud.ply";

fn trained(more: &[&str]) -> Workplace {
    let place = Workplace::new();
    place.train("run", more);
    place
}

fn scene(place: &Workplace, name: &str) -> Scene {
    luxel_io::read_scene_ply(&place.path(name)).unwrap()
}

#[test]
fn an_edited_scene_is_written_with_its_record_and_nothing_else_changed() {
    let place = trained(&[]);
    place.ok(&["edit", "run", "--where", "L > p80", "--stops", "1", "--clamp-max", "30", "-o", "edited/scene.ply"]);
    let (before, after) = (scene(&place, PLY), scene(&place, "edited/scene.ply"));
    assert_eq!(after.edits, ["where L > p80; stops 1; clamp-max 30"]);
    assert_eq!((after.radiance_scale, after.color_space, after.raster), (before.radiance_scale, before.color_space, before.raster));
    assert_eq!((&after.splats.sh, &after.splats.position), (&before.splats.sh, &before.splats.position));
    let changed = (0..before.splats.len()).filter(|i| after.luminance(*i) != before.luminance(*i)).count();
    assert!(changed > 0 && changed * 4 < before.splats.len(), "{changed} of {}", before.splats.len());

    // A second edit is added to the record; info tells both.
    place.ok(&["edit", "edited/scene.ply", "--power", "0.9", "--pivot", "0.5", "-o", "twice.ply"]);
    let told: serde_json::Value = serde_json::from_str(&place.ok(&["info", "twice.ply", "--json"])).unwrap();
    assert_eq!(told["edits"], serde_json::json!(["where L > p80; stops 1; clamp-max 30", "where all; power 0.9; pivot 0.5"]));

    place.error(&["edit", "run", "--gain", "2", "-o", "twice.ply"], &["twice.ply", "--overwrite"]);
    place.ok(&["edit", "run", "--gain", "2", "-o", "twice.ply", "--overwrite"]);
    assert_eq!(scene(&place, "twice.ply").edits, ["where all; gain 2"]);
    place.error(&["edit", "run", "--gain", "2", "-o", "data"], &["expected the scene file"]);
    place.error(&["edit", "run", "-o", "none.ply"], &["nothing to do"]);
    place.error(&["edit", "run", "--where", "L > 1", "-o", "none.ply"], &["no map behind it"]);
    place.error(&["edit", PLY, "--where", "mask(m.png, 000)", "--gain", "2", "-o", "none.ply"], &["--data"]);
    let same = ["edit", "run", "--gain", "2", "-o", "none.ply", "--overlay", "./none.ply"];
    place.error(&same, &["./none.ply", "--overlay", "another name"]);
    for usage in [
        &["edit", "run"][..],
        &["edit", "run", "--gain", "x", "-o", "none.ply"],
        &["edit", "run", "--where", "L <", "--gain", "2", "-o", "none.ply"],
        &["edit", "run", "--pivot", "1", "-o", "none.ply"],
    ] {
        place.fails(2, usage);
    }
    assert!(!place.path("none.ply").exists());
}

#[test]
fn render_edit_is_the_render_of_the_edited_scene() {
    let place = trained(&[]);
    let options = ["--where", "L < 1 ~1", "--gain", "3", "--where", "all", "--power", "1.2", "--pivot", "0.4"];
    place.ok(&[&["edit", "run", "-o", "edited.ply"][..], &options].concat());
    place.ok(&["render", "edited.ply", "--data", "data", "--exr-type", "float", "-o", "written"]);
    let edits = "where L < 1 ~1; gain 3; where all; power 1.2; pivot 0.4";
    place.ok(&["render", "run", "--edit", edits, "--exr-type", "float", "-o", "unwritten"]);
    assert_eq!(place.image("written/000.exr"), place.image("unwritten/000.exr"));
    place.ok(&["render", "run", "--exr-type", "float", "-o", "before"]);
    assert_ne!(place.image("written/000.exr"), place.image("before/000.exr"));
    place.fails(2, &["render", "run", "--edit", "gain 2; sharpen 3", "-o", "x"]);
    place.fails(2, &["render", "run", "--sh-map", "channels", "-o", "x"]);
    for idle in ["", "where L > 1"] {
        place.fails(2, &["render", "run", "--edit", idle, "-o", "x"]);
    }
}

#[test]
fn a_painted_mask_changes_what_is_behind_the_paint() {
    let place = trained(&[]);
    // The left half of view 000, at twice its size.
    let side = 2 * SIDE;
    let paint: Vec<[u8; 3]> = (0..side * side).map(|i| if i % side < SIDE { [255; 3] } else { [0; 3] }).collect();
    luxel_io::write_png(&place.path("left.png"), side, side, paint.as_flattened()).unwrap();
    let args = ["edit", "run", "--where", "mask(left.png, 000)", "--stops", "3", "-o", "left.ply", "--overlay", "overlay.png", "--json"];
    let told: serde_json::Value = serde_json::from_str(&place.ok(&args)).unwrap();
    let (selected, splats) = (told["edit_1"]["selected"].as_u64().unwrap(), told["splats"].as_u64().unwrap());
    assert!(selected > 0 && selected < splats, "{told:#}");
    for (scene, folder) in [("run", "before"), ("left.ply", "after")] {
        place.ok(&["render", scene, "--data", "data", "--exr-type", "float", "-o", folder]);
    }
    let (before, after) = (place.image("before/000.exr"), place.image("after/000.exr"));
    let gain = |columns: std::ops::Range<usize>| {
        let pixels = || columns.clone().flat_map(|x| (0..SIDE).map(move |y| (x, y)));
        let sum = |image: &Image| pixels().map(|(x, y)| luminance_sum(image.at(x, y))).sum::<f32>();
        sum(&after) / sum(&before)
    };
    let (left, right) = (gain(0..SIDE / 2 - 3), gain(SIDE / 2 + 3..SIDE));
    assert!(left > 4.0 && right < 2.0, "{left} {right}");
    let overlay = place.image("overlay.png");
    let red = |x: usize| (0..SIDE).map(|y| overlay.at(x, y)[0] - overlay.at(x, y)[2]).sum::<f32>();
    assert!(red(2) > 4.0 * red(SIDE - 3).max(0.1), "{} {}", red(2), red(SIDE - 3));

    luxel_io::write_png(&place.path("odd.png"), 5, 5, &[0; 75]).unwrap();
    place.error(&["edit", "run", "--where", "mask(odd.png, 000)", "--gain", "2", "-o", "x.ply"], &["odd.png", "5 x 5", "24 x 24"]);
    place.error(&["edit", "run", "--where", "mask(left.png, nine)", "--gain", "2", "-o", "x.ply"], &["view nine", "images/0"]);
    place.error(&["edit", "run", "--where", "mask(none.png, 000)", "--gain", "2", "-o", "x.ply"], &["none.png"]);
}

#[test]
fn a_hard_edge_through_many_splats_is_warned_of_with_the_soft_one() {
    let place = trained(&[]);
    let stderr = |args: &[&str]| String::from_utf8(place.luxel(args).output().unwrap().stderr).unwrap();
    for edit in [&["edit", "run", "--where", "L < p50", "--gain", "4", "--dry-run"][..], &["render", "run", "-o", "frames", "--edit"]] {
        let is_render = edit[0] == "render";
        let hard = stderr(&[edit, if is_render { &["where L < p50; gain 4"] } else { &[] }].concat());
        assert!(hard.contains("\"L < p50\" is a hard edge") && hard.contains("write \"L < p50 ~2\" for a soft edge"), "{hard}");
    }
    let soft = stderr(&["edit", "run", "--where", "L < p50 ~2", "--gain", "4", "--dry-run"]);
    assert!(!soft.contains("warning"), "{soft}");
}

#[test]
fn a_dry_run_reports_and_writes_nothing() {
    let place = trained(&[]);
    place.ok_unread(&["edit", "run", "--gain", "2", "--json", "-o", "unread.ply"]);
    assert!(place.path("unread.ply").is_file());
    let told = place.ok(&["edit", "run", "--where", "L > p90 and not box(-9,-9,-9, 0,9,9)", "--dry-run", "--overlay", "marked.png"]);
    for part in ["where L > p90 and not box", "selected", "share of light", "min", "max", "percentiles"] {
        assert!(told.contains(part), "{part}\n{told}");
    }
    let marked = std::fs::read(place.path("marked.png")).unwrap();
    let again = ["edit", "run", "--where", "L > p50", "--dry-run", "--overlay", "marked.png"];
    place.error(&again, &["marked.png: exists already", "--overwrite"]);
    assert!(std::fs::read(place.path("marked.png")).unwrap() == marked);
    let told = place.events(&[&again[..], &["--overwrite"]].concat(), "report");
    assert!(told.len() == 1 && told[0]["edit_1"].is_object(), "{told:?}");
    assert!(std::fs::read(place.path("marked.png")).unwrap() != marked);
    place.ok(&["edit", PLY, "--gain", "2", "--dry-run", "-o", "none.ply"]);
    assert!(!place.path("none.ply").exists());
    place.error(&["edit", PLY, "--gain", "2", "--dry-run", "--overlay", "x.png"], &["--data"]);
    let stderr = String::from_utf8(place.luxel(&["edit", PLY, "--where", "L > p100", "--dry-run"]).output().unwrap().stderr).unwrap();
    assert!(stderr.contains("selects no splats"), "{stderr}");
}

#[test]
fn splats_are_deleted_by_selection_and_as_floaters() {
    let place = trained(&[]);
    let before = scene(&place, PLY);
    // A floater far outside of the balls, seen by no camera.
    let mut with_floater = before.clone();
    let (rotation, log_scale) = ([1.0, 0.0, 0.0, 0.0], [-4.0; 3]);
    let (sh, raw) = (before.splats.sh_of(0).to_vec(), before.splats.raw_luminance_of(0).to_vec());
    with_floater.splats.push(&Splat { position: [0.0, 90.0, 0.0], rotation, log_scale, opacity_logit: 2.0, sh: &sh, raw_luminance: &raw });
    luxel_io::write_scene_ply(&place.path("floater.ply"), &with_floater).unwrap();
    let told: serde_json::Value =
        serde_json::from_str(&place.ok(&["edit", "floater.ply", "--data", "data", "--floaters", "--json", "-o", "clean.ply"])).unwrap();
    let clean = scene(&place, "clean.ply");
    let removed = told["removed"]["splats"].as_u64().unwrap() as usize;
    assert!(removed >= 1 && removed < before.splats.len() / 2 && told["removed"]["unseen"].as_u64().unwrap() >= 1, "{told:#}");
    assert_eq!(clean.splats.len() + removed, with_floater.splats.len());
    assert!(clean.splats.position.iter().all(|position| position[1] < 80.0));
    assert_eq!(clean.edits, ["floaters"]);

    // By a selection, with a map on what is left; the selection sees the scene before the map.
    let half = "box(-9,-9,-9,0,9,9)";
    place.ok(&["edit", "run", "--delete", half, "--stops", "9", "-o", "half.ply"]);
    let (left, inside) = (scene(&place, "half.ply"), |p: &[f32; 3]| p[0] <= 0.0 && p.iter().all(|v| v.abs() <= 9.0));
    assert_eq!(left.splats.position, before.splats.position.iter().copied().filter(|p| !inside(p)).collect::<Vec<_>>());
    assert_eq!(left.edits, ["where all; stops 9".to_owned(), format!("delete {half}")]);
    let dry = String::from_utf8(place.luxel(&["edit", "run", "--delete", half, "--dry-run"]).output().unwrap().stderr).unwrap();
    assert!(dry.contains("would be removed: ") && dry.contains(" selected"), "{dry}");
    place.error(&["edit", "run", "--delete", "all", "-o", "none.ply"], &["no splats would be left"]);
    place.error(&["edit", PLY, "--delete", "mask(m.png, 000)", "-o", "none.ply"], &["--data"]);
    place.fails(2, &["edit", "run", "--delete", "L <", "-o", "none.ply"]);
    place.fails(2, &["edit", "run", "--floaters", "--against", "run", "-o", "none"]);
    assert!(!place.path("none.ply").exists());
}

/// Three balls of one splat each, of different colours and luminances, apart from one another in
/// every view.
fn balls(color_model: ColorModel) -> Scene {
    let mut splats = Splats::empty(color_model);
    for (x, rgb) in [(-0.8, [6.0, 3.0, 1.0]), (0.0, [0.02, 0.05, 0.01]), (0.8, [0.1, 0.2, 0.7])] {
        let (dc, raw) = color_model.constant(rgb);
        let mut sh = vec![0.0; 3 * color_model.sh_coefficients()];
        sh[..3].copy_from_slice(&dc);
        let raw_luminance = vec![raw; color_model.luminance_coefficients()];
        let rotation = [1.0, 0.0, 0.0, 0.0];
        splats.push(&Splat {
            position: [x, 0.0, 0.0],
            rotation,
            log_scale: [-2.2; 3],
            opacity_logit: 9.0,
            sh: &sh,
            raw_luminance: &raw_luminance,
        });
    }
    let raster = RasterConfig { cutoffs: Cutoffs::PARITY, antialias: Antialias::Off, ..RasterConfig::default() };
    Scene {
        splats,
        radiance_scale: RadianceScale::ONE,
        color_space: ColorSpace::LinearRec709,
        raster,
        edits: Vec::new(),
        world_from_local: luxel_core::Similarity::IDENTITY,
        metres_per_unit: None,
    }
}

#[test]
fn lcd_keeps_its_chromaticity_where_channels_do_not() {
    let place = Workplace::new();
    let lcd = ColorModel::Lcd { chroma_degree: 3, luminance_degree: 0, activation: Activation::Softplus };
    for (name, model) in [("lcd.ply", lcd), ("sh.ply", ColorModel::Sh { degree: 3 })] {
        luxel_io::write_scene_ply(&place.path(name), &balls(model)).unwrap();
    }
    let compare = ["edit", "lcd.ply", "--against", "sh.ply", "--data", "data"];
    let table = place.ok(&[&compare[..], &["--power", "1.2", "--pivot", "0.5", "-o", "comparison"]].concat());
    let told = place.json("comparison/comparison.json");
    let error = |label: &str| told[label]["chromaticity_error"].as_f64().unwrap();
    for label in ["1-lcd", "2-sh3-luminance", "2-sh3-channels"] {
        assert!(table.contains(label), "{table}");
        for picture in ["000_edited.png", "000_chromaticity_error.png"] {
            assert!(place.path("comparison").join(label).join(picture).is_file(), "{label}/{picture}");
        }
        assert!(told[label]["luminance_error_stops"].is_number());
    }
    // A splat a pixel, but for skirts: maps of luminance leave chromaticity, those of channels do
    // not.
    assert!(error("1-lcd") < 5e-3 && error("2-sh3-luminance") < 5e-3 && error("2-sh3-channels") > 0.05, "{table}");
    assert_eq!(told["edits"], serde_json::json!(["where all; power 1.2; pivot 0.5"]));
    place.error(&[&compare[..], &["--gain", "2", "-o", "comparison"]].concat(), &["exists already"]);
    assert_eq!(place.events(&[&compare[..], &["--gain", "2", "-o", "gains"]].concat(), "comparison").len(), 1);
    place.error(&[&compare[..], &["--where", "L < 1", "--gain", "2", "-o", "other"]].concat(), &["knows no splats"]);
    place.error(&["edit", "lcd.ply", "--against", "sh.ply", "--gain", "2", "-o", "other"], &["--data"]);

    // Harmonics warn, and a plain gain of them has nothing to warn of.
    let stderr = |args: &[&str]| String::from_utf8(place.luxel(args).output().unwrap().stderr).unwrap();
    assert!(stderr(&["edit", "sh.ply", "--power", "1.2", "-o", "power.ply"]).contains("hues shift"));
    assert!(!stderr(&["edit", "sh.ply", "--gain", "2", "-o", "gain.ply"]).contains("hues shift"));
    assert!(!stderr(&["edit", "lcd.ply", "--power", "1.2", "-o", "lcd-power.ply"]).contains("hues shift"));
}
