//! Cameras of binary layers, against the same as text.

use glam::DVec3;
use proptest::prelude::*;

use super::super::decode_usd_cameras;
use super::*;

/// A layer that `usd-core` 26.11 wrote, and its `Sdf.Layer.Export` in the binary form: prims within
/// prims, samples over time, an operation that is undone, a stack that is reset, a class.
const TEXT: &str = include_str!("cameras.usda");
const BINARY: &str = include_str!("cameras.hex");

#[test]
fn cameras_of_binary_files_and_packages_are_those_of_text() {
    let (text, binary) = (decode_usd_cameras(name(), TEXT.as_bytes()).unwrap(), decode_usd_cameras(name(), &unhex(BINARY)).unwrap());
    let names = |layer: &UsdCameras| layer.cameras.iter().map(|camera| camera.path.clone()).collect::<Vec<_>>();
    assert_eq!(names(&binary), ["/World/Rig/moving", "/World/Rig/still", "/flat"]);
    assert_eq!(binary, text);
    assert_eq!((binary.meters_per_unit, binary.up_axis.as_str()), (0.1, "Z"));
    let moving = &binary.cameras[0];
    assert_eq!(moving.times(), [1.0, 2.5, 3.0]);
    let at = moving.at(Some(2.0)).unwrap();
    assert!((at.focal - 42.75 / 36.0).abs() < 1e-9 && (at.shift[0] + 0.25 / 36.0).abs() < 1e-9, "{at:?}");
    // The operations of the prims around are left out.
    assert_eq!(binary.cameras[1].at(None).unwrap().eye, DVec3::new(7.0, 8.0, 9.0));
    let mut package = Vec::new();
    let part = binary::PackagePart { name: "cameras.usdc", write: &|out| out.write_all(&unhex(BINARY)) };
    binary::write_package(&mut package, &[part]).unwrap();
    assert_eq!(decode_usd_cameras(name(), &package).unwrap(), text);
}

#[test]
fn written_cameras_are_read_back() {
    use crate::{PathCamera, StageCameras, StageChoice, StageMotion, decode_stage_cameras, stage_cameras_text};
    let camera = |i: u32| {
        let rotation = glam::DQuat::from_euler(glam::EulerRot::XYZ, 0.3 * f64::from(i), -0.2, 1.1);
        let camera_from_world = glam::DAffine3::from_rotation_translation(rotation, DVec3::new(1.0, -2.5e3, 0.1 * f64::from(i)));
        let camera = luxel_core::Camera {
            camera_from_world,
            focal_px: glam::DVec2::new(100.0 / 3.0, 41.7 + f64::from(i)),
            center_px: glam::DVec2::new(20.25, 14.0),
            size_px: [40, 30],
            distortion: luxel_core::Distortion::default(),
            projection: luxel_core::CameraProjection::Pinhole,
        };
        PathCamera { focus_distance: Some(0.5 * f64::from(i + 1)), ..PathCamera::new(format!("{i} a"), camera) }
    };
    let written = StageCameras { cameras: (0..3).map(camera).collect(), metres_per_unit: Some(0.3), is_z_up: true };
    let read = |motion| {
        let text = stage_cameras_text(name(), &written, motion).unwrap();
        decode_stage_cameras(name(), text.as_bytes(), StageChoice::default()).unwrap()
    };
    let (still, moving) = (read(StageMotion::Still), read(StageMotion::Moving { frames_per_second: 25.0 }));
    let names = |cameras: &StageCameras| cameras.cameras.iter().map(|named| named.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&still), ["_0_a", "_1_a", "_2_a"]);
    assert_eq!(names(&moving), ["shot.0000", "shot.0001", "shot.0002"]);
    for found in [&still, &moving] {
        assert_eq!((found.metres_per_unit, found.is_z_up), (Some(0.3), true));
        for (found, written) in found.cameras.iter().zip(&written.cameras) {
            assert_eq!(found.focus_distance, written.focus_distance);
            let (found, written) = (&found.camera, &written.camera);
            assert_eq!(found.size_px, written.size_px);
            assert!((found.focal_px - written.focal_px).length() < 1e-5 && (found.center_px - written.center_px).length() < 1e-5);
            // Eyes are thousands of units from the origin.
            assert!(found.camera_from_world.abs_diff_eq(written.camera_from_world, 1e-9), "{found:?}\n{written:?}");
        }
    }
}

#[test]
fn lenses_are_in_tenths_of_a_unit() {
    use crate::{PathCamera, StageCameras, StageMotion, stage_cameras_text};
    let camera = luxel_core::Camera {
        camera_from_world: glam::DAffine3::IDENTITY,
        focal_px: glam::DVec2::splat(50.0),
        center_px: glam::DVec2::splat(25.0),
        size_px: [50, 50],
        distortion: luxel_core::Distortion::default(),
        projection: luxel_core::CameraProjection::Pinhole,
    };
    // A lens of 36 mm behind 36 mm of film, in metres, centimetres and an unknown unit.
    for (metres_per_unit, length) in [(Some(1.0), "0.36"), (Some(0.01), "36"), (None, "0.36")] {
        let cameras = StageCameras { cameras: vec![PathCamera::new("a", camera.clone())], metres_per_unit, is_z_up: false };
        let text = stage_cameras_text(name(), &cameras, StageMotion::Still).unwrap();
        for property in ["focalLength", "horizontalAperture", "verticalAperture"] {
            assert!(text.contains(&format!("float {property} = {length}\n")), "{property} {length}\n{text}");
        }
    }
}

#[test]
fn ranges_of_time_are_bounded() {
    use crate::{StageChoice, decode_stage_cameras};
    let frames = |range: &str| {
        let text = format!(
            "#usda 1.0\n(\n{range}\n)\ndef Camera \"c\" {{\n double3 xformOp:translate.timeSamples = {{ 0.25: (0, 0, 0), 0.75: (1, 0, 0) }}\n \
             uniform token[] xformOpOrder = [\"xformOp:translate\"]\n}}\n"
        );
        let choice = StageChoice { camera: None, size_px: Some([8, 8]) };
        decode_stage_cameras(name(), text.as_bytes(), choice)
            .map(|found| found.cameras.into_iter().map(|named| named.name).collect::<Vec<_>>())
    };
    // No whole time code: the samples themselves.
    assert_eq!(frames("").unwrap(), ["c.0_25", "c.0_75"]);
    assert_eq!(frames("    startTimeCode = 9\n    endTimeCode = 11").unwrap(), ["c.0009", "c.0010", "c.0011"]);
    assert_eq!(frames("    startTimeCode = 3\n    endTimeCode = 1").unwrap(), ["c.0_25", "c.0_75"]);
    // Where adding 1 changes nothing.
    assert_eq!(frames("    startTimeCode = 1e300\n    endTimeCode = 1e300").unwrap().len(), 1);
    assert!(frames("    startTimeCode = 0\n    endTimeCode = 1e9").unwrap_err().message.contains("expected at most 100000"));
}

#[test]
fn damaged_layers_with_cameras_are_errors() {
    let bytes = unhex(BINARY);
    for length in 8..bytes.len() {
        assert!(decode_usd_cameras(name(), &bytes[..length]).is_err(), "{length}");
    }
    let neither = decode_usd_cameras(name(), b"#usdb 1.0").unwrap_err();
    assert!(neither.message.contains("neither text nor binary"), "{neither}");
}

proptest! {
    #[test]
    fn changed_layers_with_cameras_do_not_crash(changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8)) {
        let mut bytes = unhex(BINARY);
        for (at, value) in changes {
            let place = at.index(bytes.len());
            bytes[place] = value;
        }
        if let Ok(layer) = decode_usd_cameras(name(), &bytes) {
            for time in [None, Some(1.5)] {
                prop_assert!(layer.eyes_at(time).iter().all(|eye| eye.is_finite()));
            }
        }
    }
}
