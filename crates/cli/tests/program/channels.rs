//! Channels of `luxel render` beside radiance, and displays of OpenColorIO.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use exr::prelude::{FlatSamples, read_all_flat_layers_from_file};

use crate::common::Workplace;

/// Returns the channels of a file by name.
fn channels(path: &Path) -> BTreeMap<String, FlatSamples> {
    let file = read_all_flat_layers_from_file(path).unwrap();
    file.layer_data
        .into_iter()
        .flat_map(|layer| layer.channel_data.list)
        .map(|channel| (channel.name.to_string(), channel.sample_data))
        .collect()
}

fn floats(samples: &FlatSamples) -> Vec<f32> {
    samples.values_as_f32().collect()
}

#[test]
fn numbers_of_splats_and_motion_are_channels_of_their_own() {
    let place = Workplace::new();
    place.train("run", &[]);
    place.ok(&["render", "run", "-o", "shot", "--path", "orbit", "--frames", "3", "--aov", "alpha,id,motion"]);
    let [first, last] = ["shot/frame_00000.exr", "shot/frame_00002.exr"].map(|name| channels(&place.path(name)));
    let names: Vec<&str> = first.keys().map(String::as_str).collect();
    assert_eq!(names, ["A", "B", "G", "R", "backward.u", "backward.v", "forward.u", "forward.v", "id"]);
    assert!(matches!(first["id"], FlatSamples::F32(_)), "programs divide whole numbers by the largest");
    let ids = floats(&first["id"]);
    let alpha = floats(&first["A"]);
    let scene = std::fs::read_dir(place.path("run/point_cloud")).unwrap().next().unwrap().unwrap().path().join("point_cloud.ply");
    let splats = luxel_io::read_scene(&scene).unwrap().splats.len();
    for (id, alpha) in ids.iter().zip(&alpha) {
        assert!((0.0..splats as f32).contains(id) || (*id == -1.0 && *alpha < 0.01), "{id} {alpha}");
    }
    assert!(ids.iter().map(|id| *id as i64).collect::<BTreeSet<_>>().len() > 3, "several splats are seen");
    // The first frame comes from nowhere, and the last leads nowhere.
    assert!(floats(&first["backward.u"]).iter().chain(&floats(&last["forward.v"])).all(|v| *v == 0.0));
    let moved = |channel: &FlatSamples| floats(channel).iter().map(|v| v.abs()).sum::<f32>() / alpha.len() as f32;
    assert!(moved(&first["forward.u"]) > 0.5 && moved(&last["backward.u"]) > 0.5);
}

#[test]
fn a_matte_of_everything_covers_what_alpha_covers() {
    let place = Workplace::new();
    place.train("run", &[]);
    place.ok(&["render", "run", "-o", "shot", "--aov", "alpha", "--exr-type", "float", "--matte", "all=all", "--matte", "bright=L > p50"]);
    let path = place.path("shot/000.exr");
    let found = channels(&path);
    let [alpha, all] = ["A", "CryptoSelection00.G"].map(|name| floats(&found[name]));
    // The largest coverage is that of everything. Cut-offs follow radiance: those of a matte, whose
    // radiance is 1, are others.
    let apart: Vec<f32> = alpha.iter().zip(&all).map(|(a, b)| (a - b).abs()).collect();
    assert!(apart.iter().sum::<f32>() < 0.02 * apart.len() as f32 && apart.iter().all(|d| *d < 0.2));
    let second = floats(&found["CryptoSelection00.A"]);
    assert!(second.iter().zip(&all).all(|(less, more)| less <= more) && second.iter().any(|v| *v > 0.1));
    let texts = luxel_io::read_exr_attributes(&path).unwrap().texts;
    let manifest = texts.iter().find(|(name, _)| name.starts_with("cryptomatte/") && name.ends_with("/manifest")).unwrap().1;
    let manifest: BTreeMap<String, String> = serde_json::from_str(manifest).unwrap();
    let hash = |name: &str| u32::from_str_radix(&manifest[name], 16).unwrap();
    let ids: Vec<u32> = floats(&found["CryptoSelection00.R"]).iter().map(|v| v.to_bits()).collect();
    assert!(ids.iter().all(|id| [hash("all"), hash("bright"), 0].contains(id)));
}

#[test]
fn channels_that_cannot_be_are_refused_with_a_remedy() {
    let place = Workplace::new();
    place.train("run", &[]);
    let render = |more: &[&'static str]| [&["render", "run", "-o", "shot"], more].concat();
    place.error(&render(&["--aov", "motion"]), &["--aov motion needs a camera that moves", "--path"]);
    place.error(&render(&["--matte", "dark=L < 1e-30"]), &["matte dark: no splat is selected"]);
    place.error(&render(&["--matte", "a=all", "--matte", "a=L > p50"]), &["--matte a: the name is given twice"]);
    assert!(place.fails(2, &render(&["--matte", "L > p50"])).contains("NAME=SELECTION"));
    assert!(place.fails(2, &render(&["--aov", "beauty"])).contains("motion"));
    place.error(
        &["render", "run", "-o", "shot", "--projection", "fisheye", "--aov", "id"],
        &["cannot render the splats' numbers", "of pinholes"],
    );
}

#[cfg(feature = "ocio")]
#[test]
fn previews_are_those_of_a_display_of_opencolorio() {
    const ACES_2: &str = "ocio://cg-config-v4.0.0_aces-v2.0_ocio-v2.5";
    let place = Workplace::new();
    place.train("run", &[]);
    let with = |folder: &'static str, more: &[&'static str]| [&["render", "run", "-o", folder], more].concat();
    place.ok(&with("aces", &["--ocio", ACES_2]));
    place.ok(&with("agx", &["--tonemap", "agx"]));
    let picture = |name: &str| image::open(place.path(name)).unwrap().to_rgb8();
    let (aces, agx) = (picture("aces/000.png"), picture("agx/000.png"));
    assert_eq!(aces.dimensions(), agx.dimensions());
    assert!(aces != agx && aces.pixels().any(|pixel| pixel.0.iter().any(|v| *v > 20)));
    assert!(place.notes(&with("aces", &["--ocio", ACES_2])).contains("exist already and are kept"));
    place.error(&with("aces", &["--ocio", ACES_2, "--view", "Un-tone-mapped"]), &["aces/000.png: exists already"]);
    place.error(&with("other", &["--ocio", ACES_2, "--display", "cinema"]), &["no display \"cinema\"", "sRGB"]);
    place.error(&with("other", &["--ocio", "nowhere.ocio"]), &["nowhere.ocio", "cannot read"]);
    assert!(place.fails(2, &with("other", &["--ocio", ACES_2, "--tonemap", "agx"])).contains("--tonemap"));
    place.ok(&["probe", "run", "--at=0,0,0", "--size", "32", "-o", "probe.exr", "--ocio", ACES_2]);
    assert!(place.path("probe.png").exists());
}
