//! A mesh as binary glTF.
//!
//! `_RADIANCE` holds the radiance as it is, in the colour space that `extras` names. `COLOR_0`,
//! which viewers show, is linear Rec.709 and no more than 1, as glTF demands. The material is
//! unlit: the colours are light already.

use std::io::{self, BufWriter, Write};
use std::path::Path;

use luxel_core::{ColorSpace, Conversion};
use serde_json::{Value, json};

use super::MeshFile;
use crate::IoError;
use crate::gltf::{CHUNK_BIN, CHUNK_JSON, FLOAT, GLB_MAGIC};

const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
const UNLIT: &str = "KHR_materials_unlit";

/// A file whose sizes are known.
pub(super) struct GlbMesh<'a> {
    mesh: &'a MeshFile<'a>,
    json: Vec<u8>,
    bin_bytes: u32,
    file_bytes: u32,
}

impl<'a> GlbMesh<'a> {
    /// Lays a file out.
    ///
    /// # Errors
    /// More than the 4 GiB that the format holds.
    pub(super) fn new(name: &Path, mesh: &'a MeshFile<'a>) -> Result<Self, IoError> {
        let mut json = serde_json::to_vec(&document(mesh)).map_err(|e| IoError::invalid(name, e))?;
        json.resize(json.len().next_multiple_of(4), b' ');
        let bin = (VERTEX_ARRAYS.len() * 12 * mesh.positions.len() + 12 * mesh.triangles.len()) as u64;
        let file = 12 + 8 + json.len() as u64 + 8 + bin;
        let (Ok(bin_bytes), Ok(file_bytes)) = (u32::try_from(bin), u32::try_from(file)) else {
            let message = format!("{file} bytes, of which binary glTF holds 4 GiB; write another format, or fewer triangles");
            return Err(IoError::unsupported(name, message));
        };
        Ok(Self { mesh, json, bin_bytes, file_bytes })
    }

    /// Writes the file.
    pub(super) fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut out = BufWriter::new(out);
        for word in [GLB_MAGIC, 2, self.file_bytes, self.json.len() as u32, CHUNK_JSON] {
            out.write_all(&word.to_le_bytes())?;
        }
        out.write_all(&self.json)?;
        for word in [self.bin_bytes, CHUNK_BIN] {
            out.write_all(&word.to_le_bytes())?;
        }
        let mesh = self.mesh;
        let shown = |radiance: &[f32; 3]| shown(mesh.color_space, *radiance);
        let colors: Vec<[f32; 3]> = mesh.radiance.iter().map(shown).collect();
        for rows in [mesh.positions, mesh.normals, &colors, mesh.radiance] {
            rows.iter().try_for_each(|row| out.write_all(&row.map(f32::to_le_bytes).concat()))?;
        }
        mesh.triangles.iter().try_for_each(|triangle| out.write_all(&triangle.map(u32::to_le_bytes).concat()))?;
        out.flush()
    }
}

/// Arrays of the vertices, in the order of the buffer.
const VERTEX_ARRAYS: [&str; 4] = ["POSITION", "NORMAL", "COLOR_0", "_RADIANCE"];

/// Returns the colour that viewers show for a radiance.
fn shown(space: ColorSpace, radiance: [f32; 3]) -> [f32; 3] {
    let conversion = Conversion::between(space, ColorSpace::LinearRec709);
    conversion.apply(space.towards(ColorSpace::LinearRec709, radiance)).map(|c| c.clamp(0.0, 1.0))
}

fn document(mesh: &MeshFile<'_>) -> Value {
    let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
    let mut views: Vec<Value> = (0..VERTEX_ARRAYS.len())
        .map(|n| json!({ "buffer": 0, "byteOffset": 12 * vertices * n, "byteLength": 12 * vertices, "target": ARRAY_BUFFER }))
        .collect();
    let offset = 12 * vertices * VERTEX_ARRAYS.len();
    views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": 12 * triangles, "target": ELEMENT_ARRAY_BUFFER }));
    let mut accessors: Vec<Value> =
        (0..VERTEX_ARRAYS.len()).map(|n| json!({ "bufferView": n, "componentType": FLOAT, "count": vertices, "type": "VEC3" })).collect();
    let [low, high] = mesh.bounds();
    (accessors[0]["min"], accessors[0]["max"]) = (json!(low), json!(high));
    accessors.push(json!({ "bufferView": VERTEX_ARRAYS.len(), "componentType": UNSIGNED_INT, "count": 3 * triangles, "type": "SCALAR" }));
    let attributes: serde_json::Map<String, Value> =
        VERTEX_ARRAYS.iter().enumerate().map(|(n, name)| ((*name).to_owned(), n.into())).collect();
    let mut node = json!({ "mesh": 0, "name": "Mesh" });
    if mesh.is_moved() {
        node["translation"] = json!(mesh.translation);
    }
    let extras = json!({ "documentation": mesh.documentation(), "radianceColorSpace": mesh.color_space.name(), "metresPerUnit": mesh.metres_per_unit });
    let white = json!({ "baseColorFactor": [1, 1, 1, 1], "metallicFactor": 0, "roughnessFactor": 1 });
    json!({
        "asset": { "version": "2.0", "generator": "Luxel", "extras": extras },
        "extensionsUsed": [UNLIT],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [node],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": VERTEX_ARRAYS.len(), "material": 0, "mode": 4 }] }],
        "materials": [{ "name": "Radiance", "doubleSided": true, "pbrMetallicRoughness": white, "extensions": { UNLIT: {} } }],
        "buffers": [{ "byteLength": offset + 12 * triangles }],
        "bufferViews": views,
        "accessors": accessors,
    })
}
