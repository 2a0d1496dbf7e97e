//! Scenes that are turned, moved and scaled on their way into a file, and their lights.

use glam::DQuat;
use luxel_io::read_scene;

use super::*;
use crate::lights::tests::lamp_in_a_data_set;
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

#[test]
fn lights_are_where_the_splats_are_and_as_bright() {
    let folder = tempfile::tempdir().unwrap();
    let place = DVec3::new(0.3, -0.2, 3.0);
    let (scene, dataset) = lamp_in_a_data_set(place);
    let mut engine = SelectedEngine::open(&Device::Cpu.into()).unwrap().engine;
    let mut lit = |name: &str, exposure_ev: f32| {
        let bake = Bake { exposure_ev, ..Bake::linear(ColorSpace::LinearRec709) };
        let options =
            ExportOptions { lights: Some(LightOptions::default()), crop: Some(CropBox::between([-9.0; 3], [9.0; 3])), ..options(bake) };
        let path = folder.path().join(name);
        let exported = export(scene.clone(), &path, &options, Some(&dataset), engine.as_mut(), &Silent).unwrap();
        (std::fs::read(&path).unwrap(), exported)
    };
    let (bytes, exported) = lit("a.usda", 0.0);
    let text = String::from_utf8(bytes).unwrap();
    assert_eq!(
        exported.lights.as_ref().map(|lights| (lights.lamps, lights.map.clone())),
        Some((1, Some(folder.path().join("a_dome.exr"))))
    );
    assert!(folder.path().join("a_dome.exr").is_file() && text.contains("@@@./a_dome.exr@@@") && text.contains("metersPerUnit = 0.2\n"));
    let after = |text: &str, name: &str| text.split(name).nth(1).unwrap().split('\n').next().unwrap().to_owned();
    let numbers = |text: &str| {
        let numbers = text.split(|c: char| !"0123456789.-e".contains(c)).filter(|word| !word.is_empty());
        numbers.map(|word| word.parse().unwrap()).collect::<Vec<f64>>()
    };
    let matrix = numbers(&after(&text, "matrix4d xformOp:transform ="));
    let expected = exported.file_from_world.point(place);
    assert!(DVec3::new(matrix[12], matrix[13], matrix[14]).distance(expected) < 2e-3, "{matrix:?} {expected}");
    // Its size is 2.5 times that in the scene; a stop doubles its radiance.
    let values = |text: &str| ["float inputs:radius =", "float inputs:intensity ="].map(|name| numbers(&after(text, name))[0]);
    let [radius, intensity] = values(&text);
    assert!((0.1..0.5).contains(&(radius / 2.5)), "{radius}");
    let (brighter, _) = lit("b.usda", 1.0);
    let [same, doubled] = values(&String::from_utf8(brighter).unwrap());
    assert!((same / radius - 1.0).abs() < 1e-4 && (doubled / intensity - 2.0).abs() < 1e-4, "{same} {doubled} {radius} {intensity}");
    let (package, exported) = lit("c.usdz", 0.0);
    assert_eq!(exported.lights.and_then(|lights| lights.map), None);
    assert!(package.windows(15).any(|bytes| bytes == b"lights_dome.exr") && !folder.path().join("c_dome.exr").exists());
    let (glb, _) = lit("d.glb", 0.0);
    assert!(glb.windows(19).any(|bytes| bytes == b"KHR_lights_punctual") && folder.path().join("d_dome.exr").is_file());
}

#[test]
fn lights_need_views_and_a_format_that_holds_them() {
    let folder = tempfile::tempdir().unwrap();
    let mut engine = SelectedEngine::open(&Device::Cpu.into()).unwrap().engine;
    let options = ExportOptions { lights: Some(LightOptions::default()), ..ExportOptions::default() };
    let mut error = |name: &str| {
        let scene = synthetic::room(30, 1).into_core();
        export(scene, &folder.path().join(name), &options, None, engine.as_mut(), &Silent).unwrap_err()
    };
    let without_views = error("a.usdc");
    assert!(without_views.to_string().starts_with("no cameras: lamps are measured"), "{without_views}");
    assert!(crate::remedy_of(&without_views).is_some_and(|remedy| remedy.to_string().contains("data")));
    for name in ["a.ply", "a.spz", "a.sog"] {
        let error = error(name).to_string();
        assert!(error.ends_with("hold no lights, expected .usda, .usd, .usdc, .usdz or .glb"), "{error}");
    }
}
