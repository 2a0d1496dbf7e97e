//! Lights beside splats.

use glam::DVec3;
use luxel_core::ColorSpace;

use super::{baked, name};
use crate::lights::{LightShape, StageDome, StageLight, StageLights};
use crate::usd::{PackagedFile, decode_usda, decode_usdc, encode_usdc, write_usda, write_usdc, write_usdz};

fn lights() -> StageLights {
    StageLights {
        lights: vec![
            StageLight { middle: DVec3::new(1.0, 2.0, 3.0), shape: LightShape::Sphere { radius: 0.5 }, radiance: [4.0, 2.0, 1.0] },
            StageLight {
                middle: DVec3::Y,
                shape: LightShape::Rect { size: [2.0, 1.0], normal: DVec3::NEG_Y, along: DVec3::X },
                radiance: [1.0, 2.0, 4.0],
            },
        ],
        dome: Some(StageDome { texture: "./lights_dome.exr".into() }),
        portals: Vec::new(),
        metres_per_unit: None,
        cd_m2_per_unit: None,
        color_space: ColorSpace::AcesCg,
    }
}

#[test]
fn splats_beside_lights_read_back_as_without_them() {
    let folder = tempfile::tempdir().unwrap();
    let baked = baked(ColorSpace::AcesCg);
    let expected = decode_usdc(name(), &encode_usdc(name(), &baked).unwrap()).unwrap();
    let without_lamps = StageLights { lights: Vec::new(), dome: None, ..lights() };
    for (i, lights) in [lights(), without_lamps].iter().enumerate() {
        let path = |extension: &str| folder.path().join(format!("{i}.{extension}"));
        write_usda(&path("usda"), &baked, Some(lights)).unwrap();
        write_usdc(&path("usdc"), &baked, Some(lights)).unwrap();
        write_usdz(&path("usdz"), &baked, Some(lights), None).unwrap();
        assert_eq!(decode_usda(name(), &std::fs::read(path("usda")).unwrap()).unwrap(), expected);
        assert_eq!(crate::read_scene(&path("usdc")).unwrap(), expected);
        assert_eq!(crate::read_scene(&path("usdz")).unwrap(), expected);
    }
}

#[test]
fn text_has_the_lights_beside_the_splats() {
    let folder = tempfile::tempdir().unwrap();
    let text = folder.path().join("a.usda");
    write_usda(&text, &baked(ColorSpace::AcesCg), Some(&lights())).unwrap();
    let text = std::fs::read_to_string(&text).unwrap();
    for expected in [
        "defaultPrim = \"Scene\"",
        "    def Xform \"Lights\" (\n        doc = \"Lights by Luxel: intensity times colour is radiance in the units of the data set, lin_ap1_scene\"",
        "        def RectLight \"Lamp_2\"",
        "            float inputs:intensity = 4\n",
        "asset inputs:texture:file = @@@./lights_dome.exr@@@",
    ] {
        assert!(text.contains(expected), "{expected}");
    }
}

#[test]
fn a_package_holds_the_map_behind_the_layer() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.usdz");
    let map = PackagedFile { name: "lights_dome.exr".into(), bytes: b"the bytes of a map".to_vec() };
    write_usdz(&path, &baked(ColorSpace::AcesCg), Some(&lights()), Some(&map)).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let at = bytes.windows(map.bytes.len()).position(|window| window == map.bytes).unwrap();
    assert!(at.is_multiple_of(64));
    // The end names two entries, and where the directory begins with its first one.
    let end = &bytes[bytes.len() - 22..];
    assert_eq!((&end[..4], &end[8..12]), (&b"PK\x05\x06"[..], &[2, 0, 2, 0][..]));
    let directory = u32::from_le_bytes(end[16..20].try_into().unwrap()) as usize;
    assert!(bytes[directory..].starts_with(b"PK\x01\x02"));
}
