//! Files of meshes, read back by the formats' own rules.

use super::*;

const POSITIONS: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.5]];
const NORMALS: [[f32; 3]; 4] = [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
const RADIANCE: [[f32; 3]; 4] = [[170.5, 1e-7, 0.0], [0.5, 0.25, 0.125], [1.0, 2.0, 3.0], [0.1, 0.2, 0.3]];
const TRIANGLES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];

fn mesh() -> MeshFile<'static> {
    MeshFile {
        positions: &POSITIONS,
        normals: &NORMALS,
        radiance: &RADIANCE,
        triangles: &TRIANGLES,
        translation: [0.0; 3],
        metres_per_unit: Some(0.01),
        color_space: ColorSpace::LinearRec709,
    }
}

/// Returns the bytes of a file.
fn written(mesh: &MeshFile<'_>, extension: &str) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(format!("mesh.{extension}"));
    write_mesh(&path, mesh, MeshFormat::from_path(&path).unwrap()).unwrap();
    std::fs::read(&path).unwrap()
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks::<4>().0.iter().map(|float| f32::from_le_bytes(*float)).collect()
}

#[test]
fn text_of_openusd_states_unit_axis_colours_and_faces() {
    let text = String::from_utf8(written(&mesh(), "usda")).unwrap();
    for line in [
        "    metersPerUnit = 0.01",
        "    upAxis = \"Y\"",
        "def Mesh \"Mesh\" (",
        "    uniform token colorSpace:name = \"lin_rec709_scene\"",
        "    uniform token subdivisionScheme = \"none\"",
        "    float3[] extent = [(0, 0, 0), (1, 2, 3.5)]",
        "    int[] faceVertexCounts = [3, 3, 3, 3]",
        "    int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]",
        "    color3f[] primvars:displayColor = [(170.5, 1e-7, 0), (0.5, 0.25, 0.125), (1, 2, 3), (0.1, 0.2, 0.3)] (",
        "        interpolation = \"vertex\"",
    ] {
        assert!(text.lines().any(|found| found == line), "{line}\n{text}");
    }
    assert!(!text.contains("xformOp"));
    let moved = String::from_utf8(written(&MeshFile { translation: [4e6, 0.5, 0.0], ..mesh() }, "usda")).unwrap();
    assert!(moved.contains("double3 xformOp:translate = (4000000, 0.5, 0)"), "{moved}");
}

#[test]
fn binary_openusd_holds_the_arrays_and_a_package_holds_it() {
    let layer = written(&mesh(), "usdc");
    assert!(layer.starts_with(b"PXR-USDC"));
    for array in [POSITIONS, NORMALS, RADIANCE] {
        let bytes: Vec<u8> = array.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
        assert!(layer.windows(bytes.len()).any(|found| found == bytes), "{array:?}");
    }
    let package = written(&mesh(), "usdz");
    assert_eq!((&package[30..39], &package[64..64 + layer.len()]), (&b"mesh.usdc"[..], &layer[..]));
}

#[test]
fn binary_gltf_has_radiance_beside_colours_that_viewers_take() {
    let bytes = written(&mesh(), "glb");
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&bytes[..4], word(8)), (&b"glTF"[..], bytes.len()));
    let json: serde_json::Value = serde_json::from_slice(&bytes[20..20 + word(12)]).unwrap();
    let buffer = &bytes[28 + word(12)..];
    let view = |n: usize| {
        let view = &json["bufferViews"][n];
        let [offset, length] = ["byteOffset", "byteLength"].map(|name| view[name].as_u64().unwrap() as usize);
        &buffer[offset..offset + length]
    };
    let of = |name: &str| floats(view(json["meshes"][0]["primitives"][0]["attributes"][name].as_u64().unwrap() as usize));
    assert_eq!((of("POSITION"), of("NORMAL")), (POSITIONS.as_flattened().to_vec(), NORMALS.as_flattened().to_vec()));
    assert_eq!(of("_RADIANCE"), RADIANCE.as_flattened());
    assert_eq!(of("COLOR_0"), RADIANCE.as_flattened().iter().map(|c| c.clamp(0.0, 1.0)).collect::<Vec<f32>>());
    let indices: Vec<u8> = TRIANGLES.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(view(4), indices);
    assert_eq!(json["accessors"][0]["max"], serde_json::json!([1.0, 2.0, 3.5]));
}

#[test]
fn ply_holds_vertices_and_faces_and_doubles_where_it_is_moved() {
    for (translation, position_bytes) in [([0.0; 3], 12), ([1e7, 0.0, 0.0], 24)] {
        let bytes = written(&MeshFile { translation, ..mesh() }, "ply");
        let start = bytes.windows(11).position(|found| found == b"end_header\n").unwrap() + 11;
        let header = String::from_utf8(bytes[..start].to_vec()).unwrap();
        assert!(header.contains("element vertex 4\n") && header.contains("property float red\n"), "{header}");
        assert_eq!(header.contains("property double x"), position_bytes == 24);
        let body = &bytes[start..];
        assert_eq!(body.len(), 4 * (position_bytes + 24) + 4 * 13);
        assert_eq!(floats(&body[position_bytes + 12..position_bytes + 24]), RADIANCE[0]);
        assert_eq!(body[body.len() - 13], 3);
    }
}

#[test]
fn obj_counts_vertices_from_one() {
    let text = String::from_utf8(written(&mesh(), "obj")).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert!(lines.contains(&"v 0 0 0 170.5 0.0000001 0") && lines.contains(&"vn 0 0 -1") && lines.contains(&"f 1//1 3//3 2//2"), "{text}");
}

#[test]
fn meshes_that_do_not_go_together_are_errors() {
    let path = Path::new("a.ply");
    let refused = |mesh: MeshFile<'_>| write_mesh(path, &mesh, MeshFormat::Ply).unwrap_err().to_string();
    assert!(refused(MeshFile { triangles: &[], ..mesh() }).contains("without triangles"));
    assert!(refused(MeshFile { normals: &NORMALS[..2], ..mesh() }).contains("expected 4"));
    assert!(refused(MeshFile { triangles: &[[0, 1, 4]], ..mesh() }).contains("vertex 4"));
    assert_eq!((MeshFormat::from_path(Path::new("a.stl")), MeshFormat::from_path(Path::new("a"))), (None, None));
}
