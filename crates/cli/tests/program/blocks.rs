//! `luxel split` and `luxel merge` from outside.

use luxel_io::Block;

use crate::common::Workplace;

/// Points on a square of 4 x 2 around the origin, where the cameras of the tiny data set look.
fn with_points(place: &Workplace) {
    let mut ply =
        String::from("ply\nformat ascii 1.0\nelement vertex 800\nproperty float x\nproperty float y\nproperty float z\nend_header\n");
    for i in 0..800 {
        let (x, z) = (f64::from(i % 40) / 10.0 - 2.0, f64::from(i / 40) / 10.0 - 1.0);
        ply += &format!("{x} 0 {z}\n");
    }
    std::fs::write(place.path("data/points.ply"), ply).unwrap();
    let path = place.path("data/transforms.json");
    let mut json: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    json["ply_file_path"] = "points.ply".into();
    std::fs::write(&path, json.to_string()).unwrap();
}

const FEW: [&str; 8] = ["--iterations", "20", "--init-points", "200", "--refine-display", "0", "--threads", "1"];

#[test]
fn blocks_are_trained_like_data_sets_and_their_scenes_become_one() {
    let place = Workplace::new();
    with_points(&place);
    let split = [&["split", "data", "-o", "blocks", "--grid", "2x1", "--"][..], &FEW].concat();
    let told = place.ok(&split);
    assert!(told.contains("2 blocks in 2x1") && told.contains("blocks/jobs.txt"), "{told}");
    let blocks = ["blocks/block_000", "blocks/block_001"].map(|name| Block::read(&place.path(name)).unwrap().unwrap());
    assert_eq!(blocks[0].radiance_scale, blocks[1].radiance_scale);
    assert!(blocks[0].core[0][1] == blocks[1].core[0][0] && blocks[0].reach[0][1] > blocks[1].reach[0][0], "{blocks:?}");
    let information = place.ok(&["info", "blocks/block_000"]);
    assert!(information.contains("a block of"), "{information}");

    place.error(&["merge", "blocks", "-o", "scene.ply"], &["no run of block_000, block_001", "jobs.txt"]);
    let jobs = std::fs::read_to_string(place.path("blocks/jobs.txt")).unwrap();
    assert_eq!(jobs.lines().count(), 2);
    // All blocks have the reduction of the whole.
    assert!(jobs.lines().all(|line| line.contains(" --downscale 1 ")), "{jobs}");
    for line in jobs.lines() {
        let words: Vec<&str> = line.split(' ').skip(1).collect();
        place.ok(&words);
    }
    for run in ["blocks/runs/block_000", "blocks/runs/block_001"] {
        let (_, config) = luxel_app::run::RunFolder::open(&place.path(run)).unwrap();
        assert_eq!(config.train.radiance_scale, Some(blocks[0].radiance_scale));
    }

    let merged = place.events(&["merge", "blocks", "-o", "scene.ply"], "finished").remove(0);
    let kept: u64 = merged["blocks"].as_array().unwrap().iter().map(|block| block["kept"].as_u64().unwrap()).sum();
    assert!(merged["splats"] == kept && kept > 0, "{merged}");
    let scene = luxel::Scene::open(place.path("scene.ply")).unwrap().into_core();
    let first = (0..scene.splats.len()).filter(|i| blocks[0].owns(scene.world_position(*i))).count();
    assert_eq!(first as u64, merged["blocks"][0]["kept"].as_u64().unwrap());
    place.ok(&["eval", "scene.ply", "--data", "data"]);

    // A run that is not over gets a warning; one that ended early is whole.
    let path = place.path("blocks/runs/block_001/config.toml");
    let config = std::fs::read_to_string(&path).unwrap();
    for (early_end, warns) in [(25, true), (20, false)] {
        std::fs::write(&path, config.replace("iterations = 20", &format!("iterations = 30\nearly_end = {early_end}"))).unwrap();
        let notes = place.notes(&["merge", "blocks", "-o", "scene.ply", "--overwrite"]);
        assert_eq!(notes.contains("block_001: 20 of 30 steps are made"), warns, "{notes}");
    }

    // A block that is trained otherwise does not go with the others.
    place.ok(&[&["train", "blocks/block_001", "-o", "blocks/runs/block_001", "--overwrite", "--method", "sh1"][..], &FEW].concat());
    place.error(&["merge", "blocks", "-o", "other.ply"], &["block_001", "colour model sh1, but lcd"]);
}

#[test]
fn one_block_is_trained_to_the_bits_of_the_data_set() {
    let place = Workplace::new();
    with_points(&place);
    place.ok(&["split", "data", "-o", "blocks"]);
    place.ok(&[&["train", "blocks/block_000", "-o", "block"][..], &FEW].concat());
    place.ok(&[&["train", "data", "-o", "whole"][..], &FEW].concat());
    let scene = |run: &str| std::fs::read(place.path(run).join("point_cloud/iteration_20/point_cloud.ply")).unwrap();
    assert!(scene("block") == scene("whole"));
}

#[test]
fn what_cannot_be_split_or_merged_is_said() {
    let place = Workplace::new();
    place.error(&["split", "data", "-o", "blocks"], &["0 points", "to divide the ground by"]);
    with_points(&place);
    place.error(&["split", "data", "-o", "blocks", "--supervision", "ldr"], &["captured LDR images cannot be split"]);
    place.error(&["split", "data", "-o", "data"], &["exists already"]);
    for bad in [["--grid", "2"], ["--grid", "0x2"], ["--border", "2"], ["--max-splats", "0"]] {
        place.fails(2, &[&["split", "data", "-o", "blocks"][..], &bad].concat());
    }
    assert!(!place.path("blocks").exists());
    place.ok(&["split", "data", "-o", "blocks", "--grid", "1x2"]);
    place.error(&["split", "blocks/block_000", "-o", "again"], &["is a block"]);
    place.error(&["merge", "data", "-o", "scene.ply"], &["blocks.json"]);
    let block = place.path("blocks/block_000/block.json");
    let text = std::fs::read_to_string(&block).unwrap();
    std::fs::write(&block, text.replacen("images/", "pictures/", 1)).unwrap();
    place.error(&["train", "blocks/block_000", "-o", "run"], &["names view \"pictures/", "split it again"]);
    std::fs::write(&block, "{}").unwrap();
    place.error(&["train", "blocks/block_000", "-o", "run"], &["block.json", "not a block"]);
    std::fs::write(&block, text).unwrap();
    std::fs::rename(place.path("data"), place.path("elsewhere")).unwrap();
    place.error(&["train", "blocks/block_000", "-o", "run"], &["is missing", "put the data set back"]);
}
