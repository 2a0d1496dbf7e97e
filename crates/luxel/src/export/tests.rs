//! Scenes that are turned, moved and scaled on their way into a file.

use glam::DQuat;
use luxel_io::read_scene;

use super::*;
use crate::{Device, Renderer, Scene, SelectedEngine, Silent, synthetic};

/// A turn about no axis of the world, another origin and another unit.
fn options(bake: Bake) -> ExportOptions {
    ExportOptions {
        bake,
        origin: Some([0.4, -0.7, 1.3]),
        rotation: DMat3::from_quat(DQuat::from_xyzw(0.3, -0.5, 0.2, 0.7).normalize()),
        scale: FileScale::MetresPerUnit(0.2),
        metres_per_unit: Some(0.5),
        ..ExportOptions::default()
    }
}

fn exported(path: &Path, options: &ExportOptions) -> Exported {
    let mut engine = SelectedEngine::open(&Device::Cpu.into()).unwrap().engine;
    let scene = synthetic::room(300, 1).into_core();
    export(scene, path, options, None, engine.as_mut(), &Silent).unwrap()
}

#[test]
fn a_turned_file_looks_the_same_from_a_turned_camera() {
    let folder = tempfile::tempdir().unwrap();
    let (as_is, turned) = (folder.path().join("as-is.ply"), folder.path().join("turned.ply"));
    let bake = Bake::linear(ColorSpace::LinearRec709);
    exported(&as_is, &ExportOptions { bake, ..ExportOptions::default() });
    let said = exported(&turned, &options(bake));
    // What it does to a point: minus the origin, turned, times 0.5 / 0.2.
    let options = options(bake);
    let expected = Similarity::new(options.rotation, 2.5, options.rotation * DVec3::new(-1.0, 1.75, -3.25)).unwrap();
    let probe = DVec3::new(0.2, 0.3, -0.9);
    assert!(said.file_from_world.point(probe).distance(expected.point(probe)) < 1e-6, "{:?}", said.file_from_world);
    assert_eq!(said.metres_per_unit, Some(0.2));
    // Another program knows nothing of the comments: it sees the file's own coordinates.
    let bytes = std::fs::read(&turned).unwrap();
    let end = bytes.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
    let header: String =
        std::str::from_utf8(&bytes[..end]).unwrap().lines().filter(|l| !l.starts_with("comment")).map(|l| l.to_owned() + "\n").collect();
    let foreign = folder.path().join("foreign.ply");
    std::fs::write(&foreign, [header.as_bytes(), &bytes[end..]].concat()).unwrap();
    let camera = synthetic::room_camera([48, 32]);
    let mut moved = camera.clone();
    expected.apply_to_camera(&mut moved);
    let render = |path: &Path, camera| {
        let scene = Scene::from(luxel_core::Scene { raster: read_scene(&as_is).unwrap().raster, ..read_scene(path).unwrap() });
        let local = scene.local_camera(camera);
        Renderer::new(&scene, Device::Cpu).unwrap().render_normalised(&local).unwrap()
    };
    let (before, after) = (render(&as_is, &camera), render(&foreign, &moved));
    let largest = before.pixels.iter().flatten().fold(0.0, |most: f32, v| most.max(*v));
    let off = before.pixels.iter().flatten().zip(after.pixels.iter().flatten()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    // Positions and rotations are rounded to f32 once more.
    assert!(largest > 0.1 && off < 2e-3 * largest, "{off} of {largest}");
}

#[test]
fn turned_files_are_read_back_where_the_scene_was() {
    let folder = tempfile::tempdir().unwrap();
    let original = synthetic::room(300, 1);
    for (name, bake) in [
        ("exact.ply", Bake::exact()),
        ("linear.ply", Bake::linear(ColorSpace::AcesCg)),
        ("exact.glb", Bake::exact()),
        ("linear.usda", Bake::linear(ColorSpace::AcesCg)),
    ] {
        let path = folder.path().join(name);
        let bake = if bake.kind == Some(BakeKind::Exact) { Bake { refine_steps: Some(0), ..bake } } else { bake };
        exported(&path, &options(bake));
        let scene = read_scene(&path).unwrap();
        assert_eq!(scene.metres_per_unit, Some(0.5), "{name}");
        let place = |i: usize| scene.world_position(i);
        for i in 0..original.splats.len() {
            assert!(place(i).distance(original.world_position(i)) < 1e-5, "{name}: {} {}", place(i), original.world_position(i));
        }
    }
    let text = std::fs::read_to_string(folder.path().join("linear.usda")).unwrap();
    assert!(text.contains("metersPerUnit = 0.2\n") && !text.contains("xformOp:translate"), "{}", &text[..600]);
    let unknown = folder.path().join("unknown.usda");
    let said = exported(&unknown, &ExportOptions::default());
    assert_eq!(said.metres_per_unit, None);
    assert!(std::fs::read_to_string(&unknown).unwrap().contains("the scale of the data set is unknown: metersPerUnit is not measured"));
}

#[test]
fn an_unknown_scale_cannot_be_changed_to_metres() {
    let folder = tempfile::tempdir().unwrap();
    let options = ExportOptions { metres_per_unit: None, ..options(Bake::default()) };
    let mut engine = SelectedEngine::open(&Device::Cpu.into()).unwrap().engine;
    let scene = synthetic::room(30, 1).into_core();
    let error = export(scene, &folder.path().join("a.usda"), &options, None, engine.as_mut(), &Silent).unwrap_err();
    assert!(error.to_string().contains("the scale of the scene is unknown"), "{error}");
    assert!(crate::remedy_of(&error).is_some_and(|remedy| remedy.to_string().contains("metres_per_unit")));
}

#[test]
fn a_gain_of_the_scene_multiplies_every_pixel_of_linear_files() {
    let folder = tempfile::tempdir().unwrap();
    let camera = synthetic::room_camera([48, 32]);
    let options = ExportOptions { bake: Bake::linear(ColorSpace::LinearRec709), ..ExportOptions::default() };
    let mut engine = SelectedEngine::open(&Device::Cpu.into()).unwrap().engine;
    let mut rendered = |name: &str, gain: Option<f32>| {
        let mut scene = synthetic::room(300, 1);
        if let Some(gain) = gain {
            scene.edit(&format!("gain {gain}").parse::<crate::Edit>().unwrap()).unwrap();
        }
        let path = folder.path().join(name);
        export(scene.into_core(), &path, &options, None, engine.as_mut(), &Silent).unwrap();
        let scene = Scene::from(read_scene(&path).unwrap());
        Renderer::new(&scene, Device::Cpu).unwrap().render_normalised(&scene.local_camera(&camera)).unwrap()
    };
    for extension in ["usda", "usdc", "usdz", "ply", "glb"] {
        let name = format!("scene.{extension}");
        let before = rendered(&name, None);
        for gain in [1.0 / 1024.0, 3.0, 1024.0f32] {
            let after = rendered(&name, Some(gain));
            for (after, before) in after.pixels.as_flattened().iter().zip(before.pixels.as_flattened()) {
                assert!((after - gain * before).abs() <= 1e-5 * gain * before, "{extension}, gain {gain}: {after} of {before}");
            }
        }
    }
}
