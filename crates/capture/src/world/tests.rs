//! Cameras of known worlds, turned, scaled and disturbed, come out right.

use std::f64::consts::TAU;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::*;

const EAST_M: f64 = 111_320.0;

/// A camera at `eye` that looks along `forward` in a world in which -y is up.
fn looking(eye: DVec3, forward: DVec3, roll_rad: f64) -> WorldView {
    let forward = forward.normalize();
    // Looking straight down, the picture's top is at z.
    let level = DVec3::Y.cross(forward).try_normalize().unwrap_or(DVec3::X);
    let down = forward.cross(level);
    let (sin, cos) = roll_rad.sin_cos();
    let (right, down) = (level * cos + down * sin, down * cos - level * sin);
    let matrix3 = DMat3::from_cols(right, down, forward).transpose();
    WorldView { camera_from_world: DAffine3 { matrix3, translation: -(matrix3 * eye) }, ..WorldView::default() }
}

/// Cameras on a ring of radius 3 that look at the origin from above, rolled a little.
fn ring(count: usize) -> Vec<WorldView> {
    let mut random = Pcg64::seed_from_u64(3);
    (0..count)
        .map(|i| {
            let (sin, cos) = (TAU * i as f64 / count as f64).sin_cos();
            let eye = DVec3::new(3.0 * cos, -1.5 - 0.5 * random.random::<f64>(), 3.0 * sin);
            let jitter = DVec3::from_array(std::array::from_fn(|_| 0.1 * (random.random::<f64>() - 0.5)));
            WorldView { name: format!("v{i}"), ..looking(eye, jitter - eye, 0.1 * (random.random::<f64>() - 0.5)) }
        })
        .collect()
}

/// The arbitrary coordinates of a reconstruction.
fn disturbance() -> Similarity {
    let turn = DMat3::from_quat(DQuat::from_xyzw(0.5, -0.3, 0.6, 0.4).normalize());
    Similarity::new(turn, 0.37, DVec3::new(5.0, -2.0, 9.0)).unwrap()
}

fn disturbed(views: &[WorldView]) -> Vec<WorldView> {
    let mut out = views.to_vec();
    out.iter_mut().for_each(|view| disturbance().apply_to_pose(&mut view.camera_from_world));
    out
}

/// Angle in degrees between what was up and what is up now.
fn tilt_deg(world: &World) -> f64 {
    let up = world.transform.rotation() * (disturbance().rotation() * DVec3::NEG_Y);
    up.angle_between(DVec3::NEG_Y).to_degrees()
}

/// Returns the present place of the true origin.
fn origin(world: &World) -> DVec3 {
    world.transform.point(disturbance().point(DVec3::ZERO))
}

fn at(eye: DVec3, error: DVec3) -> GpsPosition {
    let p = eye + error;
    GpsPosition {
        latitude_deg: 40.0 + p.z / 111_035.0,
        longitude_deg: 10.0 + p.x / (EAST_M * 40f64.to_radians().cos() * 1.00138),
        altitude_m: Some(100.0 - p.y),
    }
}

#[test]
fn a_ring_of_cameras_stands_upright_about_what_it_looks_at() {
    let world = find_world(&disturbed(&ring(24)), &[], None).unwrap();
    assert_eq!((world.up, world.origin, &world.scale), (UpSource::Rights, OriginSource::ViewingRays, &ScaleSource::Unknown));
    // The mean of hand-held rolls, up to three degrees, is off by half a degree.
    assert!(tilt_deg(&world) < 1.5, "{}", tilt_deg(&world));
    assert!(origin(&world).length() < 0.03, "{}", origin(&world));
    assert_eq!((world.transform.scale(), world.metres_per_unit()), (1.0, None));
}

#[test]
fn photographs_held_upright_and_stray_cameras_do_no_harm() {
    let mut views = ring(24);
    // Every third is a portrait whose pixels lie on their side.
    for view in views.iter_mut().step_by(3) {
        let quarter = DMat3::from_cols(DVec3::Y, DVec3::NEG_X, DVec3::Z);
        view.camera_from_world.matrix3 = quarter.transpose() * view.camera_from_world.matrix3;
        view.camera_from_world.translation = quarter.transpose() * view.camera_from_world.translation;
        view.orientation = Some(6);
    }
    for (i, view) in views.iter_mut().enumerate().filter(|(i, _)| i % 8 == 1) {
        *view = looking(DVec3::new(3.0, -2.0, i as f64), DVec3::new(0.2, 1.0, 5.0), 1.3);
    }
    let world = find_world(&disturbed(&views), &[], None).unwrap();
    assert!(tilt_deg(&world) < 2.5, "{}", tilt_deg(&world));
    assert!(origin(&world).length() < 0.1, "{}", origin(&world));
}

/// Cameras of a flight 20 above the ground, in lines of eight, each looking down with a heading.
fn survey(extent: f64, heading: impl Fn(usize) -> f64) -> Vec<WorldView> {
    let mut random = Pcg64::seed_from_u64(11);
    let mut off = || 0.06 * (random.random::<f64>() - 0.5);
    (0..48)
        .map(|i| {
            let place = DVec3::new(extent * (i % 8) as f64 / 8.0, -20.0, extent * (i / 8) as f64 / 6.0);
            let down = DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y);
            let tilt = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(off(), off(), off())));
            let matrix3 = (DMat3::from_rotation_y(heading(i / 8)) * tilt * down).transpose();
            WorldView { camera_from_world: DAffine3 { matrix3, translation: -(matrix3 * place) }, ..WorldView::default() }
        })
        .collect()
}

/// Points on the ground below a flight.
fn ground(extent: f64) -> Vec<DVec3> {
    let mut random = Pcg64::seed_from_u64(12);
    let mut part = || random.random::<f64>();
    (0..400).map(|_| disturbance().point(DVec3::new(extent * part(), -0.5 * part(), extent * part()))).collect()
}

#[test]
fn up_is_behind_cameras_that_all_look_straight_down() {
    // Lines there and back, and one heading over a wide place.
    let there_and_back = survey(30.0, |line| if line % 2 == 0 { 0.0 } else { TAU / 2.0 });
    let one_heading = survey(60.0, |_| 0.7);
    for (views, extent) in [(there_and_back, 30.0), (one_heading, 60.0)] {
        let estimate = up_of_cameras(&disturbed(&views), &ground(extent));
        let up = disturbance().rotation() * DVec3::NEG_Y;
        // Each looks up to two degrees beside it; their mean does not.
        assert!(estimate.source == UpSource::LookingDown && estimate.up.angle_between(up).to_degrees() < 0.5, "{estimate:?}");
        // The ground levels them further.
        let world = find_world(&disturbed(&views), &ground(extent), None).unwrap();
        assert!(world.up == UpSource::Floor && tilt_deg(&world) < 0.5, "{world:?}");
    }
    // A few steps to and fro before a wall are no flight.
    let wall = survey(4.0, |_| 0.7);
    let world = find_world(&disturbed(&wall), &ground(4.0), None).unwrap();
    assert!(matches!(world.up, UpSource::ImageUp | UpSource::Floor), "{world:?}");
    assert!(up_of_cameras(&wall, &[]).source == UpSource::ImageUp);
}

#[test]
fn panoramas_are_upright_and_look_everywhere() {
    let mut views = ring(24);
    views.iter_mut().for_each(|view| {
        let eye = view.eye();
        *view = WorldView { is_panorama: true, ..looking(eye, DVec3::new(eye.z, 0.02, -eye.x), 0.02) };
    });
    let world = find_world(&disturbed(&views), &[], None).unwrap();
    assert_eq!((world.up, world.origin), (UpSource::Panoramas, OriginSource::Cameras));
    assert!(tilt_deg(&world) < 1.0, "{}", tilt_deg(&world));
}

#[test]
fn orientations_of_exif_give_the_same_up() {
    // Up in the picture as it is looked at, in stored pixels: x right, y down.
    let ups = [(1, DVec3::NEG_Y), (3, DVec3::Y), (6, DVec3::NEG_X), (8, DVec3::X)];
    for (orientation, up) in ups {
        let view = WorldView { orientation: Some(orientation), ..WorldView::default() };
        assert_eq!(view.axes().up, up);
        // Right, up and forward: a right-handed picture.
        assert_eq!(view.axes().right.cross(up), DVec3::NEG_Z);
    }
}

#[test]
fn a_floor_levels_cameras_that_all_look_down_the_same_way() {
    let mut random = Pcg64::seed_from_u64(5);
    let mut spread = |size: f64| size * (random.random::<f64>() - 0.5);
    let views: Vec<WorldView> = (0..12)
        .map(|_| looking(DVec3::new(spread(2.0), -2.0, -4.0 + spread(0.5)), DVec3::new(spread(0.1), 2.0, 4.0), spread(0.05)))
        .collect();
    let floor: Vec<DVec3> = (0..900).map(|_| DVec3::new(spread(6.0), spread(0.02), spread(6.0))).collect();
    let things = (0..600).map(|_| DVec3::new(spread(1.0), -0.6 + spread(1.0), spread(1.0)));
    let points: Vec<DVec3> = floor.iter().copied().chain(things.collect::<Vec<_>>()).map(|p| disturbance().point(p)).collect();
    let without = find_world(&disturbed(&views), &[], None).unwrap();
    assert_eq!(without.up, UpSource::ImageUp);
    assert!(tilt_deg(&without) > 20.0);
    let world = find_world(&disturbed(&views), &points, None).unwrap();
    assert_eq!(world.up, UpSource::Floor);
    assert!(tilt_deg(&world) < 1.0, "{}", tilt_deg(&world));
    // A wall is no floor, nor is a table top with things below it.
    let wall: Vec<DVec3> = floor.iter().map(|p| disturbance().point(DVec3::new(p.x, p.z, p.y))).collect();
    assert_ne!(find_world(&disturbed(&views), &wall, None).unwrap().up, UpSource::Floor);
    let below = floor.iter().map(|p| disturbance().point(*p + DVec3::new(0.0, 1.0, 0.0)));
    let table: Vec<DVec3> = floor.iter().take(450).map(|p| disturbance().point(*p)).chain(below).collect();
    let world = find_world(&disturbed(&views), &table, None).unwrap();
    assert!(world.up == UpSource::Floor && tilt_deg(&world) < 1.0);
}

#[test]
fn positions_by_gps_give_metres_and_north() {
    let mut random = Pcg64::seed_from_u64(11);
    let mut views = ring(30);
    let metres = 12.0;
    for view in &mut views {
        let error = DVec3::from_array(std::array::from_fn(|_| 2.0 * (random.random::<f64>() - 0.5)));
        view.gps = Some(at(view.eye() * metres, error));
    }
    // One is far off, one has none.
    views[3].gps = Some(at(DVec3::new(500.0, 0.0, -900.0), DVec3::ZERO));
    views[4].gps = None;
    let world = find_world(&disturbed(&views), &[], None).unwrap();
    let fit = world.gps.unwrap();
    assert_eq!((world.scale, fit.views), (ScaleSource::Gps, 29));
    assert!((25..29).contains(&fit.used) && fit.residual_m < 1.0, "{fit:?}");
    let factor = world.transform.scale() * disturbance().scale();
    assert!((factor / metres - 1.0).abs() < 0.02 && fit.relative_error < 0.01, "{factor} {fit:?}");
    let north = world.transform.rotation() * (disturbance().rotation() * DVec3::Z);
    assert!(north.angle_between(DVec3::Z).to_degrees() < 2.0, "{north}");
    assert!(world.transform.point(disturbance().point(DVec3::ZERO)).length() < 0.5);
}

#[test]
fn positions_that_are_too_near_each_other_say_nothing() {
    let mut random = Pcg64::seed_from_u64(12);
    let mut views = ring(30);
    for view in &mut views {
        let error = DVec3::from_array(std::array::from_fn(|_| 8.0 * (random.random::<f64>() - 0.5)));
        view.gps = Some(at(view.eye() * 0.5, error));
    }
    let world = find_world(&disturbed(&views), &[], None).unwrap();
    assert_eq!((&world.scale, world.gps), (&ScaleSource::Unknown, None));
    assert!(world.gps_unused.unwrap().contains("expected 2 m or more"), "too near");
    views.iter_mut().for_each(|view| view.gps = Some(at(DVec3::ZERO, DVec3::ZERO)));
    assert_eq!(find_world(&disturbed(&views), &[], None).unwrap().scale, ScaleSource::Unknown);
    views.iter_mut().skip(2).for_each(|view| view.gps = None);
    let reason = find_world(&disturbed(&views), &[], None).unwrap().gps_unused.unwrap();
    assert!(reason.starts_with("2 of the views"), "{reason}");
}

/// A flight that looks straight down with one heading.
fn flight() -> Vec<WorldView> {
    (0..25).map(|i| looking(DVec3::new(f64::from(i % 5), -4.0, f64::from(i / 5)), DVec3::Y, 0.0)).collect()
}

#[test]
fn a_drone_that_looks_straight_down_is_above_the_ground() {
    // Nothing but the cameras: images lie flat, and so does the world.
    let world = find_world(&disturbed(&flight()), &[], None).unwrap();
    assert_eq!((world.up, world.origin), (UpSource::ImageUp, OriginSource::Cameras));
    // By what the files state, or by positions.
    let stated: Vec<WorldView> = flight().into_iter().map(|view| WorldView { pitch_deg: Some(-90.0), ..view }).collect();
    let world = find_world(&disturbed(&stated), &[], None).unwrap();
    assert!(world.up == UpSource::StatedPitch && tilt_deg(&world) < 1e-6, "{world:?}");
    let by_gps: Vec<WorldView> =
        flight().into_iter().map(|view| WorldView { gps: Some(at(view.eye() * 20.0, DVec3::ZERO)), ..view }).collect();
    let world = find_world(&disturbed(&by_gps), &[], None).unwrap();
    assert!(world.up == UpSource::Gps && tilt_deg(&world) < 0.5 && world.metres_per_unit() == Some(1.0), "{world:?}");
    // Headings all around show the plane of the ground, and looking tells above from below.
    let mut turned = flight();
    turned.iter_mut().enumerate().for_each(|(i, view)| *view = looking(view.eye(), DVec3::Y, i as f64));
    let world = find_world(&disturbed(&turned), &[], None).unwrap();
    assert!(world.up == UpSource::Rights && tilt_deg(&world) < 1e-6, "{world:?}");
}

#[test]
fn one_camera_a_line_and_none_have_what_is_left() {
    let none = find_world(&[], &[], None).unwrap();
    assert!(none.transform.is_identity() && none.up == UpSource::Unknown);
    let one = vec![looking(DVec3::new(1.0, 2.0, 3.0), DVec3::Z, 0.0)];
    let points: Vec<DVec3> = (0..9).map(|i| disturbance().point(DVec3::new(1.0, 2.0, f64::from(i)))).collect();
    let world = find_world(&disturbed(&one), &points, None).unwrap();
    assert_eq!((world.up, world.origin), (UpSource::ImageUp, OriginSource::Points));
    assert!(tilt_deg(&world) < 1e-6);
    // In a line, all looking across it.
    let line: Vec<WorldView> = (0..10).map(|i| looking(DVec3::new(f64::from(i), 0.0, 0.0), DVec3::Z, 0.0)).collect();
    let world = find_world(&disturbed(&line), &[], None).unwrap();
    assert!(world.up == UpSource::ImageUp && world.origin == OriginSource::Cameras && tilt_deg(&world) < 1e-6);
    // In a room, looking outwards.
    let out: Vec<WorldView> = (0..12)
        .map(|i| {
            let (sin, cos) = (TAU * f64::from(i) / 12.0).sin_cos();
            looking(DVec3::new(cos, 0.0, sin), DVec3::new(cos, 0.1, sin), 0.0)
        })
        .collect();
    let world = find_world(&disturbed(&out), &[], None).unwrap();
    assert!(world.origin == OriginSource::Cameras && tilt_deg(&world) < 1e-6, "{world:?}");
}

#[test]
fn a_known_distance_gives_metres() {
    let views = disturbed(&ring(24));
    let known = KnownScale::Distance("v0,v12,1.5".parse().unwrap());
    let world = find_world(&views, &[], Some(&known)).unwrap();
    let eye = |i: usize| world.transform.point(views[i].eye());
    assert!((eye(0).distance(eye(12)) - 1.5).abs() < 1e-9 && world.metres_per_unit() == Some(1.0));
    // Points are in the coordinates that the set has without it.
    let without = find_world(&views, &[], None).unwrap();
    let [a, b] = [0, 12].map(|i| without.transform.point(views[i].eye()));
    let by_points = KnownScale::Distance(format!("{},{},{},{},{},{},1.5", a.x, a.y, a.z, b.x, b.y, b.z).parse().unwrap());
    let same = find_world(&views, &[], Some(&by_points)).unwrap();
    assert!((same.transform.scale() / world.transform.scale() - 1.0).abs() < 1e-9);
    let refused = |text: &str| find_world(&views, &[], Some(&KnownScale::Distance(text.parse().unwrap()))).unwrap_err().message;
    assert!(refused("v0,v99,1").contains("no view v99 has a pose; those that have one: v0, v1, v2, ..."));
    assert!(refused("v0,v0,1").contains("in the same place"));
}

#[test]
fn markers_give_metres_whatever_gps_says() {
    let fit = MarkerFit { markers: 2, edge_m: 0.1, metres_per_unit: 0.25, deviation: 0.0 };
    for views in [ring(24), flight()] {
        let disturbed = disturbed(&views);
        let world = find_world(&disturbed, &[], Some(&KnownScale::Markers(fit))).unwrap();
        assert!((world.transform.scale() - 0.25).abs() < 1e-9 && world.metres_per_unit() == Some(1.0));
    }
}

#[test]
fn distances_are_parsed_or_refused() {
    let parse = |text: &str| text.parse::<KnownDistance>();
    assert_eq!(parse("a,1,2,3,4").unwrap().ends, [Landmark::View("a".into()), Landmark::Point(DVec3::new(1.0, 2.0, 3.0))]);
    assert_eq!(parse("1,2,3,b.jpg,4").unwrap().ends, [Landmark::Point(DVec3::new(1.0, 2.0, 3.0)), Landmark::View("b.jpg".into())]);
    assert_eq!(parse("1,2,0.5").unwrap().ends, [Landmark::View("1".into()), Landmark::View("2".into())]);
    for bad in ["", "a,b", "a,b,0", "a,b,-1", "a,b,nan", "a,b,c", "a,,2", "1,2,3,4,5", "1,2,x,4,5,6,7", "a,b,c,d,e,1"] {
        assert!(parse(bad).is_err(), "{bad}");
    }
}
