use glam::DAffine3;

use luxel_core::{ColorModel, Image, SH_OFFSET, Splat, Splats, logit, sh};
use luxel_cpu::CpuEngine;
use luxel_io::{MemoryDataset, MemoryView};

use super::*;
use crate::Silent;
use crate::synthetic::{room, room_camera};

/// Radiance of the lamps.
const LAMP: [f32; 3] = [80.0, 60.0, 30.0];

/// Adds an opaque round splat.
fn add(splats: &mut Splats, position: DVec3, sigma: f64, radiance: [f32; 3]) {
    splats.push(&Splat {
        position: position.to_array().map(|v| v as f32),
        rotation: [1.0, 0.0, 0.0, 0.0],
        log_scale: [sigma.ln() as f32; 3],
        opacity_logit: logit(0.99),
        sh: &radiance.map(|l| (l - SH_OFFSET) / sh::C0),
        raw_luminance: &[],
    });
}

/// Adds a square sheet of splats through `middle`, spanned by two half edges.
fn sheet(splats: &mut Splats, middle: DVec3, edges: [DVec3; 2], steps: i32, radiance: [f32; 3]) {
    let step = edges[0].length() / f64::from(steps);
    for (i, j) in (-steps..=steps).flat_map(|i| (-steps..=steps).map(move |j| (i, j))) {
        let [a, b] = [i, j].map(|n| f64::from(n) / f64::from(steps));
        add(splats, middle + a * edges[0] + b * edges[1], 0.6 * step, radiance);
    }
}

/// A scene with a dim wall behind the place of lamps, 3 in front of the cameras.
fn scene(lamp: impl FnOnce(&mut Splats)) -> Scene {
    let mut splats = Splats::empty(ColorModel::Sh { degree: 0 });
    sheet(&mut splats, DVec3::new(0.0, 0.0, 4.0), [4.0 * DVec3::X, 4.0 * DVec3::Y], 14, [0.2, 0.2, 0.2]);
    lamp(&mut splats);
    Scene { splats, ..(*room(1, 1)).clone() }
}

/// Cameras on an arc that look at (0, 0, 3).
fn arc() -> Vec<Camera> {
    let turned = |i: i32| {
        let turn = DAffine3::from_rotation_y(0.12 * f64::from(i)) * DAffine3::from_rotation_x(0.05 * f64::from(i * i % 5 - 2));
        let aim = DAffine3::from_translation(DVec3::new(0.0, 0.0, 3.0));
        Camera { camera_from_world: aim * turn * aim.inverse(), ..room_camera([96, 96]) }
    };
    (-4..=4).map(turned).collect()
}

/// A scene with a lamp at a place 3 in front of its cameras, in a data set of theirs.
pub(crate) fn lamp_in_a_data_set(place: DVec3) -> (Scene, Dataset) {
    let views = |cameras: Vec<Camera>| {
        let view = |(i, camera): (usize, Camera)| {
            let image = Image::filled(96, 96, [1.0; 3]);
            MemoryView { name: format!("images/{i}"), camera, image, mask: None, is_test: false }
        };
        cameras.into_iter().enumerate().map(view).collect::<Vec<_>>()
    };
    let parts = MemoryDataset { views: views(arc()), ..MemoryDataset::default() };
    let dataset = crate::Dataset::from_memory(parts).unwrap().into_core();
    (scene(|splats| add(splats, place, 0.08, LAMP)), dataset)
}

fn found(scene: &Scene) -> (Vec<AreaLight>, Vec<String>) {
    let Lamps { lights, left_in_map, .. } = found_with(scene, &LightOptions::default());
    (lights, left_in_map)
}

fn found_with(scene: &Scene, options: &LightOptions) -> Lamps {
    let mut engine = CpuEngine::new(1).unwrap();
    find(scene, &rendered(scene, &arc(), &mut engine).unwrap(), options, &mut engine, &Silent).unwrap()
}

#[test]
fn a_ball_is_found_where_it_is_with_its_light() {
    let scene = scene(|splats| add(splats, DVec3::new(0.3, -0.2, 3.0), 0.08, LAMP));
    let (lights, left) = found(&scene);
    let [light] = &lights[..] else { panic!("{lights:?} {left:?}") };
    assert!(matches!(light.shape, LightShape::Sphere { .. }) && light.cameras == 9 && light.error < 0.03, "{light:?}");
    assert!(DVec3::from_array(light.middle).distance(DVec3::new(0.3, -0.2, 3.0)) < 1e-3, "{light:?}");
    // The light of a Gaussian: 2 pi sigma^2 times its opacity. The scene's rasteriser widens it by
    // a variance of 0.3 pixels.
    let variance = 0.08f64.powi(2) + 0.3 * (3.0 / room_camera([96, 96]).focal_px.x).powi(2);
    let expected = f64::from(scene.radiance_scale.restored_value(LAMP[0])) * 0.99 * 2.0 * std::f64::consts::PI * variance;
    assert!((light.intensity[0] / expected - 1.0).abs() < 0.05, "{light:?} {expected}");
    assert!((light.radiance[1] / light.radiance[0] - 0.75).abs() < 1e-3);
}

#[test]
fn a_lamp_in_a_shade_shines_by_the_cosine() {
    // A bright sheet that looks along x and towards the cameras, with a dark one behind it.
    let normal = DVec3::new(0.8, 0.0, -0.6);
    let edges = [0.2 * DVec3::Y, 0.2 * normal.cross(DVec3::Y)];
    let scene = scene(|splats| {
        sheet(splats, DVec3::new(0.0, 0.0, 3.0), edges, 6, LAMP);
        sheet(splats, DVec3::new(0.0, 0.0, 3.0) - 0.08 * normal, [1.3 * edges[0], 1.3 * edges[1]], 8, [0.02; 3]);
    });
    // By its splats, it is a square as windows are; by its light alone, a disc.
    let Lamps { lights, left_in_map: left, .. } = found_with(&scene, &LightOptions { windows: None, ..LightOptions::default() });
    let [light] = &lights[..] else { panic!("{lights:?} {left:?}") };
    let LightShape::Disk { normal: direction, radius } = light.shape else { panic!("{light:?}") };
    assert!(direction.dot(normal) > 0.97, "{direction}");
    // The sheet of 0.4 x 0.4, whose splats reach half a step beyond it.
    assert!((0.16..0.30).contains(&(std::f64::consts::PI * radius * radius)), "{radius}");
    assert!((light.power[0] / light.intensity[0] - std::f64::consts::PI).abs() < 1e-9);
}

#[test]
fn a_tube_is_a_mesh_that_shines_by_the_area_that_is_seen_of_it() {
    // Along x and a little towards the cameras.
    let axis = DVec3::new(0.9, 0.2, -0.4).normalize();
    let at = |i: i32| DVec3::new(0.1, 0.0, 3.0) + 0.04 * f64::from(i) * axis;
    let scene = scene(|splats| (-15..=15).for_each(|i| add(splats, at(i), 0.03, LAMP)));
    let (lights, left) = found(&scene);
    let [light] = &lights[..] else { panic!("{lights:?} {left:?}") };
    let LightShape::Mesh(mesh) = &light.shape else { panic!("{light:?}") };
    assert!(light.error < 0.04 && light.cameras == 9, "{light:?}");
    // Its light is that of the end which is nearer to the cameras by a little.
    let middle = DVec3::from_array(light.middle) - at(0);
    assert!(middle.length() < 0.06, "{middle}");
    let along = mesh.points.iter().map(|p| (*p + middle).dot(axis)).fold(0.0, f64::max);
    let across = mesh.points.iter().map(|p| (*p + middle).cross(axis).length()).fold(0.0, f64::max);
    assert!((0.6..0.72).contains(&along) && (0.03..0.1).contains(&across), "{along} {across}");
    let expected = f64::from(scene.radiance_scale.restored_value(LAMP[0]));
    // Splats fade at their edges: the mean radiance is below that of their middles.
    assert!((0.6..1.0).contains(&(light.radiance[0] / expected)), "{light:?} {expected}");
    assert!((light.power[0] / (4.0 * std::f64::consts::PI * mesh.mean_area * light.radiance[0]) - 1.0).abs() < 1e-9);
}

#[test]
fn a_bent_tube_is_a_mesh_and_no_window() {
    let scene = scene(|splats| {
        (-15..=10).for_each(|i| add(splats, DVec3::new(0.04 * f64::from(i), -0.2, 3.0), 0.03, LAMP));
        (1..=15).for_each(|i| add(splats, DVec3::new(0.4, 0.04 * f64::from(i) - 0.2, 3.0), 0.03, LAMP));
    });
    let (lights, left) = found(&scene);
    let [light] = &lights[..] else { panic!("{lights:?} {left:?}") };
    assert!(matches!(light.shape, LightShape::Mesh(_)) && light.error < 0.05 && left.is_empty(), "{light:?} {left:?}");
    let windows = WindowOptions { medians: 30.0, are_portals: true };
    let Lamps { portals, .. } = found_with(&scene, &LightOptions { windows: Some(windows), ..LightOptions::default() });
    assert!(portals.is_empty(), "{portals:?}");
}

#[test]
fn even_light_has_no_lamps_and_two_lamps_are_two() {
    assert_eq!(found(&scene(|_| ())), (Vec::new(), Vec::new()));
    let two = scene(|splats| {
        add(splats, DVec3::new(0.8, 0.0, 3.0), 0.05, LAMP);
        add(splats, DVec3::new(-0.8, 0.0, 3.0), 0.1, LAMP);
    });
    let (lights, _) = found(&two);
    assert_eq!(lights.len(), 2);
    assert!(lights[0].middle[0] < 0.0 && lights[0].intensity[0] > 3.0 * lights[1].intensity[0], "{lights:?}");
}

#[test]
fn the_map_is_between_the_cameras_and_what_they_look_at() {
    assert!(between(&arc()).distance(0.5 * (DVec3::new(0.0, 0.0, 3.0) + arc().iter().map(Camera::eye).sum::<DVec3>() / 9.0)) < 1e-6);
    let parallel = vec![room_camera([8, 8]); 3];
    assert_eq!(between(&parallel), DVec3::ZERO);
}

#[test]
fn tables_have_a_row_for_each_lamp() {
    let (lights, left_in_map) = found(&scene(|splats| add(splats, DVec3::new(0.0, 0.0, 3.0), 0.1, LAMP)));
    let shape = LightShape::Rect { size: [2.0, 1.0], normal: DVec3::Z, along: DVec3::X };
    let portals = vec![Portal { middle: [1.0, 2.0, 3.0], shape }];
    let color_space = ColorSpace::LinearRec709;
    let lights = SceneLights { lights, dome: None, unseen_share: 0.0, portals, left_in_map, color_space, cd_m2_per_unit: None };
    let table = lights_csv(&lights);
    let rows: Vec<Vec<&str>> = table.lines().map(|line| line.split(',').collect()).collect();
    assert!(rows.iter().all(|row| row.len() == rows[0].len()), "{table}");
    assert_eq!([rows[1][1], rows[2][1], rows[2][8], rows[2][10]], ["sphere", "portal", "2", ""], "{table}");
    let json = lights_json(&lights);
    assert_eq!((&json[0]["cameras"], &json[1]["shape"], &json[1]["size"]), (&9.into(), &"portal".into(), &serde_json::json!([2.0, 1.0])));
}

/// A lit sheet of 1.6 x 1, 3 in front of the cameras: between lamps and the wall in radiance.
fn window(splats: &mut Splats) {
    sheet(splats, DVec3::new(0.2, 0.1, 3.0), [0.8 * DVec3::X, 0.5 * DVec3::Y], 12, [4.0, 5.0, 6.0]);
}

#[test]
fn a_window_is_a_rectangle_with_the_radiance_that_cameras_see() {
    let scene = scene(|splats| {
        window(splats);
        add(splats, DVec3::new(-1.2, 0.3, 2.8), 0.05, LAMP);
    });
    assert_eq!(found(&scene).0.len(), 1, "not brighter than 100 medians");
    let options = LightOptions { windows: Some(WindowOptions { medians: 10.0, are_portals: false }), ..LightOptions::default() };
    let Lamps { lights, splats, left_in_map, .. } = found_with(&scene, &options);
    let [window, lamp] = &lights[..] else { panic!("{lights:?} {left_in_map:?}") };
    assert!(matches!(lamp.shape, LightShape::Sphere { .. }) && splats.len() > 100, "{lamp:?}");
    let LightShape::Rect { size, normal, along } = window.shape else { panic!("{window:?}") };
    assert!(DVec3::from_array(window.middle).distance(DVec3::new(0.2, 0.1, 3.0)) < 0.02, "{window:?}");
    assert!(normal.distance(DVec3::NEG_Z) < 0.02 && along.cross(normal).length() > 0.99, "{window:?}");
    // The splats at its edge reach half a step beyond it.
    let mut sides = size;
    sides.sort_by(f64::total_cmp);
    assert!((0.95..1.2).contains(&sides[0]) && (1.55..1.8).contains(&sides[1]), "{size:?}");
    let expected = f64::from(scene.radiance_scale.restored_value(5.0));
    assert!((window.radiance[1] / expected - 1.0).abs() < 0.12 && window.error < 0.05 && window.cameras == 9, "{window:?} {expected}");
    assert!((window.radiance[0] / window.radiance[2] - 4.0 / 6.0).abs() < 0.01, "{window:?}");
}

#[test]
fn a_portal_leaves_the_windows_light_in_the_map() {
    let options = LightOptions { windows: Some(WindowOptions { medians: 10.0, are_portals: true }), ..LightOptions::default() };
    let Lamps { lights, splats, portals, .. } = found_with(&scene(window), &options);
    assert_eq!((lights.len(), splats.len(), portals.len()), (0, 0, 1));
    let none = found_with(&scene(|splats| add(splats, DVec3::new(0.0, 0.0, 3.0), 0.08, LAMP)), &options);
    assert_eq!((none.lights.len(), none.portals.len()), (1, 0), "a lamp is no window: {:?}", none.left_in_map);
}

#[test]
fn the_lit_part_of_a_surface_is_no_window() {
    let options = LightOptions { windows: Some(WindowOptions { medians: 10.0, are_portals: false }), ..LightOptions::default() };
    let pool = scene(|splats| {
        sheet(splats, DVec3::new(0.0, 0.0, 3.4), [1.2 * DVec3::X, 1.2 * DVec3::Y], 18, [2.4; 3]);
        sheet(splats, DVec3::new(0.0, 0.0, 3.3), [0.6 * DVec3::X, 0.6 * DVec3::Y], 10, [5.0; 3]);
    });
    let medians = |medians: f64| LightOptions { windows: Some(WindowOptions { medians, are_portals: false }), ..options };
    let Lamps { lights, left_in_map, .. } = found_with(&pool, &medians(20.0));
    assert!(lights.is_empty() && left_in_map[0].contains("as on a lit surface"), "{lights:?} {left_in_map:?}");
    // The whole of it ends at the dark wall.
    assert_eq!(found_with(&pool, &medians(5.0)).lights.len(), 1);
}

#[test]
fn bent_light_is_no_window() {
    let options = LightOptions { windows: Some(WindowOptions { medians: 10.0, are_portals: false }), ..LightOptions::default() };
    // Two sheets at a right angle, which touch.
    let bent = scene(|splats| {
        sheet(splats, DVec3::new(0.0, 0.0, 3.4), [0.5 * DVec3::X, 0.5 * DVec3::Y], 10, [5.0; 3]);
        sheet(splats, DVec3::new(-0.5, 0.0, 2.9), [0.5 * DVec3::Z, 0.5 * DVec3::Y], 10, [5.0; 3]);
    });
    let Lamps { lights, left_in_map, .. } = found_with(&bent, &options);
    assert!(lights.is_empty() && left_in_map[0].contains("no window: it is not flat"), "{lights:?} {left_in_map:?}");
}
