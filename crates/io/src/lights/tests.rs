use glam::DVec3;
use luxel_core::ColorSpace;

use super::*;

fn lights() -> StageLights {
    let normal = DVec3::new(0.0, -0.8, 0.6);
    StageLights {
        lights: vec![
            StageLight { middle: DVec3::new(1.0, 2.0, 3.0), shape: LightShape::Sphere { radius: 0.048 }, radiance: [170.0, 126.0, 71.0] },
            StageLight { middle: DVec3::ZERO, shape: LightShape::Disk { radius: 0.1, normal }, radiance: [10.0, 20.0, 5.0] },
            StageLight {
                middle: DVec3::Y,
                shape: LightShape::Rect { size: [2.0, 1.0], normal, along: DVec3::X },
                radiance: [1.0, 2.0, 4.0],
            },
        ],
        dome: Some(StageDome { texture: "./a@b.exr".into() }),
        portals: Vec::new(),
        metres_per_unit: Some(0.5),
        cd_m2_per_unit: Some(1.0),
        color_space: ColorSpace::LinearRec709,
    }
}

#[test]
fn lamps_shine_along_their_normals() {
    for light in lights().lights {
        let axes = light.shape.axes();
        assert!((axes.determinant() - 1.0).abs() < 1e-12, "{axes}");
        match light.shape {
            LightShape::Sphere { .. } | LightShape::Mesh(_) => {}
            LightShape::Disk { normal, .. } | LightShape::Rect { normal, .. } => assert!((axes * DVec3::NEG_Z).distance(normal) < 1e-12),
        }
    }
}

#[test]
fn a_layer_holds_radiance_as_intensity_times_colour() {
    let text = stage_lights_text(&lights());
    for expected in [
        "upAxis = \"Y\"",
        "metersPerUnit = 0.5",
        "radiance in cd/m2 (nits), lin_rec709_scene",
        "def SphereLight \"Lamp_1\"",
        "float inputs:intensity = 170\n",
        "color3f inputs:color = (1, 0.7411764705882353, 0.4176470588235294) (",
        "bool inputs:normalize = 0",
        "float inputs:radius = 0.048",
        "( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (1, 2, 3, 1) )",
        "def DiskLight \"Lamp_2\"",
        "def RectLight \"Lamp_3\"",
        "float inputs:height = 1\n        float inputs:width = 2\n",
        "asset inputs:texture:file = @@@./a@b.exr@@@",
    ] {
        assert!(text.contains(expected), "{expected} in\n{text}");
    }
    let none = StageLights { lights: Vec::new(), dome: None, metres_per_unit: None, cd_m2_per_unit: None, ..lights() };
    let text = stage_lights_text(&none);
    assert!(text.contains("metersPerUnit is not measured") && text.contains("radiance in the units of the data set"));
}

#[test]
fn portals_belong_to_the_map() {
    let shape = LightShape::Rect { size: [2.0, 1.0], normal: DVec3::NEG_Z, along: DVec3::X };
    let portals = vec![StagePortal { middle: DVec3::Y, shape }; 2];
    let text = stage_lights_text(&StageLights { portals: portals.clone(), ..lights() });
    assert!(text.contains("def PortalLight \"Portal_2\"") && text.contains("rel portals = [<../Portal_1>, <../Portal_2>]"), "{text}");
    let without_map = stage_lights_text(&StageLights { portals, dome: None, ..lights() });
    assert!(!without_map.contains("ortal"), "{without_map}");
}

/// A tetrahedron of which an area of 0.5 is seen.
pub(crate) fn mesh_lamp() -> StageLight {
    let mesh = LightMesh {
        points: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
        mean_area: 0.5,
    };
    StageLight { middle: DVec3::new(1.0, 2.0, 3.0), shape: LightShape::Mesh(mesh), radiance: [40.0, 20.0, 10.0] }
}

#[test]
fn meshes_shine_as_lights_and_by_their_material_elsewhere() {
    let text = stage_lights_text(&StageLights { lights: vec![mesh_lamp()], ..lights() });
    for expected in [
        "def Mesh \"Lamp_1\" (\n        prepend apiSchemas = [\"MeshLightAPI\", \"MaterialBindingAPI\"]\n    )",
        "float3[] extent = [(0, 0, 0), (1, 1, 1)]",
        "float inputs:intensity = 40\n",
        "uniform token light:materialSyncMode = \"noMaterialResponse\"",
        "int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3]",
        "point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]",
        "rel material:binding = <Glow>",
        "token outputs:surface.connect = <Surface.outputs:surface>",
        "color3f inputs:emissiveColor = (40, 20, 10) (",
    ] {
        assert!(text.contains(expected), "{expected} in\n{text}");
    }
}

#[test]
fn meshes_are_turned_and_scaled() {
    let LightShape::Mesh(mesh) = mesh_lamp().shape.turned(DMat3::from_rotation_z(std::f64::consts::FRAC_PI_2)).scaled(2.0) else {
        panic!("another shape")
    };
    assert!(mesh.points[1].distance(2.0 * DVec3::Y) < 1e-12 && mesh.points[2].distance(-2.0 * DVec3::X) < 1e-12, "{mesh:?}");
    assert_eq!((mesh.mean_area, mesh.bounds()[0].x.round()), (2.0, -2.0));
}

#[test]
fn gltf_has_candela() {
    let bytes = encode_lights_glb(Path::new("a.glb"), &lights()).unwrap();
    assert_eq!(bytes.len() % 4, 0);
    let document: serde_json::Value = serde_json::from_slice(&bytes[20..]).unwrap();
    let found = &document["extensions"]["KHR_lights_punctual"]["lights"];
    let candela = 170.0 * std::f64::consts::PI * 0.048 * 0.048;
    assert!((found[0]["intensity"].as_f64().unwrap() / candela - 1.0).abs() < 1e-12 && found[0]["type"] == "point");
    assert_eq!((found[2]["intensity"].as_f64().unwrap(), found[2]["type"].as_str().unwrap()), (8.0, "spot"));
    assert_eq!(document["nodes"][0]["translation"], serde_json::json!([1.0, 2.0, 3.0]));
    let mesh = encode_lights_glb(Path::new("a.glb"), &StageLights { lights: vec![mesh_lamp()], ..lights() }).unwrap();
    let mesh: serde_json::Value = serde_json::from_slice(&mesh[20..]).unwrap();
    let mesh = &mesh["extensions"]["KHR_lights_punctual"]["lights"][0];
    assert_eq!((&mesh["type"], &mesh["intensity"], &mesh["extras"]["shape"]), (&"point".into(), &20.0.into(), &"mesh".into()));
    let none = encode_lights_glb(Path::new("a.glb"), &StageLights { lights: Vec::new(), ..lights() }).unwrap();
    assert!(!String::from_utf8(none[20..].to_vec()).unwrap().contains("extensions"));
}

#[test]
fn lamps_are_written_by_the_ending() {
    let folder = tempfile::tempdir().unwrap();
    write_lights(&folder.path().join("a/lights.usda"), &lights()).unwrap();
    write_lights(&folder.path().join("lights.glb"), &lights()).unwrap();
    let error = write_lights(&folder.path().join("lights.obj"), &lights()).unwrap_err();
    assert!(error.to_string().ends_with("not a format of lamps, expected .usda or .glb"), "{error}");
}
